//! The daemon from its command line to its exit code.

use std::ffi::OsString;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use ipc::{ClockMode, ControllerPorts, Domain, RealTime};

use crate::arguments::{Arguments, Command};
use crate::config::{self, Config, ConfigError};
use crate::cycle::{Cycle, Pace};
use crate::exit::Exit;
use crate::flight::{self, Recorder};
use crate::instance::{Instance, InstanceError};
use crate::law::{Law, LawError};
use crate::preflight::Facts;
use crate::realtime::Wish;
use crate::report::{Report, ReportError};
use crate::service::{Progress, Service, ServiceError, Talk};
use crate::shutdown::{Hangup, Stop};
use crate::supervisor::Rules;
use crate::telemetry::{self, RecorderError, Summary};
use crate::{log, preflight, realtime, stack};

/// Failures to send in a row after which the daemon gives up: a broken segment does not mend itself.
const MOST_FAILURES: u32 = 30;
/// Priority that the preflight asks about where no configuration names one.
const PRIORITY: i32 = 80;

/// Why the daemon ended other than by being asked to.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Scene, memory or law.
    #[error(transparent)]
    Law(#[from] LawError),
    /// The domain.
    #[error(transparent)]
    Join(#[from] ipc::JoinError),
    /// Another daemon at work.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// The environment of a service.
    #[error(transparent)]
    Service(#[from] ServiceError),
    /// The ports.
    #[error(transparent)]
    Open(#[from] ipc::OpenError),
    /// The recorder.
    #[error(transparent)]
    Recorder(#[from] RecorderError),
    /// The report.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The log.
    #[error("log: {0}")]
    Log(std::io::Error),
    /// The signal handlers.
    #[error("signal handlers: {0}")]
    Signals(std::io::Error),
    /// Commands cannot be sent.
    #[error("{most} commands in a row could not be sent; the last: {source}")]
    Send {
        /// How many.
        most: u32,
        /// The last failure.
        source: ipc::PublishError,
    },
}

impl Failure {
    /// The exit code that it asks for.
    pub fn exit(&self) -> Exit {
        match self {
            Self::Config(error) => error.into(),
            Self::Law(error) => error.exit(),
            Self::Join(_) | Self::Instance(_) | Self::Open(_) => Exit::Unavailable,
            Self::Service(_) => Exit::Config,
            Self::Report(_) => Exit::CannotCreate,
            Self::Recorder(RecorderError::Join(_) | RecorderError::Open(_)) => Exit::Unavailable,
            Self::Recorder(_) | Self::Log(_) | Self::Signals(_) | Self::Send { .. } => {
                Exit::Software
            }
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
    if arguments.preflight {
        return preflight(&arguments);
    }
    if arguments.print_config {
        return print_config(&arguments);
    }
    if let Some(Command::Replay(arguments)) = &arguments.command {
        return flight::command::run(arguments).into();
    }
    match run(&arguments) {
        Ok(()) => Exit::Ok.into(),
        Err(failure) => {
            log::complain(&failure.to_string());
            if let Ok(service) = Service::by_environment(Duration::ZERO) {
                service.leave(&failure.to_string());
            }
            failure.exit().into()
        }
    }
}

/// Prints the configuration that would run.
fn print_config(arguments: &Arguments) -> ExitCode {
    match Config::print(arguments) {
        Ok(text) => {
            print!("{text}");
            Exit::Ok.into()
        }
        Err(error) => {
            log::complain(&error.to_string());
            Exit::from(&error).into()
        }
    }
}

/// Tells what the machine lacks for the loop of this configuration; for a usual one where none is given.
fn preflight(arguments: &Arguments) -> ExitCode {
    let usual = Wish {
        priority: PRIORITY,
        cpu: None,
    };
    let wish = match &arguments.config {
        Some(_) => match Config::read(arguments) {
            Ok(config) => config.realtime.unwrap_or(usual),
            Err(error) => {
                log::complain(&error.to_string());
                return Exit::from(&error).into();
            }
        },
        None => usual,
    };
    let found = preflight::judge(&Facts::gather(wish), wish);
    if arguments.json {
        println!("{}", serde_json::json!(found));
    } else {
        println!("{found}");
    }
    if found.fit { Exit::Ok } else { Exit::No }.into()
}

/// Checks everything, then runs the loop in this thread.
///
/// # Errors
/// [`Failure`] names what is wrong.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    // First of all: a hang-up while the memory is read must not kill.
    let stop = Stop::by_signals().map_err(Failure::Signals)?;
    let hangup = Hangup::by_signal().map_err(Failure::Signals)?;
    let wish = flight::Wish::by_signal().map_err(Failure::Signals)?;
    let config = Config::read(arguments)?;
    let law = Law::open(&config.scene, config.memory.as_deref(), config.settings)?;
    Recorder::check_room(
        &config.flight,
        law.scene().camera.rate_hz,
        realtime::memory_bytes(),
        config::named(arguments),
    )?;
    if arguments.check_only {
        println!("{}", describe(&config, &law));
        return Ok(());
    }
    let period = Duration::from_nanos(pace(&config, &law).period_ns);
    let service = Service::by_environment(period)?;
    let log = log::start(&config).map_err(Failure::Log)?;
    let domain = Domain::join(&config.domain)?;
    let instance = Instance::claim(domain.directory())?;
    let ports = ControllerPorts::open(&domain)?;
    let (tap, tail) = flight::tap::tap(wish);
    let flight = Recorder::new(&config, &law);
    let progress = Progress::default();
    let talk = Talk::new(service, period, progress.clone(), stop.clone(), hangup);
    let recorder = telemetry::start(&config.domain, tail, talk, flight)?;
    tracing::info!("{}", describe(&config, &law));
    let realtime = match config.realtime {
        Some(wish) => realtime::enter(wish),
        None => {
            realtime::precise_sleep();
            RealTime::default()
        }
    };
    let mut pace = pace(&config, &law);
    pace.realtime = realtime;
    let mut cycle = Cycle::new(pace, ports, law, tap);
    let outcome = turn(&mut cycle, &stop, &progress, arguments.cycles);
    // Whatever happened, the last word is zero.
    let stopped = cycle.stop();
    drop(cycle);
    let stack_used_bytes = config.realtime.map_or(0, |_| stack::used());
    let locked_kib = realtime::status_kib("VmLck").unwrap_or(0);
    let reported = recorded(recorder.join()).and_then(|summary| {
        summary.tell();
        let Some(path) = &arguments.report else {
            return Ok(());
        };
        let report = Report {
            realtime: realtime.0,
            stack_used_bytes,
            locked_kib,
            lost_lines: log.lost(),
            ..summary.report()
        };
        Ok(report.write(path)?)
    });
    // The ports are closed: the next one may come.
    drop(instance);
    outcome?;
    stopped.map_err(|source| Failure::Send { most: 1, source })?;
    reported
}

/// What the recorder's thread left when it ended; a panic of it is a failure of the daemon.
fn recorded(ended: std::thread::Result<Summary>) -> Result<Summary, Failure> {
    ended.map_err(|_| RecorderError::Died.into())
}

/// Runs cycles until asked to stop, and then until the camera stands; in lockstep, where nothing moves between
/// messages, no longer.
fn turn(
    cycle: &mut Cycle,
    stop: &Stop,
    progress: &Progress,
    most: Option<u64>,
) -> Result<(), Failure> {
    let mut failures = 0;
    let mut left = cycle.braking_cycles();
    loop {
        let is_over = most.is_some_and(|most| cycle.count() >= most);
        // Without telemetry, log and watchdog nobody would know what the camera does.
        if is_over || cycle.is_unheard() {
            stop.ask();
        }
        if stop.is_asked() {
            if left == 0 || cycle.is_at_rest() {
                break;
            }
            left -= 1;
        }
        match cycle.run(stop) {
            Ok(_) => {
                failures = 0;
                progress.advance();
            }
            Err(source) => {
                failures += 1;
                if failures >= MOST_FAILURES {
                    return Err(Failure::Send {
                        most: failures,
                        source,
                    });
                }
            }
        }
    }
    Ok(())
}

/// How the loop of this configuration runs.
pub fn pace(config: &Config, law: &Law) -> Pace {
    let scene = law.scene();
    let period_ns = (scene.sampling_time() * 1e9) as u64;
    let ns = |seconds: f64| (seconds * 1e9) as u64;
    // Never before the command has gone stale and a brake has had time to begin.
    let least_ns = ns((config.stale_periods + 2.0) * scene.sampling_time());
    let (linear, angular) = (scene.limits.linear, scene.limits.angular);
    let is_lockstep = config.clock == ClockMode::Lockstep;
    let rules = Rules {
        limits: [linear, linear, linear, angular, angular, angular],
        brake_ns: if is_lockstep {
            0
        } else {
            ns(config.safety.brake_s)
        },
        lost_ns: (!is_lockstep).then(|| ns(config.safety.lost_s).max(least_ns)),
        armed: config.safety.armed,
    };
    Pace {
        clock: config.clock,
        period_ns,
        stale_periods: config.stale_periods,
        rules,
        margin_ns: config.margin_ns,
        realtime: RealTime::default(),
    }
}

/// What runs, in one line.
fn describe(config: &Config, law: &Law) -> String {
    let settings = law.settings();
    let memory = match (&config.memory, law.memory()) {
        (Some(path), Some(memory)) => format!("{} ({} bytes)", path.display(), memory.size()),
        _ => "none".to_owned(),
    };
    let clock = match config.clock {
        ClockMode::Fixed => format!("fixed at {} Hz", law.scene().camera.rate_hz),
        ClockMode::Phase => format!("phase at {} Hz", law.scene().camera.rate_hz),
        ClockMode::Lockstep => "lockstep".to_owned(),
    };
    let armed = if config.safety.armed {
        "armed"
    } else {
        "disarmed"
    };
    format!(
        "scene {}, strategy {}, np {}, memory {memory}, clock {clock}, domain {}, {armed}",
        config.scene.display(),
        settings.strategy,
        settings.np,
        config.domain.display(),
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
