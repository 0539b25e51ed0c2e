//! What goes wrong in a run, and what must follow from it.

use messages::Hold;

use crate::PERIOD_NS;

/// Time from the limits to zero, `safety.brake_s`, ns.
pub const BRAKE_NS: u64 = 150_000_000;
/// In which the law's last command is replaced, ns: three periods.
pub const BRAKING_NS: u64 = 3 * PERIOD_NS;
/// How long the law goes on while points are hidden, `safety.blind_s`, ns.
const BLIND_NS: u64 = 1_000_000_000;
/// In which an image that does not follow the commands is noticed, ns.
const NOTICED_NS: u64 = 1_500_000_000;
/// Time without features, or without the robot's state, after which the camera is disarmed,
/// `safety.lost_s`, ns.
pub const LOST_NS: u64 = 300_000_000;

/// One thing that goes wrong while the camera moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    // The camera.
    /// It sends one exposure again and again.
    Freeze,
    /// It sends one image again and again, each time as a new one.
    Image,
    /// The same, each time with a little noise.
    Noise,
    /// It loses sight of one point for a frame; from then on it sees another object.
    OtherAfterHidden,
    /// It starts again; from then on it sees another object.
    OtherAfterRestart,
    /// It sends nothing more.
    Silence,
    /// It pauses for 0.4 s and goes on.
    Pause,
    /// It sends exposures each of which is older than the one before.
    Older,
    /// It loses sight of one point.
    Hidden,
    /// It finds nothing, and says that all points are in a corner.
    Zeros,
    /// It finds the pattern's edge, and puts all points there.
    Line,
    /// Its messages take 0.4 s from now on.
    Late,
    /// Its messages are from the future.
    Future,
    /// One of its numbers is not finite.
    NotFinite,
    /// It sends three points instead of four.
    TooFew,
    /// It swaps two points.
    Swapped,
    /// Its driver counts no messages: each seems to be the first.
    Uncounted,
    /// The shared memory fails.
    Transport,
    /// It ends, and after half a second another one is there.
    Replaced,
    /// It shows the pattern nearly as a line, for which the strategy `ibvs` has no answer.
    NoAnswer,

    // The robot.
    /// It says nothing more, and moves on.
    RobotSilent,
    /// It dies: it says nothing more, and stands.
    RobotDead,
    /// It stops by itself, and says so.
    RobotReflex,
    /// It says that it carries out something else than it is told.
    RobotStrays,
    /// It stands, and says that it carries out what it is told.
    RobotBlocked,
    /// It was never heard, although one is required.
    RobotUnheard,

    // The daemon and its machine.
    /// It is killed; another one starts, and the configuration wants that armed.
    Crash,
    /// The same, where the configuration wants it disarmed.
    CrashDisarmed,
    /// It is stopped for 2 s at any place of its cycle (SIGSTOP).
    Hang,
    /// The machine is suspended.
    Suspend,
    /// The monotonic clock goes back.
    ClockBack,
    /// One cycle is late by more than two periods.
    LateOnce,
    /// Cycle after cycle is late by more than a period.
    LateLoop,
    /// Some commands in a row cannot be sent.
    Unsent,
    /// SIGTERM, once or twice.
    Terminate,
    /// SIGHUP: it ends and begins again, with another configuration perhaps.
    Reload,

    // Operators.
    /// One stops, by a request.
    Stop,
    /// One stops while seven others fill their queues.
    StopInFlood,
    /// One stops while others ask `arm` again and again.
    StopAgainstArm,
    /// One stops after a motion that another has stopped before.
    StopTwice,
    /// One stops while the daemon is braking.
    StopInBrake,
    /// A hand changes the stop file.
    StopFile,
    /// One disarms.
    Disarm,
    /// One changes the strategy.
    Strategy,
    /// Seven fill their queues, and nobody stops.
    Flood,

    // Starts that the configuration wants armed.
    /// Camera and robot come within 5 s.
    ArmedStart,
    /// They come later.
    ArmedAlone,

    // Another program steers.
    /// The strategy is `follow`; the program wants anything, then falls silent.
    Guardian,

    /// Everything at once, again and again.
    Storm,
}

