//! What one cycle of the controller did, and how long it took.

use core::mem::{offset_of, size_of};

use iceoryx2::prelude::ZeroCopySend;

use crate::MAX_POINTS;
use crate::message::{self, Invalid, Message, Qos, Stamp, codes};

codes! {
    /// What starts a cycle.
    ClockMode {
        /// An absolute grid in time.
        Fixed = 0 => "fixed",
        /// Each new features message.
        Lockstep = 1 => "lockstep",
        /// A grid in time that keeps the nominal rate and follows the camera's phase.
        Phase = 2 => "phase",
    }
}

codes! {
    /// What the grid of releases has to do with the camera's frames.
    PhaseCode {
        /// Nothing: the clock is another one, or no frames come.
        Free = 0 => "free",
        /// It is on the way to the camera's phase.
        Seeking = 1 => "seeking",
        /// It follows it.
        Locked = 2 => "locked",
    }
}

/// How real the real time of the loop's thread is: a sum of bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RealTime(pub u32);

impl RealTime {
    /// Real time was asked for.
    pub const ASKED: Self = Self(1);
    /// ... and the thread has no SCHED_FIFO.
    pub const NO_FIFO: Self = Self(2);
    /// ... and the thread is not on its processor.
    pub const NO_CPU: Self = Self(4);
    /// ... and memory is not locked.
    pub const NO_LOCK: Self = Self(8);

    /// These bits and those.
    pub const fn with(self, bits: Self) -> Self {
        Self(self.0 | bits.0)
    }

    /// Whether all of these bits are set.
    pub const fn has(self, bits: Self) -> bool {
        self.0 & bits.0 == bits.0
    }

    /// Whether something that was asked for is missing.
    pub const fn is_degraded(self) -> bool {
        self.0 & !Self::ASKED.0 != 0
    }
}

