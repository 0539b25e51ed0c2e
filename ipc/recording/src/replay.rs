//! The law again, on a recording.
//!
//! A cycle's decision is a function of what it received and when it looked (`controller::pilot`), and both are
//! recorded: the features by their number, the instant as wake-up plus time of reception. So the replay gives the same
//! bits, with two grains of salt: whether a state of the robot or a request that came within microseconds of the look
//! was still seen is not recorded, and a recording that begins in mid-run does not know what came before.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use controller::arguments::Arguments;
use controller::config::{Config, ConfigError};
use controller::cycle::REQUESTS;
use controller::daemon::pace;
use controller::gate::Input;
use controller::law::{Law, LawError};
use controller::pilot::{Inputs, Pilot};
use ipc::{
    ClockMode, CycleRecord, Features, Hold, Order, Received, Request, RobotState, Stamp,
    StrategyCode, TwistState,
};
use scene::Scene;
use serde::Serialize;

use crate::file::SCENE_FILE;
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

/// A cycle that came out otherwise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Its number.
    pub cycle: u64,
    /// Largest difference of a component of the twist, m/s and rad/s.
    pub difference: f64,
    /// The twist that was sent.
    pub recorded: [f64; 6],
    /// The twist that came out.
    pub replayed: [f64; 6],
    /// State and cause that were recorded.
    pub recorded_state: String,
    /// State and cause that came out.
    pub replayed_state: String,
}

/// What a replay found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Outcome {
    /// Cycles replayed.
    pub cycles: u64,
    /// ... in which the law ran.
    pub steps: u64,
    /// ... whose twist, state and cause came out bit for bit.
    pub equal: u64,
    /// ... that differ by more than the tolerance, or in state or cause.
    pub different: u64,
    /// Largest difference of a component of a twist, m/s and rad/s.
    pub largest: f64,
    /// The first cycle that differs.
    pub first: Option<Difference>,
    /// Features that cycles used and that are not in the recording.
    pub missing_features: u64,
    /// Records of cycles that are not in the recording, before or between those that are.
    pub missing_cycles: u64,
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
    let mut outcome = Outcome::default();
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
    features: HashMap<u64, Vec<&'a Features>>,
    robot: &'a [RobotState],
    requests: Vec<&'a Request>,
    taken: Option<Stamp>,
    state: Option<Stamp>,
}

impl<'a> Replay<'a> {
    fn of(recording: &'a Recording) -> Self {
        let mut features: HashMap<u64, Vec<&Features>> = HashMap::new();
        for message in &recording.features {
            let number = message.stamp.sequence;
            features.entry(number).or_default().push(message);
        }
        // A request that was not answered did not reach the daemon.
        let answered = |request: &&Request| {
            let mut replies = recording.replies.iter();
            replies.any(|reply| reply.id == request.id)
        };
        Self {
            features,
            robot: &recording.robot,
            requests: recording.requests.iter().filter(answered).collect(),
            taken: None,
            state: None,
        }
    }

