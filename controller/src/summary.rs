//! Sums over the records of a run.

use messages::{CycleRecord, Hold, PhaseCode, RealTime, RecallCode, TwistState};
use scene::Arm;
use tracing::{info, warn};

use crate::histogram::Histogram;
use crate::report::Report;

/// Stages of a cycle whose times are reported.
const STAGES: [&str; 5] = ["wake", "receive", "step", "send", "busy"];

/// Cycles in motion without a known way after which that is logged.
const LOST_CYCLES: u32 = 30;

/// Counts records, and logs changes.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// The counts so far; without times.
    counts: Report,
    held: u64,
    /// Of each of the [`STAGES`].
    times: [Histogram; 5],
    phase: u32,
    state: u32,
    hold: u32,
    error_px: f64,
    lag_s: f64,
    /// Cycles in motion without a known way, until the last one.
    lost: u32,
    /// Whether the law's twist was sent in some cycle so far.
    has_steered: bool,
    /// The scene's arm.
    arm: Option<Arm>,
    /// What of it binds the command of the last cycle with features, in words.
    bound: Option<String>,
    /// What is wrong with the joints that the robot told last, in words.
    joint_fault: Option<String>,
}

impl Summary {
    /// Before the first record, of a scene with this arm.
    pub fn new(arm: Option<Arm>) -> Self {
        Self {
            arm,
            ..Self::default()
        }
    }

    /// Adds the next record.
    pub fn add(&mut self, record: &CycleRecord) {
        self.counts.cycles += 1;
        self.held += u64::from(record.hold().is_some());
        let (receive, step, send) = (record.receive_ns, record.step_ns, record.send_ns);
        let times = [
            record.wake_latency_ns,
            receive,
            step,
            send,
            receive + step + send,
        ];
        for (histogram, ns) in self.times.iter_mut().zip(times) {
            histogram.add(ns);
        }
        self.counts.recalled += u64::from(record.recalled == RecallCode::Followed.code());
        self.counts.realtime = record.realtime;
        self.count_costs(record);
        if record.count > 0 {
            self.bound = self.bound(record);
        }
        self.joint_fault = self.joint_fault(record);
        self.lag_s = record.lag_s;
        self.log_changes(record);
        self.log_foresight(record);
        self.phase = record.phase;
        self.has_steered |= record.hold().is_none();
        (self.state, self.hold) = (record.state, record.hold);
        self.error_px = record.error_px;
        (self.counts.overruns, self.counts.lost_records) = (record.overruns, record.lost_records);
    }

    /// Cycles that steer are to cost nothing but time, once all peers are met.
    fn count_costs(&mut self, record: &CycleRecord) {
        if record.hold().is_some() {
            return;
        }
        let counts = &mut self.counts;
        counts.armed += 1;
        if counts.armed > Report::WARM_UP {
            counts.minor_faults += u64::from(record.minor_faults);
            counts.major_faults += u64::from(record.major_faults);
            counts.blocked += u64::from(record.blocked);
            counts.allocations += u64::from(record.allocations);
        }
    }

    fn log_changes(&self, record: &CycleRecord) {
        let cycle = record.cycle;
        if let Some(phase) = PhaseCode::from_code(record.phase)
            && record.phase != self.phase
        {
            let error_us = us(record.phase_error_ns as f64);
            info!(cycle, %phase, error_us, "phase of the grid: {phase}");
        }
        if record.state != self.state || record.hold != self.hold {
            match (TwistState::from_code(record.state), record.hold()) {
                (Some(state), Some(cause)) => {
                    let features = record.features_sequence;
                    let why = self.words(cause);
                    match self.is_expected(cause) {
                        true => info!(cycle, features, %cause, "{state}: {why}"),
                        false => warn!(cycle, features, %cause, "{state}: {why}"),
                    }
                }
                (Some(state), None) => {
                    let error_px = tenths(record.error_px);
                    info!(cycle, %state, error_px, "now {state}");
                }
                (None, _) => (),
            }
        }
        let counts = &self.counts;
        if record.overruns > counts.overruns {
            let missed = record.overruns - counts.overruns;
            let releases = if missed == 1 { "release" } else { "releases" };
            let wake_us = us(record.wake_latency_ns as f64);
            let receive_us = us(record.receive_ns as f64);
            let (step_us, send_us) = (us(record.step_ns as f64), us(record.send_ns as f64));
            warn!(
                cycle,
                missed,
                wake_us,
                receive_us,
                step_us,
                send_us,
                "overrun: {missed} {releases} missed"
            );
        }
        if record.lost_records > counts.lost_records {
            let lost = record.lost_records - counts.lost_records;
            warn!(
                cycle,
                lost, "{lost} records of telemetry lost: the recorder is slower than the loop"
            );
        }
    }

    /// What of the arm binds the command of a cycle, in words.
    fn bound(&self, record: &CycleRecord) -> Option<String> {
        let bound = record.bound()?;
        Some(match &self.arm {
            Some(arm) => bound.named(arm.names()).to_string(),
            None => bound.to_string(),
        })
    }

