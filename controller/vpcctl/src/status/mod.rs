//! `vpcctl status`: one screen, or JSON.

mod look;

use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use ipc::ReceiveError;
use messages::{Action, ClockMode, CycleRecord, ForesightCode, Hold, PhaseCode, RealTime, Reply};
use messages::{SolverStatus, StrategyCode, TwistState};
use program::Exit;
use serde_json::{Value, json};

pub use look::{Asking, look, watch_until};

use crate::failure::Failure;
use crate::image_plane::ImagePlane;
use crate::joints::joints;
use crate::latency::{Percentiles, STAGES, durations};
use crate::output::{Tone, paint};
use crate::presence::Presence;
use crate::request::strategy_name;
use crate::units::{duration, pixels};
use crate::view::{View, faults, word};
use crate::watcher::Watcher;

/// Time between two looks for the daemon's process, ns.
const LOOK_NS: u64 = 1_000_000_000;
/// Silence from which on cycles count as stopped, ns.
const SILENT_NS: u64 = 500_000_000;

/// What a daemon does.
#[derive(Clone, Debug, Default)]
pub struct Status {
    /// The domain's directory.
    pub directory: PathBuf,
    /// Process of the daemon; `None` if it is not `vpcd` that serves the domain.
    pub process: Option<u32>,
    /// Whether the daemon answered; `None` if its cycles made asking unnecessary.
    pub answered: Option<bool>,
    /// Its answer, older than the newest cycle.
    pub reply: Option<Reply>,
    /// Services that could not be watched because all slots were taken.
    pub full: Vec<&'static str>,
    /// What was watched.
    pub view: View,
    /// The present, CLOCK_MONOTONIC, ns.
    pub now_ns: u64,
    looked_ns: u64,
    /// The daemon's scene.
    plane: ImagePlane,
}

impl Status {
    /// Of a domain that is about to be watched.
    pub fn new(watcher: &Watcher) -> Self {
        let directory = watcher.domain.directory();
        Self {
            directory: directory.to_owned(),
            plane: ImagePlane::open(directory, None).unwrap_or_default(),
            full: watcher.full.clone(),
            ..Self::default()
        }
    }

    /// Takes in all that came since the last call; does not wait.
    ///
    /// # Errors
    /// As [`Watcher::poll`].
    pub fn update(&mut self, watcher: &mut Watcher) -> Result<(), ReceiveError> {
        watcher.poll(&mut self.view)?;
        self.now_ns = ipc::now_ns();
        if self.now_ns.saturating_sub(self.looked_ns) >= LOOK_NS {
            self.process = Presence::of(&self.directory).process();
            self.plane.refresh();
            self.view.arm = self.plane.arm().cloned();
            self.looked_ns = self.now_ns;
        }
        Ok(())
    }

    /// The state of the newest cycle, else of the answer.
    pub fn state(&self) -> Option<TwistState> {
        match self.view.latest() {
            Some(record) => TwistState::from_code(record.state),
            None => self.reply.as_ref()?.state(),
        }
    }

    /// What keeps the law's twist back.
    pub fn hold(&self) -> Option<Hold> {
        match self.view.latest() {
            Some(record) => record.hold(),
            None => self.reply.as_ref()?.hold(),
        }
    }

    /// State and cause in words, with their tone; the end of a run is no alarm.
    pub fn headline(&self) -> (String, Option<String>, Tone) {
        let (view, now_ns) = (&self.view, self.now_ns);
        let (Some(state), Some(silence)) = (self.state(), view.silence_ns(now_ns)) else {
            return ("waiting for cycles".to_owned(), None, Tone::Warning);
        };
        let cause = view.cause_words(now_ns);
        if silence <= SILENT_NS {
            let tone = Tone::of(state, self.hold());
            return (state.to_string(), cause, tone);
        }
        let since = duration(silence);
        match (self.process, view.camera_silence_ns(now_ns)) {
            (None, _) => (format!("ended {since} ago"), cause, Tone::Warning),
            // In lockstep, there is no cycle without a frame.
            (_, Some(_)) => (format!("no frame for {since}"), cause, Tone::Warning),
            _ => (format!("no cycle for {since}"), cause, Tone::Bad),
        }
    }

