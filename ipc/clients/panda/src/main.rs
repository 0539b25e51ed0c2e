//! `vpc-panda`: the bridge as a process.

use std::fmt::Display;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use heap_meter::Meter;
use program::Exit;
use vpc_panda::config::{Arguments, Config};
use vpc_panda::drive::{DriveError, Event, drive};
use vpc_panda::first_motion::{FirstMotionError, first_motion};
use vpc_panda::{look, robot};

// Counts what the loop allocates, which is nothing.
#[global_allocator]
static METER: Meter = Meter;

/// The program's name, for messages.
const NAME: &str = "vpc-panda";
/// Events that wait for the log.
const QUEUE: usize = 256;
/// Longest time from a signal to the end: it brakes, ends the motion, and waits for the robot to
/// say that it is idle.
const LAST: Duration = Duration::from_secs(3);
/// How often the log looks.
const LOOK: Duration = Duration::from_millis(20);
/// Between two lines about the same thing.
const SELDOM: Duration = Duration::from_secs(1);

fn main() -> ExitCode {
    begin().unwrap_or_else(|code| code)
}

fn begin() -> Result<ExitCode, ExitCode> {
    let matches = program::arguments::<Arguments>()?;
    program::log("info");
    let config = Config::load(&matches).map_err(|error| Exit::from(&error).say(NAME, error))?;
    let unavailable = |error| Exit::Unavailable.say(NAME, error);
    let stop = program::stop_on_signals().map_err(unavailable)?;
    program::end_within(LAST, &stop, NAME).map_err(unavailable)?;
    std::thread::spawn(end_if_it_hangs);
    let words = |error: &dyn Display| error.to_string();
    let is_asked = |flag: &str| matches.get_flag(flag);
    let looked_at = if is_asked("dry_run") {
        Some(look::dry_run(&config, &stop).map_err(|error| words(&error)))
    } else if is_asked("preflight") {
        Some(look::preflight(&config, &stop).map_err(|error| words(&error)))
    } else if is_asked("first_motion") {
        match first_motion(&config, is_asked("yes"), &stop) {
            Err(error @ (FirstMotionError::NotConfirmed | FirstMotionError::Stopped)) => {
                return Ok(Exit::Attention.say(NAME, error));
            }
            found => Some(found.map_err(|error| words(&error))),
        }
    } else {
        None
    };
    Ok(match looked_at {
        None => run(config, &stop),
        Some(Ok(is_good)) => ExitCode::from(u8::from(!is_good)),
        Some(Err(error)) => Exit::Unavailable.say(NAME, error),
    })
}

/// A robot without commands stops by itself.
fn end_if_it_hangs() {
    loop {
        std::thread::sleep(LOOK);
        if let Some(why) = robot::hangs() {
            eprintln!("{NAME}: {why}: ended");
            std::process::exit(Exit::Unavailable as i32);
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
            return Exit::Unavailable.say(NAME, format_args!("no thread: {error}"));
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
        Ok(Err(error @ DriveError::NotIdle { .. })) => Exit::Attention.say(NAME, error),
        Ok(Err(error)) => Exit::Unavailable.say(NAME, error),
        Err(_) => {
            let defect = "a defect; the robot stops by itself without commands";
            Exit::Software.say(NAME, defect)
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
