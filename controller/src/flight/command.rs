//! `vpcd replay`: from its command line to its exit code.

use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use super::about::{Build, hex};
use super::file::{Flight, FlightError};
use super::record::FlightRecord;
use super::replay::{Difference, Report, replay};
use super::words::words_of;
use crate::arguments::ReplayArguments;
use crate::exit::Exit;
use crate::law::{Law, LawError};
use crate::log;
use crate::pilot::Pilot;

/// Why a record cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The file.
    #[error(transparent)]
    Flight(#[from] FlightError),
    /// Scene or memory.
    #[error(transparent)]
    Law(#[from] LawError),
    /// Scene or memory is another than the recorded one.
    #[error("{path}: {what} = {found}; allowed: {expected}, that of the flight record")]
    Other {
        /// The file.
        path: String,
        /// Fingerprint or digest.
        what: &'static str,
        /// What was found.
        found: String,
        /// What was recorded.
        expected: String,
    },
    /// The settings in the record are none.
    #[error("{path}: settings: {what}")]
    Settings {
        /// The file.
        path: String,
        /// Name, value, allowed.
        what: String,
    },
    /// The cycle that was asked for is not in the record, or nothing can be said about it.
    #[error("{path}: --cycle = {found}; allowed: {allowed}")]
    Cycle {
        /// The file.
        path: String,
        /// The cycle.
        found: u64,
        /// What can be replayed.
        allowed: String,
    },
}

impl ReplayError {
    /// The exit code that it asks for.
    pub fn exit(&self) -> Exit {
        match self {
            Self::Flight(FlightError::Read { .. }) => Exit::NoInput,
            Self::Law(error) => error.exit(),
            Self::Cycle { .. } => Exit::Usage,
            _ => Exit::Data,
        }
    }
}

/// Replays and tells; messages about failures go to standard error.
pub fn run(arguments: &ReplayArguments) -> Exit {
    match attempt(arguments) {
        Ok(exit) => exit,
        Err(error) => {
            log::complain(&error.to_string());
            error.exit()
        }
    }
}

fn attempt(arguments: &ReplayArguments) -> Result<Exit, ReplayError> {
    let flight = Flight::read(&arguments.file)?;
    let path = arguments.file.display().to_string();
    let mut pilot = pilot(&flight, &path, arguments)?;
    let outcome = replay(&mut pilot, &flight, arguments.cycle);
    let asked_for = match arguments.cycle {
        Some(cycle) => Some(find(&flight, &path, cycle, &outcome)?),
        None => None,
    };
    let build = Build::running();
    let is_other_build = build != flight.about.build;
    if arguments.json {
        tell_json(&flight, is_other_build, &outcome, asked_for);
    } else {
        tell(&flight, is_other_build, &outcome, asked_for);
    }
    Ok(match outcome {
        Ok(_) => Exit::Ok,
        Err(_) => Exit::No,
    })
}

/// The pilot that the record asks for; its state comes with the first key.
fn pilot(flight: &Flight, path: &str, arguments: &ReplayArguments) -> Result<Pilot, ReplayError> {
    let about = &flight.about;
    let settings = about
        .settings
        .settings()
        .map_err(|what| ReplayError::Settings {
            path: path.to_owned(),
            what,
        })?;
    let recorded = about.memory.as_ref();
    let memory = recorded.map(|memory| {
        let given = arguments.memory.clone();
        given.unwrap_or_else(|| PathBuf::from(&memory.path))
    });
    let memory = memory.as_deref();
    let (law, scene) = match &arguments.scene {
        Some(scene) => (
            Law::open(scene, memory, settings)?,
            scene.display().to_string(),
        ),
        None => {
            let text = about.scene.text.clone();
            let law = Law::parse(text, about.scene.path.clone(), memory, settings)?;
            (law, about.scene.path.clone())
        }
    };
    same(
        &scene,
        "fingerprint",
        law.scene().fingerprint().to_string(),
        &about.scene.fingerprint,
    )?;
    if let (Some(found), Some(recorded)) = (law.memory(), recorded) {
        let path = memory.unwrap_or(Path::new("")).display().to_string();
        same(&path, "SHA-256", hex(found.digest()), &recorded.sha256)?;
    }
    let Some(key) = flight.keys.first() else {
        return Err(FlightError::Damaged {
            path: path.to_owned(),
            offset: super::file::PREAMBLE,
            what: "keys".to_owned(),
            found: "0".to_owned(),
            allowed: "1 and more: without a key no cycle can be replayed".to_owned(),
        }
        .into());
    };
    let mut pilot = Pilot::new(law, None, key.state.supervisor.rules());
    pilot.restore(&key.state);
    Ok(pilot)
}

fn same(path: &str, what: &'static str, found: String, expected: &str) -> Result<(), ReplayError> {
    if found == expected {
        return Ok(());
    }
    Err(ReplayError::Other {
        path: path.to_owned(),
        what,
        found,
        expected: expected.to_owned(),
    })
}

/// The record of the cycle that was asked for.
fn find<'a>(
    flight: &'a Flight,
    path: &str,
    cycle: u64,
    outcome: &Result<Report, Box<Difference>>,
) -> Result<&'a FlightRecord, ReplayError> {
    let found = flight.records.iter().find(|record| record.cycle() == cycle);
    let was_reached = outcome.as_ref().is_ok_and(|report| report.last == cycle);
    match found {
        Some(record) if was_reached || outcome.is_err() => Ok(record),
        _ => Err(ReplayError::Cycle {
            path: path.to_owned(),
            found: cycle,
            allowed: range(flight),
        }),
    }
}

