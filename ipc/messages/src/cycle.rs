//! What one cycle of the controller did, and how long it took.

use core::fmt;

use crate::codes::{bits, codes};
use crate::features::{MAX_POINTS, pairs};
use crate::field::Stamp;
use crate::message::{Qos, message};
use crate::twist::TwistState;

codes! {
    /// What starts a cycle.
    ClockMode {
        /// A fixed grid in time.
        Fixed = 0 => "fixed",
        /// Each new features message.
        Lockstep = 1 => "lockstep",
        /// A grid in time that keeps the nominal rate and follows the camera's phase.
        Phase = 2 => "phase",
    }
}

codes! {
    /// Whether the grid of releases follows the camera's frames.
    PhaseCode {
        /// No: the clock is another one, or no frames come.
        Free = 0 => "free",
        /// It is moving towards the camera's phase.
        Seeking = 1 => "seeking",
        /// It follows the camera's phase.
        Locked = 2 => "locked",
    }
}

codes! {
    /// What a cycle received from a port.
    InputCode {
        /// No message came.
        Nothing = 0 => "nothing",
        /// A valid message.
        Message = 1 => "message",
        /// A message that was refused.
        Refused = 2 => "refused",
        /// The shared memory failed.
        Failed = 3 => "failed",
    }
}

bits! {
    /// What happened in a cycle.
    CycleFlags {
        /// The command was sent.
        SENT = 1 => "sent",
        /// The daemon was shutting down.
        SHUTDOWN = 2 => "shutdown",
        /// The machine was suspended just before this cycle.
        SUSPENDED = 4 => "suspended",
    }
}

bits! {
    /// Whether the loop's thread has the real-time properties that were asked for.
    RealTime {
        /// Real time was asked for.
        ASKED = 1 => "asked",
        /// It was asked for, but the thread has no SCHED_FIFO.
        NO_FIFO = 2 => "no SCHED_FIFO",
        /// It was asked for, but the thread is not on its processor.
        NO_CPU = 4 => "not on its processor",
        /// It was asked for, but memory is not locked.
        NO_LOCK = 8 => "memory not locked",
    }
}

impl RealTime {
    /// What was asked for and is missing, in words.
    pub fn lacks(self) -> impl Iterator<Item = &'static str> {
        let missing = self.names().filter(|name| name.number != Self::ASKED.0);
        missing.map(|name| name.text)
    }

    /// Whether something that was asked for is missing.
    pub const fn is_degraded(self) -> bool {
        self.0 & !Self::ASKED.0 != 0
    }
}