    /// What is wrong with the joints that the robot told last, in words.
    fn joint_fault(&self, record: &CycleRecord) -> Option<String> {
        let names = self.arm.as_ref().map_or(&[][..], |arm| &arm.joint_names);
        Some(record.joint_fault()?.words(names).to_string())
    }

    /// Why the law's twist is not sent, with what of the arm stands in its way, or how late it is.
    fn words(&self, cause: Hold) -> String {
        if let (Hold::NoJoints | Hold::JointsNotFollowing, Some(fault)) = (cause, &self.joint_fault)
        {
            return format!("{cause}: {fault}");
        }
        match (cause, &self.bound, &self.arm) {
            (Hold::NoWay, Some(bound), _) => format!("{cause}: {bound}"),
            (Hold::NoJoints, _, Some(arm)) => {
                let joints = arm.joints.len();
                format!("{cause}: the scene's arm has {joints}, and vpc/robot must tell all")
            }
            (Hold::RobotLate | Hold::ImageLate, ..) => format!("{cause} by {:.2} s", self.lag_s),
            _ => cause.to_string(),
        }
    }

    /// Whether a cause belongs to a normal start, or was asked for: it is no warning then. Camera and
    /// robot may start later than `vpcd`.
    fn is_expected(&self, cause: Hold) -> bool {
        match cause {
            Hold::NotArmed | Hold::Operator | Hold::Shutdown => true,
            Hold::NoFeatures | Hold::NoRobot | Hold::NoJoints | Hold::Stale => !self.has_steered,
            _ => false,
        }
    }

    fn log_foresight(&mut self, record: &CycleRecord) {
        let cycle = record.cycle;
        if record.state == TwistState::Moving.code() && record.knows_no_way() {
            self.lost = self.lost.saturating_add(1);
            if self.lost == LOST_CYCLES {
                let error_px = tenths(record.error_px);
                let bound = self.bound.as_ref();
                let bound = bound.map_or(String::new(), |bound| format!("; {bound}"));
                warn!(
                    cycle,
                    error_px,
                    "foresight: no way known for {LOST_CYCLES} cycles; what comes nearest is followed{bound}"
                );
            }
            return;
        }
        if self.lost >= LOST_CYCLES {
            let arrival_s = tenths(record.arrival_s);
            info!(cycle, arrival_s, "foresight: a way is known");
        }
        self.lost = 0;
    }

    /// Cycles counted.
    pub fn cycles(&self) -> u64 {
        self.counts.cycles
    }

    /// State and counters in one line, for the service manager.
    pub fn status(&self) -> String {
        let state = match (
            TwistState::from_code(self.state),
            Hold::from_code(self.hold),
        ) {
            _ if self.counts.cycles == 0 => "starting".to_owned(),
            (Some(state), Some(cause)) => format!("{state}: {}", self.words(cause)),
            (Some(state), _) if self.error_px.is_nan() => state.to_string(),
            (Some(state), _) => format!("{state}, error {:.1} px", self.error_px),
            (None, _) => "unknown".to_owned(),
        };
        let realtime = RealTime(self.counts.realtime);
        let degraded = match realtime.is_degraded() {
            true => {
                let lacks: Vec<_> = realtime.lacks().collect();
                format!("; NOT REAL TIME: {}", lacks.join(", "))
            }
            false => String::new(),
        };
        let phase = match PhaseCode::from_code(self.phase) {
            Some(PhaseCode::Free) | None => String::new(),
            Some(phase) => format!(", phase {phase}"),
        };
        format!(
            "{state}{phase}{degraded}; {} cycles, {} held, {} overruns, {} records lost",
            self.counts.cycles, self.held, self.counts.overruns, self.counts.lost_records
        )
    }

    /// The run in numbers, without what only the loop's thread knows.
    pub fn report(&self) -> Report {
        let [wake_ns, receive_ns, step_ns, send_ns, busy_ns] =
            self.times.each_ref().map(Histogram::percentiles);
        Report {
            wake_ns,
            receive_ns,
            step_ns,
            send_ns,
            busy_ns,
            ..self.counts.clone()
        }
    }

    /// Writes the end of a run to the log.
    pub fn log_end(&self) {
        for (stage, histogram) in STAGES.iter().zip(&self.times) {
            let found = histogram.percentiles();
            let [p50_us, p99_us, p999_us, max_us] =
                [found.p50, found.p99, found.p999, found.max].map(|ns| us(ns as f64));
            info!(stage, p50_us, p99_us, p999_us, max_us, "time of {stage}");
        }
        let counts = &self.counts;
        info!(
            cycles = counts.cycles,
            held = self.held,
            overruns = counts.overruns,
            lost_records = counts.lost_records,
            minor_faults = counts.minor_faults,
            major_faults = counts.major_faults,
            blocked = counts.blocked,
            allocations = counts.allocations,
            "stopped"
        );
    }
}

/// A number of a log line to one decimal; `None`, which leaves the field out, where it is not known.
fn tenths(x: f64) -> Option<f64> {
    x.is_finite().then(|| (x * 10.0).round() / 10.0)
}

