//! The law again, on a recording.
//!
//! A cycle's decision is a function of what it received and when it looked (`controller::pilot`), and both are
//! recorded: the features by their number, the instant as wake-up plus time of reception. So the replay gives the same
//! bits, with two grains of salt: whether a state of the robot or a request that came within microseconds of the look
//! was still seen is not recorded, and where a recording begins in mid-run, or lost something, the state is taken over
//! from what follows (`controller::takeover`): those cycles are replayed and told, and not judged.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use controller::arguments::Arguments;
use controller::config::{Config, ConfigError};
use controller::cycle::REQUESTS;
use controller::daemon::pace;
use controller::gate::Input;
use controller::law::{Law, LawError};
use controller::pilot::{Inputs, Pilot};
use controller::takeover::{Takeover, Told};
use ipc::{
    ClockMode, CycleRecord, Features, Hold, Order, Received, Request, RobotState, Stamp,
    StrategyCode, TwistState,
};
use scene::Scene;

use crate::file::SCENE_FILE;
pub use crate::outcome::{Difference, Outcome, TakenOver};
use crate::reader::Recording;

/// What stands beside a recording.
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// Configuration of the daemon, instead of the recorded one.
    pub config: Option<PathBuf>,
    /// Memory of motion, instead of the one that the configuration names.
    pub memory: Option<PathBuf>,
    /// Scene, instead of the recorded one.
    pub scene: Option<PathBuf>,
}

/// Why there was no replay.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A file.
    #[error("{path}: cannot read: {source}")]
    Read {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// Scene or memory.
    #[error(transparent)]
    Law(#[from] LawError),
    /// There is no scene.
    #[error(
        "no scene in the recording; allowed: one recorded with --scene or --config, or --scene here"
    )]
    NoScene,
    /// There is nothing to compare with.
    #[error("no cycles in the recording: was vpcd at work?")]
    Empty,
}

/// Replays a recording; cycles whose twist differs by at most `tolerance` (m/s, rad/s) count as the same.
///
/// # Errors
/// [`ReplayError`].
pub fn replay(
    recording: &Recording,
    beside: &Beside,
    tolerance: f64,
) -> Result<Outcome, ReplayError> {
    if recording.cycles.is_empty() {
        return Err(ReplayError::Empty);
    }
    let mut outcome = Outcome {
        begins_at: recording.cycles[0].cycle,
        ..Outcome::default()
    };
    // A number that falls back is a daemon that started again.
    for run in recording
        .cycles
        .chunk_by(|one, next| next.cycle > one.cycle)
    {
        let mut pilot = pilot(recording, beside, &run[0])?;
        Replay::of(recording).run(&mut pilot, run, tolerance, &mut outcome);
    }
    Ok(outcome)
}

/// The pilot of the daemon that sent this record first.
fn pilot(
    recording: &Recording,
    beside: &Beside,
    first: &CycleRecord,
) -> Result<Pilot, ReplayError> {
    let (text, path) = match (&beside.config, &recording.config_toml) {
        (Some(path), _) => (read(path)?, path.display().to_string()),
        (None, Some(text)) => {
            let path = recording.config_path.clone();
            (text.clone(), path.unwrap_or_else(|| "vpcd.toml".to_owned()))
        }
        (None, None) => (String::new(), "no configuration".to_owned()),
    };
    let (scene, toml, scene_path) = match (&beside.scene, &recording.scene, &recording.scene_toml) {
        (Some(path), ..) => {
            let toml = read(path)?;
            let scene = Scene::parse(&toml, &path.display().to_string());
            (scene.map_err(LawError::from)?, toml, path.clone())
        }
        (None, Some(scene), Some(toml)) => (scene.clone(), toml.clone(), PathBuf::from(SCENE_FILE)),
        (None, ..) => return Err(ReplayError::NoScene),
    };
    // Flags of its command line are not recorded, but what they did is.
    let arguments = Arguments {
        scene: Some(scene_path.clone()),
        memory: beside.memory.clone(),
        strategy: StrategyCode::from_code(first.strategy).map(|strategy| match strategy {
            StrategyCode::Knn => format!("knn{}", first.neighbours),
            other => other.to_string(),
        }),
        np: (first.np > 0).then_some(i64::from(first.np)),
        clock: ClockMode::from_code(first.clock).map(|clock| clock.to_string()),
        arm: first.state != TwistState::Disarmed.code(),
        ..Arguments::default()
    };
    let directory = Path::new(&path).parent().unwrap_or(Path::new(""));
    let config = Config::parse(&text, &path, directory, &arguments)?;
    let scene_path = scene_path.display().to_string();
    let memory = config.memory.as_deref();
    let law = Law::of(scene, toml, scene_path, memory, config.settings)?;
    Ok(pace(&config, &law).pilot(law))
}

