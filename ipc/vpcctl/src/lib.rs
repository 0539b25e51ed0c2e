//! `vpcctl`: watch and command the daemon `vpcd` through shared memory.
//!
//! A pure client: it knows the contract (`ipc`) and the scene file (`scene`), and nothing of the daemon's code. Tour,
//! exit codes and decisions: `README.md` beside this crate.
#![forbid(unsafe_code)]

pub mod arguments;
pub mod doctor;
pub mod exit;
pub mod http;
pub mod manual;
pub mod metrics;
pub mod output;
pub mod phase;
pub mod plot;
pub mod presence;
pub mod record;
pub mod replay;
pub mod request;
pub mod serve;
pub mod stage;
pub mod status;
pub mod view;
pub mod watch;
pub mod watcher;
pub mod words;

use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::Parser;
use clap::error::ErrorKind;
use ipc::{Action, Request};

use arguments::{Arguments, Command, RequestArguments};
use exit::{Exit, Failure};
use stage::Stage;
use status::Asking;

/// Runs the command line; a failure is one line on standard error.
pub fn main(line: impl IntoIterator<Item = OsString>) -> ExitCode {
    let arguments = match Arguments::try_parse_from(line) {
        Ok(arguments) => arguments,
        Err(error) => {
            // Nothing better can be done where even this cannot be written.
            let _ = error.print();
            return match error.kind() {
                ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => Exit::Ok.into(),
                _ => Exit::Usage.into(),
            };
        }
    };
    match run(&arguments) {
        Ok(exit) => exit.into(),
        Err(failure) => {
            eprintln!("vpcctl: {failure}");
            failure.exit().into()
        }
    }
}

fn run(arguments: &Arguments) -> Result<Exit, Failure> {
    let directory = arguments.directory();
    let ask = |request: Request, with: &RequestArguments| -> Result<Exit, Failure> {
        let reply = request::send(&directory, &request, with.timeout)?;
        let (line, exit) = request::verdict(&reply);
        output::write(&line)?;
        Ok(exit)
    };
    match &arguments.command {
        Command::Status(with) => {
            let status = status::look(&directory, with.watch, Asking::IfSilent)?;
            let text = match with.json {
                true => serde_json::to_string_pretty(&status).map_err(std::io::Error::from)? + "\n",
                false => status.text(output::colours()),
            };
            output::write(&text)?;
            Ok(status.exit())
        }
        Command::Watch(with) => {
            let stage = Stage::read(with.scene.as_deref())?;
            watch::run(&directory, &stage, with.neighbours)
        }
        Command::Arm(with) => ask(request::plain(Action::Arm), with),
        Command::Disarm(with) => ask(request::plain(Action::Disarm), with),
        Command::Stop(with) => ask(request::plain(Action::Stop), with),
        Command::Doctor(with) => {
            let findings = doctor::examine(&doctor::Patient {
                directory,
                scene: with.scene.clone(),
                memory: with.memory.clone(),
                watch: with.watch,
            });
            let (text, exit) = doctor::report(&findings, output::colours());
            output::write(&text)?;
            Ok(exit)
        }
        Command::Metrics(with) if with.once => metrics::once(&directory, with.watch),
        Command::Metrics(with) => {
            http::allow(with.listen, with.expose)?;
            metrics::serve(&directory, with.listen, &*until_signalled()?)
        }
        Command::Serve(with) => {
            http::allow(with.listen, with.expose)?;
            let stage = Stage::read(with.scene.as_deref())?;
            let service = serve::Service {
                directory,
                address: with.listen,
                control: with.control,
            };
            serve::allow(&service)?;
            serve::run(&service, &stage, &*until_signalled()?)
        }
        Command::Completions { shell } => {
            output::write(&manual::completions(*shell))?;
            Ok(Exit::Ok)
        }
        Command::Man { directory } => {
            let names = manual::write(directory)?;
            output::write(&format!("{}\n", names.join("\n")))?;
            Ok(Exit::Ok)
        }
        Command::Flight(with) => ask(request::plain(Action::Record), with),
        Command::Record(with) => {
            output::write(&record::run(&directory, with)?)?;
            Ok(Exit::Ok)
        }
        Command::Plot(with) => {
            output::write(&plot::run(with)?)?;
            Ok(Exit::Ok)
        }
        Command::Replay(with) => Err(replay::run(with)),
        Command::Strategy(with) => match with.choice() {
            Ok(choice) => ask(
                request::strategy(choice.strategy, choice.neighbours),
                &with.request,
            ),
            Err(message) => {
                eprintln!("vpcctl: {message}");
                Ok(Exit::Usage)
            }
        },
    }
}

/// A flag that SIGINT, SIGTERM and SIGHUP raise.
fn until_signalled() -> std::io::Result<Arc<AtomicBool>> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let end = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&end))?;
    }
    Ok(end)
}
