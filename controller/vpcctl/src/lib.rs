//! `vpcctl`: watch and command the daemon `vpcd` through shared memory.
//!
//! A client of the contract (`ipc`); it does not depend on the daemon's code. Exit codes and
//! decisions are in `README.md` beside this crate.
#![forbid(unsafe_code)]

pub mod arguments;
pub mod check_bridge;
pub mod clock;
pub mod doctor;
pub mod failure;
pub mod flight;
pub mod foxglove;
pub mod image_plane;
pub mod init;
pub mod joints;
pub mod latency;
pub mod manual;
pub mod metrics;
pub mod output;
pub mod plot;
pub mod presence;
pub mod record;
pub mod recover;
pub mod request;
pub mod serve;
pub mod server;
pub mod settings;
pub mod status;
pub mod stop;
pub mod take_up;
pub mod teach;
pub mod units;
pub mod view;
pub mod visit;
pub mod watch;
pub mod watcher;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::Parser;
use messages::{Action, Request};
use program::Exit;

use arguments::{Arguments, Command, RequestArguments};
use clock::Monotonic;
use failure::Failure;
use image_plane::ImagePlane;
use status::Asking;
use watcher::Watcher;

/// Runs the command line; a failure is one line on standard error.
pub fn main(line: impl IntoIterator<Item = OsString>) -> ExitCode {
    let result = match Arguments::try_parse_from(line) {
        Ok(arguments) => run(&arguments),
        Err(error) => {
            // Nothing better can be done where even this cannot be written.
            let _ = error.print();
            let exit = if error.use_stderr() {
                Exit::Usage
            } else {
                Exit::Ok
            };
            return exit.into();
        }
    };
    match result {
        Ok(exit) => exit.into(),
        Err(failure) => {
            eprintln!("vpcctl: {failure}");
            failure.exit.into()
        }
    }
}

fn run(arguments: &Arguments) -> Result<Exit, Failure> {
    let asked_ns = ipc::now_ns();
    let directory = arguments.directory();
    let ask = |request: Request, with: &RequestArguments| {
        request::ask(&directory, &request, with.timeout)
    };
    let (text, exit) = match &arguments.command {
        Command::Arm(with) => {
            let known = request::known(&directory, with.veto, asked_ns, with.request.timeout)?;
            ask(request::arm(known), &with.request)?
        }
        Command::Disarm(with) => ask(request::plain(Action::Disarm), with)?,
        Command::Stop(with) if with.all => stop::stop_all(with.request.timeout),
        Command::Stop(with) => stop::stop(&directory, with.request.timeout)?,
        Command::Flight(with) => flight::flight(&directory, with.timeout)?,
        Command::Recover(with) => recover::recover(&directory, with.timeout, &mut Monotonic)?,
        Command::Strategy(with) => {
            let (strategy, neighbours) = with.strategy;
            ask(request::strategy(strategy, neighbours), &with.request)?
        }
        Command::Status(with) => {
            let status = status::look(&directory, with.watch, Asking::IfSilent)?;
            let text = match with.json {
                true => serde_json::to_string_pretty(&status.json())? + "\n",
                false => status.text(output::colours()),
            };
            (text, status.exit())
        }
        Command::Doctor(with) => {
            let findings = doctor::examine(&directory, with);
            doctor::report(&findings, output::colours())
        }
        Command::CheckBridge(with) => check_bridge::check(&directory, with, &mut Monotonic)?,
        Command::Watch(with) => {
            let plane = ImagePlane::open(&directory, with.scene.as_deref())?;
            return watch::run(&directory, plane, with.neighbours);
        }
        Command::Metrics(with) if with.once => return metrics::once(&directory, with.watch),
        Command::Metrics(with) => {
            server::allow(with.listen, with.expose, false)?;
            return metrics::serve(Watcher::open(&directory)?, with.listen);
        }
        Command::Serve(with) if with.foxglove.is_some() => {
            return foxglove::run(&directory, with);
        }
        Command::Serve(with) => {
            server::allow(with.listen, with.expose, with.control)?;
            if with.control {
                server::has_descriptors()?;
            }
            let plane = ImagePlane::open(&directory, with.scene.as_deref())?;
            let watcher = Watcher::open(&directory)?;
            return serve::run(watcher, plane, with.listen, with.control);
        }
        Command::Teach(with) => (teach::teach(&directory, with, &mut Monotonic)?, Exit::Ok),
        Command::Visit(with) => return visit::visit(&directory, with, asked_ns),
        Command::Init(with) => (init::init(with)?, Exit::Ok),
        Command::Completions { shell } => {
            let script = manual::completions(*shell);
            (String::from_utf8_lossy(&script).into_owned(), Exit::Ok)
        }
        Command::Man { directory } => (manual::write(directory)?.join("\n") + "\n", Exit::Ok),
        Command::Record(with) => (record::run(&directory, with)?, Exit::Ok),
        Command::Plot(with) => (plot::run(with)?, Exit::Ok),
    };
    match output::write(&text) {
        // What was done was done, whoever could not be told so.
        Err(failure) if arguments.command.acts() => eprintln!("vpcctl: {failure}: {}", text.trim()),
        written => written?,
    }
    Ok(exit)
}
