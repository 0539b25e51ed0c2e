//! The loop of the process: expose, publish, execute, move, judge.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, bail};
use ipc::{
    CameraPorts, Domain, Features, RobotFaults, RobotMode, RobotState, TwistCommand, TwistState,
    now_ns,
};
use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute};
use serde::Serialize;

use crate::camera::FreeCamera;
use crate::carrier::Carrier;
use crate::config::{Clock, Config};
use crate::recording::{Record, Recorder};
use crate::referee::{Place, Referee, Verdict};
use crate::sensor::Sensor;

/// A camera whose commands are older than this, or than three periods of a slow camera, stands still.
const STALE_NS: u64 = 100_000_000;
/// How long lockstep waits for a controller to come, and for each answer.
const PATIENCE: Duration = Duration::from_secs(10);

/// What a run came to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// `arrived`, `violation`, `time_out`, `lost_sight` or `stopped`.
    pub verdict: &'static str,
    /// Seconds from start to verdict.
    pub time_s: f64,
    /// Frames exposed.
    pub frames: u64,
    /// Frames after which the camera stood still for want of a valid command.
    pub stale: u64,
    /// Commands that were outside the limits.
    pub limited: u64,
    /// Largest component of s - s* at the end, px.
    pub error_px: f64,
    /// Least signed distance of any point from an occlusion or the border, px; negative inside.
    pub least_clearance_px: f64,
    /// The violation, in words.
    pub violation: Option<String>,
}

