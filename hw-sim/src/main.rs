//! `hw-sim`: the emulator as a process.

use std::io::IsTerminal;
use std::process::ExitCode;

use hw_sim::config::{Arguments, Clock, Config};
use hw_sim::emulator::{self, Tally};
use hw_sim::outcome::Outcome;
use hw_sim::rig::RigError;
use program::Exit;

fn main() -> ExitCode {
    begin().unwrap_or_else(|code| code)
}

fn begin() -> Result<ExitCode, ExitCode> {
    let matches = program::arguments::<Arguments>()?;
    let config = Config::load(&matches).map_err(|error| Exit::from(&error).say("hw-sim", error))?;
    let unavailable = |error| Exit::Unavailable.say("hw-sim", error);
    let start_up = program::StartUp::begin().map_err(unavailable)?;
    let stop = program::stop_on_signals().map_err(unavailable)?;
    let prints_json = config.json || !std::io::stdout().is_terminal();
    let is_series = config.repeat || config.starts.len() > 1;
    let tell = |outcome: &Outcome, tally: Tally| {
        if prints_json {
            println!("{}", serde_json::json!(outcome));
        }
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
    Ok(match emulator::run(&config, start_up, &stop, tell) {
        Ok(tally) => {
            if config.clock == Clock::Fixed {
                eprintln!("hw-sim: no more frames come, so vpcd disarms");
            }
            ExitCode::from(u8::from(tally.runs == 0 || tally.arrived < tally.runs))
        }
        Err(error) => {
            // An arm that cannot be: its start is out of reach, or a setting out of range.
            let is_settings = matches!(error.downcast_ref(), Some(RigError::Arm(_)));
            let exit = if is_settings {
                Exit::Config
            } else {
                Exit::Unavailable
            };
            exit.say("hw-sim", format_args!("{error:#}"))
        }
    })
}