codes! {
    /// Why the twist of the control law was not sent.
    Hold {
        none = 0 => "none" " It was sent.",
        /// No features have come yet.
        NoFeatures = 1 => "no features",
        /// The latest features are older than the stale limit.
        Stale = 2 => "stale features",
        /// A message was refused on reception: count or numbers.
        Invalid = 3 => "invalid message",
        /// Points were not visible for longer than `safety.blind_s`, or it is not known where they
        /// are.
        Hidden = 4 => "hidden point",
        /// The number of points is not that of the pattern.
        Count = 5 => "wrong count",
        /// A point is not finite.
        NotFinite = 6 => "not finite",
        /// A point lies outside the image.
        OffImage = 7 => "off image",
        /// The shared memory failed.
        Transport = 8 => "transport",
        /// The control law gave a twist that is not finite or beyond the limits.
        BadTwist = 9 => "bad twist",
        /// The features are older than those before, from the same camera.
        Order = 10 => "features out of order",
        /// The features are from the future, or the clock jumped.
        Clock = 11 => "clock anomaly",
        /// The solver failed several cycles in a row.
        Solver = 12 => "solver failure",
        /// The robot reports a fault or a reflex.
        RobotFault = 13 => "robot fault",
        /// The robot's state came and then stopped coming.
        RobotLost = 14 => "robot silent",
        /// Several releases in a row were missed.
        Overruns = 15 => "overruns",
        /// Nobody has armed the controller yet.
        NotArmed = 16 => "not armed",
        /// An operator disarmed or stopped it.
        Operator = 17 => "operator",
        /// The daemon is shutting down.
        Shutdown = 18 => "shutdown",
        /// No usable features came for so long that the camera was disarmed.
        Lost = 19 => "features lost",
        /// The loop itself stood still for so long that the camera was disarmed, or the machine was
        /// suspended.
        Standstill = 20 => "standstill of the loop",
        /// Points are swapped (also if the pattern is mirrored), coincide, lie on a line, or jump.
        Mixed = 21 => "points mixed up",
        /// The features did not change in any bit, although the camera was commanded to move: one
        /// image comes again and again, or `data_ns` is later than its exposure.
        Frozen = 22 => "frozen image or wrong stamps",
        /// The last vpcd of this domain was killed or crashed: whatever the configuration says, the
        /// next one begins disarmed.
        Unclean = 24 => "unclean end of the last vpcd",
        /// No robot has told its state yet, and one is required (`safety.robot`).
        NoRobot = 25 => "no robot",
        /// What the robot says it carries out is not what it was commanded.
        NotFollowed = 26 => "not followed",
        /// Foresight knows no way, and nothing has improved for 5 s: the camera stands until a way
        /// is found.
        NoWay = 27 => "no way known",
        /// The image does not move as commanded: less than a third of it, or the other way.
        NotFollowing = 28 => "image does not follow",
        /// The features are not where object and camera can have come since the last ones.
        Elsewhere = 29 => "features elsewhere",
        /// It has arrived, and stands since then, as `safety.after_arrival` wants it.
        Arrived = 30 => "arrived",
        /// The scene names an arm, and no positions of as many joints came for 0.5 s, or those that
        /// came were refused: see `joint_fault`.
        NoJoints = 31 => "joints unknown",
        /// The strategy is `follow`, and no program wants a twist.
        Unwanted = 32 => "no twist is wanted",
        /// The arm's joints do not move as the robot says that its camera moves, or leap: see
        /// `joint_fault`.
        JointsNotFollowing = 33 => "joints do not follow",
        /// What the robot says it carries out is late after the commands, by `lag_s`: more than the
        /// control law stands.
        RobotLate = 34 => "robot is late",
        /// The image moves late after the commands, by `lag_s`: more than the control law stands.
        /// The robot carries them out late, or `data_ns` is later than the exposure.
        ImageLate = 35 => "image is late",
        /// The image moves more than twice as far as commanded.
        ImageExceeds = 36 => "image moves more than commanded",
    }
}

impl Hold {
    /// The number of a hold, or that of none.
    pub fn number(hold: Option<Self>) -> u32 {
        hold.map_or(0, Self::code)
    }
}

codes! {
    /// What of the arm binds the command.
    ArmBound {
        none = 0 => "none" " Nothing, or the arm is not known.",
        /// A joint is at the end of its range.
        Range = 1 => "joint range",
        /// A joint has its greatest speed.
        Speed = 2 => "joint speed",
        /// The posture is nearly singular.
        Singularity = 3 => "singularity",
        /// The camera, a point of the arm or a link is at a wall.
        Wall = 4 => "wall",
        /// A link is near another one.
        Link = 5 => "link",
        /// A link is near a box.
        Box = 6 => "box",
    }
}

/// What of the arm binds a command, in words for people.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bound<'a> {
    /// What it is.
    pub kind: ArmBound,
    /// Of the joint, base to flange, of the wall, box or the other link's shape; from 0.
    pub index: usize,
    /// Name of the joint, wall, box or other link; empty if it is not known.
    pub name: &'a str,
    /// Index of the link's shape that is near it, from 0.
    pub link: Option<usize>,
    /// Name of that link; empty if it is not known.
    pub link_name: &'a str,
}

/// One more than the largest index of a joint, wall, box or shape.
const INDICES: usize = 256;

impl<'a> Bound<'a> {
    /// The field `arm_bound_index`, of a joint, wall, box or other link's shape, and of the link's
    /// shape near it.
    pub fn coded_index(index: usize, link: Option<usize>) -> u32 {
        (index + INDICES * link.map_or(0, |link| link + 1)) as u32
    }

