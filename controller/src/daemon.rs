//! The daemon from its command line to its exit code.

use std::ffi::OsString;
use std::hash::{BuildHasher, RandomState};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Parser;
use ipc::{ControllerPorts, Domain, StopFile};
use messages::{ClockMode, Hold, RealTime};
use program::Exit;

use crate::arguments::{Arguments, Command};
use crate::config::{self, Config, ConfigError};
use crate::cycle::{Cycle, MOST_FAILURES, Pace};
use crate::flight::{self, About, DumpRequest, Recorder};
use crate::instance::{self, Instance, InstanceError};
use crate::loaded::{LoadError, Loaded};
use crate::log::Log;
use crate::machine::Machine;
use crate::panicked::Panicked;
use crate::preflight::{Cost, Facts};
use crate::published::{self, Published};
use crate::reload::{Again, Reload, Successor};
use crate::report::{Report, ReportError};
use crate::service::{Notifier, Progress, Service, ServiceError};
use crate::shutdown::{Renewal, Stop};
use crate::start::{Start, StartError};
use crate::summary::Summary;
use crate::telemetry::{RecorderError, Telemetry};
use crate::{log, preflight, realtime, replay, stack};

/// Priority that the preflight asks about if no configuration names one.
const PRIORITY: i32 = 80;

