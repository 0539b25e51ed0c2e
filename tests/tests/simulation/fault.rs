//! What goes wrong in a run, and what must follow from it.

use messages::Hold;

/// Time from the limits to zero, `safety.brake_s`, ns.
pub const BRAKE_NS: u64 = 150_000_000;
/// In how many periods the law's last command is replaced.
pub const BRAKING: u64 = 3;
/// How long the law goes on while points are hidden, `safety.blind_s`, ns.
pub const BLIND_NS: u64 = 1_000_000_000;
/// In which an image that does not follow the commands is noticed, ns.
const NOTICED_NS: u64 = 1_500_000_000;
/// For how long, in all, the law is fast with a robot that is late or too fast, with images that
/// are late, and goes on with ones that flicker, ns.
const ROBOT_NS: u64 = 1_000_000_000;
const LATE_NS: u64 = 1_500_000_000;
const FLICKER_NS: u64 = 2_000_000_000;
/// In which the camera comes near any goal, ns.
const LONG_NS: u64 = 6_000_000_000;
/// Time without features, or without the robot's state, after which the camera is disarmed,
/// `safety.lost_s`, ns.
pub const LOST_NS: u64 = 300_000_000;

/// Why an image is held that does not move as commanded.
const IMAGE: &[Hold] = &[
    Hold::ImageExceeds,
    Hold::ImageLate,
    Hold::NotFollowing,
    Hold::Frozen,
    Hold::Lost,
];
/// The same, or a robot.
const MOTION: &[Hold] = &[
    Hold::ImageExceeds,
    Hold::ImageLate,
    Hold::NotFollowing,
    Hold::RobotLate,
    Hold::NotFollowed,
    Hold::Lost,
];

/// Faults whose mends are still to come: no seed has them.
pub const AWAITED: &[Fault] = &[
    // Some swing for longer than stated: 0.2 to 0.4 s old, from the first motion on.
    Fault::LateFresh,
];