    /// With its names, from those of all joints, base to flange, walls, shapes' links and boxes.
    pub fn named<T: AsRef<str>>(self, [joints, walls, links, boxes]: [&'a [T]; 4]) -> Self {
        let names = match self.kind {
            ArmBound::Range | ArmBound::Speed => joints,
            ArmBound::Wall => walls,
            ArmBound::Link => links,
            ArmBound::Box => boxes,
            ArmBound::Singularity => &[],
        };
        let name = |names: &'a [T], index: usize| names.get(index).map_or("", AsRef::as_ref);
        Self {
            name: name(names, self.index),
            link_name: self.link.map_or("", |link| name(links, link)),
            ..self
        }
    }
}

impl fmt::Display for Bound<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            kind, index, name, ..
        } = *self;
        let number = index + 1;
        if let Some(link) = self.link {
            match self.link_name {
                "" => write!(f, "link shape {}", link + 1)?,
                name => f.write_str(name)?,
            }
            f.write_str(" is ")?;
        }
        match (kind, name) {
            (ArmBound::Range, "") => write!(f, "joint {number} is at the end of its range"),
            (ArmBound::Range, _) => write!(f, "{name} is at the end of its range"),
            (ArmBound::Speed, "") => write!(f, "joint {number} is at its greatest speed"),
            (ArmBound::Speed, _) => write!(f, "{name} is at its greatest speed"),
            (ArmBound::Singularity, _) => f.write_str("near a singular posture"),
            (ArmBound::Wall, "") => write!(f, "at wall {number}"),
            (ArmBound::Wall, _) => write!(f, "at wall {number} ({name})"),
            (ArmBound::Link, "") => write!(f, "near link shape {number}"),
            (ArmBound::Link, _) => write!(f, "near {name}"),
            (ArmBound::Box, "") => write!(f, "near box {number}"),
            (ArmBound::Box, _) => write!(f, "near box {number} ({name})"),
        }
    }
}

codes! {
    /// What is wrong with the joints that the robot tells.
    JointFaultCode {
        none = 0 => "none" " Nothing, or the arm is not known.",
        /// Their instant is later than now.
        Future = 1 => "future",
        /// A position is outside the joint's range.
        Range = 2 => "range",
        /// A joint moved faster than it can since the message before.
        Leap = 3 => "leap",
        /// The camera's translation by the joints is not that by the reported twist.
        Translation = 4 => "translation",
        /// The camera's rotation by the joints is not that by the reported twist.
        Rotation = 5 => "rotation",
    }
}

/// What is wrong with the joints that the robot tells: what, its value, and what is allowed.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct JointFault {
    /// What it is.
    pub code: JointFaultCode,
    /// Index of the joint, base to flange, from 0; 0 where the fault is of none.
    pub joint: u32,
    /// The joint's position or change, rad or m; how far the stamp is ahead, s; or the difference
    /// of both motions of the camera, m or rad.
    pub found: f64,
    /// The least and the greatest value allowed.
    pub allowed: [f64; 2],
}

impl JointFault {
    /// In words for people, with the joint's name from those of all, base to flange; by its number
    /// from 1 where that is not known.
    pub fn words<T: AsRef<str>>(self, joints: &[T]) -> impl fmt::Display {
        let name = joints.get(self.joint as usize).map_or("", AsRef::as_ref);
        JointWords { fault: self, name }
    }
}

/// A fault of joints in words.
struct JointWords<'a> {
    fault: JointFault,
    name: &'a str,
}

/// A number in few digits.
struct Short(f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.abs() < 1e4 {
            true => write!(f, "{:.3}", self.0),
            false => write!(f, "{:.1e}", self.0),
        }
    }
}