/// A time in us to one decimal, from ns.
fn us(ns: f64) -> Option<f64> {
    tenths(ns / 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(cycle: u64) -> CycleRecord {
        CycleRecord {
            cycle,
            ..CycleRecord::default()
        }
    }

    #[test]
    fn the_status_says_what_real_time_lacks_as_long_as_it_lacks_it() {
        let mut summary = Summary::default();
        summary.add(&record(1));
        assert!(!summary.status().contains("REAL TIME"));
        let bits = RealTime::ASKED
            .with(RealTime::NO_FIFO)
            .with(RealTime::NO_LOCK);
        for cycle in 2..4 {
            let realtime = bits.0;
            summary.add(&CycleRecord {
                realtime,
                ..record(cycle)
            });
            let status = summary.status();
            let words = "; NOT REAL TIME: no SCHED_FIFO, memory not locked; ";
            assert!(status.contains(words), "{status}");
        }
    }

    #[test]
    fn numbers_have_a_decimal_and_what_is_not_known_is_left_out() {
        assert_eq!(tenths(266.093_251_774_574_7), Some(266.1));
        assert_eq!(us(3_095_379.0), Some(3095.4));
        assert_eq!(tenths(f64::NAN), None);
        let mut summary = Summary::default();
        summary.add(&CycleRecord {
            state: TwistState::Moving.code(),
            error_px: f64::NAN,
            ..record(1)
        });
        assert!(summary.status().starts_with("moving; "));
    }

    #[test]
    fn no_way_is_told_with_what_of_the_arm_binds_and_missing_joints_with_their_number() {
        let text = format!("arm = 'panda.toml'\n{}", scene::PAPER_ROBOT);
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../ipc/scene/scenes/s.toml");
        let arm = scene::Scene::parse(&text, path).unwrap().arm;
        let status = |arm: Option<Arm>, record: &CycleRecord| {
            let mut summary = Summary::new(arm);
            summary.add(record);
            summary.status()
        };
        let mut held = record(1);
        (held.state, held.count) = (TwistState::Holding.code(), 4);
        held.hold = Hold::NoWay.code();
        assert!(status(arm.clone(), &held).starts_with("holding: no way known; "));
        (held.arm_bound, held.arm_bound_index) = (messages::ArmBound::Range.code(), 3);
        let named = "holding: no way known: panda_joint4 is at the end of its range; ";
        assert!(status(arm.clone(), &held).starts_with(named));
        let numbered = "holding: no way known: joint 4 is at the end of its range; ";
        assert!(status(None, &held).starts_with(numbered));
        held.hold = Hold::NoJoints.code();
        let shipped = arm.clone();
        let told = status(arm, &held);
        assert!(
            told.starts_with("holding: joints unknown: the scene's arm has 7"),
            "{told}"
        );
        held.hold = Hold::Hidden.code();
        assert!(status(None, &held).starts_with("holding: hidden point; "));
        held.hold = Hold::NoJoints.code();
        held.joint_fault = messages::JointFaultCode::Range.code();
        (held.joint_fault_index, held.joint_fault_found) = (6, 5.0);
        held.joint_fault_allowed = [-2.947, 2.947];
        let told = status(shipped, &held);
        let named =
            "holding: joints unknown: panda_joint7 is told at 5.000; allowed: -2.947 to 2.947; ";
        assert!(told.starts_with(named), "{told}");
    }

    #[test]
    fn to_wait_is_no_warning_until_the_law_has_steered() {
        let mut summary = Summary::default();
        let is_expected = |summary: &Summary| {
            [Hold::NoRobot, Hold::NoFeatures, Hold::Stale].map(|cause| summary.is_expected(cause))
        };
        let mut waiting = record(1);
        waiting.hold = Hold::NoFeatures.code();
        summary.add(&waiting);
        assert_eq!(is_expected(&summary), [true; 3]);
        assert!(!summary.is_expected(Hold::RobotLost) && !summary.is_expected(Hold::Count));
        summary.add(&record(2));
        assert_eq!(is_expected(&summary), [false; 3]);
        assert!(summary.is_expected(Hold::Operator));
    }

    #[test]
    fn costs_count_in_cycles_that_steer_and_not_while_peers_are_met() {
        let mut summary = Summary::default();
        for cycle in 1..=2 * Report::WARM_UP {
            let mut record = record(cycle);
            record.hold = match cycle % 2 {
                0 => Hold::number(None),
                _ => Hold::NoFeatures.code(),
            };
            (record.minor_faults, record.allocations) = (1, 1);
            summary.add(&record);
        }
        assert_eq!(summary.report().minor_faults, 0);
        let mut last = record(1000);
        (last.minor_faults, last.blocked, last.allocations) = (3, 2, 1);
        summary.add(&last);
        let report = summary.report();
        let found = (report.minor_faults, report.blocked, report.allocations);
        assert_eq!(found, (3, 2, 1));
        assert_eq!(report.armed, Report::WARM_UP + 1);
    }
}
