//! `vpcctl status`: one screen, or JSON.

use std::fmt::Write;
use std::path::Path;
use std::time::{Duration, Instant};

use ipc::{
    ClockMode, Domain, Hold, OperatorPorts, PhaseCode, RealTime, Reply, RobotFaults, SolverStatus,
    TwistState,
};
use serde::Serialize;

use crate::exit::{Exit, Failure};
use crate::output::{Tone, paint};
use crate::phase::{Phase, Times};
use crate::presence::Presence;
use crate::request;
use crate::view::View;
use crate::watcher::Watcher;

/// Pause between two looks at the ports.
const PAUSE: Duration = Duration::from_millis(5);
/// Patience with the answer to a question for the state; a daemon answers within a period.
const PATIENCE: Duration = Duration::from_millis(300);

/// What a daemon does, for people (`Display` is [`Status::text`]) and as JSON. Times are ns, image errors px, twists
/// m/s and rad/s in the camera frame; numbers that are not known are null.
#[derive(Clone, Debug, Serialize)]
pub struct Status {
    /// The domain's directory.
    pub domain: String,
    /// Process of the daemon; null where it is not `vpcd` that serves the domain.
    pub process: Option<u32>,
    /// stopped, moving, arrived, holding, braking, disarmed; null where nobody tells.
    pub state: Option<String>,
    /// Why the law's twist is not sent at present, in the words of the contract.
    pub cause: Option<String>,
    /// The last cause seen while watching, though it may be over.
    pub last_cause: Option<String>,
    /// How long ago that was over; null while it lasts.
    pub last_cause_over_ns: Option<u64>,
    /// Whether the daemon answered when asked for its state; null where its cycles made asking unnecessary.
    pub answered: Option<bool>,
    /// Strategy, with the neighbours of knn in its name.
    pub strategy: Option<String>,
    /// From the records of its cycles; null where none came.
    pub cycles: Option<Cycles>,
    /// From the robot; null where it says nothing.
    pub robot: Option<Robot>,
    /// Services that could not be watched, since all places were taken.
    pub full: Vec<&'static str>,
    #[serde(skip)]
    exit: Option<TwistState>,
}

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

/// What the robot says.
#[derive(Clone, Debug, Serialize)]
pub struct Robot {
    /// idle, moving, stale, fault.
    pub mode: String,
    /// Names of the faults.
    pub faults: Vec<&'static str>,
    /// Since it said so.
    pub age_ns: u64,
}

/// Whether the daemon is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asking {
    /// Only where no cycles come: each new operator costs the loop of the daemon a connection.
    IfSilent,
    /// In any case.
    Always,
}

/// Watches the domain for a while, and asks the daemon for its state where that is needed.
///
/// # Errors
/// [`Failure::NoDaemon`] where neither a daemon, a record nor an answer is found; what stands against joining.
pub fn look(directory: &Path, watch: Duration, asking: Asking) -> Result<Status, Failure> {
    let nobody = || Failure::NoDaemon {
        domain: directory.display().to_string(),
    };
    let presence = Presence::of(directory);
    if presence == Presence::NoDomain {
        return Err(nobody());
    }
    let end = Instant::now() + watch;
    let domain = Domain::join(directory)?;
    let mut watcher = Watcher::open(&domain)?;
    watcher.poll()?;
    watch_until(&mut watcher, end.min(Instant::now() + PATIENCE))?;
    let is_silent = watcher.view.latest().is_none();
    let answer = match asking == Asking::Always || is_silent {
        true => Some(ask(&domain, watch)?),
        false => None,
    };
    watch_until(&mut watcher, end)?;
    let reply = answer.flatten();
    // The daemon may have started or ended since.
    let process = Presence::of(directory).process();
    if process.is_none() && reply.is_none() && watcher.view.latest().is_none() {
        return Err(nobody());
    }
    let mut status = Status::of(&watcher.view, reply.as_ref(), ipc::now_ns());
    status.domain = domain.directory().display().to_string();
    status.process = process;
    status.answered = answer.map(|reply| reply.is_some());
    status.full = watcher.full;
    Ok(status)
}

fn watch_until(watcher: &mut Watcher, end: Instant) -> Result<(), Failure> {
    loop {
        watcher.poll()?;
        if Instant::now() >= end {
            return Ok(());
        }
        std::thread::sleep(PAUSE);
    }
}