impl fmt::Display for JointWords<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let JointFault {
            code,
            joint,
            found,
            allowed,
        } = self.fault;
        let is_joint = matches!(code, JointFaultCode::Range | JointFaultCode::Leap);
        match self.name {
            _ if !is_joint => (),
            "" => write!(f, "joint {}", joint + 1)?,
            name => f.write_str(name)?,
        }
        let (found, [least, most]) = (Short(found), allowed.map(Short));
        match code {
            JointFaultCode::Future => {
                write!(
                    f,
                    "their stamp is {found} s later than now; allowed: {most} s"
                )
            }
            JointFaultCode::Range => write!(f, " is told at {found}; allowed: {least} to {most}"),
            JointFaultCode::Leap => {
                write!(
                    f,
                    " leaps by {found} from one message to the next; allowed: {least} to {most}"
                )
            }
            JointFaultCode::Translation => write!(
                f,
                "the camera's way by them and by the reported twist are {found} m apart; allowed: {most} m"
            ),
            JointFaultCode::Rotation => write!(
                f,
                "the camera's turn by them and by the reported twist are {found} rad apart; allowed: {most} rad"
            ),
        }
    }
}

codes! {
    /// How the solver ended.
    SolverStatus {
        /// It did not run.
        Idle = 0 => "idle",
        /// Optimal to the tolerance, no constraint violated.
        Converged = 1 => "converged",
        /// Feasible, but the iterations ran out.
        IterationLimit = 2 => "iteration limit",
        /// No further decrease.
        Stalled = 3 => "stalled",
        /// The best plan violates a constraint.
        Infeasible = 4 => "infeasible",
        /// No plan could be computed.
        NumericalFailure = 5 => "numerical failure",
    }
}

codes! {
    /// What the memory of motion answered.
    RecallCode {
        /// It was not asked: no feature is near an occlusion or a border, or the strategy has no
        /// memory.
        Unasked = 0 => "not asked",
        /// Its warm start and way point were followed.
        Followed = 1 => "followed",
        /// Its answers were out of range and were not used.
        Refused = 2 => "out of range",
        /// The Gaussian process knew nothing, or its answer was out of range: the nearest
        /// neighbour's was followed.
        Replaced = 3 => "replaced by the nearest neighbour's",
    }
}

codes! {
    /// Strategy of the control law.
    StrategyCode {
        /// Warm start from the previous cycle.
        Previous = 0 => "previous",
        /// k nearest neighbours of the memory.
        Knn = 1 => "knn",
        /// Gaussian-process regression over the memory.
        Gpr = 2 => "gpr",
        /// Classic image-based visual servoing.
        Ibvs = 3 => "ibvs",
        /// Whole futures are simulated, and the best one is followed.
        Foresight = 4 => "foresight",
        /// The nearest allowed twist to that of `vpc/desired` is sent.
        Follow = 5 => "follow",
    }
}

codes! {
    /// What foresight follows.
    ForesightCode {
        /// The strategy is another one.
        Off = 0 => "off",
        /// The goal.
        Goal = 1 => "goal",
        /// A sample of the memory, then the goal.
        Sample = 2 => "sample",
        /// A step aside, then the goal, perhaps over a sample.
        Aside = 3 => "step aside",
        /// The way point of the nearest sample, then the goal.
        Neighbour = 4 => "k-NN way point",
        /// The way point that the Gaussian process infers, then the goal.
        Regression = 5 => "GPR way point",
        /// A path in the arm's joints, to the goal.
        Joints = 6 => "joint path",
        /// A way that was refined as a whole.
        Refined = 7 => "refined way",
    }
}

/// Corners of an ellipse's outline, and its half axes in deviations.
const CORNERS: usize = 24;
const DEVIATIONS: f64 = 2.0;

/// Most places of a foreseen path.
pub const PATH_PLACES: usize = 8;

/// Most neighbours that knn averages.
pub const MAX_NEIGHBOURS: u32 = 64;