codes! {
    /// Why a cycle did not send the law's twist.
    Hold {
        /// It did not: the law's twist was sent.
        None = 0 => "none",
        /// No features have come yet.
        NoFeatures = 1 => "no features",
        /// The latest features are older than the stale limit.
        Stale = 2 => "stale features",
        /// A message was refused on reception: count or numbers.
        Invalid = 3 => "invalid message",
        /// A point was not visible.
        Hidden = 4 => "hidden point",
        /// The count of points is not the pattern's.
        Count = 5 => "wrong count",
        /// A point is not finite.
        NotFinite = 6 => "not finite",
        /// A point lies outside the image.
        OffImage = 7 => "off image",
        /// The shared memory failed.
        Transport = 8 => "transport",
        /// The law gave a twist that is not finite or beyond the limits.
        BadTwist = 9 => "bad twist",
        /// Features came in the wrong order: older than those before, from the same camera.
        Order = 10 => "features out of order",
        /// Features bear the time of the future, or the clock jumped.
        Clock = 11 => "clock anomaly",
        /// The solver failed several cycles in a row.
        Solver = 12 => "solver failure",
        /// The robot reports a fault or a reflex.
        RobotFault = 13 => "robot fault",
        /// The robot's state was coming and fell silent.
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
        /// The loop itself stood still for that long.
        Standstill = 20 => "standstill of the loop",
        /// Points lie in each other's places (they turn the other way than the pattern, or changed their names), in one
        /// place, all on a line, or leap.
        Mixed = 21 => "points mixed up",
        /// Not one bit of the features changed, though the camera was commanded to move.
        Frozen = 22 => "frozen image",
        /// The memory's answers were out of range several cycles in a row.
        Recall = 23 => "recall out of range",
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
    /// What the memory had to say.
    RecallCode {
        /// It was not asked: no features near a border, or a strategy without memory.
        Unasked = 0 => "not asked",
        /// Its warm start and way point were followed.
        Followed = 1 => "followed",
        /// Its answer was out of range; the cycle went without.
        Refused = 2 => "out of range",
        /// The law was stalled: the way point is a sample's features, back on a stored trajectory.
        Detour = 3 => "detour",
    }
}

codes! {
    /// Strategy of the law.
    StrategyCode {
        /// Warm start from the previous cycle.
        Previous = 0 => "previous",
        /// k nearest neighbours of the memory.
        Knn = 1 => "knn",
        /// Gaussian-process regression over the memory.
        Gpr = 2 => "gpr",
        /// Classic image-based visual servoing.
        Ibvs = 3 => "ibvs",
    }
}

/// Telemetry of one cycle; service `vpc/cycles`. Numbers of the law are NaN where it did not run.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[type_name("vpc/CycleRecord/2")]
pub struct CycleRecord {
    /// Head; `data_ns` is when the cycle woke up.
    pub stamp: Stamp,
    /// Number of the cycle, from 1.
    pub cycle: u64,
    /// A [`ClockMode`] code.
    pub clock: u32,
    /// A [`SolverStatus`] code.
    pub status: u32,
    /// Wake-up after the release, ns; 0 in lockstep.
    pub wake_latency_ns: u64,
    /// Time taken by receiving and the gate, ns.
    pub receive_ns: u64,
    /// Time taken by the law, ns.
    pub step_ns: u64,
    /// Time taken by sending, ns.
    pub send_ns: u64,
    /// Releases missed since the start.
    pub overruns: u64,
    /// Sequence number of the features used; 0 where none were.
    pub features_sequence: u64,
    /// Age of the features used when the cycle woke up, from the middle of the exposure, ns.
    pub features_age_ns: u64,
    /// Records lost since the start because the recorder was slower than the loop.
    pub lost_records: u64,
    /// Points in `points`, 0 to 8.
    pub count: u32,
    /// Points in `way_point`: 0 where the goal is tracked.
    pub way_point_count: u32,
    /// A [`RecallCode`].
    pub recalled: u32,
    /// A [`StrategyCode`].
    pub strategy: u32,
    /// Neighbours averaged by k-NN; 0 for other strategies.
    pub neighbours: u32,
    /// Steps previewed.
    pub np: u32,
    /// Iterations of the solver.
    pub iterations: u32,
    /// Active-set changes in its quadratic programs.
    pub qp_iterations: u32,
    /// A [`Hold`] code.
    pub hold: u32,
    /// A [`crate::TwistState`] code.
    pub state: u32,
    /// Features used, u1 v1 u2 v2 ..., px.
    pub points: [f64; 2 * MAX_POINTS],
    /// Way point tracked instead of the goal, u1 v1 u2 v2 ..., px.
    pub way_point: [f64; 2 * MAX_POINTS],
    /// Camera twist that was sent, camera frame, m/s and rad/s.
    pub twist: [f64; 6],
    /// The paper's running cost of the command that was sent.
    pub cost: f64,
    /// Worst violation predicted over the window, px.
    pub violation_px: f64,
    /// Least clearance of a feature from an occlusion, px; infinite in a scene without any.
    pub clearance_px: f64,
    /// Largest component of s - s*, px.
    pub error_px: f64,
    /// [`RealTime`] bits.
    pub realtime: u32,
    /// A [`PhaseCode`].
    pub phase: u32,
    /// This release after the one that the camera's phase asks for, ns; 0 while the grid is free.
    pub phase_error_ns: i64,
    /// Page faults of the loop's thread from wake to send that were served without a disk.
    pub minor_faults: u32,
    /// ... that waited for a disk.
    pub major_faults: u32,
    /// Times that the loop's thread gave up its processor from wake to send, because a call blocked.
    pub blocked: u32,
    /// Calls of the heap by the loop's thread from wake to send, where the allocator counts them.
    pub allocations: u32,
    /// Zero: room to grow.
    pub room: [u64; 4],
}

const _: () = {
    assert!(size_of::<CycleRecord>() == 544);
    assert!(offset_of!(CycleRecord, cycle) == 24);
    assert!(offset_of!(CycleRecord, clock) == 32);
    assert!(offset_of!(CycleRecord, status) == 36);
    assert!(offset_of!(CycleRecord, wake_latency_ns) == 40);
    assert!(offset_of!(CycleRecord, receive_ns) == 48);
    assert!(offset_of!(CycleRecord, step_ns) == 56);
    assert!(offset_of!(CycleRecord, send_ns) == 64);
    assert!(offset_of!(CycleRecord, overruns) == 72);
    assert!(offset_of!(CycleRecord, features_sequence) == 80);
    assert!(offset_of!(CycleRecord, features_age_ns) == 88);
    assert!(offset_of!(CycleRecord, lost_records) == 96);
    assert!(offset_of!(CycleRecord, count) == 104);
    assert!(offset_of!(CycleRecord, way_point_count) == 108);
    assert!(offset_of!(CycleRecord, recalled) == 112);
    assert!(offset_of!(CycleRecord, strategy) == 116);
    assert!(offset_of!(CycleRecord, neighbours) == 120);
    assert!(offset_of!(CycleRecord, np) == 124);
    assert!(offset_of!(CycleRecord, iterations) == 128);
    assert!(offset_of!(CycleRecord, qp_iterations) == 132);
    assert!(offset_of!(CycleRecord, hold) == 136);
    assert!(offset_of!(CycleRecord, state) == 140);
    assert!(offset_of!(CycleRecord, points) == 144);
    assert!(offset_of!(CycleRecord, way_point) == 272);
    assert!(offset_of!(CycleRecord, twist) == 400);
    assert!(offset_of!(CycleRecord, cost) == 448);
    assert!(offset_of!(CycleRecord, violation_px) == 456);
    assert!(offset_of!(CycleRecord, clearance_px) == 464);
    assert!(offset_of!(CycleRecord, error_px) == 472);
    assert!(offset_of!(CycleRecord, realtime) == 480);
    assert!(offset_of!(CycleRecord, phase) == 484);
    assert!(offset_of!(CycleRecord, phase_error_ns) == 488);
    assert!(offset_of!(CycleRecord, minor_faults) == 496);
    assert!(offset_of!(CycleRecord, major_faults) == 500);
    assert!(offset_of!(CycleRecord, blocked) == 504);
    assert!(offset_of!(CycleRecord, allocations) == 508);
    assert!(offset_of!(CycleRecord, room) == 512);
};

impl Default for CycleRecord {
    /// A cycle in which nothing happened.
    fn default() -> Self {
        Self {
            stamp: Stamp::default(),
            cycle: 0,
            clock: ClockMode::Fixed.code(),
            status: SolverStatus::Idle.code(),
            wake_latency_ns: 0,
            receive_ns: 0,
            step_ns: 0,
            send_ns: 0,
            overruns: 0,
            features_sequence: 0,
            features_age_ns: 0,
            lost_records: 0,
            count: 0,
            way_point_count: 0,
            recalled: 0,
            strategy: StrategyCode::Previous.code(),
            neighbours: 0,
            np: 0,
            iterations: 0,
            qp_iterations: 0,
            hold: Hold::None.code(),
            state: crate::TwistState::Stopped.code(),
            points: [0.0; 2 * MAX_POINTS],
            way_point: [0.0; 2 * MAX_POINTS],
            twist: [0.0; 6],
            cost: f64::NAN,
            violation_px: f64::NAN,
            clearance_px: f64::NAN,
            error_px: f64::NAN,
            realtime: 0,
            phase: PhaseCode::Free.code(),
            phase_error_ns: 0,
            minor_faults: 0,
            major_faults: 0,
            blocked: 0,
            allocations: 0,
            room: [0; 4],
        }
    }
}

impl CycleRecord {
    /// Cause of the zero twist; `None` where the code is unknown, which reception refuses.
    pub fn hold(&self) -> Option<Hold> {
        Hold::from_code(self.hold)
    }

    /// The features used (u, v), px.
    pub fn pairs(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        pairs(&self.points, self.count)
    }

    /// The way point (u, v), px; empty where the goal is tracked.
    pub fn way_point_pairs(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        pairs(&self.way_point, self.way_point_count)
    }
}

fn pairs(stacked: &[f64], count: u32) -> impl Iterator<Item = [f64; 2]> + '_ {
    let count = (count as usize).min(MAX_POINTS);
    stacked.chunks_exact(2).take(count).map(|p| [p[0], p[1]])
}

