//! `vpc-calib`: calibrations as a process.

use std::process::ExitCode;

use clap::FromArgMatches;
use program::Exit;
use vpc_calib::arguments::Arguments;
use vpc_calib::command;

fn main() -> ExitCode {
    begin().unwrap_or_else(|code| code)
}

fn begin() -> Result<ExitCode, ExitCode> {
    let matches = program::arguments::<Arguments>()?;
    let arguments = Arguments::from_arg_matches(&matches).map_err(|error| {
        let _ = error.print();
        ExitCode::from(Exit::Usage)
    })?;
    let stop =
        program::stop_on_signals().map_err(|error| Exit::Unavailable.say("vpc-calib", error))?;
    Ok(match command::run(&arguments.command, &stop) {
        Ok(true) => Exit::Ok.into(),
        Ok(false) => Exit::Attention.into(),
        Err(error) => error.exit.say("vpc-calib", error),
    })
}