    /// The strategy, as `vpcd --strategy` takes it.
    pub fn strategy(&self) -> Option<String> {
        let reply = self.reply.as_ref().map(|r| (r.strategy, r.neighbours));
        let codes = self.view.latest().map(|r| (r.strategy, r.neighbours));
        codes.or(reply).map(|(code, k)| strategy_name(code, k))
    }

    /// Whether neither an answer nor a record came, or the records have stopped: for half a second
    /// or ten periods.
    pub fn hangs(&self) -> bool {
        let period_ns = self.view.rate_hz().map_or(0.0, |rate| 1e9 / rate);
        let most = (10.0 * period_ns).max(SILENT_NS as f64);
        let silence = self.view.silence_ns(self.now_ns);
        self.answered != Some(true) && silence.is_none_or(|silence| silence as f64 > most)
    }

    /// The exit code.
    pub fn exit(&self) -> Exit {
        match self.state() {
            _ if self.hangs() => Exit::NoAnswer,
            Some(TwistState::Moving | TwistState::Arrived) => Exit::Ok,
            Some(TwistState::Disarmed) => Exit::Disarmed,
            Some(_) => Exit::Attention,
            None => Exit::NoAnswer,
        }
    }

    /// As JSON: times in ns, image errors in px, twists in m/s and rad/s in the camera frame; null
    /// for what is not known.
    pub fn json(&self) -> Value {
        let (view, now_ns) = (&self.view, self.now_ns);
        let (last, over) = view.last_cause().unzip();
        let robot = view.robot_at(now_ns).map(|robot| {
            let age_ns = now_ns.saturating_sub(robot.stamp.published_ns);
            let joints = joints(view, now_ns);
            json!({ "mode": word(robot.mode()), "faults": faults(robot), "age_ns": age_ns, "joints": joints })
        });
        let image = view.image().map(|image| {
            json!({
                "width": image.width,
                "height": image.height,
                "encoding": word(image.encoding()),
                "exposure_ns": (image.exposure_ns > 0).then_some(image.exposure_ns),
                "rate_hz": view.image_rate_hz(),
                "age_ns": now_ns.saturating_sub(image.stamp.published_ns),
            })
        });
        json!({
            "domain": self.directory.display().to_string(),
            "process": self.process,
            "state": self.state().map(|state| state.to_string()),
            "cause": self.hold().map(|hold| hold.to_string()),
            "bound": view.bound().map(|bound| {
                json!({ "kind": word(Some(bound.kind)), "index": bound.index, "words": bound.to_string() })
            }),
            "last_cause": last.map(|hold| hold.to_string()),
            "last_cause_over_ns": over.flatten().map(|at| now_ns.saturating_sub(at)),
            "answered": self.answered,
            "veto": view.latest().and_then(|last| {
                let action = Action::of_veto(last.veto)?;
                Some(json!({ "action": action.to_string(), "number": last.veto }))
            }),
            "strategy": self.strategy(),
            "cycles": view.latest().map(|last| cycles(last, view, now_ns)),
            "robot": robot,
            "image": image,
            "full": self.full,
        })
    }

    /// One screen of at most 80 columns.
    pub fn text(&self, colours: bool) -> String {
        let process = self.process.map(|process| format!("process {process}"));
        let process = process.unwrap_or_else(|| "not vpcd".to_owned());
        let domain = self.directory.display();
        let mut text = format!("daemon    {process}, domain {domain}\n");
        if self.hangs() {
            let words = paint("does not answer, no cycles are coming", Tone::Bad, colours);
            text += &format!("          {words}; see `vpcctl doctor`\n");
        }
        text += &self.state_line(colours);
        let strategy = self.strategy().unwrap_or_else(|| "unknown".to_owned());
        text += &match self.view.latest() {
            Some(last) => self.cycle_text(last, &strategy, colours),
            None => format!("strategy  {strategy}\ncycles    none came while watching\n"),
        };
        let robot = self.view.robot_at(self.now_ns).map(|robot| {
            let age = duration(self.now_ns.saturating_sub(robot.stamp.published_ns));
            let faults = match faults(robot).join(", ") {
                none if none.is_empty() => "no faults".to_owned(),
                names => paint(&names, Tone::Bad, colours),
            };
            format!("{}, {faults}, {age} ago", word(robot.mode()))
        });
        text += &format!("robot     {}\n", robot.as_deref().unwrap_or("says nothing"));
        text += &self.arm_line(colours);
        if let Some(image) = self.view.image() {
            let (width, height, encoding) = (image.width, image.height, word(image.encoding()));
            let rate = self.view.image_rate_hz();
            let rate = rate.map_or(String::new(), |rate| format!(", {rate:.1} Hz"));
            let age = duration(self.now_ns.saturating_sub(image.stamp.published_ns));
            text += &format!("image     {width} x {height} {encoding}{rate}, {age} ago\n");
        }
        for service in &self.full {
            text += &format!("not seen  {service}: all subscribers' slots are taken\n");
        }
        text
    }

