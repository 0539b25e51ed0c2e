//! `vpc-panda`: the bridge as a process.

use std::fmt::Display;
use std::io::IsTerminal;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use clap::CommandFactory;
use heap_meter::Meter;
use signal_hook::consts::{SIGINT, SIGTERM};
use tracing_subscriber::EnvFilter;
use vpc_panda::config::{Arguments, Config};
use vpc_panda::drive::{DriveError, Event, drive};
use vpc_panda::first_motion::{FirstMotionError, first_motion};
use vpc_panda::look;

// Counts what the loop allocates, which is nothing.
#[global_allocator]
static METER: Meter = Meter;

const USAGE: u8 = 64;
const ATTENTION: u8 = 1;
const UNAVAILABLE: u8 = 69;
const SOFTWARE: u8 = 70;

/// Events that wait for the log.
const QUEUE: usize = 256;
/// How often the log looks.
const LOOK: Duration = Duration::from_millis(20);
/// Between two lines about the same thing.
const SELDOM: Duration = Duration::from_secs(1);

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
    let filter = EnvFilter::try_from_env("VPC_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    let log = tracing_subscriber::fmt().with_env_filter(filter);
    log.with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .init();
    let config = match Config::load(&matches) {
        Ok(config) => config,
        Err(error) => {
            eprintln!("vpc-panda: {error}");
            return ExitCode::from(error.exit_code());
        }
    };
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // The second one ends the process where it is, and the robot stops by itself.
        let second = signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop));
        let first = second.and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop)));
        if let Err(error) = first {
            eprintln!("vpc-panda: signal {signal}: {error}");
            return ExitCode::from(UNAVAILABLE);
        }
    }
    let words = |error: &dyn Display| error.to_string();
    let is_asked = |flag: &str| matches.get_flag(flag);
    let looked_at = if is_asked("dry_run") {
        Some(look::dry_run(&config, &stop).map_err(|error| words(&error)))
    } else if is_asked("preflight") {
        Some(look::preflight(&config, &stop).map_err(|error| words(&error)))
    } else if is_asked("first_motion") {
        match first_motion(&config, is_asked("yes"), &stop) {
            Err(error @ (FirstMotionError::NotConfirmed | FirstMotionError::Stopped)) => {
                eprintln!("vpc-panda: {error}");
                return ExitCode::from(ATTENTION);
            }
            found => Some(found.map_err(|error| words(&error))),
        }
    } else {
        None
    };
    match looked_at {
        None => run(config, &stop),
        Some(Ok(is_good)) => ExitCode::from(u8::from(!is_good)),
        Some(Err(error)) => {
            eprintln!("vpc-panda: {error}");
            ExitCode::from(UNAVAILABLE)
        }
    }
}

fn run(config: Config, stop: &Arc<AtomicBool>) -> ExitCode {
    let (mut sender, mut events) = rtrb::RingBuffer::new(QUEUE);
    let stopping = Arc::clone(stop);
    let driver = std::thread::Builder::new()
        .name("drive".to_owned())
        .spawn(move || drive(&config, &stopping, &mut sender));
    let driver = match driver {
        Ok(driver) => driver,
        Err(error) => {
            eprintln!("vpc-panda: no thread: {error}");
            return ExitCode::from(UNAVAILABLE);
        }
    };
    let mut log = Log::default();
    loop {
        let is_over = driver.is_finished();
        while let Ok(event) = events.pop() {
            log.tell(&event);
        }
        if is_over {
            break;
        }
        std::thread::sleep(LOOK);
    }
    match driver.join() {
        Ok(Ok(())) => {
            tracing::info!("stopped; the arm stands");
            ExitCode::SUCCESS
        }
        Ok(Err(error @ DriveError::NotIdle { .. })) => {
            eprintln!("vpc-panda: {error}");
            ExitCode::from(ATTENTION)
        }
        Ok(Err(error)) => {
            eprintln!("vpc-panda: {error}");
            ExitCode::from(UNAVAILABLE)
        }
        Err(_) => {
            eprintln!("vpc-panda: a defect; the robot stops by itself without commands");
            ExitCode::from(SOFTWARE)
        }
    }
}

/// The log, in which what comes in every millisecond stands once a second.
#[derive(Default)]
struct Log {
    limited: Option<Instant>,
    not_obeyed: Option<Instant>,
}

impl Log {
    fn tell(&mut self, event: &Event) {
        let is_due = |last: &mut Option<Instant>| {
            let is_due = last.is_none_or(|last| last.elapsed() > SELDOM);
            if is_due {
                *last = Some(Instant::now());
            }
            is_due
        };
        match event {
            Event::Connected(model) => tracing::info!("connected: {model}"),
            Event::Lacks(what) => tracing::warn!("DEGRADED, not real time: {what}"),
            Event::Over(report) => tracing::info!(
                answered = report.answered,
                lost = report.lost,
                least_rate = report.least_rate,
                allocations = report.allocations,
                "motion over"
            ),
            Event::Moves => tracing::info!("the robot follows vpc/twist"),
            Event::Refused(why) => tracing::warn!("no motion: {why}"),
            Event::Stopped(why) => {
                tracing::error!("the robot stopped: {why}; clear it with: vpcctl recover");
            }
            Event::Waits => tracing::warn!(
                "a twist is in force already: it is not carried out before it was zero, or ended"
            ),
            Event::Recovered => tracing::info!("the robot's errors are cleared"),
            Event::NotRecovered(why) => tracing::error!("the robot's errors stand: {why}"),
            Event::NotObeyed(why) if is_due(&mut self.not_obeyed) => {
                tracing::warn!("vpc/twist is not obeyed: {why}");
            }
            Event::Limited(limited) if is_due(&mut self.limited) => {
                for (is_so, what) in [
                    (limited.is_cut, "longer than linear or angular allow"),
                    (limited.by_workspace, "a wall of the workspace is near"),
                    (limited.by_joint, "a joint is near its margin or too fast"),
                ] {
                    if is_so {
                        tracing::warn!("the command is not carried out in full: {what}");
                    }
                }
            }
            Event::NotObeyed(_) | Event::Limited(_) => (),
        }
    }
}
