//! The loop of the process: run after run, publishes frames and states, and obeys twists.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, bail};
use ipc::{Domain, Publisher, now_ns};
use messages::{RobotState, Stamp, TwistCommand, TwistState};
use panda::Joints;
use program::StartUp;
use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute};
use scene::Pose;

use crate::cell::{Cell, Exposed, Order};
use crate::config::{Body, Clock, Config};
use crate::eye::Shot;
use crate::free::FreeCell;
use crate::late_frames::LateFrames;
use crate::lateness::Lateness;
use crate::motion::Motion;
use crate::outcome::{Outcome, Verdict};
use crate::port::Ports;
use crate::pose::to_scene;
use crate::recording::{Record, Recorder};
use crate::rig::Rig;

/// In lockstep the camera stands still if its command is older than this, or than three periods of
/// a slow camera; in real time the contract says when ([`TwistCommand::in_force_until_ns`]).
const STALE_NS: u64 = 100_000_000;
/// How long lockstep waits for a controller to come, and for each answer.
const PATIENCE: Duration = Duration::from_secs(10);
/// Most commands that are obeyed before a step: more come in a period only where that takes longer
/// than the period itself, and then frames have to go out all the same.
const COMMANDS: usize = 16;
/// How long the camera rests at the goal between two runs.
const REST_NS: u64 = 2_000_000_000;

/// SCHED_FIFO for the robot's millisecond: above ordinary processes, below vpcd's default of 80.
const PRIORITY: i32 = 70;

/// What lets the time of a run pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pace {
    /// The monotonic clock.
    RealTime,
    /// The controller, which answers each frame.
    Controller,
    /// The client of the vendor's interface, which answers each state. Time is the robot's, from 0.
    Client,
}

impl Pace {
    fn of(config: &Config) -> Self {
        match (config.clock, config.rig.arm.fci) {
            (Clock::Fixed, _) => Self::RealTime,
            (Clock::Lockstep, None) => Self::Controller,
            (Clock::Lockstep, Some(_)) => Self::Client,
        }
    }
}

/// How many runs there were.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Runs that were decided.
    pub runs: usize,
    /// Runs that arrived at the goal without a violation.
    pub arrived: usize,
}

/// Runs the configured starts one after another, until all are decided or `stop` is set; passes
/// each outcome to `tell`, with the tally. `start_up` ends when the domain is joined.
///
/// # Errors
/// The shared memory cannot be opened, a start is out of the robot's reach, nobody answers in
/// lockstep, or the recording cannot be written.
pub fn run(
    config: &Config,
    start_up: StartUp,
    stop: &AtomicBool,
    mut tell: impl FnMut(&Outcome, Tally),
) -> anyhow::Result<Tally> {
    let domain = Domain::join(&config.domain)?;
    drop(start_up);
    let mut session = Session::open(config, &domain, stop)?;
    let rounds = if config.repeat { usize::MAX } else { 1 };
    let most = config.starts.len().saturating_mul(rounds);
    let mut tally = Tally::default();
    for (run, (number, start)) in config.starts.iter().cycle().take(most).enumerate() {
        if run > 0 {
            session.rest()?;
        }
        let mut cell = session.cell(start, false)?;
        if run == 0 {
            session.announce();
        }
        if session.is_stopped() && run > 0 {
            break;
        }
        session.drive(cell.as_mut(), None)?;
        let outcome = session.outcome(*number, cell.as_mut());
        tally.runs += usize::from(outcome.verdict != Verdict::Stopped);
        tally.arrived += usize::from(outcome.is_success());
        tell(&outcome, tally);
        if config.rig.arm.fci.is_some() {
            session.go_on(cell.as_mut())?;
        }
    }
    if let Some(recorder) = session.recorder {
        recorder.finish()?;
    }
    Ok(tally)
}

