//! The loop of the process: expose, publish, execute, move, judge.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, bail};
use ipc::{
    CameraPorts, Domain, Features, RobotFaults, RobotMode, RobotState, Stamp, TwistCommand,
    TwistState, now_ns,
};
use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute};
use serde::Serialize;

use crate::camera::FreeCamera;
use crate::carrier::{Carrier, Executed};
use crate::config::{Body, Clock, Config};
use crate::lateness::LatenessReport;
use crate::pose::RigidPose;
use crate::recording::{Record, Recorder};
use crate::referee::{Place, Referee, Verdict};
use crate::robot::inspector::ArmReport;
use crate::robot::process;
use crate::sensor::Sensor;

/// A camera whose commands are older than this, or than three periods of a slow camera, stands still.
pub(crate) const STALE_NS: u64 = 100_000_000;
/// How long lockstep waits for a controller to come, and for each answer.
pub(crate) const PATIENCE: Duration = Duration::from_secs(10);

/// What a run came to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// `arrived`, `violation`, `time_out`, `lost_sight` or `stopped`; of an arm, too, `reflex`, and `arm_violation` where
    /// it arrived but its referee saw a limit exceeded.
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
    /// Of an arm: what the sequence was about at the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<&'static str>,
    /// Of an arm: seconds until the features were at the goal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arrived_s: Option<f64>,
    /// Of an arm: what its referee reports.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arm: Option<ArmReport>,
    /// Of an arm on the fixed clock: how late its milliseconds began.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lateness: Option<LatenessReport>,
}

/// Says that features go out. Else who starts it sees nothing until the run is over, which begins when somebody arms.
pub(crate) fn announce(config: &Config) {
    if config.clock == Clock::Fixed {
        eprintln!(
            "hw-sim: features go out in domain {}; the run begins when vpcd is armed, and ends with one line",
            config.domain.display()
        );
    }
}

/// Runs the emulator until the run is decided or `stop` is set.
///
/// # Errors
/// Where the shared memory cannot be opened, nobody answers in lockstep, or the recording cannot be written.
pub fn run(config: &Config, stop: &AtomicBool) -> anyhow::Result<Outcome> {
    if config.robot == Body::Panda {
        return process::run(config, &config.rig, stop);
    }
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
        step: None,
        arrived_s: None,
        arm: None,
        lateness: None,
    };
    announce(config);
    // The run begins with the first command of an armed controller, which may come late.
    let mut begun = false;
    let mut command: Option<TwistCommand> = None;
    // The same while it is valid: what the camera executes.
    let mut standing = command;
    let start_ns = now_ns();
    let mut release = start_ns;
    // The instant of the camera's pose, at which the next frame is exposed.
    let mut exposure = start_ns;
    while !stop.load(Ordering::Relaxed) {
        let Ok(points) = camera.features() else {
            outcome.verdict = "lost_sight";
            break;
        };
        let pose = *camera.pose();
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
                let place = place_in_words(&place);
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
            Some(frame) => {
                let mut features = Features::new(&frame.points, frame.exposure_ns);
                features.stamp = Stamp {
                    // Frames are numbered as they are exposed: a lost one shows as a gap.
                    sequence: outcome.frames - config.flaws.delay_frames as u64,
                    published_ns: match config.clock {
                        Clock::Lockstep => exposure,
                        Clock::Fixed => now_ns(),
                    },
                    data_ns: frame.exposure_ns,
                };
                Some(ports.features.publish_verbatim(&features)?)
            }
            None => None,
        };
        // The instant of the next exposure. Until then the camera moves: here on the fixed clock, below in lockstep.
        let next = match config.clock {
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
                start_ns + (outcome.frames as f64 * 1e9 * ts).round() as u64
            }
            Clock::Fixed => {
                release += period_ns;
                sleep_until(release, stop);
                let now = now_ns();
                let mut moved = exposure;
                // Each command takes effect when it was sent, in the middle of a period.
                while let Some(newer) = ports.twist.oldest()? {
                    let sent = newer.stamp.published_ns.clamp(moved, now);
                    carry(&mut camera, &carrier, standing.as_ref(), moved, sent);
                    (moved, command) = (sent, Some(newer.message));
                    standing = command;
                }
                carry(&mut camera, &carrier, standing.as_ref(), moved, now);
                now
            }
        };
        begun |= command.is_some_and(|command| command.state() != Some(TwistState::Disarmed));

        let valid = command.filter(|command| match config.clock {
            Clock::Lockstep => true,
            // What would be too old before the next frame is too old now.
            Clock::Fixed => next + period_ns <= end_ns(command, stale_ns),
        });
        standing = valid;
        let executed = carrier.execute(&valid.map_or([0.0; 6], |command| command.twist));
        outcome.stale += u64::from(begun && valid.is_none());
        outcome.limited += u64::from(executed.limited);
        publish_state(
            &mut ports,
            &pose,
            exposure,
            outcome.frames,
            &executed,
            begun,
            valid.is_some(),
        )?;
        if let Some(recorder) = &mut recorder {
            recorder.add(&Record {
                time_s: outcome.time_s,
                translation: pose.translation.into(),
                rotation: pose.rotation_vector(),
                features: points.to_vec(),
                measured: frame.map(|frame| frame.points.to_vec()),
                twist: executed.twist,
                answered: valid.map_or(0, |command| command.features_sequence),
                stale: valid.is_none(),
                arm: None,
            })?;
        }
        if config.progress && outcome.frames.is_multiple_of(3) {
            eprint!(
                "\r  {:5.1} s   error {:7.1} px   ",
                outcome.time_s, outcome.error_px
            );
        }
        if config.clock == Clock::Lockstep {
            camera.advance(&executed.twist, ts);
        }
        if begun {
            outcome.time_s += (next - exposure) as f64 * 1e-9;
        }
        exposure = next;
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