    fn state_line(&self, colours: bool) -> String {
        let hold = self.hold();
        let tone = match self.state() {
            Some(state) if !self.hangs() => Tone::of(state, hold),
            _ => Tone::Bad,
        };
        let state = paint(&word(self.state()), tone, colours);
        let cause = self.view.cause_words(self.now_ns);
        let cause = cause.or_else(|| hold.map(|hold| hold.to_string()));
        match (cause, self.view.last_cause()) {
            (Some(cause), _) => format!("state     {state}: {cause}\n"),
            (None, Some((last, over))) => {
                let ago = duration(over.map_or(0, |at| self.now_ns.saturating_sub(at)));
                format!("state     {state} (before: {last}, until {ago} ago)\n")
            }
            (None, None) => format!("state     {state}\n"),
        }
    }

    /// What of the arm binds the command, else the joint with the least left of its range; empty
    /// where nothing is known of an arm.
    fn arm_line(&self, colours: bool) -> String {
        if let Some(bound) = self.view.bound() {
            let words = paint(&bound.to_string(), Tone::Warning, colours);
            return format!("arm       {words}\n");
        }
        let joints = joints(&self.view, self.now_ns);
        let nearest = joints.iter().min_by(|a, b| a.left().total_cmp(&b.left()));
        nearest.map_or(String::new(), |joint| {
            let (name, left, unit) = (&joint.name, joint.left(), joint.unit);
            format!(
                "arm       {} joints, {name} has {left:.2} {unit} left\n",
                joints.len()
            )
        })
    }

    fn cycle_text(&self, last: &CycleRecord, strategy: &str, colours: bool) -> String {
        let view = &self.view;
        let target = match last.way_point_count {
            _ if is_following(last) => "wanted twist",
            0 => "goal",
            _ => "way point",
        };
        let clock = word(ClockMode::from_code(last.clock));
        let rate = view.rate_hz().unwrap_or(f64::NAN);
        let mut text = format!(
            "strategy  {strategy}, {} steps previewed, towards the {target}
clock     {clock}, {rate:.1} Hz measured, cycle {}
times     {:>9}{:>10}{:>10}\n",
            last.np, last.cycle, "p50", "p99", "max"
        );
        for (name, of) in STAGES.iter().zip(stages(view)) {
            let [p50, p99, max] = [of.p50_ns, of.p99_ns, of.max_ns].map(duration);
            text += &format!("  {name:<8}{p50:>9}{p99:>10}{max:>10}\n");
        }
        let warning = |text: String| paint(&text, Tone::Warning, colours);
        if let Some(foresight) = ForesightCode::from_code(last.foresight)
            && foresight != ForesightCode::Off
        {
            let arrival = match last.arrival_s.is_finite() {
                true => format!("arrives in {:.1} s", last.arrival_s.max(0.0)),
                false => warning("no way known".to_owned()),
            };
            let (tried, steps) = (last.candidates, last.simulated);
            text += &format!(
                "foresight {arrival}, by {foresight}; {tried} others tried in {steps} simulated steps\n"
            );
        }
        let counts = [last.overruns, last.lost_records, view.missed];
        let [overruns, lost, missed] = counts.map(|count| match count {
            0 => count.to_string(),
            _ => warning(count.to_string()),
        });
        let realtime = match lacks(RealTime(last.realtime)) {
            None => "not asked for".to_owned(),
            Some(lacks) if lacks.is_empty() => "held".to_owned(),
            Some(lacks) => warning(lacks.join(", ")),
        };
        let [minor, major, blocked, heap] = view.disturbances;
        let faults = minor + major;
        let veto = match Action::of_veto(last.veto) {
            None => String::new(),
            Some(Action::Disarm) => "veto      an operator's disarm: vpcctl arm\n".to_owned(),
            Some(action) => format!(
                "veto      an operator's {action}; to arm all the same: vpcctl arm --veto {}\n",
                last.veto
            ),
        };
        let (error, clearance) = (pixels(last.error_px), pixels(last.clearance_px));
        let (count, age) = (last.count, duration(last.features_age_ns));
        let features = match last.features_sequence {
            0 => "none used".to_owned(),
            _ => format!("{count} points, {age} old, error {error}, clearance {clearance}"),
        };
        let (solver, steps) = (word(SolverStatus::from_code(last.status)), last.iterations);
        let is_moving = last.state == TwistState::Moving.code();
        let wanted = match wanted(last) {
            Some(wanted) if is_moving && last.twist == *wanted => {
                format!("wanted    {}: sent as it is\n", twist(wanted))
            }
            Some(wanted) => format!("wanted    {}\n", twist(wanted)),
            None => String::new(),
        };
        let sent = twist(&last.twist);
        text += &format!(
            "deadline  {overruns} overruns, {lost} records lost, {missed} missed here
real time {realtime}; {faults} page faults, {blocked} blocked, {heap} heap calls
features  {features}
solver    {solver}, {steps} iterations
{wanted}twist     {sent}\n{veto}"
        );
        text
    }
}

