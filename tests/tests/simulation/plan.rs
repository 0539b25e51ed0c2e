//! What is decided about a run before it begins: all of it by the seed.

use decision::{Rules, Safety};
use memory_blob::MemoryFile;
use messages::ClockMode;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Pose, Scene};
use vpc::{Settings, Strategy};

use crate::PERIOD_NS;
use crate::fault::{ALL, Fault};

/// Where the object is at first where the camera must become fast: far from the goal, nothing in
/// the way.
const FAR: [Pose; 2] = [
    Pose {
        translation: [-0.1, -0.1, 1.0],
        rotation: [0.0; 3],
    },
    Pose {
        translation: [0.25, 0.1, 0.9],
        rotation: [0.1, -0.2, 0.4],
    },
];
/// Where it is for the strategy `ibvs`: a camera that comes from there is fast.
const VERY_FAR: Pose = Pose {
    translation: [0.1, 0.0, 3.2],
    rotation: [0.0; 3],
};

/// What all runs share: scenes and the memory of motion.
pub struct Stock {
    /// Without and with limits of acceleration.
    scenes: [Scene; 2],
    starts: Vec<Pose>,
    memory: MemoryFile,
}

impl Stock {
    /// Reads it.
    pub fn read() -> Self {
        let text = scene::PAPER_SIM;
        let limits = "[limits]\nlinear_acceleration = 2.0\nangular_acceleration = 4.0\n";
        let limited = text.replace("[limits]\n", limits);
        assert_ne!(limited, text);
        Self {
            scenes: [text, &limited].map(|text| Scene::parse(text, "sim").unwrap()),
            starts: scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap(),
            memory: MemoryFile::open(&testkit::memory_file(), None).unwrap(),
        }
    }

    /// Where the object may be at first.
    pub fn starts(&self) -> &[Pose] {
        &self.starts
    }

    /// The scene without limits of acceleration.
    pub fn scene(&self) -> &Scene {
        &self.scenes[0]
    }

    /// The memory of motion.
    pub fn memory(&self) -> memory_blob::Memory<'_> {
        self.memory.view()
    }
}

/// What the seed decides before the run.
pub struct Plan<'s> {
    pub stock: &'s Stock,
    pub fault: Fault,
    pub scene: &'s Scene,
    pub settings: Settings,
    pub safety: Safety,
    pub clock: ClockMode,
    pub start: Pose,
    /// From exposure to publication, ns.
    pub latency_ns: u64,
    /// Whether the records are kept, and replayed at the end.
    pub is_recorded: bool,
    /// Whether each cycle is rehearsed before its release, as `vpcd` does.
    pub rehearses: bool,
}

impl<'s> Plan<'s> {
    /// That of this seed, and the source of all later choices.
    pub fn new(stock: &'s Stock, seed: u64) -> (Self, ChaCha8Rng) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let fault = ALL[(seed % ALL.len() as u64) as usize];
        let strategy = strategy(fault, &mut random);
        let safety = Safety {
            armed: matches!(fault, Fault::ArmedStart | Fault::ArmedAlone | Fault::Crash),
            needs_robot: fault == Fault::RobotUnheard || random.random_bool(0.7),
            ..Safety::default()
        };
        let plan = Self {
            stock,
            fault,
            scene: &stock.scenes[usize::from(random.random_bool(0.3) && !fault.needs_speed())],
            settings: Settings {
                strategy,
                foresight_steps: 5,
                brake_s: safety.brake_s,
                blind_s: safety.blind_s,
                ..Settings::daemon()
            },
            safety,
            clock: match random.random_bool(0.25) {
                true => ClockMode::Phase,
                false => ClockMode::Fixed,
            },
            start: match fault {
                Fault::NoAnswer => VERY_FAR,
                // From there another object is elsewhere for certain: at full speed the law's tolerance
                // comes to half an image.
                Fault::OtherAfterHidden | Fault::OtherAfterRestart => FAR[1],
                _ if fault.needs_speed() => FAR[random.random_range(0..FAR.len())],
                _ => stock.starts[random.random_range(0..stock.starts.len())],
            },
            latency_ns: random.random_range(0..PERIOD_NS),
            is_recorded: (seed / ALL.len() as u64).is_multiple_of(8),
            rehearses: seed / ALL.len() as u64 % 8 == 1,
        };
        (plan, random)
    }

    /// Whether the scene limits the acceleration.
    pub fn is_limited(&self) -> bool {
        self.scene.limits.acceleration()[0].is_finite()
    }

    /// Time of a brake from the limits to zero, in whole cycles, ns.
    pub fn brake_ns(&self) -> u64 {
        let rules = self.rules();
        let by_time = rules.brake_ns.div_ceil(PERIOD_NS);
        by_time.max(rules.stop_cycles(&rules.limits).ceil() as u64) * PERIOD_NS
    }

    /// The supervisor's rules, as `vpcd` makes them of scene and settings.
    pub fn rules(&self) -> Rules {
        Rules::new(self.scene, &self.settings, &self.safety, self.clock)
    }
}

/// Mostly one that costs little.
fn strategy(fault: Fault, random: &mut ChaCha8Rng) -> Strategy {
    match (fault, random.random_range(0..20)) {
        (Fault::NoAnswer, _) => Strategy::Ibvs,
        (Fault::Guardian, _) => Strategy::Follow,
        (_, 0) => Strategy::Foresight,
        (_, 1) => Strategy::Knn { k: 5 },
        (_, 2) => Strategy::Gpr,
        _ => Strategy::Previous,
    }
}
