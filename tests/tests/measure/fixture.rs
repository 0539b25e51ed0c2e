//! What the measurements share: domains, processes, a camera that moves, and an observer of the
//! commands.

use std::process::{Command, Stdio};
use std::time::Duration;

pub use crate::limits::{assert_within_limits, is_still};
use ipc::{Domain, Observer, OperatorPorts, now_ns};
use messages::{Action, CycleRecord, Outcome, Request, TwistCommand, TwistState};
use rand::{Rng, RngExt};
pub use testkit::{Ended, Running, ended, memory_file, program, root, scene_file, starts_file};

use crate::judge::{Miss, NotShown, give_up};
pub use crate::judge::{PATIENCE, WAKE_NS, eventually};
pub use crate::machine::on_time;
use crate::reference::Class;

/// One sampling period of the paper's scene, ns.
pub const PERIOD_NS: u64 = 33_333_333;
/// SCHED_FIFO priority of cameras, which are instruments here; below the daemon's 60.
pub const CAMERA_PRIORITY: i32 = 50;

/// The scheduling classes of a round in which `vpcd` and camera are in real time where they may be,
/// and everybody else is ordinary.
pub fn classes() -> Vec<Class> {
    let mut all = vec![Class::of_vpcd(), Class::Ordinary];
    all.dedup();
    all
}

/// A directory for one measurement, with a domain in it and the programs that work there.
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

    /// The camera in this domain, on the start of this number, for longer than any round takes.
    pub fn hw_sim(&self, start: usize) -> Command {
        let mut command = testkit::command(program("hw-sim"));
        command.arg("--scene").arg(scene_file());
        command.arg("--starts").arg(starts_file());
        command.args(["--start", &start.to_string(), "--clock", "fixed"]);
        command.arg("--domain").arg(self.domain());
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        command
    }

    /// `vpcctl` in this domain.
    pub fn vpcctl(&self) -> Command {
        let mut command = testkit::command(program("vpcctl"));
        command.arg("--domain").arg(self.domain());
        command.stdin(Stdio::null());
        command
    }

    /// What `vpcctl status` says of the state.
    pub fn state(&self) -> String {
        let said = ended(self.vpcctl().arg("status")).stdout;
        let line = said.lines().find_map(|line| line.strip_prefix("state"));
        line.unwrap_or(&said).trim().to_owned()
    }
}

/// Sleeps for a random part of this number of periods.
pub fn some_time(periods: u64, random: &mut impl Rng) {
    let ns = random.random_range(0..periods * PERIOD_NS);
    std::thread::sleep(Duration::from_nanos(ns));
}

/// Daemon and camera in a place of their own, in motion, and a witness. Taken apart in this order,
/// they end in the other: the camera first, the place last.
pub struct Stage {
    pub place: Place,
    pub witness: Witness,
    pub daemon: Running,
    pub camera: Running,
}

impl Stage {
    /// The camera moves, from the start of this number (of a hundred, over and over).
    pub fn in_motion(start: usize) -> anyhow::Result<Self> {
        let place = Place::new();
        let mut witness = Witness::new(&place);
        let daemon = Running::start(place.vpcd(""));
        let camera = on_time(place.hw_sim(start % 100), CAMERA_PRIORITY);
        let camera = Running::start(camera);
        witness.set_in_motion()?;
        Ok(Self {
            place,
            witness,
            daemon,
            camera,
        })
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

    /// Sends a request as it is and does not wait for an answer.
    pub fn say(&mut self, request: &Request) {
        self.operator.requests.publish(request).unwrap();
    }

    /// Arms, once camera and robot are there, and waits until the camera moves.
    ///
    /// # Errors
    /// If it is disarmed before it moves, as a late machine may cause.
    pub fn set_in_motion(&mut self) -> Result<(), Miss> {
        eventually("arming", || {
            self.commands();
            (self.ask(Action::Arm) == Outcome::Done).then_some(())
        });
        let armed_ns = now_ns();
        let mut was_armed = false;
        eventually("motion", || {
            let twist = self.observer.twist.oldest().unwrap()?.message;
            match twist.state() {
                Some(TwistState::Moving) => Some(Ok(())),
                Some(TwistState::Disarmed) if was_armed => {
                    let hold = self.records().last().and_then(CycleRecord::hold);
                    let what = format!("disarmed before it moves: {hold:?}");
                    let class = Class::of_vpcd();
                    Some(Err(Miss::upset(what, class, armed_ns, now_ns())))
                }
                Some(TwistState::Disarmed) => None,
                _ => {
                    was_armed = true;
                    None
                }
            }
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

    /// Waits until the robot, which is `camera`, says after this instant that it stands: when it
    /// said so, ns.
    pub fn until_it_stands(&mut self, after_ns: u64, camera: &mut Running) -> u64 {
        eventually("a robot that stands", || {
            let has_ended = !camera.is_running();
            while let Some(state) = self.observer.robot.oldest().unwrap() {
                if state.twist == [0.0; 6] && state.stamp.published_ns > after_ns {
                    return Some(state.stamp.published_ns);
                }
            }
            if has_ended {
                let why = "the camera's run was decided just then";
                give_up(NotShown(why.to_owned()));
            }
            None
        })
    }

    /// When the newest features so far were published, ns.
    pub fn newest_features_ns(&mut self) -> u64 {
        let mut newest = 0;
        while let Some(features) = self.observer.features.oldest().unwrap() {
            newest = features.stamp.published_ns;
        }
        newest
    }
}
