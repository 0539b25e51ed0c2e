//! The cell as a process: publishes frames and states, takes twists, in real time at 1 kHz or in lockstep.

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, bail};
use ipc::{CameraPorts, Domain, Features, Stamp, TwistCommand, TwistState, now_ns};

use super::rig::{End, Exposed, Rig, RigSettings};
use super::telling;
use crate::config::{Clock, Config};
use crate::emulator::{Outcome, PATIENCE, STALE_NS, announce, place_in_words, sleep_until};
use crate::eye::Shot;
use crate::lateness::Lateness;
use crate::recording::{Record, Recorder};
use crate::referee::Verdict;

/// Runs the cell until the run is decided or `stop` is set.
///
/// # Errors
/// Where the shared memory cannot be opened, the start is out of reach, nobody answers in lockstep, or the recording
/// cannot be written.
pub fn run(config: &Config, settings: &RigSettings, stop: &AtomicBool) -> anyhow::Result<Outcome> {
    let domain = Domain::join(&config.domain)?;
    let mut ports = CameraPorts::open(&domain)?;
    let scene = &config.scene;
    // All that takes time before time begins.
    let mut rig = Rig::new(scene, &config.start, settings, 0)?;
    let goal = rig.referee().goal().map(|points| points.to_vec());
    let mut recorder = config
        .record
        .as_ref()
        .map(|path| {
            Recorder::create(path, scene, &config.scene_file, &goal.unwrap_or_default())
                .with_context(|| format!("{}: cannot record", path.display()))
        })
        .transpose()?;
    announce(config);
    if config.clock == Clock::Fixed {
        crate::priority::raise();
    }
    rig.set_epoch(now_ns());

    let period_ns = (1e9 * scene.sampling_time()) as u64;
    let mut run = Run {
        config,
        ports: &mut ports,
        command: None,
        measured: None,
        stale: 0,
        lateness: Lateness::default(),
        stale_ns: STALE_NS.max(3 * period_ns),
    };
    while rig.end().is_none() && !stop.load(Ordering::Relaxed) {
        if config.clock == Clock::Fixed {
            sleep_until(rig.now_ns(), stop);
            run.lateness.add(now_ns().saturating_sub(rig.now_ns()));
        }
        let instant = rig.look()?;
        if let Some(shot) = &instant.shot {
            run.deliver(&mut rig, shot)?;
        }
        if config.clock == Clock::Fixed
            && let Some(newest) = run.ports.twist.latest()?
        {
            run.obey(&mut rig, newest.message);
        }
        if let Some(exposed) = &instant.exposed {
            run.note(&mut rig, exposed, recorder.as_mut())?;
        }
        if config.clock == Clock::Fixed || instant.exposed.is_some() {
            let state = telling::state(&mut rig, instant.exposed.is_some());
            run.ports.robot.publish(&state)?;
        }
        if let Some(phase) = rig.advance()
            && config.progress
        {
            eprintln!("\r  {:5.1} s   {:<40}", rig.time_s(), phase.name());
        }
    }
    if config.progress {
        eprintln!();
    }
    // The last word, so that who listens learns how it ended.
    let state = telling::state(&mut rig, false);
    run.ports.robot.publish(&state)?;
    if let Some(recorder) = recorder {
        recorder.finish()?;
    }
    Ok(run.outcome(&rig))
}

/// What the process keeps beside the cell.
struct Run<'a> {
    config: &'a Config,
    ports: &'a mut CameraPorts,
    command: Option<TwistCommand>,
    /// Features delivered since the last exposure, px.
    measured: Option<Vec<[f64; 2]>>,
    stale: u64,
    lateness: Lateness,
    stale_ns: u64,
}