/// Declares the faults with the list of all.
macro_rules! faults {
    ($($(#[$doc:meta])+ $fault:ident)+) => {
        /// One thing that goes wrong while the camera moves.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Fault {
            $($(#[$doc])+ $fault,)+
        }

        /// All of them.
        pub const FAULTS: &[Fault] = &[$(Fault::$fault,)+];
    };
}

faults! {
    // The camera.
    /// It sends one exposure again and again.
    Freeze
    /// It sends one image again and again, each time as a new one.
    Image
    /// The same, each time with a little noise.
    Noise
    /// The same, and in most images points are hidden.
    Flicker
    /// It loses sight of one point for a frame; from then on it sees another object.
    OtherAfterHidden
    /// It starts again; from then on it sees another object.
    OtherAfterRestart
    /// It sends nothing more.
    Silence
    /// It pauses for 0.4 s and goes on.
    Pause
    /// It sends exposures each of which is older than the one before.
    Older
    /// It loses sight of one point.
    Hidden
    /// It finds nothing, and says that all points are in a corner.
    Zeros
    /// It finds the pattern's edge, and puts all points there.
    Line
    /// Its messages take 0.4 s from now on.
    Late
    /// Its images take 0.2 to 0.4 s from now on, and are stamped as fresh ones.
    LateFresh
    /// Its messages are from the future.
    Future
    /// One of its numbers is not finite.
    NotFinite
    /// It sends three points instead of four.
    TooFew
    /// It swaps two points.
    Swapped
    /// Its image is mirrored.
    Mirrored
    /// Its driver counts no messages: each seems to be the first.
    Uncounted
    /// The shared memory fails.
    Transport
    /// It ends, and after half a second another one is there.
    Replaced
    /// It shows the pattern nearly as a line, for which the strategy `ibvs` has no answer.
    NoAnswer

    // The robot.
    /// It says nothing more, and moves on.
    RobotSilent
    /// It dies: it says nothing more, and stands.
    RobotDead
    /// It stops by itself, and says so.
    RobotReflex
    /// It says that it carries out something else than it is told.
    RobotStrays
    /// It stands, and says that it carries out what it is told.
    RobotBlocked
    /// It was never heard, although one is required.
    RobotUnheard
    /// It is three times as fast as told, and says that it carries out what it is told.
    RobotFast
    /// It is late by 0.35 to 0.5 s, whatever it says.
    RobotLate
    /// It is late by 0.1 s at most.
    RobotLags
    /// It is too fast or too slow by 30 % at most.
    RobotGain
    /// It moves beside, by 0.03 m/s or rad/s at most.
    RobotBias
    /// It does not move at low speeds.
    RobotDeadZone
    /// It takes x for y.
    RobotCrossed

    // The joints of its arm.
    /// They stay where they are.
    JointsFrozen
    /// The same, stamped in the future.
    JointsFuture
    /// Every second message says another posture.
    JointsJump
    /// One is less by a turn.
    JointsWrapped
    /// They are those of another posture.
    JointsOther
    /// One is 1e300 rad.
    JointsHuge
    /// They are in degrees.
    JointsDegrees
    /// They are 0.2 s old, and stamped as fresh ones.
    JointsLate
    /// There are too few.
    JointsFew

    // The daemon and its machine.
    /// It is killed; another one starts, and the configuration wants that armed.
    Crash
    /// The same, where the configuration wants it disarmed.
    CrashDisarmed
    /// It is stopped for 2 s at any place of its cycle (SIGSTOP).
    Hang
    /// The machine is suspended.
    Suspend
    /// The monotonic clock goes back.
    ClockBack
    /// One cycle is late by more than two periods.
    LateOnce
    /// Cycle after cycle is late by more than a period.
    LateLoop
    /// Some commands in a row cannot be sent.
    Unsent
    /// SIGTERM, once or twice.
    Terminate
    /// SIGHUP: it ends and begins again, with another configuration perhaps.
    Reload

    // Operators.
    /// One stops, by a request.
    Stop
    /// One stops while seven others fill their queues.
    StopInFlood
    /// One stops while others ask `arm` again and again.
    StopAgainstArm
    /// One stops after a motion that another has stopped before.
    StopTwice
    /// One stops while the daemon is braking.
    StopInBrake
    /// A hand changes the stop file.
    StopFile
    /// One disarms.
    Disarm
    /// One changes the strategy.
    Strategy
    /// One changes from a strategy with a goal to `follow`.
    ToFollow
    /// One changes from `follow` to a strategy with a goal.
    ToGoal
    /// Seven fill their queues, and nobody stops.
    Flood
    /// One disarms while a program visits goals, which arms by itself.
    VisitDisarm
    /// One stops while a program does.
    VisitStop
    /// A program visits a goal whose scene has other limits.
    VisitForeign

    // Starts that the configuration wants armed.
    /// Camera and robot come within 5 s.
    ArmedStart
    /// They come later.
    ArmedAlone

    // Another program steers.
    /// The strategy is `follow`; the program wants anything, then falls silent.
    Guardian

    // No single one.
    /// Messages are late, lost, doubled and out of order.
    Network
    /// Nothing goes wrong.
    Nothing
    /// Everything at once, again and again.
    Storm
}

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
    /// It arrives, or disarms for one of these causes; it is fast for this time at most, ns.
    Bears {
        causes: &'static [Hold],
        fast_ns: u64,
    },
    /// The daemon ends.
    Ends,
    /// The run has an end of its own.
    Own,
}

impl Fault {
    /// What must follow at this period, ns.
    pub fn outcome(self, period_ns: u64) -> Outcome {
        use Hold::*;
        let disarms = |causes, noticed_ns, brakes| Outcome::Disarms {
            causes,
            goes_on_ns: noticed_ns + BRAKING * period_ns,
            brakes,
        };
        let brakes = |causes, noticed_ns| disarms(causes, noticed_ns, 1);
        let at_once = |causes| disarms(causes, 0, 0);
        let bears = |fast_ns| Outcome::Bears {
            causes: MOTION,
            fast_ns,
        };
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
            Self::Uncounted => brakes(&[Order, Lost], period_ns),
            Self::Image => brakes(&[Frozen], 0),
            Self::Noise => brakes(&[NotFollowing, Frozen], NOTICED_NS),
            Self::Flicker => brakes(IMAGE, FLICKER_NS),
            Self::LateFresh | Self::Mirrored => bears(LATE_NS),
            Self::Hidden => brakes(&[Lost], BLIND_NS),
            Self::NoAnswer => brakes(&[Solver], 0),
            Self::Future | Self::ClockBack => at_once(&[Clock]),
            Self::RobotSilent | Self::RobotDead => brakes(&[RobotLost], LOST_NS),
            Self::RobotReflex => at_once(&[RobotFault]),
            Self::RobotStrays => brakes(&[NotFollowed], LOST_NS),
            Self::RobotBlocked => brakes(&[NotFollowing], NOTICED_NS),
            Self::RobotFast | Self::RobotLate | Self::RobotCrossed => bears(ROBOT_NS),
            Self::RobotLags | Self::RobotGain | Self::RobotBias | Self::RobotDeadZone => {
                bears(LONG_NS)
            }
            Self::Hang | Self::Suspend => at_once(&[Standstill]),
            // A brake of cycles each of which takes three periods.
            Self::LateLoop => disarms(&[Overruns], 10 * period_ns, 3),
            Self::Stop
            | Self::StopInFlood
            | Self::StopAgainstArm
            | Self::StopTwice
            | Self::StopFile => at_once(&[Operator]),
            Self::Disarm | Self::StopInBrake | Self::ToFollow => brakes(&[Operator], 0),
            Self::LateOnce | Self::Unsent | Self::Strategy | Self::Flood => Outcome::GoesOn,
            Self::Terminate | Self::Reload => Outcome::Ends,
            _ => Outcome::Own,
        }
    }

    /// Whether the camera causes it: times count from the last good features.
    pub fn is_of_eyes(self) -> bool {
        self <= Self::NoAnswer && self != Self::Future
    }

    /// Whether the joints of an arm lie.
    pub fn is_of_joints(self) -> bool {
        (Self::JointsFrozen..=Self::JointsFew).contains(&self)
    }

    /// Whether a program visits goals, and arms by itself.
    pub fn is_of_visit(self) -> bool {
        matches!(
            self,
            Self::VisitDisarm | Self::VisitStop | Self::VisitForeign
        )
    }

    /// Whether another program steers from the beginning.
    pub fn is_of_policy(self) -> bool {
        let is_one = matches!(self, Self::Guardian | Self::ToGoal | Self::RobotFast);
        is_one || self.is_of_joints()
    }

    /// Whether it is noticed only where the camera moves fast, or is the point only there.
    pub fn needs_speed(self) -> bool {
        let is_of_motion = (Self::RobotFast..=Self::RobotCrossed).contains(&self);
        let is_of_image = matches!(
            self,
            Self::Noise | Self::Flicker | Self::LateFresh | Self::Mirrored
        );
        let others = matches!(self, Self::RobotBlocked | Self::NoAnswer | Self::Nothing);
        is_of_motion || is_of_image || others
    }

    /// Whether the camera may move again after a zero, until it disarms.
    pub fn may_flare(self) -> bool {
        self == Self::Flicker
    }

    /// Whether it can begin in the midst of everything else, and end.
    pub fn is_of_storm(self) -> bool {
        let is_alone = matches!(
            self,
            Self::Storm
                | Self::Nothing
                | Self::Guardian
                | Self::ArmedStart
                | Self::ArmedAlone
                | Self::RobotUnheard
                | Self::CrashDisarmed
                | Self::StopInBrake
                | Self::StopAgainstArm
                | Self::StopTwice
        );
        !is_alone && !self.is_of_joints() && !self.is_awaited()
    }

    /// Whether its mend is still to come.
    pub fn is_awaited(self) -> bool {
        AWAITED.contains(&self)
    }

    /// Whether zero at once is in order, without a brake.
    pub fn is_grave(self) -> bool {
        matches!(
            self,
            Self::Future | Self::RobotReflex | Self::Suspend | Self::ClockBack
        )
    }

    /// Whether it ends by itself, or with the daemon.
    pub fn is_short(self) -> bool {
        self >= Self::Crash && self != Self::Network
    }
}