/// Runs the emulator until the run is decided or `stop` is set.
///
/// # Errors
/// Where the shared memory cannot be opened, nobody answers in lockstep, or the recording cannot be written.
pub fn run(config: &Config, stop: &AtomicBool) -> anyhow::Result<Outcome> {
    let domain = Domain::join(&config.domain)?;
    let mut ports = CameraPorts::open(&domain)?;
    let scene = &config.scene;
    let ts = scene.sampling_time();
    let period_ns = (1e9 * ts) as u64;
    let stale_ns = STALE_NS.max(3 * period_ns);
    let carrier = Carrier::free_flying(scene.limits);
    let mut camera = FreeCamera::new(scene, &config.start);
    let mut referee = Referee::new(scene);
    let mut sensor = Sensor::new(config.flaws);
    let goal = referee
        .goal()
        .map(|points| points.to_vec())
        .unwrap_or_default();
    let mut recorder = config
        .record
        .as_ref()
        .map(|path| {
            Recorder::create(path, scene, &config.scene_file, &goal)
                .with_context(|| format!("{}: cannot record", path.display()))
        })
        .transpose()?;

    let mut outcome = Outcome {
        verdict: "stopped",
        time_s: 0.0,
        frames: 0,
        stale: 0,
        limited: 0,
        error_px: f64::INFINITY,
        least_clearance_px: f64::INFINITY,
        violation: None,
    };
    // The run begins with the first command of an armed controller, which may come late.
    let mut begun = false;
    let mut command: Option<TwistCommand> = None;
    let mut release = now_ns();
    while !stop.load(Ordering::Relaxed) {
        let exposure = now_ns();
        let Ok(points) = camera.features() else {
            outcome.verdict = "lost_sight";
            break;
        };
        outcome.error_px = referee.error(&points);
        let verdict = referee.judge(&points, outcome.time_s);
        outcome.least_clearance_px = referee.least_clearance();
        outcome.verdict = match verdict {
            Verdict::Running if outcome.time_s >= config.time_limit_s => "time_out",
            Verdict::Running => "running",
            Verdict::Arrived => "arrived",
            Verdict::TimeOut => "time_out",
            Verdict::LostSight => "lost_sight",
            Verdict::Violation {
                point,
                depth_px,
                place,
            } => {
                let place = match place {
                    Place::OutsideImage => "outside the image".to_owned(),
                    Place::Occlusion(name) => format!("inside `{name}`"),
                };
                outcome.violation = Some(format!("point {point} is {depth_px:.1} px deep {place}"));
                "violation"
            }
        };
        if outcome.verdict != "running" {
            break;
        }
        outcome.frames += 1;

        let frame = sensor.expose(&points, exposure);
        let sent = match &frame {
            Some(frame) => Some(
                ports
                    .features
                    .publish(&Features::new(&frame.points, frame.exposure_ns))?,
            ),
            None => None,
        };
        match config.clock {
            Clock::Lockstep => {
                if let Some(sent) = &sent {
                    let answer = ports.wait_for_answer(sent, PATIENCE)?;
                    let Some(answer) = answer else {
                        bail!(
                            "lockstep: nobody answered features {} within {} s; is vpcd running with clock = \
                             \"lockstep\" in the domain {}?",
                            sent.sequence,
                            PATIENCE.as_secs(),
                            config.domain.display()
                        );
                    };
                    command = Some(answer.message);
                }
            }
            Clock::Fixed => {
                release += period_ns;
                sleep_until(release, stop);
                if let Some(newest) = ports.twist.latest()? {
                    command = Some(newest.message);
                }
            }
        }
        begun |= command.is_some_and(|command| command.state() != Some(TwistState::Disarmed));

        let next = now_ns() + period_ns;
        let valid = command.filter(|command| match config.clock {
            Clock::Lockstep => true,
            // What would be too old before the next frame is too old now.
            Clock::Fixed => {
                let published = command.stamp.published_ns;
                next <= command.valid_until_ns && next <= published.saturating_add(stale_ns)
            }
        });
        let executed = carrier.execute(&valid.map_or([0.0; 6], |command| command.twist));
        outcome.stale += u64::from(begun && valid.is_none());
        outcome.limited += u64::from(executed.limited);
        publish_state(
            &mut ports,
            &camera,
            sent.map_or(0, |sent| sent.sequence),
            &executed.twist,
            begun,
            valid.is_some(),
            executed.limited,
        )?;
        if let Some(recorder) = &mut recorder {
            recorder.add(&Record {
                time_s: outcome.time_s,
                translation: camera.pose().translation.into(),
                rotation: camera.pose().rotation_vector(),
                features: points.to_vec(),
                measured: frame.map(|frame| frame.points.to_vec()),
                twist: executed.twist,
                answered: valid.map_or(0, |command| command.features_sequence),
                stale: valid.is_none(),
            })?;
        }
        if config.progress && outcome.frames.is_multiple_of(3) {
            eprint!(
                "\r  {:5.1} s   error {:7.1} px   ",
                outcome.time_s, outcome.error_px
            );
        }
        camera.advance(&executed.twist, ts);
        if begun {
            outcome.time_s += ts;
        }
    }
    if config.progress {
        eprintln!();
    }
    if outcome.verdict == "running" {
        outcome.verdict = "stopped";
    }
    if let Some(recorder) = recorder {
        recorder.finish()?;
    }
    Ok(outcome)
}

fn publish_state(
    ports: &mut CameraPorts,
    camera: &FreeCamera,
    features_sequence: u64,
    twist: &[f64; 6],
    begun: bool,
    valid: bool,
    limited: bool,
) -> anyhow::Result<()> {
    let pose = camera.pose();
    let mut state =
        RobotState::free_camera(pose.translation.into(), pose.rotation_vector(), now_ns());
    state.features_sequence = features_sequence;
    state.twist = *twist;
    let mode = match (begun, valid) {
        (false, _) => RobotMode::Idle,
        (true, true) => RobotMode::Moving,
        (true, false) => RobotMode::Stale,
    };
    state.mode = mode.code();
    if begun && !valid {
        state.faults |= RobotFaults::STALE_COMMAND.0;
    }
    if limited {
        state.faults |= RobotFaults::COMMAND_LIMITED.0;
    }
    ports.robot.publish(&state)?;
    Ok(())
}

/// Sleeps until an instant of the monotonic clock, or until `stop` is set by a signal that interrupts the sleep.
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