/// The daemon's own word; `None` where it says nothing, or all operators' places are taken.
fn ask(domain: &Domain, watch: Duration) -> Result<Option<Reply>, Failure> {
    match OperatorPorts::open(domain) {
        Ok(mut operator) => {
            let patience = PATIENCE.min(watch);
            Ok(operator.ask(&request::plain(ipc::Action::Status), patience)?)
        }
        Err(ipc::OpenError::Taken { .. } | ipc::OpenError::Full { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

impl Status {
    /// From what was watched and, where the daemon answered, from its answer, which is the elder of the two.
    pub fn of(view: &View, reply: Option<&Reply>, now_ns: u64) -> Self {
        let latest = view.latest();
        let state = latest.map_or(reply.and_then(Reply::state), |r| {
            TwistState::from_code(r.state)
        });
        let hold = latest.map_or(reply.and_then(Reply::hold), |record| record.hold());
        let strategy = latest
            .map(|r| (r.strategy, r.neighbours))
            .or(reply.map(|r| (r.strategy, r.neighbours)));
        let (last, over) = view.last_cause().unzip();
        Self {
            domain: String::new(),
            process: None,
            state: state.map(|state| state.to_string()),
            cause: hold
                .filter(|&hold| hold != Hold::None)
                .map(|hold| hold.to_string()),
            last_cause: last.map(|change| change.hold.to_string()),
            last_cause_over_ns: over.flatten().map(|at| now_ns.saturating_sub(at)),
            answered: reply.map(|_| true),
            strategy: strategy.map(|(code, k)| request::strategy_name(code, k)),
            cycles: Cycles::of(view, now_ns),
            robot: view.robot_at(now_ns).map(|state| Robot {
                mode: state
                    .mode()
                    .map_or_else(|| "unknown".to_owned(), |mode| mode.to_string()),
                faults: faults(state.faults()),
                age_ns: now_ns.saturating_sub(state.stamp.published_ns),
            }),
            full: Vec::new(),
            exit: state,
        }
    }

    /// Whether neither an answer nor a record came, or the records have stopped: for half a second or ten periods.
    pub fn hangs(&self) -> bool {
        if self.answered == Some(true) {
            return false;
        }
        self.cycles.as_ref().is_none_or(|cycles| {
            let period_ns = cycles.rate_hz.map_or(0.0, |rate| 1e9 / rate);
            cycles.silence_ns as f64 > (10.0 * period_ns).max(0.5e9)
        })
    }

    /// The exit code.
    pub fn exit(&self) -> Exit {
        if self.hangs() {
            return Exit::NoAnswer;
        }
        match self.exit {
            Some(TwistState::Moving | TwistState::Arrived) => Exit::Ok,
            Some(TwistState::Disarmed) => Exit::Disarmed,
            Some(TwistState::Stopped | TwistState::Holding | TwistState::Braking) => {
                Exit::Attention
            }
            None => Exit::NoAnswer,
        }
    }

    /// One screen of at most 80 columns.
    pub fn text(&self, colours: bool) -> String {
        let mut lines = String::new();
        // Writing to a string does not fail.
        let _ = self.write(&mut lines, colours);
        lines
    }

    fn write(&self, out: &mut String, colours: bool) -> std::fmt::Result {
        let process = self
            .process
            .map_or("not vpcd".to_owned(), |p| format!("process {p}"));
        writeln!(out, "daemon    {process}, domain {}", self.domain)?;
        if self.hangs() {
            let words = paint("does not answer, no cycles are coming", Tone::Bad, colours);
            writeln!(out, "          {words}; see `vpcctl doctor`")?;
        }
        let state = self.state.as_deref().unwrap_or("unknown");
        let tone = match self.exit() {
            Exit::Ok => Tone::Good,
            Exit::NoAnswer => Tone::Bad,
            _ => Tone::Warning,
        };
        write!(out, "state     {}", paint(state, tone, colours))?;
        match (&self.cause, &self.last_cause) {
            (Some(cause), _) => writeln!(out, ": {cause}")?,
            (None, Some(last)) => {
                let ago = self.last_cause_over_ns.unwrap_or(0);
                writeln!(out, " (before: {last}, until {} ago)", duration(ago))?;
            }
            (None, None) => writeln!(out)?,
        }
        let strategy = self.strategy.as_deref().unwrap_or("unknown");
        match &self.cycles {
            Some(cycles) => cycles.write(out, strategy, colours)?,
            None => {
                writeln!(out, "strategy  {strategy}")?;
                writeln!(out, "cycles    none came while watching")?;
            }
        }
        match &self.robot {
            Some(robot) => {
                let faults = match robot.faults.as_slice() {
                    [] => "no faults".to_owned(),
                    faults => paint(&faults.join(", "), Tone::Bad, colours),
                };
                let age = duration(robot.age_ns);
                writeln!(out, "robot     {}, {faults}, {age} ago", robot.mode)?;
            }
            None => writeln!(out, "robot     says nothing")?,
        }
        for service in &self.full {
            writeln!(
                out,
                "not seen  {service}: all subscribers' places are taken"
            )?;
        }
        Ok(())
    }
}

impl Cycles {
    fn of(view: &View, now_ns: u64) -> Option<Self> {
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

    fn write(&self, out: &mut String, strategy: &str, colours: bool) -> std::fmt::Result {
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

/// A duration for people: three digits and a unit.
pub fn duration(ns: u64) -> String {
    let ns = ns as f64;
    let (value, unit) = match ns {
        _ if ns < 1e3 => return format!("{ns:.0} ns"),
        _ if ns < 1e6 => (ns / 1e3, "us"),
        _ if ns < 1e9 => (ns / 1e6, "ms"),
        _ => (ns / 1e9, "s"),
    };
    match value {
        _ if value < 10.0 => format!("{value:.2} {unit}"),
        _ if value < 100.0 => format!("{value:.1} {unit}"),
        _ => format!("{value:.0} {unit}"),
    }
}

/// Pixels for people; a dash where the law did not run.
pub fn pixels(value: f64) -> String {
    match value {
        _ if value.is_nan() => "-".to_owned(),
        _ if value.is_infinite() => "unbounded".to_owned(),
        _ => format!("{value:.1} px"),
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

/// The faults and their names.
pub fn fault_names() -> [(RobotFaults, &'static str); 5] {
    [
        (RobotFaults::STALE_COMMAND, "stale command"),
        (RobotFaults::COMMAND_LIMITED, "command limited"),
        (RobotFaults::REFLEX, "reflex"),
        (RobotFaults::JOINT_LIMIT, "joint limit"),
        (RobotFaults::PATTERN_LOST, "pattern lost"),
    ]
}

/// Names of the faults that are set.
pub fn faults(faults: RobotFaults) -> Vec<&'static str> {
    let set = fault_names()
        .into_iter()
        .filter(|(bit, _)| faults.any(*bit));
    set.map(|(_, name)| name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::tests::record;
    use ipc::{Order, Received};

    fn status(state: TwistState, hold: Hold, silence_ns: u64) -> Status {
        let mut view = View::default();
        let message = record(5, state, hold);
        let order = Order::First;
        view.cycle(&Received { message, order });
        Status::of(&view, None, message.stamp.published_ns + silence_ns)
    }

    #[test]
    fn the_exit_code_tells_moving_from_standing_from_disarmed_from_hanging() {
        let exit = |state, hold, silence| status(state, hold, silence).exit();
        assert_eq!(exit(TwistState::Moving, Hold::None, 0), Exit::Ok);
        assert_eq!(exit(TwistState::Arrived, Hold::None, 0), Exit::Ok);
        assert_eq!(exit(TwistState::Holding, Hold::Stale, 0), Exit::Attention);
        assert_eq!(
            exit(TwistState::Disarmed, Hold::NotArmed, 0),
            Exit::Disarmed
        );
        assert_eq!(
            exit(TwistState::Moving, Hold::None, 600_000_000),
            Exit::NoAnswer
        );
    }

    #[test]
    fn the_cause_stands_beside_the_state() {
        let text = status(TwistState::Holding, Hold::Hidden, 0).text(false);
        assert!(text.contains("state     holding: hidden point\n"), "{text}");
        assert!(text.lines().all(|line| line.len() <= 80), "{text}");
    }

    #[test]
    fn json_has_null_for_what_is_not_known() {
        let json = serde_json::to_value(status(TwistState::Moving, Hold::None, 0)).unwrap();
        assert_eq!(json["state"], "moving");
        assert_eq!(json["cycles"]["cycle"], 5);
        assert!(json["cycles"]["error_px"].is_null() && json["robot"].is_null());
    }

    #[test]
    fn durations_have_three_digits_and_a_unit() {
        let texts = [999, 1_500, 12_340, 123_400, 2_000_000_000].map(duration);
        assert_eq!(texts, ["999 ns", "1.50 us", "12.3 us", "123 us", "2.00 s"]);
    }

    #[test]
    fn what_real_time_lacks_is_told_from_none_asked_for() {
        assert_eq!(lacks(RealTime::default()), None);
        assert_eq!(lacks(RealTime::ASKED), Some(vec![]));
        let without = RealTime::ASKED.with(RealTime::NO_LOCK);
        assert_eq!(lacks(without), Some(vec!["memory not locked"]));
    }

    #[test]
    fn faults_are_named_bit_by_bit() {
        assert_eq!(faults(RobotFaults(0b10100)), ["reflex", "pattern lost"]);
        assert_eq!(faults(RobotFaults(0)).len(), 0);
    }
}