impl Message for CycleRecord {
    const SERVICE: &'static str = "vpc/cycles";
    /// A buffer for recorders: half a minute at 30 Hz, a good part of a second in lockstep.
    const QOS: Qos = Qos {
        history: 0,
        buffer: 1024,
        subscribers: 8,
        publishers: 1,
    };

    message::carried_by!(cycles);

    fn check(&self) -> Result<(), Invalid> {
        let service = Self::SERVICE;
        message::check_stamp(service, &self.stamp)?;
        for (field, found, known) in [
            (
                "clock",
                self.clock,
                ClockMode::from_code(self.clock).is_some(),
            ),
            (
                "status",
                self.status,
                SolverStatus::from_code(self.status).is_some(),
            ),
            (
                "strategy",
                self.strategy,
                StrategyCode::from_code(self.strategy).is_some(),
            ),
            ("hold", self.hold, Hold::from_code(self.hold).is_some()),
            (
                "state",
                self.state,
                crate::TwistState::from_code(self.state).is_some(),
            ),
            (
                "phase",
                self.phase,
                PhaseCode::from_code(self.phase).is_some(),
            ),
        ] {
            message::check_code(service, field, found, known)?;
        }
        message::check_count(service, "count", self.count, 0..=MAX_POINTS)?;
        message::check_count(
            service,
            "way_point_count",
            self.way_point_count,
            0..=MAX_POINTS,
        )?;
        message::check_finite(service, "twist", &self.twist)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