/// Keeps a status that others read up to date; `then` runs after each look.
///
/// # Errors
/// As [`Watcher::poll`].
pub async fn keep(
    status: &Mutex<Status>,
    watcher: &mut Watcher,
    pause: Duration,
    mut then: impl FnMut(&Watcher),
) -> Result<Infallible, Failure> {
    loop {
        status
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .update(watcher)?;
        then(watcher);
        tokio::time::sleep(pause).await;
    }
}

/// Whether another program wants the twists.
fn is_following(last: &CycleRecord) -> bool {
    last.strategy == StrategyCode::Follow.code()
}

/// The twist that it wants, if it wants one.
fn wanted(last: &CycleRecord) -> Option<&[f64; 6]> {
    let is_silent = last.hold == Hold::Unwanted.code();
    (is_following(last) && !is_silent).then_some(&last.desired)
}

/// A twist in words.
fn twist([vx, vy, vz, wx, wy, wz]: &[f64; 6]) -> String {
    format!("{vx:+.3} {vy:+.3} {vz:+.3} m/s, {wx:+.3} {wy:+.3} {wz:+.3} rad/s")
}

/// Percentiles of each of [`STAGES`].
fn stages(view: &View) -> [Percentiles; STAGES.len()] {
    std::array::from_fn(|i| Percentiles::of(view.recent(u64::MAX).map(|r| durations(r)[i])))
}

/// What the records of the cycles say.
fn cycles(last: &CycleRecord, view: &View, now_ns: u64) -> Value {
    let [wake, receive, step, send, total] = stages(view);
    let [minor, major, blocked, heap_calls] = view.disturbances;
    json!({
        "clock": word(ClockMode::from_code(last.clock)),
        "cycle": last.cycle,
        "silence_ns": view.silence_ns(now_ns),
        "watched": view.received,
        "rate_hz": view.rate_hz(),
        "overruns": last.overruns,
        "lost_records": last.lost_records,
        "missed_records": view.missed,
        "realtime_lacks": lacks(RealTime(last.realtime)),
        "phase": word(PhaseCode::from_code(last.phase)),
        "page_faults": minor + major,
        "blocked": blocked,
        "heap_calls": heap_calls,
        "wake": wake,
        "receive": receive,
        "step": step,
        "send": send,
        "total": total,
        "solver": word(SolverStatus::from_code(last.status)),
        "iterations": last.iterations,
        "np": last.np,
        "count": last.count,
        "features_age_ns": (last.features_sequence > 0).then_some(last.features_age_ns),
        "way_point": last.way_point_count > 0,
        "foresight": word(ForesightCode::from_code(last.foresight)),
        "arrival_s": last.arrival_s.is_finite().then_some(last.arrival_s),
        "error_px": last.error_px,
        "clearance_px": last.clearance_px,
        "wanted": wanted(last),
        "twist": last.twist,
    })
}

