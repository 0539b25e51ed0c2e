//! `visit`: the goals of several scenes, one after the other.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use memory_blob::MemoryFile;
use messages::{Action, Outcome, TwistState};
use program::Exit;
use scene::SceneFiles;

use crate::failure::Failure;
use crate::status::Status;
use crate::take_up::{self, Daemon, with_suffix};
use crate::units::seconds;
use crate::watcher::Watcher;
use crate::{output, request};

/// How long a daemon that has begun again may take until it sees camera and robot.
const PATIENCE: Duration = Duration::from_secs(3);
/// How long it may take to answer.
const ANSWER: Duration = Duration::from_secs(2);
/// Between two looks.
const PAUSE: Duration = Duration::from_millis(10);

/// The command line of `visit`.
#[derive(Clone, Debug, Args)]
pub struct VisitArguments {
    /// The scenes, in this order; beside each its memory of motion, NAME.vpcmem, if the daemon has
    /// one. Files that a scene names must lie beside the daemon's scene.
    #[arg(value_name = "FILE", required = true)]
    pub scenes: Vec<PathBuf>,

    /// Take up what differs from the daemon's scene in this key or table, such as `limits`; may be
    /// repeated. Goal and starts may differ in any case.
    #[arg(long, value_name = "KEY")]
    pub accept: Vec<String>,

    /// Arm in spite of this stop, as `arm --veto`.
    #[arg(long, value_name = "NUMBER")]
    pub veto: Option<u32>,

    /// How long the way to a goal may take, 0.05 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value = "120", value_parser = seconds)]
    pub within: Duration,
}

/// Lets the daemon take up each scene, arms it, and waits until the camera has arrived. Says so for
/// each. `asked_ns` is when the operator asked, CLOCK_MONOTONIC.
///
/// # Errors
/// As [`Daemon`]. A stop or a disarm since then ends the visit. Where a goal is not reached in
/// time, or a signal ends it, the daemon is disarmed.
pub fn visit(directory: &Path, with: &VisitArguments, asked_ns: u64) -> Result<Exit, Failure> {
    let stop = program::stop_on_signals()?;
    let _turn = take_up::turn(directory)?;
    // Before anything moves: wrong files are refused, and one may be the daemon's own.
    let daemon = Daemon::of(directory)?;
    let goals = with.scenes.iter().map(|path| Goal::read(path, &daemon));
    let goals: Vec<_> = goals.collect::<Result<_, _>>()?;
    for goal in &goals {
        daemon
            .check(goal.scene.clone(), &with.accept)
            .map_err(|failure| Failure::new(failure.exit, format!("{}: {failure}", goal.name)))?;
    }
    let known = request::known(directory, with.veto, asked_ns, ANSWER)?;
    for (number, goal) in goals.iter().enumerate() {
        let daemon = Daemon::of(directory)?;
        let scene = next(goal.scene.as_bytes(), &daemon.scene)?;
        let files = goal.memory.as_deref().zip(daemon.memory.as_deref());
        let memory = files.map(|(bytes, place)| next(bytes, place)).transpose()?;
        daemon.take_up(&scene, memory.as_deref(), number == 0, &with.accept, &stop)?;
        let begin = arm(directory, &daemon, known, &stop)?;
        arrive(directory, begin, with.within, &stop).map_err(|failure| {
            let message = format!("{}: {failure}", goal.name);
            Failure::new(failure.exit, message)
        })?;
        let seconds = begin.elapsed().as_secs_f64();
        output::write(&format!("arrived at {} after {seconds:.1} s\n", goal.name))?;
    }
    Ok(Exit::Ok)
}

/// A goal to visit.
struct Goal<'a> {
    /// The file of the scene.
    name: std::path::Display<'a>,
    /// What is in it.
    scene: String,
    /// What is in its memory, if the daemon has one.
    memory: Option<Vec<u8>>,
}

impl<'a> Goal<'a> {
    fn read(path: &'a Path, daemon: &Daemon) -> Result<Self, Failure> {
        let scene = SceneFiles::read(path)?.text;
        let memory = path.with_extension("vpcmem");
        let to_build = |failure: Failure| match memory.exists() {
            true => failure,
            false => {
                let (name, memory) = (path.display(), memory.display());
                let message = format!("{failure}: vpc-memory build {name} -o {memory} makes it");
                Failure::new(failure.exit, message)
            }
        };
        let of_memory = || {
            let read = MemoryFile::read(&memory);
            read.map_err(|error| to_build(Failure::new(Exit::NoInput, error)))
        };
        Ok(Self {
            name: path.display(),
            scene,
            memory: daemon.memory.is_some().then(of_memory).transpose()?,
        })
    }
}

/// A file of these bytes in the folder of the one that it will replace.
fn next(bytes: &[u8], place: &Path) -> Result<PathBuf, Failure> {
    let to = with_suffix(place, ".next");
    fs::write(&to, bytes).map_err(Failure::write(&to))?;
    Ok(to)
}

/// Arms in spite of the veto that is `known`, as soon as the daemon sees camera and robot; when
/// that was. Another veto is not armed over.
fn arm(
    directory: &Path,
    daemon: &Daemon,
    known: u32,
    stop: &AtomicBool,
) -> Result<Instant, Failure> {
    let end = Instant::now() + PATIENCE;
    loop {
        if stop.load(Ordering::Relaxed) || !daemon.is_at_work() {
            let message = "the visit, or the daemon, was ended; disarmed";
            return Err(Failure::new(Exit::Attention, message));
        }
        let reply = request::send(directory, &request::arm(known), ANSWER);
        let reply = match reply {
            // It begins.
            Err(_) if Instant::now() < end => None,
            reply => Some(reply?),
        };
        let outcome = reply.as_ref().and_then(messages::Reply::outcome);
        match (outcome, reply) {
            (Some(Outcome::Done), _) => return Ok(Instant::now()),
            (Some(Outcome::Vetoed), Some(reply)) => return Err(refused(&reply)),
            (_, Some(reply)) if Instant::now() >= end => return Err(refused(&reply)),
            _ => std::thread::sleep(PAUSE),
        }
    }
}

fn refused(reply: &messages::Reply) -> Failure {
    Failure::new(Exit::Refused, request::outcome(reply).0.trim_end())
}

/// Waits until the camera has arrived.
fn arrive(
    directory: &Path,
    begin: Instant,
    within: Duration,
    stop: &AtomicBool,
) -> Result<(), Failure> {
    let armed_ns = ipc::now_ns();
    let mut watcher = Watcher::open(directory)?;
    let mut status = Status::new(&watcher);
    while begin.elapsed() < within && !stop.load(Ordering::Relaxed) {
        status.update(&mut watcher)?;
        let latest = status.view.latest();
        let latest = latest.filter(|record| record.stamp.published_ns > armed_ns);
        match latest.and_then(|record| TwistState::from_code(record.state)) {
            Some(TwistState::Arrived) => return Ok(()),
            Some(TwistState::Disarmed) => {
                let (state, cause, _) = status.headline();
                let message = format!("{state}: {}", cause.unwrap_or_default());
                return Err(Failure::new(Exit::Attention, message));
            }
            _ => std::thread::sleep(PAUSE),
        }
    }
    request::send(directory, &request::plain(Action::Disarm), ANSWER)?;
    let seconds = within.as_secs_f64();
    let message = match stop.load(Ordering::Relaxed) {
        true => "ended by a signal; disarmed".to_owned(),
        false => format!("not arrived within {seconds} s; disarmed"),
    };
    Err(Failure::new(Exit::Attention, message))
}
