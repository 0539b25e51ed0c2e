//! What is decided about a run before it begins: all of it by the seed.

use decision::{Rules, Safety};
use memory_blob::MemoryFile;
use messages::ClockMode;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use scene::{Pose, Scene, SceneFiles};
use vpc::{Settings, Strategy};

use crate::fault::{FAULTS, Fault};
use crate::{dice, kinds};

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
/// Where it is for a visit, near the goals.
const NEAR: Pose = Pose {
    translation: [0.05, 0.0, 0.7],
    rotation: [0.0; 3],
};
/// Where the arm's camera sees it.
const BEFORE_ARM: Pose = Pose {
    translation: [0.0, -0.01, 0.4],
    rotation: [0.0; 3],
};
/// Events of a storm.
const BLOWS: std::ops::Range<u64> = 4..12;

/// The scenes of all runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The paper's.
    Paper,
    /// With limits of acceleration.
    Limited,
    /// At 15 and at 10 Hz.
    At15,
    At10,
    /// With another goal.
    Beside,
    /// With another goal, and ten times the limits.
    Foreign,
    /// Carried by an arm.
    Arm,
}

const PLACES: [Place; 7] = [
    Place::Paper,
    Place::Limited,
    Place::At15,
    Place::At10,
    Place::Beside,
    Place::Foreign,
    Place::Arm,
];

/// What all runs share: scenes and the memory of motion.
pub struct Stock {
    scenes: [SceneFiles; PLACES.len()],
    starts: Vec<Pose>,
    memory: MemoryFile,
}

impl Stock {
    /// Reads it.
    pub fn read() -> Self {
        Self {
            scenes: PLACES.map(scene_of),
            starts: scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap(),
            memory: MemoryFile::open(&testkit::memory_file(), None).unwrap(),
        }
    }

    /// Where the object may be at first.
    pub fn starts(&self) -> &[Pose] {
        &self.starts
    }

    /// A scene.
    pub fn scene(&self, place: Place) -> &Scene {
        &self.scenes[place as usize].scene
    }

    /// Whether scenes differ in no more than the goal and the starts.
    pub fn is_same_task(&self, one: Place, other: Place) -> bool {
        let [one, other] = [one, other].map(|place| &self.scenes[place as usize]);
        one.differences(other).is_empty()
    }

    /// The memory of motion.
    pub fn memory(&self) -> memory_blob::Memory<'_> {
        self.memory.view()
    }
}

fn scene_of(place: Place) -> SceneFiles {
    let directory = testkit::root().join("ipc/scene/scenes");
    let read = |name: &str| std::fs::read(directory.join(name));
    let files = |text| SceneFiles::parse(text, "simulation", &read).unwrap();
    let paper = scene::PAPER_SIM;
    let changed = |changes: &[(&str, &str)]| {
        let mut text = paper.to_owned();
        for (from, to) in changes {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        }
        files(text)
    };
    let beside = (
        "[goal]\ntranslation = [0.0, 0.0, 0.6]",
        "[goal]\ntranslation = [0.0, 0.0, 0.8]",
    );
    match place {
        Place::Paper => changed(&[]),
        Place::Limited => changed(&[(
            "[limits]\n",
            "[limits]\nlinear_acceleration = 2.0\nangular_acceleration = 4.0\n",
        )]),
        Place::At15 => changed(&[("rate_hz = 30.0", "rate_hz = 15.0")]),
        Place::At10 => changed(&[("rate_hz = 30.0", "rate_hz = 10.0")]),
        Place::Beside => changed(&[beside]),
        Place::Foreign => changed(&[
            beside,
            ("linear = 0.5 ", "linear = 5.0 "),
            ("angular = 1.0 ", "angular = 10.0 "),
        ]),
        Place::Arm => {
            let text = scene::PAPER_ROBOT.replace("linear = 0.01", "linear = 0.1");
            let text = text.replace("angular = 0.03", "angular = 0.4");
            let (text, _) = text.split_once("[[occlusion]]").unwrap();
            files(format!("arm = \"panda.toml\"\n{text}"))
        }
    }
}

/// Something that goes wrong in a storm, from when to when, ns after its begin.
#[derive(Clone, Copy, Debug)]
pub struct Blow {
    /// Its place in the storm.
    pub number: usize,
    pub fault: Fault,
    pub from_ns: u64,
    pub until_ns: u64,
}

/// What the seed decides before the run.
pub struct Plan<'s> {
    pub stock: &'s Stock,
    pub seed: u64,
    pub fault: Fault,
    pub place: Place,
    pub scene: &'s Scene,
    pub settings: Settings,
    pub safety: Safety,
    pub clock: ClockMode,
    pub start: Pose,
    pub period_ns: u64,
    /// From exposure to publication, ns.
    pub latency_ns: u64,
    /// Whether the records are kept, and replayed at the end.
    pub is_recorded: bool,
    /// The events of a storm.
    pub blows: Vec<Blow>,
}

