//! What foresight costs on this machine: the time of a simulated step, measured.

use std::time::Instant;

use memory_blob::MemoryFile;
use vpc::{Law, Measurement, MotionMemory, Settings, Strategy};

use crate::loaded::Loaded;

/// Cycles that are measured.
const CYCLES: u32 = 50;
/// How far the camera starts behind the goal and beside it, as a share of the goal's depth.
const AWAY: f64 = 0.4;

/// The cost of foresight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cost {
    /// Time of a simulated step, ns: the median over cycles.
    pub step_ns: u64,
    /// Steps that a cycle may simulate.
    pub steps: u32,
    /// The control period, ns.
    pub control_ns: u64,
}

impl Cost {
    /// Lets the law look at a pattern away from the goal again and again; `None` where it refuses
    /// that.
    pub fn measure(loaded: &Loaded) -> Option<Self> {
        let scene = loaded.scene();
        let view = loaded.memory.as_ref().map(MemoryFile::view);
        let memory = view.as_ref().map(|view| view as &dyn MotionMemory);
        let settings = Settings {
            strategy: Strategy::Foresight,
            ..loaded.settings
        };
        let mut law = Law::new(scene, settings, |len| vec![0.0; len]).ok()?;
        let mut pose = scene.goal;
        let depth = pose.translation[2];
        pose.translation[0] += AWAY * depth;
        pose.translation[2] += AWAY * depth;
        let points = law.task().features_at(&pose)?;
        let mut times = Vec::new();
        for cycle in 0..CYCLES {
            let now_ns = u64::from(cycle) * (1e9 * scene.sampling_time()) as u64;
            let measured = Measurement::from_points(&points).taken(now_ns, now_ns);
            law.step(&measured, memory).ok()?;
            law.sent(&[0.0; 6], now_ns);
            let begin = Instant::now();
            law.think(memory);
            let time = begin.elapsed().as_nanos() as u64;
            if let Some(each) = time.checked_div(law.foreseen().simulated.into()) {
                times.push(each);
            }
        }
        times.sort_unstable();
        Some(Self {
            step_ns: times.get(times.len() / 2).copied()?,
            steps: law.foreseen_steps(),
            control_ns: (1e9 * scene.sampling_time()) as u64,
        })
    }
}