impl StrategyCode {
    /// Reads a name, for knn with the number of neighbours behind it; the number is 1 where knn
    /// stands alone, and 0 for other strategies.
    pub fn from_name(text: &str) -> Option<(Self, u32)> {
        if let Some(digits) = text.strip_prefix("knn").filter(|digits| !digits.is_empty()) {
            let k = digits
                .parse()
                .ok()
                .filter(|k| (1..=MAX_NEIGHBOURS).contains(k));
            return k.map(|k| (Self::Knn, k));
        }
        let name = Self::TABLE.names.iter().find(|name| name.text == text)?;
        let strategy = Self::from_code(name.number)?;
        Some((strategy, u32::from(strategy == Self::Knn)))
    }
}

message! {
    /// Telemetry of one cycle. Numbers of the control law are NaN if it did not run.
    CycleRecord {
        /// Head; `data_ns` is when the cycle woke up.
        stamp: Stamp,
        /// Number of the cycle, from 1.
        cycle: u64,
        /// What starts a cycle.
        clock: u32 [code(ClockMode)],
        /// How the solver ended.
        status: u32 [code(SolverStatus)],
        /// Wake-up after the release; 0 in lockstep.
        wake_latency_ns: u64 ["ns"],
        /// Time taken by receiving: the decision was made for the instant `stamp.data_ns +
        /// receive_ns`.
        receive_ns: u64 ["ns"],
        /// Time taken by the decision.
        step_ns: u64 ["ns"],
        /// Time taken by sending.
        send_ns: u64 ["ns"],
        /// Releases missed since the start.
        overruns: u64,
        /// Sequence number of the features used; 0 if none were.
        features_sequence: u64,
        /// Age of the features used at wake-up, from `data_ns`; in lockstep at their delivery.
        features_age_ns: u64 ["ns"],
        /// Records lost since the start because the recorder was slower than the loop.
        lost_records: u64,
        /// Points in `points`.
        count: u32 [range(0, MAX_POINTS)],
        /// Points in `way_point`; 0 if the goal is tracked.
        way_point_count: u32 [range(0, MAX_POINTS)],
        /// What the memory of motion answered.
        recalled: u32 [code(RecallCode)],
        /// Strategy of the control law.
        strategy: u32 [code(StrategyCode)],
        /// Neighbours averaged by knn; 0 for other strategies.
        neighbours: u32,
        /// Length of the preview in periods.
        np: u32,
        /// Iterations of the solver.
        iterations: u32,
        /// Active-set changes in its quadratic programs.
        qp_iterations: u32,
        /// Why the twist of the control law was not sent.
        hold: u32 [code(Hold)],
        /// State of the controller.
        state: u32 [code(TwistState)],
        /// Features used, u1 v1 u2 v2 ...; a point that was not seen is where it is believed.
        points: [f64; 2 * MAX_POINTS] ["px"],
        /// Covariance of each point that was not seen, uu uv vv; zero for the others.
        covariance: [f64; 3 * MAX_POINTS] ["px^2"],
        /// The pattern's own motion as the law believes it, in the camera frame: vx vy vz wx wy wz.
        drift: [f64; 6] ["m/s, rad/s" finite],
        /// Way point tracked instead of the goal, u1 v1 u2 v2 ....
        way_point: [f64; 2 * MAX_POINTS] ["px"],
        /// Camera velocity of the command, in the camera frame: vx vy vz wx wy wz.
        twist: [f64; 6] ["m/s, rad/s" finite],
        /// The paper's running cost of the command.
        cost: f64 = f64::NAN,
        /// Worst constraint violation predicted over the preview.
        violation_px: f64 ["px"] = f64::NAN,
        /// Least distance of a marker's edge, or of a feature where markers are points, from an
        /// occlusion; infinite in a scene without any.
        clearance_px: f64 ["px"] = f64::NAN,
        /// Largest component of s - s*.
        error_px: f64 ["px"] = f64::NAN,
        /// What foresight follows.
        foresight: u32 [code(ForesightCode)],
        /// Candidates that foresight compared with it since the previous command.
        candidates: u32,
        /// Steps that foresight simulated for that.
        simulated: u32,
        /// How often foresight has changed what it follows.
        switches: u32,
        /// Foreseen time to arrival; NaN where no way is known, and without foresight.
        arrival_s: f64 ["s"] = f64::NAN,
        /// Time from one place of `path` to the next.
        path_every_s: f64 ["s"],
        /// Places in `path`; 0 without foresight.
        path_count: u32 [range(0, PATH_PLACES)],
        /// Points at each place of `path`.
        path_points: u32 [range(0, MAX_POINTS)],
        /// The foreseen features, place by place: u1 v1 u2 v2 ....
        path: [f64; 2 * MAX_POINTS * PATH_PLACES] ["px"],
        /// Whether the loop's thread has its real-time properties.
        realtime: u32 [bits(RealTime)],
        /// Whether the grid of releases follows the camera's frames.
        phase: u32 [code(PhaseCode)],
        /// This release minus the one that the camera's phase asks for; 0 while the grid is free.
        phase_error_ns: i64 ["ns"],
        /// Page faults of the loop's thread from wake-up to sending that were served without a
        /// disk.
        minor_faults: u32,
        /// Page faults in that time that waited for a disk.
        major_faults: u32,
        /// Times that the loop's thread gave up its processor in that time because a call blocked.
        blocked: u32,
        /// Calls of the heap by the loop's thread in that time, if the allocator counts them.
        allocations: u32,
        /// What came from the camera.
        features_input: u32 [code(InputCode)],
        /// What came from the robot.
        robot_input: u32 [code(InputCode)],
        /// What came from the program that wants a twist.
        desired_input: u32 [code(InputCode)],
        /// Zero.
        reserved: u32,
        /// Head of the features message that came, also of a refused one; zero if none came.
        features_seen: Stamp,
        /// Head of the robot state that came, also of a refused one; zero if none came.
        robot_seen: Stamp,
        /// Head of the wanted twist that came, also of a refused one; zero if none came.
        desired_seen: Stamp,
        /// The wanted twist, with the strategy `follow`; zero if there is none.
        desired: [f64; 6] ["m/s, rad/s" finite],
        /// Requests of operators taken since the previous cycle.
        requests: u32,
        /// Releases missed just before this cycle.
        missed: u32,
        /// What happened in this cycle.
        flags: u32 [bits(CycleFlags)],
        /// The veto that stands: the random name of the last operator's stop (odd) or disarm (even)
        /// since it was last armed; 0: none.
        veto: u32,
        /// Bit i is set if point i of `points` was seen.
        visible: u32,
        /// Cycles in a row that the law answered by prediction, because no image came.
        predicted: u32,
        /// What of the arm binds the law's command.
        arm_bound: u32 [code(ArmBound)],
        /// Index of that joint, base to flange, wall, box or link's shape, from 0; where a link's
        /// shape is near it, plus 256 times that shape's number, from 1.
        arm_bound_index: u32,
        /// Velocity of the arm's elbow that was sent.
        elbow: f64 ["rad/s" finite],
        /// What is wrong with the joints that the robot told last.
        joint_fault: u32 [code(JointFaultCode)],
        /// Index of the joint that it is of, base to flange, from 0.
        joint_fault_index: u32,
        /// The position of that joint or its change, rad or m; how far the stamp is ahead, s; or
        /// the difference of the camera's motions by the joints and by the reported twist, m or
        /// rad.
        joint_fault_found: f64,
        /// The least and the greatest value allowed.
        joint_fault_allowed: [f64; 2],
        /// How late the motion was after the commands when robot or image were last held as late;
        /// NaN before.
        lag_s: f64 ["s"] = f64::NAN,
    }
    // A buffer for recorders: half a minute at 30 Hz, a good part of a second in lockstep.
    "vpc/cycles" from "controller": Qos { history: 0, buffer: 1024, subscribers: 8, publishers: 1 }
}