    fn run(
        mut self,
        pilot: &mut Pilot,
        run: &[CycleRecord],
        tolerance: f64,
        outcome: &mut Outcome,
    ) {
        // Before the first one nothing was heard.
        let begin_ns = run.first().map_or(0, |cycle| cycle.stamp.data_ns);
        let heard = |stamp: &Stamp| stamp.published_ns < begin_ns;
        let robots = self.robot.iter().take_while(|state| heard(&state.stamp));
        self.robot = &self.robot[robots.count()..];
        let (mut number, mut overruns, mut missed) = (0, 0, 0);
        for cycle in run {
            outcome.missing_cycles += cycle.cycle.saturating_sub(number + 1);
            number = cycle.cycle;
            let now_ns = cycle.stamp.data_ns + cycle.receive_ns;
            let features = self.features(cycle, now_ns, outcome);
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
            // A cycle counts what was missed before it; its record, what was missed until its end.
            missed = cycle.overruns.saturating_sub(overruns);
            overruns = cycle.overruns;
            let mut record = CycleRecord::default();
            let answer = pilot.decide(&inputs, &mut record);
            compare(cycle, &record, tolerance, outcome);
            debug_assert_eq!(record.twist, answer.decision.twist);
        }
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
        // Cameras start again with the same numbers: the last one that had been published by then.
        let known = self.features.get(&number).and_then(|messages| {
            let published = |message: &&&Features| message.stamp.published_ns <= now_ns;
            messages.iter().rfind(published).copied()
        });
        let known_to_be_old = self.taken.is_some_and(|taken| taken.sequence == number);
        match known {
            Some(message) if self.taken == Some(message.stamp) => Input::Nothing,
            Some(message) => {
                let order = Order::after(self.taken, &message.stamp);
                self.taken = Some(message.stamp);
                Input::Message(Received {
                    message: *message,
                    order,
                })
            }
            None if known_to_be_old => Input::Nothing,
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

fn compare(recorded: &CycleRecord, replayed: &CycleRecord, tolerance: f64, to: &mut Outcome) {
    let pairs = recorded.twist.iter().zip(&replayed.twist);
    let difference = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let situation = |record: &CycleRecord| (record.state, record.hold);
    let is_same_situation = situation(recorded) == situation(replayed);
    let bits = |record: &CycleRecord| record.twist.map(f64::to_bits);
    to.cycles += 1;
    to.steps += u64::from(recorded.status != 0);
    to.equal += u64::from(is_same_situation && bits(recorded) == bits(replayed));
    to.largest = to.largest.max(difference);
    if is_same_situation && difference <= tolerance {
        return;
    }
    to.different += 1;
    to.first.get_or_insert_with(|| Difference {
        cycle: recorded.cycle,
        difference,
        recorded: recorded.twist,
        replayed: replayed.twist,
        recorded_state: words(recorded),
        replayed_state: words(replayed),
    });
}

fn words(record: &CycleRecord) -> String {
    let state = TwistState::from_code(record.state).map_or("?".to_owned(), |s| s.to_string());
    match Hold::from_code(record.hold) {
        Some(Hold::None) | None => state,
        Some(cause) => format!("{state}: {cause}"),
    }
}

impl Outcome {
    /// The outcome as text.
    pub fn text(&self) -> String {
        let Self {
            cycles,
            steps,
            equal,
            different,
            largest,
            first,
            missing_features,
            missing_cycles,
        } = self;
        let mut text = format!(
            "{cycles} cycles, the law ran in {steps}: {equal} bit for bit the same, {different} different; largest \
             difference of a twist {largest:e}\n"
        );
        if *missing_cycles > 0 {
            text += &format!(
                "{missing_cycles} cycles are not in the recording: what they left behind is unknown\n"
            );
        }
        if *missing_features > 0 {
            text +=
                &format!("{missing_features} features that were used are not in the recording\n");
        }
        if let Some(first) = first {
            text += &format!(
                "first different: cycle {}, by {:e}\n  recorded {} {:?}\n  replayed {} {:?}\n",
                first.cycle,
                first.difference,
                first.recorded_state,
                first.recorded,
                first.replayed_state,
                first.replayed
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cycles of a daemon in lockstep, by its own pilot, on a camera that moves by itself.
    fn flown(cycles: usize) -> Recording {
        let mut recording = Recording {
            scene: Some(Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap()),
            scene_toml: Some(scene::PAPER_SIM.to_owned()),
            config_toml: Some("[law]\niterations = 20\n[cycle]\nclock = \"lockstep\"\n".to_owned()),
            ..Recording::default()
        };
        let blank = CycleRecord {
            clock: ClockMode::Lockstep.code(),
            np: 3,
            state: TwistState::Moving.code(),
            ..CycleRecord::default()
        };
        let mut pilot = pilot(&recording, &Beside::default(), &blank).unwrap();
        let mut last = None;
        for i in 0..cycles as u64 {
            let offset = 90.0 - i as f64;
            let corners = [
                [312.0, 312.0],
                [712.0, 312.0],
                [712.0, 712.0],
                [312.0, 712.0],
            ];
            let points = corners.map(|[u, v]| [u + offset, v - 0.5 * offset]);
            let mut message = Features::new(&points, 1_000 * i);
            // The fifth frame is lost.
            message.stamp.sequence = if i < 5 { i + 1 } else { i + 2 };
            message.stamp.published_ns = 1_000 * i + 1;
            let order = Order::after(last, &message.stamp);
            last = Some(message.stamp);
            let mut record = CycleRecord {
                cycle: i + 1,
                ..blank
            };
            record.stamp.data_ns = 1_000 * i + 2;
            let inputs = Inputs {
                now_ns: record.stamp.data_ns,
                features: Input::Message(Received { message, order }),
                robot: Input::Nothing,
                missed: 0,
                shutdown: false,
            };
            pilot.decide(&inputs, &mut record);
            recording.features.push(message);
            recording.cycles.push(record);
        }
        recording
    }

    #[test]
    fn the_same_law_gives_the_same_bits() {
        let recording = flown(40);
        let outcome = replay(&recording, &Beside::default(), 0.0).unwrap();
        assert_eq!((outcome.cycles, outcome.steps, outcome.equal), (40, 40, 40));
        assert_eq!((outcome.largest, outcome.first), (0.0, None));
    }

    #[test]
    fn another_law_is_told_from_the_recorded_one_and_so_is_one_bit() {
        let mut recording = flown(40);
        recording.cycles[17].twist[2] = f64::from_bits(recording.cycles[17].twist[2].to_bits() ^ 1);
        let outcome = replay(&recording, &Beside::default(), 0.0).unwrap();
        assert_eq!((outcome.equal, outcome.different), (39, 1));
        assert_eq!(outcome.first.unwrap().cycle, 18);
        let tolerant = replay(&recording, &Beside::default(), 1e-9).unwrap();
        assert_eq!((tolerant.equal, tolerant.different), (39, 0));

        recording.config_toml = Some("[law]\nmodel = \"target-depth\"\n".to_owned());
        let outcome = replay(&recording, &Beside::default(), 1e-9).unwrap();
        assert!(
            outcome.different > 20 && outcome.largest > 1e-6,
            "{outcome:?}"
        );
    }

    #[test]
    fn features_that_were_not_recorded_are_counted() {
        let mut recording = flown(10);
        recording.features.remove(6);
        let outcome = replay(&recording, &Beside::default(), 0.0).unwrap();
        assert_eq!(outcome.missing_features, 1);
        assert_eq!(outcome.first.unwrap().cycle, 7);
    }
}
