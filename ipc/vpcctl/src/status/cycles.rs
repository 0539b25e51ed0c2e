//! What the records of the cycles say.

use std::fmt::Write;

use ipc::{ClockMode, PhaseCode, RealTime, SolverStatus};
use serde::Serialize;

use crate::output::{Tone, paint};
use crate::phase::{Phase, Times};
use crate::view::View;
use crate::words::{duration, pixels};

/// What the records of the cycles say.
#[derive(Clone, Debug, Serialize)]
pub struct Cycles {
    /// fixed or lockstep.
    pub clock: String,
    /// Number of the newest cycle.
    pub cycle: u64,
    /// Since the newest cycle was published.
    pub silence_ns: u64,
    /// Cycles watched.
    pub watched: u64,
    /// Cycles a second.
    pub rate_hz: Option<f64>,
    /// Releases missed since the start.
    pub overruns: u64,
    /// Records that the daemon lost since its start.
    pub lost_records: u64,
    /// Records that vpcctl missed.
    pub missed_records: u64,
    /// What the loop's thread lacks of the real time that was asked for; null where none was.
    pub realtime_lacks: Option<Vec<&'static str>>,
    /// free, seeking, locked: the grid against the camera's frames.
    pub phase: String,
    /// Page faults, blocking calls and calls of the heap between wake and send, in the cycles watched.
    pub page_faults: u64,
    /// Calls that blocked.
    pub blocked: u64,
    /// Calls of the heap, where the daemon counts them.
    pub heap_calls: u64,
    /// Time after the release.
    pub wake: Times,
    /// Receiving and gate.
    pub receive: Times,
    /// The law.
    pub step: Times,
    /// Sending.
    pub send: Times,
    /// From waking up to having sent.
    pub total: Times,
    /// How the solver ended.
    pub solver: String,
    /// Iterations of the solver.
    pub iterations: u32,
    /// Steps previewed.
    pub np: u32,
    /// Points used.
    pub count: u32,
    /// Age of the features used, when the cycle woke up; null where none were.
    pub features_age_ns: Option<u64>,
    /// Whether a way point is tracked instead of the goal.
    pub way_point: bool,
    /// Largest component of s - s*.
    pub error_px: f64,
    /// Least clearance from an occlusion; null without any.
    pub clearance_px: f64,
    /// Twist sent.
    pub twist: [f64; 6],
}

impl Cycles {
    /// From what was watched; `None` where nothing came.
    pub(super) fn of(view: &View, now_ns: u64) -> Option<Self> {
        let last = view.latest()?;
        let times = |phase: Phase| Times::of(view.recent(u64::MAX).map(|r| phase.of(r)));
        let word = |text: Option<String>| text.unwrap_or_else(|| "unknown".to_owned());
        let [minor, major, blocked, heap_calls] = view.disturbances;
        Some(Self {
            clock: word(ClockMode::from_code(last.clock).map(|clock| clock.to_string())),
            cycle: last.cycle,
            silence_ns: view.silence_ns(now_ns)?,
            watched: view.received,
            rate_hz: view.rate_hz(),
            overruns: last.overruns,
            lost_records: last.lost_records,
            missed_records: view.missed,
            realtime_lacks: lacks(RealTime(last.realtime)),
            phase: word(PhaseCode::from_code(last.phase).map(|phase| phase.to_string())),
            page_faults: minor + major,
            blocked,
            heap_calls,
            wake: times(Phase::Wake),
            receive: times(Phase::Receive),
            step: times(Phase::Step),
            send: times(Phase::Send),
            total: times(Phase::Cycle),
            solver: word(SolverStatus::from_code(last.status).map(|status| status.to_string())),
            iterations: last.iterations,
            np: last.np,
            count: last.count,
            features_age_ns: (last.features_sequence > 0).then_some(last.features_age_ns),
            way_point: last.way_point_count > 0,
            error_px: last.error_px,
            clearance_px: last.clearance_px,
            twist: last.twist,
        })
    }

    /// Lines of the screen.
    pub(super) fn write(
        &self,
        out: &mut String,
        strategy: &str,
        colours: bool,
    ) -> std::fmt::Result {
        let target = match self.way_point {
            true => "way point",
            false => "goal",
        };
        writeln!(
            out,
            "strategy  {strategy}, {} steps previewed, towards the {target}",
            self.np
        )?;
        let rate = self
            .rate_hz
            .map_or("unknown".to_owned(), |rate| format!("{rate:.1} Hz"));
        writeln!(
            out,
            "clock     {}, {rate} measured, cycle {}",
            self.clock, self.cycle
        )?;
        writeln!(out, "times     {:>9}{:>10}{:>10}", "p50", "p99", "max")?;
        for (name, times) in [
            ("wake", &self.wake),
            ("receive", &self.receive),
            ("step", &self.step),
            ("send", &self.send),
            ("cycle", &self.total),
        ] {
            let [p50, p99, max] = [times.p50_ns, times.p99_ns, times.max_ns].map(duration);
            writeln!(out, "  {name:<8}{p50:>9}{p99:>10}{max:>10}")?;
        }
        let number = |count: u64| match count {
            0 => count.to_string(),
            _ => paint(&count.to_string(), Tone::Warning, colours),
        };
        writeln!(
            out,
            "deadline  {} overruns, {} records lost, {} missed here",
            number(self.overruns),
            number(self.lost_records),
            number(self.missed_records)
        )?;
        let realtime = match self.realtime_lacks.as_deref() {
            None => "not asked for".to_owned(),
            Some([]) => "held".to_owned(),
            Some(lacks) => paint(&lacks.join(", "), Tone::Warning, colours),
        };
        writeln!(
            out,
            "real time {realtime}; {} page faults, {} blocked, {} heap calls",
            self.page_faults, self.blocked, self.heap_calls
        )?;
        match self.features_age_ns {
            Some(age) => writeln!(
                out,
                "features  {} points, {} old, error {}, clearance {}",
                self.count,
                duration(age),
                pixels(self.error_px),
                pixels(self.clearance_px)
            )?,
            None => writeln!(out, "features  none used")?,
        }
        writeln!(
            out,
            "solver    {}, {} iterations",
            self.solver, self.iterations
        )?;
        let [vx, vy, vz, wx, wy, wz] = self.twist;
        writeln!(
            out,
            "twist     {vx:+.3} {vy:+.3} {vz:+.3} m/s, {wx:+.3} {wy:+.3} {wz:+.3} rad/s"
        )
    }
}

/// What is missing of the real time asked for; `None` where none was.
fn lacks(realtime: RealTime) -> Option<Vec<&'static str>> {
    let names = [
        (RealTime::NO_FIFO, "no SCHED_FIFO"),
        (RealTime::NO_CPU, "not on its processor"),
        (RealTime::NO_LOCK, "memory not locked"),
    ];
    let missing = names.into_iter().filter(|(bit, _)| realtime.has(*bit));
    realtime
        .has(RealTime::ASKED)
        .then(|| missing.map(|(_, name)| name).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_real_time_lacks_is_told_from_none_asked_for() {
        assert_eq!(lacks(RealTime::default()), None);
        assert_eq!(lacks(RealTime::ASKED), Some(vec![]));
        let without = RealTime::ASKED.with(RealTime::NO_LOCK);
        assert_eq!(lacks(without), Some(vec!["memory not locked"]));
    }
}
