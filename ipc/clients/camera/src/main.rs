//! `vpc-camera`: from images to features, as a process.

use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use clap::FromArgMatches;
use program::{Exit, StartUp, publish};
use vpc_camera::config::{Arguments, Command, Config};
use vpc_camera::metrics::Metrics;
use vpc_camera::run::{Event, Report, run};
use vpc_camera::{mask, pattern, sheet};

/// The program's name, for messages.
const NAME: &str = "vpc-camera";
/// How often the log looks.
const LOOK: Duration = Duration::from_millis(100);
/// Between two lines about the same thing.
const SELDOM: Duration = Duration::from_secs(10);
/// Between two files of metrics.
const METRICS: Duration = Duration::from_secs(1);
/// Silence after which the log says that no image comes.
const SILENCE: Duration = Duration::from_secs(2);

fn main() -> ExitCode {
    begin().unwrap_or_else(|code| code)
}

fn begin() -> Result<ExitCode, ExitCode> {
    let matches = program::arguments::<Arguments>()?;
    program::log("info");
    let command = Arguments::from_arg_matches(&matches).map(|arguments| arguments.command);
    match command {
        Ok(Some(Command::Mask(arguments))) => return Ok(end("mask", mask::run(&arguments))),
        Ok(Some(Command::Tags(arguments))) => return Ok(end("tags", sheet::run(&arguments))),
        Ok(Some(Command::Pattern(arguments))) => {
            return Ok(end("pattern", pattern::run(&arguments)));
        }
        _ => {}
    }
    let config = Config::load(&matches).map_err(|error| Exit::from(&error).say(NAME, error))?;
    let unavailable = |error| Exit::Unavailable.say(NAME, error);
    let start_up = StartUp::begin().map_err(unavailable)?;
    let stop = program::stop_on_signals().map_err(unavailable)?;
    Ok(watch(config, start_up, stop, matches.get_flag("print")))
}

/// Tells what a command did.
fn end(command: &str, result: anyhow::Result<String>) -> ExitCode {
    match result {
        Ok(words) => {
            print!("{words}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            let name = format!("{NAME} {command}");
            Exit::Attention.say(&name, format_args!("{error:#}"))
        }
    }
}

/// Runs the loop in a thread of its own, and tells what it does.
fn watch(config: Config, start_up: StartUp, stop: Arc<AtomicBool>, is_printed: bool) -> ExitCode {
    let mut log = Log::new(&config, is_printed);
    let (sender, events) = mpsc::channel();
    let body = move || run(&config, start_up, &stop, &sender);
    let worker = std::thread::Builder::new()
        .name("camera".to_owned())
        .spawn(body);
    let worker = match worker {
        Ok(worker) => worker,
        Err(error) => {
            return Exit::Unavailable.say(NAME, format_args!("no thread: {error}"));
        }
    };
    loop {
        match events.recv_timeout(LOOK) {
            Ok(event) => log.tell(&event),
            Err(RecvTimeoutError::Timeout) => log.look(),
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    log.end();
    match worker.join() {
        Ok(Ok(())) => ExitCode::SUCCESS,
        Ok(Err(error)) => Exit::Unavailable.say(NAME, error),
        Err(_) => Exit::Software.say(NAME, "a defect; without features vpcd stops the camera"),
    }
}

/// What the program tells, each thing at most every few seconds.
struct Log {
    metrics: Metrics,
    file: Option<std::path::PathBuf>,
    is_printed: bool,
    written: Instant,
    summed: Instant,
    seen: Instant,
    is_silent: bool,
    misplaced: Option<Instant>,
    missized: Option<Instant>,
}

impl Log {
    fn new(config: &Config, is_printed: bool) -> Self {
        let now = Instant::now();
        Self {
            metrics: Metrics::new(config.targets.numbers()),
            file: config.metrics.clone(),
            is_printed,
            written: now,
            summed: now,
            seen: now,
            is_silent: false,
            misplaced: None,
            missized: None,
        }
    }

    fn tell(&mut self, event: &Event) {
        match event {
            Event::Lacks(what) => tracing::warn!("DEGRADED, not real time: {what}"),
            Event::Mask(warning) => tracing::warn!("{warning}"),
            Event::Size { found, expected } => self.size(*found, *expected),
            Event::Frame(report) => self.frame(report),
        }
        self.look();
    }

    fn frame(&mut self, report: &Report) {
        if self.is_silent || self.metrics.frames == 0 {
            tracing::info!("images are coming");
        }
        (self.seen, self.is_silent) = (Instant::now(), false);
        self.metrics.add(report);
        if self.is_printed {
            print(report);
        }
        if let Some((number, px)) = report.found.misplaced
            && is_due(&mut self.misplaced)
        {
            tracing::warn!(
                "tag {number} is {px:.0} px from where the scene's pattern has it, beside the others: is the pattern that of \
                 the scene, is marker_size its size with the white border, are there other tags of these numbers?"
            );
        }
    }

    fn size(&mut self, [width, height]: [usize; 2], [w, h]: [usize; 2]) {
        if is_due(&mut self.missized) {
            tracing::warn!(
                "an image of {width} x {height} px is passed over; allowed: {w} x {h} px, the size of the scene's camera"
            );
        }
    }

    fn look(&mut self) {
        if !self.is_silent && self.seen.elapsed() > SILENCE {
            self.is_silent = true;
            tracing::warn!("no image for {} s", SILENCE.as_secs());
        }
        if self.summed.elapsed() > SELDOM && self.metrics.frames > 0 {
            self.summed = Instant::now();
            tracing::info!("{}", self.metrics.line());
        }
        if self.written.elapsed() > METRICS {
            self.write();
        }
    }

    fn write(&mut self) {
        self.written = Instant::now();
        if let Some(path) = &self.file
            && let Err(error) = publish(path, self.metrics.text().as_bytes(), 0o666)
        {
            tracing::warn!("{}: {error}", path.display());
            self.file = None;
        }
    }

    fn end(&mut self) {
        self.write();
        tracing::info!("stopped: {}", self.metrics.line());
    }
}

/// Whether a line about a thing is due, of which the last came at that time.
fn is_due(last: &mut Option<Instant>) -> bool {
    let is_due = last.is_none_or(|last| last.elapsed() > SELDOM);
    if is_due {
        *last = Some(Instant::now());
    }
    is_due
}

fn print(report: &Report) {
    let mut line = format!("{} {}", report.sequence, report.data_ns);
    for (bit, [u, v]) in report.found.points.iter().enumerate() {
        let guessed = if report.found.visible >> bit & 1 == 0 {
            "?"
        } else {
            ""
        };
        line += &format!(" ({u:.2}, {v:.2}){guessed}");
    }
    // Nobody reads it any more.
    let _ = writeln!(std::io::stdout(), "{line}");
}