impl Run<'_> {
    /// Publishes a frame; in lockstep, waits for its answer and obeys it.
    fn deliver(&mut self, rig: &mut Rig, shot: &Shot) -> anyhow::Result<()> {
        let mut features = Features::new(&shot.points, shot.stamp_ns);
        features.visible = shot.visible;
        features.exposure_ns = self.config.rig.eye.exposure_ns;
        features.stamp = Stamp {
            // Frames are numbered as they are exposed: a lost one shows as a gap.
            sequence: shot.number,
            published_ns: match self.config.clock {
                Clock::Lockstep => rig.now_ns(),
                Clock::Fixed => now_ns(),
            },
            data_ns: shot.stamp_ns,
        };
        let sent = self.ports.features.publish_verbatim(&features)?;
        self.measured = Some(shot.points.to_vec());
        if self.config.clock == Clock::Lockstep {
            let Some(answer) = self.ports.wait_for_answer(&sent, PATIENCE)? else {
                bail!(
                    "lockstep: nobody answered features {} within {} s; is vpcd running with clock = \"lockstep\" in \
                     the domain {}?",
                    sent.sequence,
                    PATIENCE.as_secs(),
                    self.config.domain.display()
                );
            };
            let mut command = answer.message;
            command.stamp.published_ns = rig.now_ns();
            self.obey(rig, command);
        }
        Ok(())
    }

    /// Hands a command to the bridge, for as long as it says that it is valid, and never for longer than a robot obeys
    /// a controller that is silent.
    fn obey(&mut self, rig: &mut Rig, command: TwistCommand) {
        let stale = command.stamp.published_ns.saturating_add(self.stale_ns);
        let is_armed = !matches!(
            command.state(),
            Some(TwistState::Disarmed | TwistState::Stopped)
        );
        rig.command(&command.twist, stale.min(command.valid_until_ns), is_armed);
        self.command = Some(command);
    }

    /// Once a frame: count, record, show.
    fn note(
        &mut self,
        rig: &mut Rig,
        exposed: &Exposed,
        recorder: Option<&mut Recorder>,
    ) -> anyhow::Result<()> {
        let is_stale = rig.is_stale();
        self.stale += u64::from(is_stale && rig.time_s() > 0.0);
        if let Some(recorder) = recorder {
            recorder.add(&Record {
                time_s: rig.time_s(),
                translation: exposed.object.translation.into(),
                rotation: exposed.object.rotation_vector(),
                features: exposed.points.to_vec(),
                measured: self.measured.take(),
                twist: rig.aimed(),
                answered: self.command.map_or(0, |command| command.features_sequence),
                stale: is_stale,
                arm: Some(rig.record()),
            })?;
        }
        if self.config.progress && rig.frames().is_multiple_of(3) {
            let phase = rig.sequence().phase().name();
            eprint!(
                "\r  {:5.1} s   {phase:<10} error {:7.1} px   ",
                rig.time_s(),
                rig.error_px()
            );
        }
        Ok(())
    }

    fn outcome(&self, rig: &Rig) -> Outcome {
        let mut violation = None;
        let verdict = match rig.end() {
            None => "stopped",
            Some(End::Done) if rig.report().is_clean() => "arrived",
            Some(End::Done) => "arm_violation",
            Some(End::TimeOut) => "time_out",
            Some(End::Reflex) => "reflex",
            Some(End::Image(Verdict::Violation {
                point,
                depth_px,
                place,
            })) => {
                let place = place_in_words(place);
                violation = Some(format!("point {point} is {depth_px:.1} px deep {place}"));
                "violation"
            }
            Some(End::Image(_)) => "lost_sight",
        };
        Outcome {
            verdict,
            time_s: rig.time_s(),
            frames: rig.frames(),
            stale: self.stale,
            limited: rig.limited(),
            error_px: rig.error_px(),
            least_clearance_px: rig.referee().least_clearance(),
            violation,
            step: Some(rig.sequence().phase().name()),
            arrived_s: rig.arrived_s(),
            arm: Some(rig.report().clone()),
            lateness: (self.config.clock == Clock::Fixed).then(|| self.lateness.report()),
        }
    }
}
