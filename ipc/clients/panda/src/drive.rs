//! The loop at the robot's pace: a state comes, a command goes. While a motion runs nothing here
//! allocates, and nothing waits but for the robot's next state.

use std::sync::atomic::{AtomicBool, Ordering};

use arm::{Limited, Model};
use franka::{FrankaError, RobotMode as Mode, RobotState as Told};
use ipc::{Domain, ReceiveError, RobotPorts, Subscriber, now_ns};
use messages::{Action, MOST_OBEYED_NS, Request, TwistCommand};
use rtrb::Producer;
use rustix::mm::{MlockAllFlags, mlockall};

use crate::config::Config;
use crate::robot::{self, Doing, Motion};
use crate::steering::{Output, Steering};

/// What happened, for the log.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The robot answered.
    Connected(Model),
    /// Something that the machine does not grant.
    Lacks(String),
    /// A motion runs: commands are carried out from now on.
    Moves,
    /// No motion can begin here.
    Refused(String),
    /// The robot, or somebody at it, ended the motion, and why.
    Stopped(String),
    /// Its errors are cleared.
    Recovered,
    /// They are not.
    NotRecovered(String),
    /// A command came that no robot obeys: of lockstep, or one that is refused.
    NotObeyed(&'static str),
    /// A twist was in force when the motion began: it is not obeyed before it was zero, or ended.
    Waits,
    /// What limits the motion changed.
    Limited(Limited),
    /// A motion is over.
    Over(Report),
}

/// What a motion was like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Report {
    /// States that were answered.
    pub answered: u64,
    /// States that never came, by the robot's own clock.
    pub lost: u64,
    /// Least share of commands that the robot got in time, 0 to 1, after the first second.
    pub least_rate: f64,
    /// Allocations in the loop after the first second, in which connections are made. Counted where
    /// the program's allocator is [`heap_meter::Meter`].
    pub allocations: u64,
}

/// Speed of a joint below which it stands, rad/s.
const AT_REST: f64 = 1e-3;
/// Answers of the first second.
const WARM_UP: u64 = 1000;
/// Oldest request that counts, and time between two tries to begin a motion, ns.
const OLDEST_NS: u64 = 1_000_000_000;
const RETRY_NS: u64 = 1_000_000_000;