impl CycleRecord {
    /// Why the law's twist was not sent; `None` if it was. Reception refuses unknown codes.
    pub fn hold(&self) -> Option<Hold> {
        Hold::from_code(self.hold)
    }

    /// What of the arm binds the law's command, without a name.
    pub fn bound(&self) -> Option<Bound<'static>> {
        Some(Bound {
            kind: ArmBound::from_code(self.arm_bound)?,
            index: self.arm_bound_index as usize % INDICES,
            name: "",
            link: (self.arm_bound_index as usize / INDICES).checked_sub(1),
            link_name: "",
        })
    }

    /// What is wrong with the joints that the robot told last.
    pub fn joint_fault(&self) -> Option<JointFault> {
        Some(JointFault {
            code: JointFaultCode::from_code(self.joint_fault)?,
            joint: self.joint_fault_index,
            found: self.joint_fault_found,
            allowed: self.joint_fault_allowed,
        })
    }

    /// The features used (u, v), px.
    pub fn pairs(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        pairs(&self.points, self.count)
    }

    /// Whether this point of `points` was seen.
    pub fn sees(&self, point: usize) -> bool {
        self.visible >> point & 1 == 1
    }

    /// The outline of where a point is believed that was not seen, px: two deviations, which hold
    /// it in 86 of 100 cases. `None` where it was seen, or nothing is believed.
    pub fn ellipse(&self, point: usize) -> Option<impl Iterator<Item = [f64; 2]> + use<>> {
        let middle = self.pairs().nth(point).filter(|_| !self.sees(point))?;
        let &[uu, uv, vv] = self.covariance.as_chunks().0.get(point)?;
        if [uu, vv] == [0.0; 2] {
            // Of an image that was refused.
            return None;
        }
        // A factor of the covariance takes a circle to the ellipse.
        let u = libm::sqrt(uu);
        let across = if u > 0.0 { uv / u } else { 0.0 };
        let v = libm::sqrt((vv - across * across).max(0.0));
        let corner = move |k: usize| {
            let (sin, cos) = libm::sincos(core::f64::consts::TAU * k as f64 / CORNERS as f64);
            let [du, dv] = [u * cos, across * cos + v * sin];
            [middle[0] + DEVIATIONS * du, middle[1] + DEVIATIONS * dv]
        };
        Some((0..CORNERS).map(corner))
    }

    /// The points that were not seen, with the outlines of where they are believed.
    pub fn ellipses(
        &self,
    ) -> impl Iterator<Item = (usize, impl Iterator<Item = [f64; 2]> + use<>)> {
        let points = 0..(self.count as usize).min(MAX_POINTS);
        points.filter_map(|point| Some((point, self.ellipse(point)?)))
    }

    /// How fast the pattern is believed to move by itself, m/s, and to turn, rad/s.
    pub fn drift_speed(&self) -> [f64; 2] {
        let [x, y, z, a, b, c] = self.drift;
        [[x, y, z], [a, b, c]].map(|v| libm::sqrt(v.map(|x| x * x).iter().sum()))
    }

    /// Whether foresight knows no way to the goal.
    pub fn knows_no_way(&self) -> bool {
        self.foresight != ForesightCode::Off.code() && self.arrival_s.is_nan()
    }

    /// The foreseen way of each point (u, v), px, place by place.
    pub fn foreseen(&self) -> impl Iterator<Item = impl Iterator<Item = [f64; 2]>> {
        let places = (self.path_count as usize).min(PATH_PLACES);
        (0..(self.path_points as usize).min(MAX_POINTS)).map(move |point| {
            let at =
                move |place: usize| [0, 1].map(|c| self.path[2 * (place * MAX_POINTS + point) + c]);
            (0..places).map(at)
        })
    }

    /// The way point (u, v), px; empty if the goal is tracked.
    pub fn way_point_pairs(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        pairs(&self.way_point, self.way_point_count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Message;

    #[test]
    fn an_empty_cycle_is_valid_and_unknown_codes_are_not() {
        let mut record = CycleRecord::default();
        record.stamp.sequence = 1;
        assert_eq!(record.check(), Ok(()));
        record.hold = 1000;
        let message = record.check().unwrap_err().to_string();
        assert!(message.starts_with("vpc/cycles: hold = 1000"), "{message}");
    }

    #[test]
    fn real_time_is_degraded_by_what_was_asked_for_and_is_missing() {
        assert!(!RealTime::default().is_degraded() && !RealTime::ASKED.is_degraded());
        let bits = RealTime::ASKED.with(RealTime::NO_LOCK);
        assert!(bits.is_degraded() && bits.has(RealTime::NO_LOCK) && !bits.has(RealTime::NO_CPU));
    }

    #[test]
    fn a_bound_is_told_by_name_or_by_number_from_one() {
        let mut record = CycleRecord::default();
        assert_eq!(record.bound(), None);
        (record.arm_bound, record.arm_bound_index) = (ArmBound::Range.code(), 3);
        let bound = record.bound().unwrap();
        assert_eq!(bound.to_string(), "joint 4 is at the end of its range");
        let (joints, walls) = (["a", "b", "c", "elbow"], ["table"]);
        let names: [&[&str]; 4] = [&joints, &walls, &["base", "hand"], &["bin"]];
        let named = bound.named(names);
        assert_eq!(named.to_string(), "elbow is at the end of its range");
        assert_eq!(bound.named([&joints[..3], &[], &[], &[]]), bound);
        let mut told = |kind: ArmBound, index, link| {
            let index = Bound::coded_index(index, link);
            (record.arm_bound, record.arm_bound_index) = (kind.code(), index);
            let bound = record.bound().unwrap();
            [bound.to_string(), bound.named(names).to_string()]
        };
        assert_eq!(
            told(ArmBound::Wall, 0, None),
            ["at wall 1", "at wall 1 (table)"]
        );
        let by_link = told(ArmBound::Wall, 0, Some(1));
        assert_eq!(
            by_link,
            ["link shape 2 is at wall 1", "hand is at wall 1 (table)"]
        );
        let links = told(ArmBound::Link, 0, Some(1));
        assert_eq!(
            links,
            ["link shape 2 is near link shape 1", "hand is near base"]
        );
        let of_box = told(ArmBound::Box, 0, Some(1));
        assert_eq!(
            of_box,
            ["link shape 2 is near box 1", "hand is near box 1 (bin)"]
        );
    }

    #[test]
    fn a_fault_of_joints_is_told_with_its_joint_its_value_and_what_is_allowed() {
        let mut record = CycleRecord::default();
        assert_eq!(record.joint_fault(), None);
        record.joint_fault_index = 1;
        let mut told = |code: JointFaultCode, found| {
            (record.joint_fault, record.joint_fault_found) = (code.code(), found);
            record.joint_fault_allowed = [-2.947, 2.947];
            let fault = record.joint_fault().unwrap();
            [
                fault.words(&["a", "elbow"]).to_string(),
                fault.words(&["a"]).to_string(),
            ]
        };
        assert_eq!(
            told(JointFaultCode::Range, 5.0),
            [
                "elbow is told at 5.000; allowed: -2.947 to 2.947",
                "joint 2 is told at 5.000; allowed: -2.947 to 2.947"
            ]
        );
        let [huge, _] = told(JointFaultCode::Range, 1e300);
        assert_eq!(huge, "elbow is told at 1.0e300; allowed: -2.947 to 2.947");
        let [leap, _] = told(JointFaultCode::Leap, -6.25);
        assert!(leap.starts_with("elbow leaps by -6.250 from"), "{leap}");
        let [future, same] = told(JointFaultCode::Future, 1e9);
        assert_eq!(future, same);
        assert!(
            future.starts_with("their stamp is 1.0e9 s later"),
            "{future}"
        );
        let [turn, _] = told(JointFaultCode::Rotation, 0.4);
        assert!(
            turn.ends_with("0.400 rad apart; allowed: 2.947 rad"),
            "{turn}"
        );
    }

    #[test]
    fn a_way_point_has_as_many_points_as_it_says() {
        let mut record = CycleRecord::default();
        record.way_point[0] = 3.0;
        assert_eq!(record.way_point_pairs().count(), 0);
        record.way_point_count = 1;
        assert!(record.way_point_pairs().eq([[3.0, 0.0]]));
        record.way_point_count = 4000;
        assert_eq!(record.way_point_pairs().count(), 8);
    }
}