/// All of them, in the order of their seeds.
pub const ALL: [Fault; 50] = [
    Fault::Freeze,
    Fault::Image,
    Fault::Noise,
    Fault::OtherAfterHidden,
    Fault::OtherAfterRestart,
    Fault::Silence,
    Fault::Pause,
    Fault::Older,
    Fault::Hidden,
    Fault::Zeros,
    Fault::Line,
    Fault::Late,
    Fault::Future,
    Fault::NotFinite,
    Fault::TooFew,
    Fault::Swapped,
    Fault::Uncounted,
    Fault::Transport,
    Fault::Replaced,
    Fault::NoAnswer,
    Fault::RobotSilent,
    Fault::RobotDead,
    Fault::RobotReflex,
    Fault::RobotStrays,
    Fault::RobotBlocked,
    Fault::RobotUnheard,
    Fault::Crash,
    Fault::CrashDisarmed,
    Fault::Hang,
    Fault::Suspend,
    Fault::ClockBack,
    Fault::LateOnce,
    Fault::LateLoop,
    Fault::Unsent,
    Fault::Terminate,
    Fault::Reload,
    Fault::Stop,
    Fault::StopInFlood,
    Fault::StopAgainstArm,
    Fault::StopTwice,
    Fault::StopInBrake,
    Fault::StopFile,
    Fault::Disarm,
    Fault::Strategy,
    Fault::Flood,
    Fault::ArmedStart,
    Fault::ArmedAlone,
    Fault::Guardian,
    Fault::Storm,
    Fault::Storm,
];

/// What must follow a fault in a moving camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// It brakes and disarms.
    Disarms {
        /// What may be the cause of the disarming.
        causes: &'static [Hold],
        /// How long the law may go on, from the last good features or from the fault, ns.
        goes_on_ns: u64,
        /// Zero comes after the time of this many brakes from the limits.
        brakes: u64,
    },
    /// Nothing that concerns the supervisor: it stays armed.
    GoesOn,
    /// The daemon ends.
    Ends,
    /// The run has an end of its own.
    Own,
}

impl Fault {
    /// What must follow.
    pub fn outcome(self) -> Outcome {
        use Hold::*;
        let disarms = |causes, noticed_ns, brakes| Outcome::Disarms {
            causes,
            goes_on_ns: noticed_ns + BRAKING_NS,
            brakes,
        };
        let brakes = |causes, noticed_ns| disarms(causes, noticed_ns, 1);
        let at_once = |causes| disarms(causes, 0, 0);
        match self {
            Self::Freeze
            | Self::Silence
            | Self::Pause
            | Self::Older
            | Self::OtherAfterRestart
            | Self::OtherAfterHidden
            | Self::Zeros
            | Self::Line
            | Self::Late
            | Self::NotFinite
            | Self::TooFew
            | Self::Swapped
            | Self::Transport
            | Self::Replaced => brakes(&[Lost], 0),
            // The first of them may be another camera's.
            Self::Uncounted => brakes(&[Order, Lost], PERIOD_NS),
            Self::Image => brakes(&[Frozen], 0),
            Self::Noise => brakes(&[NotFollowing, Frozen], NOTICED_NS),
            Self::Hidden => brakes(&[Lost], BLIND_NS),
            Self::NoAnswer => brakes(&[Solver], 0),
            Self::Future | Self::ClockBack => at_once(&[Clock]),
            Self::RobotSilent | Self::RobotDead => brakes(&[RobotLost], LOST_NS),
            Self::RobotReflex => at_once(&[RobotFault]),
            Self::RobotStrays => brakes(&[NotFollowed], LOST_NS),
            Self::RobotBlocked => brakes(&[NotFollowing], NOTICED_NS),
            Self::Hang | Self::Suspend => at_once(&[Standstill]),
            // A brake of cycles each of which takes three periods.
            Self::LateLoop => disarms(&[Overruns], 10 * PERIOD_NS, 3),
            Self::Stop
            | Self::StopInFlood
            | Self::StopAgainstArm
            | Self::StopTwice
            | Self::StopFile => at_once(&[Operator]),
            Self::Disarm | Self::StopInBrake => brakes(&[Operator], 0),
            Self::LateOnce | Self::Unsent | Self::Strategy | Self::Flood => Outcome::GoesOn,
            Self::Terminate | Self::Reload => Outcome::Ends,
            Self::RobotUnheard
            | Self::Crash
            | Self::CrashDisarmed
            | Self::ArmedStart
            | Self::ArmedAlone
            | Self::Guardian
            | Self::Storm => Outcome::Own,
        }
    }

    /// Whether the camera causes it: times count from the last good features.
    pub fn is_of_eyes(self) -> bool {
        self <= Self::NoAnswer && self != Self::Future
    }

    /// Whether it is noticed only where the camera moves fast.
    pub fn needs_speed(self) -> bool {
        matches!(self, Self::Noise | Self::RobotBlocked | Self::NoAnswer)
    }
}