/// Why the bridge ends by itself.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The robot does not answer, or no longer.
    #[error("robot {address}: {source}{}", hint(source))]
    Robot {
        /// Where.
        address: String,
        /// Why.
        source: Box<FrankaError>,
    },
    /// The shared memory cannot be used.
    #[error(transparent)]
    Join(#[from] ipc::JoinError),
    /// Another robot is at work in the domain.
    #[error(transparent)]
    Open(#[from] ipc::OpenError),
    /// A message could not be received.
    #[error(transparent)]
    Receive(#[from] ipc::ReceiveError),
    /// A state could not be published.
    #[error(transparent)]
    Publish(#[from] ipc::PublishError),
    /// A signal ended it, and the robot is not idle.
    #[error("stopped, but the robot is in mode {mode}, with the errors {errors}")]
    NotIdle {
        /// Its mode.
        mode: String,
        /// Its errors.
        errors: String,
    },
}

/// What the interface's own words leave out.
fn hint(source: &FrankaError) -> &'static str {
    match source.to_string().contains("FCI refused") {
        true => " Or is another client connected, such as another vpc-panda?",
        false => "",
    }
}

impl DriveError {
    /// Names the robot in what its interface says.
    pub(crate) fn robot(config: &Config) -> impl Fn(FrankaError) -> Self {
        |source| Self::Robot {
            address: config.robot.clone(),
            source: Box::new(source),
        }
    }
}

/// Drives the robot until `stop`; it stands then.
///
/// # Errors
/// [`DriveError`]: the robot or the shared memory cannot be used.
pub fn drive(
    config: &Config,
    stop: &AtomicBool,
    events: &mut Producer<Event>,
) -> Result<(), DriveError> {
    let failed = DriveError::robot(config);
    let robot = robot::connect(config).map_err(&failed)?;
    let mut told = |event| {
        // A full queue loses what nobody has read for long.
        let _ = events.push(event);
    };
    told(Event::Connected(config.model));
    enter_real_time(config.priority, &mut told);
    let domain = Domain::join(&config.domain)?;
    let mut bridge = Bridge {
        config,
        stop,
        ports: RobotPorts::open(&domain)?,
        requests: domain.subscriber(usize::MAX)?,
        command: TwistCommand::default(),
        refused: None,
        // By then it has heard what is in force.
        retry_ns: now_ns() + MOST_OBEYED_NS,
        tell: &mut told,
    };
    loop {
        let state = robot.read_once().map_err(&failed)?;
        bridge.publish(&state, bridge.doing())?;
        if stop.load(Ordering::Relaxed) {
            return match state.robot_mode {
                Mode::Idle if state.dq_d.iter().all(|dq| dq.abs() < AT_REST) => Ok(()),
                // It still brakes, or its finish is on the way.
                Mode::Idle | Mode::Move => continue,
                mode => Err(DriveError::NotIdle {
                    mode: format!("{mode:?}"),
                    errors: state.current_errors.to_string(),
                }),
            };
        }
        bridge.take_newest()?;
        bridge.take_requests(&robot, &state)?;
        if state.robot_mode == Mode::Idle && now_ns() >= bridge.retry_ns {
            match bridge.carry_out(&robot, &state) {
                Ok(()) => (),
                Err(End::Robot(source)) => return Err(failed(source)),
                Err(End::Ours(error)) => return Err(error),
            }
        }
    }
}

/// Asks for what the loop needs; it works without, and late.
pub(crate) fn enter_real_time(priority: i32, tell: &mut dyn FnMut(Event)) {
    if let Err(why) = franka::realtime::set_current_thread_scheduler_priority(priority) {
        tell(Event::Lacks(format!("SCHED_FIFO {priority}: {why}")));
    }
    if let Err(why) = mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE) {
        tell(Event::Lacks(format!("locked memory: {why}")));
    }
}

/// How a motion ends by something that is wrong.
enum End {
    Robot(FrankaError),
    Ours(DriveError),
}

impl<T: Into<DriveError>> From<T> for End {
    fn from(error: T) -> Self {
        Self::Ours(error.into())
    }
}

struct Bridge<'a> {
    config: &'a Config,
    stop: &'a AtomicBool,
    ports: RobotPorts,
    requests: Subscriber<Request>,
    /// The newest command.
    command: TwistCommand,
    /// Why no motion could begin when it was last tried, and when to try again, ns.
    refused: Option<String>,
    retry_ns: u64,
    tell: &'a mut dyn FnMut(Event),
}

