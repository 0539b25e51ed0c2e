//! `vpcctl status`: one screen, or JSON.

mod cycles;
mod look;

use std::fmt::Write;

use ipc::{Hold, Reply, TwistState};
use serde::Serialize;

pub use cycles::Cycles;
pub use look::{Asking, look};

use crate::exit::Exit;
use crate::output::{Tone, paint};
use crate::request;
use crate::view::View;
use crate::words::{duration, faults};

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
}