/// What is missing of the real time that was asked for; `None` if none was.
pub fn lacks(realtime: RealTime) -> Option<Vec<&'static str>> {
    realtime
        .has(RealTime::ASKED)
        .then(|| realtime.lacks().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::tests::record;
    use messages::{Order, Received};

    fn status(state: TwistState, hold: impl Into<Option<Hold>>, silence_ns: u64) -> Status {
        let mut status = Status::default();
        let message = record(5, state, hold);
        let order = Order::First;
        status.view.cycle(&Received { message, order });
        status.now_ns = message.stamp.published_ns + silence_ns;
        status
    }

    #[test]
    fn what_another_program_wants_is_told_beside_what_is_sent() {
        let mut status = status(TwistState::Moving, None, 0);
        assert!(!status.text(false).contains("wanted"));
        let mut record = record(6, TwistState::Moving, None);
        record.strategy = StrategyCode::Follow.code();
        for (sent, words) in [
            (0.1, "+0.000 rad/s: sent as it is"),
            (0.05, "+0.000 rad/s\n"),
        ] {
            (record.desired[0], record.twist[0]) = (0.1, sent);
            let order = Order::First;
            let message = record;
            status.view.cycle(&Received { message, order });
            let text = status.text(false);
            let line = text
                .split_inclusive('\n')
                .find(|line| line.starts_with("wanted"));
            assert!(line.unwrap().contains(words), "{text}");
        }
        let mut message = record;
        message.hold = Hold::Unwanted.code();
        let order = Order::First;
        status.view.cycle(&Received { message, order });
        assert!(!status.text(false).contains("wanted  "));
        assert!(status.json()["cycles"]["wanted"].is_null());
    }

    #[test]
    fn the_exit_code_tells_moving_standing_disarmed_and_hanging() {
        let exit = |state, hold, silence| status(state, hold, silence).exit();
        assert_eq!(exit(TwistState::Moving, None, 0), Exit::Ok);
        assert_eq!(exit(TwistState::Arrived, None, 0), Exit::Ok);
        assert_eq!(
            exit(TwistState::Holding, Some(Hold::Stale), 0),
            Exit::Attention
        );
        assert_eq!(
            exit(TwistState::Disarmed, Some(Hold::NotArmed), 0),
            Exit::Disarmed
        );
        assert_eq!(exit(TwistState::Moving, None, 600_000_000), Exit::NoAnswer);
    }

    #[test]
    fn the_cause_stands_beside_the_state() {
        let text = status(TwistState::Holding, Hold::Hidden, 0).text(false);
        assert!(text.contains("state     holding: hidden point\n"), "{text}");
        assert!(text.lines().all(|line| line.len() <= 80), "{text}");
    }

    #[test]
    fn the_arm_has_a_line_and_its_joints_are_in_json() {
        let mut status = status(TwistState::Holding, Hold::NoWay, 0);
        assert!(!status.text(false).contains("\narm "));
        status.view = crate::joints::tests::with_arm(status.view, status.now_ns);
        let text = status.text(false);
        let line = "arm       panda_joint4 is at the end of its range\n";
        assert!(text.contains(line), "{text}");
        assert!(text.lines().all(|line| line.len() <= 80), "{text}");
        let json = status.json();
        assert_eq!(json["bound"]["index"], 3);
        assert_eq!(json["bound"]["kind"], "joint range");
        let joint = &json["robot"]["joints"][3];
        assert_eq!(
            (joint["q"].as_f64(), &joint["binds"]),
            (Some(-2.87), &true.into())
        );
        let message = record(6, TwistState::Moving, None);
        let order = Order::Next;
        let message = CycleRecord {
            count: 4,
            ..message
        };
        status.view.cycle(&Received { message, order });
        let text = status.text(false);
        assert!(
            text.contains("arm       7 joints, panda_joint4 has 0.20 rad left\n"),
            "{text}"
        );
    }

    #[test]
    fn json_has_null_for_what_is_not_known() {
        let json = status(TwistState::Moving, None, 0).json();
        assert_eq!(json["state"], "moving");
        assert_eq!(json["cycles"]["cycle"], 5);
        assert!(json["cycles"]["error_px"].is_null() && json["robot"].is_null());
    }

    #[test]
    fn what_real_time_lacks_is_told_from_none_asked_for() {
        assert_eq!(lacks(RealTime::default()), None);
        assert_eq!(lacks(RealTime::ASKED), Some(vec![]));
        let without = RealTime::ASKED.with(RealTime::NO_LOCK);
        assert_eq!(lacks(without), Some(vec!["memory not locked"]));
    }
}