/// The process's part of one run after another.
struct Session<'a> {
    config: &'a Config,
    pace: Pace,
    stop: &'a AtomicBool,
    ports: Ports,
    /// None where a client of the vendor's interface tells the states.
    robot: Option<Publisher<RobotState>>,
    recorder: Option<Recorder>,
    stale_ns: u64,
    /// When the present run began: what answers earlier features is not for it.
    since_ns: u64,
    /// The newest command.
    command: Option<TwistCommand>,
    /// Features delivered since the last exposure, px.
    measured: Option<Vec<[f64; 2]>>,
    lateness: Lateness,
    late: LateFrames,
    /// Whether a disarmed controller was told of, or is not to be.
    is_told: bool,
    /// Where the arm's last motion ended.
    joints: Option<Joints>,
}

impl<'a> Session<'a> {
    fn open(config: &'a Config, domain: &Domain, stop: &'a AtomicBool) -> anyhow::Result<Self> {
        let record = |path: &Path| {
            Recorder::create(path, &config.scene, &config.scene_file)
                .with_context(|| format!("{}: cannot record", path.display()))
        };
        let ports = Ports::open(domain, &config.scene, config.rig.eye.sight)?;
        let robot = match config.rig.arm.fci {
            Some(_) => None,
            None => Some(domain.publisher()?),
        };
        Ok(Self {
            config,
            pace: Pace::of(config),
            stop,
            ports,
            robot,
            recorder: config.record.as_deref().map(record).transpose()?,
            stale_ns: STALE_NS.max((3e9 * config.scene.sampling_time()) as u64),
            since_ns: 0,
            command: None,
            measured: None,
            lateness: Lateness::default(),
            late: LateFrames::default(),
            is_told: false,
            joints: None,
        })
    }

