//! What the promises share: a lock so that they run one at a time, domains, processes, a camera
//! that moves, and an observer of the commands.

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ipc::{Domain, Observer, OperatorPorts, now_ns};
use messages::{Action, CycleRecord, Hold, Outcome, Request, TwistCommand, TwistState};
use rand::{Rng, RngExt};
pub use testkit::{
    Ended, PATIENCE, Running, are_installed, ended, eventually, memory_file, not_run, program,
    repeats, root, scene_file, starts_file, tell, turn, within,
};

use crate::machine::on_time;

/// One sampling period of the paper's scene, ns.
pub const PERIOD_NS: u64 = 33_333_333;
/// Lateness of a wake-up that is the machine's fault, not the daemon's, ns. Idle, SCHED_FIFO: 0.2
/// ms.
pub const WAKE_NS: u64 = 3_000_000;
/// SCHED_FIFO priority of cameras, which are instruments here; below the daemon's 60.
pub const CAMERA_PRIORITY: i32 = 50;
/// Largest magnitude of each component of the twist in the paper's scene, m/s and rad/s.
pub const LIMITS: [f64; 6] = [0.5, 0.5, 0.5, 1.0, 1.0, 1.0];

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

    /// The camera in this domain, on the start of this number, for longer than any test takes.
    pub fn hw_sim(&self, start: usize) -> Command {
        let mut command = testkit::command(program("hw-sim"));
        command.arg("--scene").arg(scene_file());
        command.arg("--starts").arg(starts_file());
        command.args(["--start", &start.to_string(), "--clock", "fixed"]);
        command.arg("--domain").arg(self.domain());
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        command
    }
}

/// Sleeps for a random part of so many periods.
pub fn some_time(periods: u64, random: &mut impl Rng) {
    let ns = random.random_range(0..periods * PERIOD_NS);
    std::thread::sleep(Duration::from_nanos(ns));
}

/// Ends threads, which look at the flag, when it is dropped: also when an assertion fails, for
/// whose scope waits.
pub struct EndOnDrop<'a>(pub &'a AtomicBool);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
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
    pub fn in_motion(start: usize) -> Self {
        Self::with(start, &[])
    }

    /// The same with these environment variables for both.
    pub fn with(start: usize, environment: &[(&str, &Path)]) -> Self {
        let place = Place::new();
        let mut witness = Witness::new(&place);
        let mut daemon = place.vpcd("");
        daemon.envs(environment.iter().copied());
        let daemon = Running::start(daemon);
        let mut camera = on_time(place.hw_sim(start % 100), CAMERA_PRIORITY);
        camera.envs(environment.iter().copied());
        let camera = Running::start(camera);
        witness.set_in_motion();
        Self {
            place,
            witness,
            daemon,
            camera,
        }
    }
}

/// Somebody who watches a domain and can command.
pub struct Witness {
    pub observer: Observer,
    operator: OperatorPorts,
    asked: u64,
    /// The count of stops that the last refusal has told.
    stops: u32,
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
            stops: 0,
            _domain: domain,
        }
    }

    /// Asks until there is an answer. Who arms has seen the stop that the last refusal told of.
    pub fn ask(&mut self, action: Action) -> Outcome {
        eventually("an answer", || {
            self.asked += 1;
            let request = match action {
                Action::Arm => Request::arm(self.asked, self.stops),
                _ => Request::new(self.asked, action),
            };
            let reply = self.operator.ask(&request, Duration::from_millis(200));
            let reply = reply.unwrap()?;
            assert_eq!(reply.action, action.code(), "another operator's answer");
            self.stops = match reply.outcome() {
                Some(Outcome::Stopped) => reply.stops,
                _ => 0,
            };
            reply.outcome()
        })
    }

    /// Sends a request as it is and does not wait for an answer.
    pub fn say(&mut self, request: &Request) {
        self.operator.requests.publish(request).unwrap();
    }

    /// Arms, and waits until the camera moves. Where a standstill of the machine disarms it at
    /// once, it is armed again.
    pub fn set_in_motion(&mut self) {
        for _ in 0..3 {
            eventually("arming", || {
                (self.ask(Action::Arm) == Outcome::Done).then_some(())
            });
            self.commands();
            let moves = within(PATIENCE, || {
                let twist = self.observer.twist.oldest().unwrap()?.message;
                (twist.state() == Some(TwistState::Moving)).then_some(())
            });
            if moves.is_some() {
                return;
            }
            let last = self.records().last().and_then(CycleRecord::hold);
            assert_eq!(last, Some(Hold::Standstill), "armed, it does not move");
            tell("armed again after a standstill of the machine");
        }
        panic!("armed, it does not move");
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
    /// said so, ns; `None` if its run was decided before, so that it went.
    pub fn until_it_stands(&mut self, after_ns: u64, camera: &mut Running) -> Option<u64> {
        eventually("a robot that stands", || {
            let went = !camera.is_running();
            while let Some(state) = self.observer.robot.oldest().unwrap() {
                if state.twist == [0.0; 6] && state.stamp.published_ns > after_ns {
                    return Some(Some(state.stamp.published_ns));
                }
            }
            went.then_some(None)
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

/// Whether a command asks for no motion.
pub fn is_still(twist: &TwistCommand) -> bool {
    twist.twist == [0.0; 6]
}

/// Largest component of a twist as a share of its limit; NaN is infinite.
pub fn speed(twist: &[f64; 6]) -> f64 {
    let shares = std::iter::zip(twist, LIMITS).map(|(v, limit)| v.abs() / limit);
    shares.fold(0.0, |most, share| {
        if share.is_nan() {
            f64::INFINITY
        } else {
            most.max(share)
        }
    })
}

/// Asserts that no component of a command is beyond the limits of the paper's scene.
pub fn assert_within_limits(twist: &TwistCommand) {
    assert!(speed(&twist.twist) <= 1.0 + 1e-9, "{twist:?}");
}
