//! `vpcd replay`: from its command line to its exit code.

use std::io;
use std::path::{Path, PathBuf};

use decision::snapshot::SnapshotError;
use decision::{Rules, contract};
use memory_blob::{MemoryFile, hex};
use messages::{CycleRecord, StrategyCode};
use program::Exit;
use recording::{CONFIG_FILE, ReadError, Recorded, Recording, SCENE_FILE};
use scene::SceneFiles;
use serde_json::{Value, json};

use super::{Difference, ReplayError, Report, replay};
use crate::arguments::{Arguments, ReplayArguments};
use crate::config::{self, Config, ConfigError};
use crate::flight::file::{self, origin};
use crate::loaded::{LoadError, Loaded};
use crate::log;

/// Why a recording cannot be replayed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
enum CommandError {
    #[error(transparent)]
    Read(#[from] ReadError),
    #[error("{path}: damaged: {reason}; allowed: a whole flight record")]
    Damaged { path: String, reason: String },
    #[error("{path}: {lacking}")]
    Lacking { path: String, lacking: &'static str },
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Load(#[from] LoadError),
    #[error("{path}: SHA-256 = {found}; allowed: {expected}, that of the flight record")]
    OtherMemory {
        path: String,
        found: String,
        expected: String,
    },
    #[error("{path}: {source}")]
    Snapshot { path: String, source: SnapshotError },
    #[error("{path}: --until = {found}; allowed: {allowed}")]
    Until {
        path: String,
        found: u64,
        allowed: String,
    },
}

impl CommandError {
    fn exit(&self) -> Exit {
        match self {
            Self::Read(ReadError::Read { .. }) => Exit::NoInput,
            Self::Config(error) => config::exit(error),
            Self::Load(error) => error.into(),
            Self::Until { .. } => Exit::Usage,
            _ => Exit::Data,
        }
    }
}

/// Replays and prints the report; failures go to standard error.
pub fn run(arguments: &ReplayArguments) -> Exit {
    attempt(arguments).unwrap_or_else(|error| {
        log::complain(&error.to_string());
        error.exit()
    })
}

fn attempt(arguments: &ReplayArguments) -> Result<Exit, CommandError> {
    let path = arguments.file.display().to_string();
    let recording = read(&arguments.file, &path)?;
    let (loaded, rules) = load(&recording, &path, arguments)?;
    let mut control = loaded.control(rules)?;
    let outcome = match replay(&mut control, &recording, arguments.until) {
        Ok(report) => Ok(report),
        Err(ReplayError::Difference(difference)) => Err(difference),
        Err(ReplayError::Snapshot(source)) => return Err(CommandError::Snapshot { path, source }),
    };
    let asked_for = arguments
        .until
        .map(|until| find(&recording, &path, until, &outcome))
        .transpose()?;
    if arguments.json {
        print_json(&recording, &outcome, asked_for);
    } else {
        print(&recording, &outcome, asked_for);
    }
    Ok(match outcome {
        Ok(_) => Exit::Ok,
        Err(_) => Exit::Attention,
    })
}

/// Reads the file. A recorder may have been killed; a flight record is written whole.
fn read(file: &Path, path: &str) -> Result<Recording, CommandError> {
    let recording = Recording::read(file)?;
    if let Some(reason) = &recording.cut
        && recording.origin(origin::CAUSE).is_some()
    {
        return Err(CommandError::Damaged {
            path: path.to_owned(),
            reason: reason.clone(),
        });
    }
    let lacking = if recording.cycles.is_empty() {
        "no cycles in the recording; allowed: one of a domain in which vpcd was at work"
    } else if recording.snapshots.is_empty() {
        "no snapshot in the recording; allowed: one of a second or more, of this version of vpcd"
    } else {
        return Ok(recording);
    };
    Err(CommandError::Lacking {
        path: path.to_owned(),
        lacking,
    })
}

/// What the control step of the daemon that was recorded is made of.
fn load(
    recording: &Recording,
    path: &str,
    arguments: &ReplayArguments,
) -> Result<(Loaded, Rules), CommandError> {
    let Some(scene) = recording.scene_toml() else {
        return Err(CommandError::Lacking {
            path: path.to_owned(),
            lacking: "no scene in the recording; allowed: one recorded while vpcd was at work",
        });
    };
    let files = SceneFiles::parse(scene.to_owned(), SCENE_FILE, &|name| {
        let file = recording.attachments.get(name).cloned();
        file.ok_or_else(|| io::Error::other("not in the recording"))
    });
    let files = files.map_err(LoadError::from)?;
    let config = config(recording, arguments)?;
    let memory = config.memory.as_deref();
    let bytes = memory.map(MemoryFile::read).transpose();
    let bytes = bytes.map_err(LoadError::from)?;
    let loaded = Loaded::of(files, memory.zip(bytes.as_deref()), config.settings)?;
    if let (Some(found), Some(expected)) = (&loaded.memory, recording.origin(origin::MEMORY_SHA256))
        && hex(found.digest()) != expected
    {
        return Err(CommandError::OtherMemory {
            path: memory.unwrap_or(Path::new("")).display().to_string(),
            found: hex(found.digest()),
            expected: expected.to_owned(),
        });
    }
    let rules = config.rules(loaded.scene(), "the recording")?;
    Ok((loaded, rules))
}

/// The attached configuration, with the scene that is attached as well, and with the strategy of
/// the first cycle: an operator may have changed it.
fn config(recording: &Recording, arguments: &ReplayArguments) -> Result<Config, CommandError> {
    let first = &recording.cycles[0];
    let flags = Arguments {
        scene: Some(PathBuf::from(SCENE_FILE)),
        memory: arguments.memory.clone(),
        strategy: StrategyCode::from_code(first.strategy)
            .and_then(|code| contract::strategy(code, first.neighbours))
            .map(|strategy| strategy.to_string()),
        np: (first.np > 0).then_some(i64::from(first.np)),
        ..Arguments::default()
    };
    let text = recording.config().unwrap_or_default();
    Ok(Config::parse(text, CONFIG_FILE, Path::new(""), &flags)?)
}

/// The record of the cycle that was asked for.
fn find<'a>(
    recording: &'a Recording,
    path: &str,
    until: u64,
    outcome: &Result<Report, Box<Difference>>,
) -> Result<&'a CycleRecord, CommandError> {
    let cycles = &recording.cycles;
    let found = cycles.iter().find(|record| record.cycle == until);
    let was_reached = outcome.as_ref().map_or(true, |report| report.last == until);
    found.filter(|_| was_reached).ok_or_else(|| {
        let (first, last) = (cycles.first(), cycles.last());
        let number = |record: Option<&CycleRecord>| record.map_or(0, |record| record.cycle);
        CommandError::Until {
            path: path.to_owned(),
            found: until,
            allowed: format!(
                "{} to {}, where nothing is missing",
                number(first),
                number(last)
            ),
        }
    })
}

/// Whether another program recorded; unknown is no.
fn is_other_build(recording: &Recording) -> bool {
    let recorded = recording.origin(origin::EXECUTABLE);
    recorded.is_some_and(|recorded| recorded != file::executable())
}

fn print_json(
    recording: &Recording,
    outcome: &Result<Report, Box<Difference>>,
    asked_for: Option<&CycleRecord>,
) {
    let mut document = json!({
        "same": outcome.is_ok(),
        "cause": recording.origin(origin::CAUSE),
        "cut": recording.cut,
        "records": recording.cycles.len(),
        "snapshots": recording.snapshots.len(),
        "other_build": is_other_build(recording),
    });
    match outcome {
        Ok(report) => document["report"] = json!(report),
        Err(difference) => document["difference"] = json!(difference),
    }
    if let Some(record) = asked_for {
        document["recorded"] = serde_json::from_str(&record.to_json()).unwrap_or(Value::Null);
    }
    println!("{document:#}");
}

fn print(
    recording: &Recording,
    outcome: &Result<Report, Box<Difference>>,
    asked_for: Option<&CycleRecord>,
) {
    if is_other_build(recording) {
        println!("recorded by another build of vpcd; a difference may come from that");
    }
    if let Some(reason) = &recording.cut {
        println!("the recording is cut short: {reason}");
    }
    if let Some(record) = asked_for {
        println!("{}", record.to_json());
    }
    match outcome {
        Ok(report) => println!(
            "same: {} cycles ({} to {}), {} snapshots compared, {} restored, {} cycles skipped{}",
            report.cycles,
            report.first,
            report.last,
            report.snapshots_compared,
            report.snapshots_restored,
            report.skipped,
            match recording.origin(origin::CAUSE) {
                Some(cause) => format!("; recorded for: {cause}"),
                None => String::new(),
            },
        ),
        Err(difference) => println!("{difference}"),
    }
}