/// Why the daemon failed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum Failure {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Load(#[from] LoadError),
    #[error(transparent)]
    Join(#[from] ipc::JoinError),
    #[error(transparent)]
    Instance(#[from] InstanceError),
    #[error(transparent)]
    Service(#[from] ServiceError),
    #[error(transparent)]
    Open(#[from] ipc::OpenError),
    #[error(transparent)]
    Stop(#[from] ipc::StopError),
    #[error(transparent)]
    Recorder(#[from] RecorderError),
    #[error(transparent)]
    Report(#[from] ReportError),
    #[error("log: {0}")]
    Log(std::io::Error),
    #[error("signal handlers: {0}")]
    Signals(std::io::Error),
    #[error("cannot begin again: {0}")]
    Again(std::io::Error),
    #[error("cannot leave what was checked: {0}")]
    Leave(std::io::Error),
    #[error("{most} commands in a row could not be sent; the last: {source}")]
    Send {
        most: u32,
        source: ipc::PublishError,
    },
}

impl From<StartError> for Failure {
    fn from(error: StartError) -> Self {
        match error {
            StartError::Config(error) => error.into(),
            StartError::Load(error) => error.into(),
        }
    }
}

impl Failure {
    /// The exit code that it asks for.
    pub fn exit(&self) -> Exit {
        match self {
            Self::Config(error) => config::exit(error),
            Self::Load(error) => error.into(),
            Self::Service(_) | Self::Instance(InstanceError::NoState) => Exit::Config,
            Self::Join(_) | Self::Instance(_) | Self::Open(_) | Self::Stop(_) => Exit::Unavailable,
            Self::Report(_) | Self::Leave(_) => Exit::CannotCreate,
            Self::Recorder(RecorderError::Join(_) | RecorderError::Open(_)) => Exit::Unavailable,
            Self::Recorder(_) | Self::Log(_) => Exit::Software,
            Self::Signals(_) | Self::Again(_) | Self::Send { .. } => Exit::Software,
        }
    }
}

/// The program: runs until it is asked to stop. Messages about failures go to standard error.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let arguments = match Arguments::try_parse_from(arguments) {
        Ok(arguments) => arguments,
        Err(error) => {
            // Help and version are no errors; clap writes them to standard output.
            let exit = if error.use_stderr() {
                Exit::Usage
            } else {
                Exit::Ok
            };
            let _ = error.print();
            return exit.into();
        }
    };
    let exit = match &arguments.command {
        Some(Command::Replay(arguments)) => replay::command::run(arguments),
        None if arguments.preflight => preflight(&arguments),
        None if arguments.print_config => print_config(&arguments),
        None => match run(&arguments).and_then(begin_again) {
            Ok(()) => Exit::Ok,
            Err(failure) => {
                if let Ok(service) = Service::by_environment(Duration::ZERO) {
                    service.leave(&failure.to_string());
                }
                failed(&failure, failure.exit())
            }
        },
    };
    exit.into()
}

/// Lets the successor begin, if there is to be one, under the veto of this name.
fn begin_again(successor: Option<(Successor, u32, Again)>) -> Result<(), Failure> {
    successor.map_or(Ok(()), |(successor, veto, again)| {
        Err(Failure::Again(successor.begin(veto, again)))
    })
}

/// Writes a failure to standard error.
fn failed(failure: &impl ToString, exit: Exit) -> Exit {
    log::complain(&failure.to_string());
    exit
}

/// Prints the configuration that would run.
fn print_config(arguments: &Arguments) -> Exit {
    match Config::print(arguments) {
        Ok(text) => {
            print!("{text}");
            Exit::Ok
        }
        Err(error) => failed(&error, config::exit(&error)),
    }
}

/// Prints what the machine lacks for the loop of this configuration; for a usual one if none is
/// given.
fn preflight(arguments: &Arguments) -> Exit {
    let usual = realtime::RealtimeRequest {
        priority: PRIORITY,
        cpu: None,
    };
    let config = arguments.config.as_ref().map(|_| Config::read(arguments));
    let config = match config.transpose() {
        Ok(config) => config,
        Err(error) => return failed(&error, config::exit(&error)),
    };
    let wanted = config.as_ref().and_then(|config| config.realtime);
    let wanted = wanted.unwrap_or(usual);
    let mut facts = Facts::gather(wanted);
    if let Some(config) = config.filter(|c| c.settings.strategy == vpc::Strategy::Foresight) {
        match Loaded::open(&config.scene, config.memory.as_deref(), config.settings) {
            Ok(loaded) => facts.foresight = Cost::measure(&loaded),
            Err(error) => return failed(&error, Exit::from(&error)),
        }
    }
    let found = preflight::judge(&facts, wanted);
    if arguments.json {
        println!("{}", serde_json::json!(found));
    } else {
        println!("{found}");
    }
    if found.fit { Exit::Ok } else { Exit::Attention }
}

/// Checks everything, then runs the loop in this thread. Returns what is to begin after it.
///
/// # Errors
/// [`Failure`], with its cause.
pub fn run(arguments: &Arguments) -> Result<Option<(Successor, u32, Again)>, Failure> {
    // First of all: a request to begin again while the memory is read must not kill.
    let (start_up, stop) = Stop::by_signals().map_err(Failure::Signals)?;
    let renewal = Renewal::by_signals().map_err(Failure::Signals)?;
    let dump = DumpRequest::by_signal().map_err(Failure::Signals)?;
    let (start, lost) = match arguments.again {
        Some(_) if !arguments.check_only => Start::again(arguments)?,
        _ => (Start::read(arguments)?, None),
    };
    if arguments.check_only && arguments.again.is_some() {
        start.leave().map_err(Failure::Leave)?;
        return Ok(None);
    }
    let (config, printed, loaded) = start.into_parts();
    let rules = config.rules(loaded.scene(), &config::named(arguments))?;
    let mut control = loaded.control(rules)?;
    let rate_hz = loaded.scene().camera.rate_hz;
    if arguments.check_only {
        println!("{}", describe(&config, &loaded, config.safety.armed));
        if let Some(warning) = loaded.warning() {
            eprintln!("vpcd: warning: {warning}");
        }
        return Ok(None);
    }
    let period_ns = decision::rules::ns(loaded.scene().sampling_time());
    let period = Duration::from_nanos(period_ns);
    let service = Service::by_environment(period)?;
    let log = log::start(&config).map_err(Failure::Log)?;
    let domain = Domain::join(&config.domain)?;
    drop(start_up);
    if let Some(why) = &lost {
        tracing::error!("begins with its files as they were checked before: {why}");
    }
    let begins_armed = config.safety.armed && config.clock != ClockMode::Lockstep;
    let state = begins_armed.then(instance::state_directory).transpose()?;
    let mut instance = Instance::claim(domain.directory(), state.as_deref())?;
    // The hashers of the standard library are seeded with the kernel's random numbers.
    control.name_vetoes(RandomState::new().hash_one(ipc::now_ns()));
    if let Some(veto) = arguments.again {
        control.begin_again(veto);
        instance.presence.follow();
    }
    let unclean = instance.presence.unclean.clone();
    let unclean = unclean.filter(|_| config.clock != ClockMode::Lockstep);
    if let Some(process) = &unclean {
        control.begin_disarmed(Hold::Unclean);
        tracing::warn!(
            "process {process}, a vpcd of this domain, was killed or crashed, and nobody has armed since: begins disarmed"
        );
    }
    let ports = ControllerPorts::open(&domain)?;
    let mut stop_file = StopFile::open(domain.directory())?;
    if arguments.again.is_some() {
        published::warn_of_changes(domain.directory(), &loaded.files, &printed);
    }
    let published = publish(&loaded, &printed, domain.directory());
    let (producer, consumer) = flight::queue();
    let (progress, again) = (Progress::default(), Again::default());
    let about = About::new(printed, &loaded);
    let telemetry = Telemetry {
        consumer,
        dump: dump.clone(),
        flight: Recorder::new(&config, about, rate_hz),
        notifier: Notifier::new(
            service,
            period,
            progress.clone(),
            stop.clone(),
            again.clone(),
            Instant::now(),
        ),
        reload: Reload::new(renewal, stop.clone(), again.clone()),
        arm: loaded.scene().arm.clone(),
    };
    let recorder = telemetry.start(&config.domain)?;
    let successor = Successor::ready().map_err(Failure::Again)?;
    let is_disarmed = arguments.again.is_some() || unclean.is_some() || stop_file.is_asked();
    let is_armed = config.safety.armed && !is_disarmed;
    tracing::info!("{}", describe(&config, &loaded, is_armed));
    if let Some(warning) = loaded.warning() {
        tracing::warn!("{warning}");
    }
    let realtime = match config.realtime {
        Some(wanted) => realtime::enter(wanted),
        None => {
            realtime::precise_sleep();
            RealTime::default()
        }
    };
    let pace = Pace {
        clock: config.clock,
        period_ns,
        margin_ns: config.margin_ns,
        realtime,
    };
    let world = Machine::new(ports, stop_file, producer, dump, &control);
    let mut cycle = Cycle::new(pace, world, control);
    let panicked = Panicked::in_this_thread();
    let outcome = {
        let turn = || cycle.turn(&stop, arguments.cycles, || progress.advance());
        catch_unwind(AssertUnwindSafe(turn))
    };
    // Whatever happened, the last word is zero.
    let stopped = catch_unwind(AssertUnwindSafe(|| cycle.stop()));
    let (Ok(outcome), Ok(stopped)) = (outcome, stopped) else {
        panicked.end(cycle, recorder, log);
    };
    drop(std::panic::take_hook());
    instance.presence.has_consent = cycle.has_consent();
    let veto = cycle.veto();
    let is_again = again.is_asked();
    drop(cycle);
    let machine = Report {
        realtime: realtime.0,
        stack_used_bytes: config.realtime.map_or(0, |_| stack::used()),
        locked_kib: realtime::status_kib("VmLck").unwrap_or(0),
        ..Report::default()
    };
    let reported =
        recorded(recorder.join()).and_then(|summary| report(arguments, &summary, machine, &log));
    // Who asked to stop meanwhile wins.
    let is_ended = !is_again || stop.last_signal().map_err(Failure::Signals)?;
    instance.presence.is_followed =
        !is_ended && outcome.is_ok() && stopped.is_ok() && reported.is_ok();
    // The ports are closed: the next one may come.
    match published {
        // It compares.
        Some(published) if instance.presence.is_followed => published.leave(),
        published => drop(published),
    }
    drop(instance);
    outcome.map_err(|source| Failure::Send {
        most: MOST_FAILURES,
        source,
    })?;
    stopped.map_err(|source| Failure::Send { most: 1, source })?;
    reported?;
    if is_ended {
        return Ok(None);
    }
    Ok(Some((successor, veto, again)))
}

/// Leaves scene and configuration in the domain, where viewers and recorders find them. They do
/// without if these cannot be written.
fn publish(loaded: &Loaded, config: &str, domain: &Path) -> Option<Published> {
    let published = Published::write(&loaded.files, config, domain);
    let warn = |error: &std::io::Error| {
        let domain = domain.display();
        tracing::warn!(%error, "{domain}: viewers lack scene and configuration: {error}");
    };
    published.inspect_err(warn).ok()
}

/// What the recorder's thread left when it ended; a panic of it is a failure of the daemon.
fn recorded(ended: std::thread::Result<Summary>) -> Result<Summary, Failure> {
    ended.map_err(|_| RecorderError::Died.into())
}

/// Writes the report of the run to the log and to the file of `--report`.
fn report(
    arguments: &Arguments,
    summary: &Summary,
    machine: Report,
    log: &Log,
) -> Result<(), Failure> {
    summary.log_end();
    let Some(path) = &arguments.report else {
        return Ok(());
    };
    let report = Report {
        realtime: machine.realtime,
        stack_used_bytes: machine.stack_used_bytes,
        locked_kib: machine.locked_kib,
        lost_lines: log.lost(),
        ..summary.report()
    };
    Ok(report.write(path)?)
}

/// What runs, in one line.
fn describe(config: &Config, loaded: &Loaded, is_armed: bool) -> String {
    let settings = &loaded.settings;
    let memory = match (&config.memory, &loaded.memory) {
        (Some(path), Some(memory)) => format!("{} ({} bytes)", path.display(), memory.size()),
        _ => "none".to_owned(),
    };
    let rate = match config.clock {
        ClockMode::Fixed | ClockMode::Phase => {
            format!(" at {} Hz", loaded.scene().camera.rate_hz)
        }
        ClockMode::Lockstep => String::new(),
    };
    format!(
        "scene {}, strategy {}, np {}, memory {memory}, clock {}{rate}, domain {}, {}",
        config.scene.display(),
        settings.strategy,
        settings.np,
        config.clock,
        config.domain.display(),
        match is_armed {
            true => "armed",
            false => "disarmed",
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recorder_that_died_is_a_failure_of_the_daemon() {
        let panics = || -> Summary { std::panic::resume_unwind(Box::new("as if it panicked")) };
        let failure = recorded(std::thread::spawn(panics).join()).unwrap_err();
        assert_eq!(failure.exit(), Exit::Software);
        assert!(failure.to_string().contains("before the loop"), "{failure}");
        assert!(recorded(Ok(Summary::default())).is_ok());
    }
}