impl<'s> Plan<'s> {
    /// That of this seed.
    pub fn new(stock: &'s Stock, seed: u64) -> Self {
        let kinds = kinds();
        let (round, kind) = (seed / kinds.len() as u64, seed % kinds.len() as u64);
        let random = &mut dice(seed, 0);
        let fault = kinds[kind as usize];
        let strategy = strategy(fault, random);
        let place = place(fault, random);
        let scene = stock.scene(place);
        let period_ns = decision::rules::ns(scene.sampling_time());
        let safety = Safety {
            armed: matches!(fault, Fault::ArmedStart | Fault::ArmedAlone | Fault::Crash),
            needs_robot: fault == Fault::RobotUnheard || random.random_bool(0.7),
            ..Safety::default()
        };
        Self {
            stock,
            seed,
            fault,
            place,
            scene,
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
                // From there another object is elsewhere for certain: at full speed the law's
                // tolerance comes to half an image.
                Fault::OtherAfterHidden | Fault::OtherAfterRestart => FAR[1],
                _ if fault.is_of_joints() => BEFORE_ARM,
                _ if fault.is_of_visit() => NEAR,
                _ if fault.needs_speed() => FAR[random.random_range(0..FAR.len())],
                _ => stock.starts[random.random_range(0..stock.starts.len())],
            },
            period_ns,
            latency_ns: random.random_range(0..period_ns),
            is_recorded: round.is_multiple_of(8),
            blows: match fault {
                Fault::Storm => blows(random),
                _ => Vec::new(),
            },
        }
    }

    /// The memory of motion, where the scene is the one that it was made for.
    pub fn memory(&self) -> Option<memory_blob::Memory<'s>> {
        (self.place != Place::Arm).then(|| self.stock.memory())
    }

    /// Whether the clock goes back: records then have no order.
    pub fn turns_back(&self) -> bool {
        let is_back = |fault| fault == Fault::ClockBack;
        is_back(self.fault) || self.blows.iter().any(|blow| is_back(blow.fault))
    }

    /// Whether the scene limits the acceleration.
    pub fn is_limited(&self) -> bool {
        self.scene.limits.acceleration()[0].is_finite()
    }

    /// Time of a brake from the limits to zero, in whole cycles, ns.
    pub fn brake_ns(&self) -> u64 {
        let rules = self.rules(self.scene);
        let by_time = rules.brake_ns.div_ceil(self.period_ns);
        by_time.max(rules.stop_cycles(&rules.limits).ceil() as u64) * self.period_ns
    }

    /// The supervisor's rules in a scene, as `vpcd` makes them of scene and settings.
    pub fn rules(&self, scene: &Scene) -> Rules {
        Rules::new(scene, &self.settings, &self.safety, self.clock)
    }
}

fn place(fault: Fault, random: &mut ChaCha8Rng) -> Place {
    match fault {
        Fault::Flicker => [Place::Paper, Place::At15, Place::At10][random.random_range(0..3)],
        _ if fault.is_of_joints() => Place::Arm,
        _ if random.random_bool(0.3) && !fault.needs_speed() && !fault.is_of_visit() => {
            Place::Limited
        }
        _ => Place::Paper,
    }
}

/// Mostly one that costs little.
fn strategy(fault: Fault, random: &mut ChaCha8Rng) -> Strategy {
    match (fault, random.random_range(0..20)) {
        (Fault::NoAnswer, _) => Strategy::Ibvs,
        _ if fault.is_of_policy() => Strategy::Follow,
        (Fault::Storm, 0..5) if !Fault::ToGoal.is_awaited() => Strategy::Follow,
        _ if fault.needs_speed() => Strategy::Previous,
        (_, 0) => Strategy::Foresight,
        (_, 1) => Strategy::Knn { k: 5 },
        (_, 2) => Strategy::Gpr,
        _ => Strategy::Previous,
    }
}

/// The events of a storm, one after the other or at once.
fn blows(random: &mut ChaCha8Rng) -> Vec<Blow> {
    let possible: Vec<Fault> = FAULTS
        .iter()
        .copied()
        .filter(|one| one.is_of_storm())
        .collect();
    let count = random.random_range(BLOWS);
    let mut blows: Vec<Blow> = (0..count)
        .map(|_| {
            let from_ns = random.random_range(500_000_000..10_000_000_000);
            Blow {
                number: 0,
                fault: possible[random.random_range(0..possible.len())],
                from_ns,
                until_ns: from_ns + random.random_range(10_000_000..1_500_000_000),
            }
        })
        .collect();
    blows.sort_by_key(|blow| blow.from_ns);
    for (number, blow) in blows.iter_mut().enumerate() {
        blow.number = number;
    }
    blows
}