fn range(flight: &Flight) -> String {
    match (flight.records.first(), flight.records.last()) {
        (Some(first), Some(last)) => {
            format!(
                "{} to {}, without gaps after lost records",
                first.cycle(),
                last.cycle()
            )
        }
        _ => "none: the record is empty".to_owned(),
    }
}

/// All words of a record by their names; doubles that JSON has no number for as text.
fn fields(record: &FlightRecord) -> Map<String, Value> {
    let layout = FlightRecord::layout();
    let words = words_of(&mut record.clone());
    let named = words.iter().enumerate().filter_map(|(index, word)| {
        let (name, kind) = layout.word(index)?;
        Some((name, kind.value(*word)))
    });
    named.collect()
}

fn tell_json(
    flight: &Flight,
    is_other_build: bool,
    outcome: &Result<Report, Box<Difference>>,
    asked_for: Option<&FlightRecord>,
) {
    let about = &flight.about;
    let mut told = json!({
        "same": outcome.is_ok(),
        "cause": about.cause,
        "written_unix_ms": about.written_unix_ms,
        "records": about.records,
        "keys": about.keys,
        "other_build": is_other_build,
    });
    match outcome {
        Ok(report) => told["report"] = json!(report),
        Err(difference) => told["difference"] = json!(difference),
    }
    if let Some(record) = asked_for {
        told["recorded"] = Value::Object(fields(record));
    }
    println!("{told:#}");
}

fn tell(
    flight: &Flight,
    is_other_build: bool,
    outcome: &Result<Report, Box<Difference>>,
    asked_for: Option<&FlightRecord>,
) {
    if is_other_build {
        println!(
            "recorded by another build of vpcd ({}); a difference may come from that",
            flight.about.build.version
        );
    }
    if let Some(record) = asked_for {
        for (name, value) in fields(record) {
            println!("{name} = {value}");
        }
    }
    match outcome {
        Ok(report) => println!(
            "same: {} cycles ({} to {}), {} keys compared, {} restored, {} cycles skipped; recorded for: {}",
            report.cycles,
            report.first,
            report.last,
            report.keys_compared,
            report.keys_restored,
            report.skipped,
            flight.about.cause,
        ),
        Err(difference) => println!("{difference}"),
    }
}
