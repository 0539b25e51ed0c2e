//! `vpc-replay`: the law again on a recording, compared with what was sent.

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use controller::law::LawError;
use recording::replay::{Beside, Outcome, ReplayError, replay};
use recording::{ReadError, Recording};

/// Runs the law again on a recording (MCAP) and compares each twist with the one that was sent.
///
/// The daemon's configuration and scene come from the recording, where the recorder was told of them; strategy, preview
/// and clock from its first cycle. A recording that was begun in mid-run is judged from where it tells all of the law's
/// state, mostly after less than a second of motion. Flight records are replayed by `vpcd replay`.
///
/// Exit codes: 0 the same; 1 different; 2 nothing to compare: no cycle before which all is recorded; 64 command line; 65 recording, scene, memory or configuration wrong; 66 file
/// missing; 70 failure.
#[derive(Debug, Parser)]
#[command(name = "vpc-replay", version, max_term_width = 100)]
struct Arguments {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    recording: PathBuf,

    /// Memory of motion, instead of the one that the configuration names.
    #[arg(long, value_name = "FILE")]
    memory: Option<PathBuf>,

    /// Configuration of vpcd, instead of the recorded one.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Scene file, instead of the recorded one.
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,

    /// Difference of a twist's component that counts as none, m/s and rad/s.
    #[arg(long, value_name = "DIFFERENCE", default_value_t = 0.0, value_parser = tolerance)]
    tolerance: f64,

    /// The outcome as JSON.
    #[arg(long)]
    json: bool,
}

fn tolerance(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(difference) if (0.0..=10.0).contains(&difference) => Ok(difference),
        _ => Err("allowed: 0 to 10".to_owned()),
    }
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // Help and version are not errors.
            let code = if error.use_stderr() { 64 } else { 0 };
            let _ = error.print();
            return ExitCode::from(code);
        }
    };
    match attempt(&arguments) {
        Ok(outcome) if outcome.judged == 0 => ExitCode::from(2),
        Ok(outcome) => ExitCode::from(u8::from(outcome.different > 0)),
        Err((code, message)) => {
            eprintln!("vpc-replay: {message}");
            ExitCode::from(code)
        }
    }
}

/// Replays and tells; else exit code and message.
fn attempt(arguments: &Arguments) -> Result<Outcome, (u8, String)> {
    let recording = Recording::read(&arguments.recording).map_err(|error| {
        let code = if matches!(error, ReadError::Read { .. }) {
            66
        } else {
            65
        };
        (code, error.to_string())
    })?;
    if let Some(cut) = &recording.cut {
        let path = arguments.recording.display();
        eprintln!("vpc-replay: {path}: cut short: {cut}");
    }
    let beside = Beside {
        config: arguments.config.clone(),
        memory: arguments.memory.clone(),
        scene: arguments.scene.clone(),
    };
    let outcome = replay(&recording, &beside, arguments.tolerance).map_err(|error| {
        let code = match &error {
            ReplayError::Read { .. } => 66,
            ReplayError::Law(LawError::Thread(_)) => 70,
            ReplayError::Law(error) => error.exit() as u8,
            _ => 65,
        };
        (code, error.to_string())
    })?;
    let text = match arguments.json {
        true => serde_json::to_string_pretty(&outcome).map_err(|e| (70, e.to_string()))? + "\n",
        false => outcome.to_string(),
    };
    match std::io::stdout().write_all(text.as_bytes()) {
        // Who reads no further (head) has what they wanted.
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err((70, format!("cannot write the output: {error}")))
        }
        _ => Ok(outcome),
    }
}