impl Bridge<'_> {
    fn publish(&mut self, state: &Told, doing: Doing) -> Result<(), DriveError> {
        let mount = self.config.mount(&robot::pose(&state.F_T_EE));
        let told = robot::told(state, &mount, doing, now_ns());
        self.ports.robot.publish(&told)?;
        Ok(())
    }

    /// What it is about while no motion runs.
    fn doing(&self) -> Doing {
        match self.refused {
            Some(_) => Doing::Refused,
            None => Doing::Waits,
        }
    }

    /// Whether somebody asks for a recovery. One that was asked for before, in another situation,
    /// does not count.
    fn is_asked(&mut self) -> Result<bool, DriveError> {
        let mut is_asked = false;
        loop {
            match self.requests.oldest() {
                Ok(Some(request)) => {
                    let age_ns = now_ns().saturating_sub(request.stamp.published_ns);
                    is_asked |= request.action() == Some(Action::Recover) && age_ns < OLDEST_NS;
                }
                Ok(None) => break,
                Err(ReceiveError::Invalid { .. }) => (),
                Err(error) => return Err(error.into()),
            }
        }
        Ok(is_asked)
    }

    /// It never recovers by itself.
    fn take_requests(&mut self, robot: &robot::Robot, state: &Told) -> Result<(), DriveError> {
        if !self.is_asked()? {
            return Ok(());
        }
        self.retry_ns = 0;
        let outcome = match (state.robot_mode, &self.refused) {
            (Mode::Reflex, _) => match robot.automatic_error_recovery() {
                Ok(()) => Event::Recovered,
                Err(why) => Event::NotRecovered(why.to_string()),
            },
            (_, Some(why)) => Event::NotRecovered(why.clone()),
            (mode, None) => Event::NotRecovered(format!("the robot is in mode {mode:?}")),
        };
        (self.tell)(outcome);
        Ok(())
    }

    /// No motion can begin now.
    fn refuse(&mut self, why: String) {
        self.retry_ns = now_ns() + RETRY_NS;
        if self.refused.as_ref() != Some(&why) {
            (self.tell)(Event::Refused(why.clone()));
            self.refused = Some(why);
        }
    }

    /// A motion, from rest to rest.
    fn carry_out(&mut self, robot: &robot::Robot, state: &Told) -> Result<(), End> {
        let measured = robot::measured(state);
        let mut steering = match Steering::begin(self.config, &measured) {
            Ok(steering) => steering,
            Err(why) => {
                self.refuse(why.to_string());
                return Ok(());
            }
        };
        let mut motion = match Motion::begin(robot, self.config.interface) {
            Ok(motion) => motion,
            Err(why @ (FrankaError::Control(_) | FrankaError::Command(_))) => {
                self.refuse(why.to_string());
                return Ok(());
            }
            Err(gone) => return Err(End::Robot(gone)),
        };
        self.refused = None;
        (self.tell)(Event::Moves);
        let mut report = Report {
            least_rate: 1.0,
            ..Report::default()
        };
        let ended = self.answer_all(&mut motion, &mut steering, &mut report);
        (self.tell)(Event::Over(report));
        // What was asked for during the motion was not asked of what comes now.
        let _ = self.is_asked()?;
        match ended {
            Err(End::Robot(why)) => self.ended(why),
            ended => ended,
        }
    }

    /// The loop: a state comes, a command goes.
    fn answer_all(
        &mut self,
        motion: &mut Motion,
        steering: &mut Steering,
        report: &mut Report,
    ) -> Result<(), End> {
        let interface = &self.config.interface;
        let (mut limited, mut time, mut calls) = (Limited::default(), None, 0);
        let is_zero = |command: &TwistCommand| command.in_force(now_ns()) == [0.0; 6];
        let mut waits = !is_zero(&self.command);
        if waits {
            (self.tell)(Event::Waits);
        }
        loop {
            let state = motion.state().map_err(End::Robot)?;
            let passed = time.replace(state.time.as_millis());
            let passed = passed.map_or(1, |before| state.time.as_millis().saturating_sub(before));
            report.lost += passed.saturating_sub(1);
            report.answered += 1;
            match report.answered {
                ..WARM_UP => (),
                WARM_UP => calls = heap_meter::calls(),
                _ => {
                    report.allocations = heap_meter::calls() - calls;
                    report.least_rate = report.least_rate.min(state.control_command_success_rate);
                }
            }
            self.take_newest()?;
            let (measured, now) = (robot::measured(&state), now_ns());
            let is_over = self.stop.load(Ordering::Relaxed);
            waits &= !is_zero(&self.command);
            let output = match is_over || waits {
                true => steering.brake(&measured, now),
                false => steering.step(&self.command, &measured, now),
            };
            if is_over && steering.is_at_rest(&measured) {
                return motion
                    .answer(&Output::still(*interface), true)
                    .map_err(End::Robot);
            }
            motion.answer(&output, false).map_err(End::Robot)?;
            // After the command, which the robot waits for.
            self.publish(&state, Doing::Moves(steering.limited()))?;
            let was = std::mem::replace(&mut limited, steering.limited());
            if was != limited {
                (self.tell)(Event::Limited(limited));
            }
        }
    }

    fn take_newest(&mut self) -> Result<(), DriveError> {
        match self.ports.twist.latest() {
            Ok(None) => (),
            Ok(Some(newest)) => {
                self.command = newest.message;
                // A daemon's last zero is valid for ever, too.
                let is_zero = self.command.twist == [0.0; 6];
                if self.command.in_force_until_ns() == 0 && !is_zero {
                    (self.tell)(Event::NotObeyed("it is of a controller in lockstep"));
                }
            }
            // The arm stands until a good one comes.
            Err(ReceiveError::Invalid { .. }) => {
                self.command = TwistCommand::default();
                (self.tell)(Event::NotObeyed("a field is out of its range"));
            }
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    /// The robot ended a motion: with a reason that is told, or by being gone.
    fn ended(&mut self, why: FrankaError) -> Result<(), End> {
        match why {
            FrankaError::Control(_) | FrankaError::Command(_) => {
                (self.tell)(Event::Stopped(why.to_string()));
                Ok(())
            }
            gone => Err(End::Robot(gone)),
        }
    }
}
