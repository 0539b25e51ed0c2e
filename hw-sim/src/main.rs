//! `hw-sim`: the emulator as a process.

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::CommandFactory;
use hw_sim::config::{Arguments, Clock, Config};
use hw_sim::emulator::{self, Tally};
use hw_sim::outcome::Outcome;
use hw_sim::rig::RigError;

const USAGE: u8 = 64;
const UNAVAILABLE: u8 = 69;
const CONFIGURATION: u8 = 78;

fn main() -> ExitCode {
    let matches = match Arguments::command().try_get_matches() {
        Ok(matches) => matches,
        Err(error) => {
            // Help and version are not errors.
            let code = if error.use_stderr() { USAGE } else { 0 };
            let _ = error.print();
            return ExitCode::from(code);
        }
    };
    let config = match Config::load(&matches) {
        Ok(config) => config,
        Err(error) => {
            eprintln!("hw-sim: {error}");
            return ExitCode::from(error.exit_code());
        }
    };
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        if let Err(error) = signal_hook::flag::register(signal, Arc::clone(&stop)) {
            eprintln!("hw-sim: signal {signal}: {error}");
            return ExitCode::from(UNAVAILABLE);
        }
    }
    let is_series = config.repeat || config.starts.len() > 1;
    let tell = |outcome: &Outcome, tally: Tally| {
        println!("{}", serde_json::json!(outcome));
        let sentence = outcome.sentence();
        if is_series {
            let Tally { runs, arrived } = tally;
            eprintln!(
                "hw-sim: start {}: {sentence} ({arrived} of {runs} arrived)",
                outcome.start
            );
        } else {
            eprintln!("hw-sim: {sentence}");
        }
    };
    match emulator::run(&config, &stop, tell) {
        Ok(tally) => {
            if config.clock == Clock::Fixed {
                eprintln!("hw-sim: no more frames come, so vpcd disarms");
            }
            ExitCode::from(u8::from(tally.runs == 0 || tally.arrived < tally.runs))
        }
        Err(error) => {
            eprintln!("hw-sim: {error:#}");
            // An arm that cannot be: its start is out of reach, or a setting out of range.
            let is_settings = matches!(error.downcast_ref(), Some(RigError::Arm(_)));
            ExitCode::from(if is_settings {
                CONFIGURATION
            } else {
                UNAVAILABLE
            })
        }
    }
}