fn read(path: &Path) -> Result<String, ReplayError> {
    std::fs::read_to_string(path).map_err(|source| ReplayError::Read {
        path: path.display().to_string(),
        source,
    })
}

/// What the daemon heard, and how far the replay has come.
struct Replay<'a> {
    /// By their numbers, with their places in the recording.
    features: HashMap<u64, Vec<(usize, &'a Features)>>,
    /// Place after the last one that was taken.
    next: usize,
    robot: &'a [RobotState],
    requests: Vec<&'a Request>,
    taken: Option<Stamp>,
    state: Option<Stamp>,
    /// Whether the run is in the recording from its first cycle on.
    is_whole: bool,
}

impl<'a> Replay<'a> {
    fn of(recording: &'a Recording) -> Self {
        let mut features: HashMap<u64, Vec<(usize, &Features)>> = HashMap::new();
        for (place, message) in recording.features.iter().enumerate() {
            let number = message.stamp.sequence;
            let same = features.entry(number).or_default();
            same.push((place, message));
        }
        // A request that was not answered did not reach the daemon.
        let answered = |request: &&Request| {
            let mut replies = recording.replies.iter();
            replies.any(|reply| reply.id == request.id)
        };
        Self {
            features,
            next: 0,
            robot: &recording.robot,
            requests: recording.requests.iter().filter(answered).collect(),
            taken: None,
            state: None,
            is_whole: true,
        }
    }

    fn run(
        mut self,
        pilot: &mut Pilot,
        run: &[CycleRecord],
        tolerance: f64,
        outcome: &mut Outcome,
    ) {
        let Some(first) = run.first() else {
            return;
        };
        let is_whole = first.cycle <= 1;
        // Before the first cycle of all nothing was heard; before another one, the last that was said.
        let heard = |stamp: &Stamp| stamp.published_ns < first.stamp.data_ns;
        let robots = self.robot.iter().take_while(|state| heard(&state.stamp));
        let robots = robots.count().saturating_sub(usize::from(!is_whole));
        self.robot = &self.robot[robots..];
        let mut takeover = match is_whole {
            true => Takeover::known(),
            false => Takeover::unknown(pilot),
        };
        self.is_whole = is_whole;
        let (mut number, mut missed) = (first.cycle - 1, 0);
        let mut overruns = if is_whole { 0 } else { first.overruns };
        for cycle in run {
            let gap = cycle.cycle.saturating_sub(number + 1);
            outcome.missing_cycles += gap;
            if gap > 0 {
                takeover = Takeover::unknown(pilot);
            }
            number = cycle.cycle;
            let now_ns = cycle.stamp.data_ns + cycle.receive_ns;
            let (lost, had_taken) = (outcome.missing_features, self.taken.is_some());
            let features = self.features(cycle, now_ns, outcome);
            if outcome.missing_features > lost {
                takeover.lose_input();
            }
            let robot = self.robot(now_ns);
            for request in self.requests(now_ns) {
                pilot.request(request);
            }
            let inputs = Inputs {
                now_ns,
                features,
                robot,
                missed,
                shutdown: cycle.hold == Hold::Shutdown.code(),
            };
            let starts = |order| matches!(order, Order::First | Order::Restarted);
            let is_new = matches!(&features, Input::Message(new) if starts(new.order));
            // A cycle counts what was missed before it; its record, what was missed until its end.
            let missed_before = missed;
            missed = cycle.overruns.saturating_sub(overruns);
            overruns = cycle.overruns;
            let mut record = CycleRecord::default();
            let answer = pilot.decide(&inputs, &mut record);
            debug_assert_eq!(record.twist, answer.decision.twist);
            let told = Told {
                recorded: cycle,
                replayed: &record,
                effective_ns: pilot.effective_ns(&answer.stamp, now_ns),
                missed: missed_before,
                is_new: is_new && had_taken,
            };
            if takeover.look(pilot, &told) {
                outcome.judge(cycle, &record, tolerance);
            } else {
                outcome.take_over(cycle, &record);
            }
            outcome.cycles += 1;
            outcome.steps += u64::from(cycle.status != 0);
        }
    }

