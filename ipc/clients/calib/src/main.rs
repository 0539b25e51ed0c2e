//! `vpc-calib`: calibrations as a process.

use std::process::ExitCode;

use clap::FromArgMatches;
use vpc_calib::arguments::Arguments;
use vpc_calib::command;

fn main() -> ExitCode {
    begin().unwrap_or_else(|code| code)
}

fn begin() -> Result<ExitCode, ExitCode> {
    let matches = program::arguments::<Arguments>()?;
    let arguments = Arguments::from_arg_matches(&matches).map_err(|error| {
        let _ = error.print();
        ExitCode::from(program::USAGE)
    })?;
    let stop = program::stop_on_signals("vpc-calib")?;
    Ok(match command::run(&arguments.command, &stop) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(program::ATTENTION),
        Err(error) => {
            eprintln!("vpc-calib: {error}");
            ExitCode::from(error.code)
        }
    })
}