    fn is_live(&self) -> bool {
        self.pace == Pace::RealTime
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// A camera, and what carries it, that sees the object at `start`. One that rests never
    /// releases the object.
    fn cell(&self, start: &Pose, is_resting: bool) -> anyhow::Result<Box<dyn Cell>> {
        let Config { scene, flaws, .. } = self.config;
        // Between two runs the object rests, too.
        let (motion, follow_s) = match is_resting {
            true => (Motion::default(), 0.0),
            false => (self.config.motion.clone(), self.config.follow_s),
        };
        Ok(match self.config.robot {
            Body::Free => {
                let limit_s = match is_resting {
                    true => f64::INFINITY,
                    false => self.config.rig.time_limit_s,
                };
                let cell = FreeCell::new(scene, start, *flaws, limit_s);
                Box::new(cell.follow(motion, follow_s))
            }
            Body::Panda | Body::Urdf => {
                let mut settings = self.config.rig;
                if is_resting {
                    settings.sequence.dwell_ns = u64::MAX;
                }
                // The arm is driven there from where it stands.
                settings.arm.joints = self.joints.and_then(|from| {
                    let driven = settings.arm.driven(&from, start);
                    driven
                        .inspect_err(|error| {
                            eprintln!("hw-sim: the arm is placed anew: {error}");
                        })
                        .ok()
                });
                Box::new(Rig::new(scene, start, &settings)?.follow(motion, follow_s))
            }
        })
    }

    /// Says that features go out: otherwise nothing is seen of a run that begins when somebody
    /// arms.
    fn announce(&self) {
        if self.pace != Pace::Controller {
            eprintln!(
                "hw-sim: {} go out in domain {}; the run begins when vpcd is armed",
                self.ports.what(),
                self.config.domain.display()
            );
            if self.is_live() && self.config.robot.is_robot() {
                // Where it is not permitted, milliseconds begin later: the outcome's lateness.
                let _ = program::take_fifo(PRIORITY);
            }
        }
    }

    /// The camera rests at the goal for a while, obeying the controller. In lockstep time does not
    /// pass between runs.
    fn rest(&mut self) -> anyhow::Result<()> {
        if self.is_live() {
            let mut cell = self.cell(&self.config.scene.goal, true)?;
            self.drive(cell.as_mut(), Some(REST_NS))?;
        }
        Ok(())
    }

    /// Steps a cell from now on until its run is decided, or for a while.
    fn drive(&mut self, cell: &mut dyn Cell, rest_ns: Option<u64>) -> anyhow::Result<()> {
        self.since_ns = match self.pace {
            Pace::Client => 0,
            Pace::RealTime | Pace::Controller => now_ns(),
        };
        (self.command, self.measured) = (None, None);
        (self.lateness, self.late) = Default::default();
        self.is_told = rest_ns.is_some() || !self.is_live();
        cell.begin(self.since_ns);
        let end_ns = rest_ns.map(|rest_ns| self.since_ns + rest_ns);
        let is_over = |cell: &mut dyn Cell| match end_ns {
            Some(end_ns) => cell.due_ns() >= end_ns,
            None => cell.progress().end.is_some(),
        };
        while !is_over(cell) && !self.is_stopped() {
            self.step(cell, rest_ns.is_some())?;
        }
        if self.config.progress {
            eprintln!();
        }
        self.joints = cell.arm().map(|arm| arm.q.into());
        // The last word, so that whoever listens learns how it ended.
        self.tell(&cell.state())
    }

    fn tell(&mut self, state: &RobotState) -> anyhow::Result<()> {
        if let Some(robot) = &mut self.robot {
            robot.publish(state)?;
        }
        Ok(())
    }

    /// A robot goes on when its run is decided.
    fn go_on(&mut self, cell: &mut dyn Cell) -> anyhow::Result<()> {
        while !self.is_stopped() {
            self.step(cell, true)?;
        }
        Ok(())
    }

    fn step(&mut self, cell: &mut dyn Cell, is_resting: bool) -> anyhow::Result<()> {
        let due_ns = cell.due_ns();
        let now_ns = match self.pace {
            Pace::RealTime => {
                sleep_until(due_ns, self.stop);
                for _ in 0..COMMANDS {
                    let Some(newer) = self.ports.command()? else {
                        break;
                    };
                    self.obey(cell, newer);
                    self.warn_if_late(due_ns);
                }
                now_ns()
            }
            Pace::Controller => due_ns,
            Pace::Client => {
                while !cell.may_step() {
                    if self.is_stopped() {
                        return Ok(());
                    }
                }
                // The client obeys them; here they tell when the run begins.
                if let Some(mut newer) = self.ports.command()? {
                    newer.stamp.published_ns = due_ns;
                    self.obey(cell, newer);
                }
                due_ns
            }
        };
        let late_ns = now_ns.saturating_sub(due_ns);
        self.lateness.add(late_ns);
        cell.late(late_ns);
        if self.is_live() {
            self.warn_if_late(due_ns);
        }
        let seen = cell.look(now_ns)?;
        if let Some(shot) = &seen.shot {
            self.publish(cell, shot, now_ns)?;
        }
        if let Some(exposed) = &seen.exposed {
            self.note(cell, exposed, is_resting)?;
            self.late.add(late_ns, self.config.scene.camera.rate_hz);
        }
        if self.is_live() || seen.exposed.is_some() {
            let mut state = cell.state();
            let frames = cell.progress().frames;
            state.features_sequence = seen.exposed.map_or(0, |_| frames);
            self.tell(&state)?;
        }
        cell.advance();
        Ok(())
    }

    /// Warns where a step is late that was due at this instant.
    fn warn_if_late(&mut self, due_ns: u64) {
        let (now_ns, rate_hz) = (now_ns(), self.config.scene.camera.rate_hz);
        let late_ns = now_ns.saturating_sub(due_ns);
        if let Some(warning) = self.late.warning(now_ns, late_ns, self.since_ns, rate_hz) {
            eprintln!("hw-sim: {warning}");
        }
    }

    /// Publishes a frame; in lockstep, waits for its answer and obeys it.
    fn publish(&mut self, cell: &mut dyn Cell, shot: &Shot, now_ns: u64) -> anyhow::Result<()> {
        let stamp = Stamp {
            sequence: shot.number,
            published_ns: if self.is_live() {
                ipc::now_ns()
            } else {
                now_ns
            },
            data_ns: shot.stamp_ns,
        };
        let exposure_ns = match self.config.robot {
            Body::Panda | Body::Urdf => self.config.rig.eye.exposure_ns,
            Body::Free => 0,
        };
        let sent = self.ports.send(shot, stamp, exposure_ns)?;
        self.measured = shot.image.is_none().then(|| shot.points.to_vec());
        if self.pace == Pace::Controller {
            let Some(answer) = self.ports.answer(&sent, PATIENCE)? else {
                bail!(
                    "lockstep: nobody answered frame {} within {} s; {} running with --clock lockstep in domain {}?",
                    sent.sequence,
                    PATIENCE.as_secs(),
                    match shot.image {
                        Some(_) => "are vpc-camera and vpcd",
                        None => "is vpcd",
                    },
                    self.config.domain.display()
                );
            };
            let mut command = answer;
            command.stamp.published_ns = now_ns;
            self.obey(cell, command);
        }
        Ok(())
    }

    /// Hands a command of this run to the cell, for as long as it says that it is valid, and never
    /// for longer than a camera obeys a controller that is silent.
    fn obey(&mut self, cell: &mut dyn Cell, command: TwistCommand) {
        if (1..self.since_ns).contains(&command.features_published_ns) {
            return;
        }
        let (sent_ns, now) = (command.stamp.published_ns, now_ns());
        let (twist, elbow, sent_ns) = match self.is_live() {
            // One from the future moves nothing, now or later.
            true => (
                command.in_force(now),
                command.elbow_in_force(now),
                sent_ns.min(now),
            ),
            false => (command.twist, command.elbow, sent_ns),
        };
        let still = [Some(TwistState::Disarmed), Some(TwistState::Stopped)];
        let is_armed = !still.contains(&command.state());
        let is_disarmed = command.state() == Some(TwistState::Disarmed);
        if is_disarmed && !cell.progress().has_begun() && !self.is_told {
            self.is_told = true;
            eprintln!("hw-sim: vpcd is disarmed: the run begins with vpcctl arm");
        }
        cell.obey(&Order {
            twist,
            elbow,
            sent_ns,
            until_ns: match self.is_live() {
                true => command.in_force_until_ns(),
                false => sent_ns.saturating_add(self.stale_ns),
            },
            is_armed,
        });
        self.command = Some(command);
    }

    /// Once a frame: count, record, show.
    fn note(
        &mut self,
        cell: &mut dyn Cell,
        exposed: &Exposed,
        is_resting: bool,
    ) -> anyhow::Result<()> {
        let (stale, twist, arm) = (cell.is_stale(), cell.aimed(), cell.arm());
        let progress = cell.progress();
        progress.stale += u64::from(stale && progress.has_begun());
        let time_s = progress.time_s;
        if self.config.progress && !is_resting && progress.frames.is_multiple_of(3) {
            let phase = arm.as_ref().map_or("", |arm| arm.phase.name());
            eprint!(
                "\r  {time_s:5.1} s   {phase:<10} error {:7.1} px   ",
                progress.error_px
            );
        }
        if let Some(recorder) = &mut self.recorder {
            let object = to_scene(&exposed.object);
            recorder.add(&Record {
                time_s,
                translation: object.translation,
                rotation: object.rotation,
                object_twist: (!self.config.motion.is_rest()).then_some(exposed.object_twist),
                features: exposed.points.to_vec(),
                measured: self.measured.take(),
                twist,
                answered: self.command.map_or(0, |command| command.features_sequence),
                stale,
                arm,
            })?;
        }
        Ok(())
    }

    fn outcome(&self, start: usize, cell: &mut dyn Cell) -> Outcome {
        let allowed_px = self.config.scene.success.violation_px;
        let mut outcome = Outcome::new(start, cell.progress(), allowed_px);
        cell.complete(&mut outcome);
        outcome.late = self.late.report();
        if self.is_live() && outcome.arm.is_some() {
            outcome.lateness = Some(self.lateness.report());
        }
        outcome
    }
}

/// Sleeps until an instant of the monotonic clock, or until `stop` is set by a signal that
/// interrupts the sleep.
fn sleep_until(ns: u64, stop: &AtomicBool) {
    let until = Timespec {
        tv_sec: (ns / 1_000_000_000) as i64,
        tv_nsec: (ns % 1_000_000_000) as i64,
    };
    while now_ns() < ns && !stop.load(Ordering::Relaxed) {
        // Interrupted or not, the loop's condition decides.
        let _ = clock_nanosleep_absolute(ClockId::Monotonic, &until);
    }
}
