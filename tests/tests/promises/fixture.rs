//! What the promises share: domains, processes, and an observer of the commands.

use std::process::{Command, Stdio};
use std::time::Duration;

pub use crate::limits::{assert_within_limits, is_still, speed};
use ipc::{Domain, Observer, OperatorPorts, now_ns};
use messages::{Action, CycleRecord, Outcome, Request, TwistCommand};
pub use testkit::{
    Ended, PATIENCE, Running, ended, eventually, memory_file, program, repeats, root, scene_file,
    starts_file, tell,
};

/// One sampling period of the paper's scene, ns.
pub const PERIOD_NS: u64 = 33_333_333;

/// A directory for one test, with a domain in it and the programs that work there.
#[derive(Debug)]
pub struct Place(testkit::Place);

impl std::ops::Deref for Place {
    type Target = testkit::Place;

    fn deref(&self) -> &testkit::Place {
        &self.0
    }
}

impl Place {
    pub fn new() -> Self {
        Self(testkit::Place::new())
    }

    /// The daemon in this domain, in real time where that is permitted; `more` is TOML of its
    /// configuration.
    pub fn vpcd(&self, more: &str) -> Command {
        let scene = scene_file();
        let scene = scene.display();
        let text = format!("scene = '{scene}'\n{more}\n[realtime]\npriority = 60\n");
        let mut command = testkit::command(program("vpcd"));
        command.arg("--config").arg(self.file("vpcd.toml", text));
        command.arg("--domain").arg(self.domain());
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        command
    }
}

/// Somebody who watches a domain and can command.
pub struct Witness {
    pub observer: Observer,
    operator: OperatorPorts,
    asked: u64,
    /// The veto that the last answer has told.
    veto: u32,
    _domain: Domain,
}

impl Witness {
    pub fn new(place: &Place) -> Self {
        let domain = Domain::join(&place.domain()).unwrap();
        Self {
            observer: Observer::open(&domain).unwrap(),
            operator: OperatorPorts::open(&domain).unwrap(),
            // Ids that no other operator of the domain uses.
            asked: now_ns(),
            veto: 0,
            _domain: domain,
        }
    }

    /// Asks until there is an answer. Who arms names the veto that the last answer told.
    pub fn ask(&mut self, action: Action) -> Outcome {
        eventually("an answer", || {
            self.asked += 1;
            let request = match action {
                Action::Arm => Request::arm(self.asked, self.veto),
                _ => Request::new(self.asked, action),
            };
            let reply = self.operator.ask(&request, Duration::from_millis(200));
            let reply = reply.unwrap()?;
            assert_eq!(reply.action, action.code(), "another operator's answer");
            self.veto = reply.veto;
            reply.outcome()
        })
    }

    /// All commands since the last call.
    pub fn commands(&mut self) -> Vec<TwistCommand> {
        std::iter::from_fn(|| self.observer.twist.oldest().unwrap())
            .map(|twist| twist.message)
            .collect()
    }

    /// Commands up to the first one of a kind, with it.
    pub fn until(
        &mut self,
        what: &str,
        is_it: impl Fn(&TwistCommand) -> bool,
    ) -> Vec<TwistCommand> {
        let mut commands = Vec::new();
        eventually(what, || {
            let twist = self.observer.twist.oldest().unwrap()?.message;
            commands.push(twist);
            is_it(&twist).then_some(())
        });
        commands
    }

    /// All records of cycles since the last call.
    pub fn records(&mut self) -> Vec<CycleRecord> {
        std::iter::from_fn(|| self.observer.cycles.oldest().unwrap())
            .map(|record| record.message)
            .collect()
    }
}