    /// Whether features came before the recording, and none since.
    fn is_late(&self) -> bool {
        !self.is_whole && self.taken.is_none()
    }

    /// What this cycle received from the camera.
    fn features(&mut self, cycle: &CycleRecord, now_ns: u64, outcome: &mut Outcome) -> Input {
        if cycle.hold == Hold::Transport.code() {
            return Input::Failed;
        }
        let number = cycle.features_sequence;
        if number == 0 {
            return Input::Nothing;
        }
        let known = self.find(cycle, now_ns);
        let known_to_be_old = self.taken.is_some_and(|taken| taken.sequence == number);
        match known {
            Some(message) if self.taken == Some(message.stamp) => Input::Nothing,
            Some(message) => {
                let order = match self.is_late() {
                    true => Order::Next,
                    false => Order::after(self.taken, &message.stamp),
                };
                self.taken = Some(message.stamp);
                Input::Message(Received {
                    message: *message,
                    order,
                })
            }
            None if known_to_be_old || self.is_late() => Input::Nothing,
            None => {
                let stamp = Stamp {
                    sequence: number,
                    ..Stamp::default()
                };
                self.taken = Some(stamp);
                // Messages that break the contract are not recorded, but their numbers are.
                if cycle.hold != Hold::Invalid.code() {
                    outcome.missing_features += 1;
                }
                Input::Refused(stamp)
            }
        }
    }

    /// The message that a cycle used. Cameras start again with the same numbers.
    fn find(&mut self, cycle: &CycleRecord, now_ns: u64) -> Option<&'a Features> {
        let same = self.features.get(&cycle.features_sequence)?;
        let is_seen = |message: &Features| {
            cycle.status == 0 || (message.count, message.points) == (cycle.count, cycle.points)
        };
        let (place, message) = match ClockMode::from_code(cycle.clock) {
            // Its stamps are of another time. Each is answered once, so it is the next one.
            Some(ClockMode::Lockstep) => {
                let mut later = same.iter().filter(|(place, _)| *place >= self.next);
                later.find(|(_, message)| is_seen(message))?
            }
            // The last one that had been published by then.
            _ => {
                let published = |message: &Features| message.stamp.published_ns <= now_ns;
                same.iter().rfind(|(_, message)| published(message))?
            }
        };
        self.next = place + 1;
        Some(message)
    }

    /// The newest state of the robot since the last call.
    fn robot(&mut self, now_ns: u64) -> Input<RobotState> {
        let count = self
            .robot
            .iter()
            .take_while(|state| state.stamp.published_ns <= now_ns)
            .count();
        let (new, rest) = self.robot.split_at(count);
        self.robot = rest;
        let Some(message) = new.last().copied() else {
            return Input::Nothing;
        };
        let order = Order::after(self.state, &message.stamp);
        self.state = Some(message.stamp);
        Input::Message(Received { message, order })
    }

    /// The requests that this cycle took.
    fn requests(&mut self, now_ns: u64) -> Vec<&'a Request> {
        let count = self
            .requests
            .iter()
            .take_while(|request| request.stamp.published_ns <= now_ns)
            .count();
        self.requests.drain(..count.min(REQUESTS)).collect()
    }
}

#[cfg(test)]
mod tests;