/// Where a violation took place, in words.
pub(crate) fn place_in_words(place: &Place) -> String {
    match place {
        Place::OutsideImage => "outside the image".to_owned(),
        Place::Occlusion(name) => format!("inside `{name}`"),
    }
}

/// When a command that is older than `stale_ns` then, or that says so itself, is no longer executed, ns.
fn end_ns(command: &TwistCommand, stale_ns: u64) -> u64 {
    let stale = command.stamp.published_ns.saturating_add(stale_ns);
    stale.min(command.valid_until_ns)
}

/// Moves the camera from one instant to another by a command, for as long as that is valid.
fn carry(
    camera: &mut FreeCamera,
    carrier: &Carrier,
    command: Option<&TwistCommand>,
    from_ns: u64,
    to_ns: u64,
) {
    if let Some(command) = command {
        let end_ns = to_ns.min(command.valid_until_ns);
        let seconds = end_ns.saturating_sub(from_ns) as f64 * 1e-9;
        camera.advance(&carrier.execute(&command.twist).twist, seconds);
    }
}

fn publish_state(
    ports: &mut CameraPorts,
    pose: &RigidPose,
    exposure_ns: u64,
    features_sequence: u64,
    executed: &Executed,
    begun: bool,
    valid: bool,
) -> anyhow::Result<()> {
    let (translation, rotation) = (pose.translation.into(), pose.rotation_vector());
    let mut state = RobotState::free_camera(translation, rotation, exposure_ns);
    state.features_sequence = features_sequence;
    state.twist = executed.twist;
    let mode = match (begun, valid) {
        (false, _) => RobotMode::Idle,
        (true, true) => RobotMode::Moving,
        (true, false) => RobotMode::Stale,
    };
    state.mode = mode.code();
    if begun && !valid {
        state.faults |= RobotFaults::STALE_COMMAND.0;
    }
    if executed.limited {
        state.faults |= RobotFaults::COMMAND_LIMITED.0;
    }
    ports.robot.publish(&state)?;
    Ok(())
}

/// Sleeps until an instant of the monotonic clock, or until `stop` is set by a signal that interrupts the sleep.
pub(crate) fn sleep_until(ns: u64, stop: &AtomicBool) {
    let until = Timespec {
        tv_sec: (ns / 1_000_000_000) as i64,
        tv_nsec: (ns % 1_000_000_000) as i64,
    };
    while now_ns() < ns && !stop.load(Ordering::Relaxed) {
        // Interrupted or not, the loop's condition decides.
        let _ = clock_nanosleep_absolute(ClockId::Monotonic, &until);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc::TwistState;
    use scene::Scene;

    #[test]
    fn a_command_carries_the_camera_for_as_long_as_it_is_valid() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let carrier = Carrier::free_flying(scene.limits);
        let mut camera = FreeCamera::new(&scene, &scene.goal);
        let mut command = TwistCommand::zero(TwistState::Moving);
        command.twist = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0];
        command.stamp.published_ns = 1_000_000_000;
        command.valid_until_ns = 1_100_000_000;
        assert_eq!(end_ns(&command, 60_000_000), 1_060_000_000);
        assert_eq!(end_ns(&command, 200_000_000), 1_100_000_000);
        let mut moved = |from_ns: u64, to_ns: u64| {
            let before = camera.pose().translation.x;
            carry(&mut camera, &carrier, Some(&command), from_ns, to_ns);
            before - camera.pose().translation.x
        };
        assert!((moved(1_010_000_000, 1_030_000_000) - 0.002).abs() < 1e-12);
        // 70 ms are left of the 100.
        assert!((moved(1_030_000_000, 1_200_000_000) - 0.007).abs() < 1e-12);
        assert_eq!(moved(1_200_000_000, 1_300_000_000), 0.0);
        let still = *camera.pose();
        carry(&mut camera, &carrier, None, 0, 1_000_000_000);
        assert_eq!(*camera.pose(), still);
    }
}
