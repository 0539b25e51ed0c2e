//! `teach`, against a camera that is held at a goal, moves, or sees something else. Camera and
//! command take turns on a clock that no machine delays.

use std::path::Path;
use std::time::Duration;

use ipc::{CameraPorts, Domain};
use messages::Features;
use program::Exit;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Pose, Scene};
use vpc::Task;
use vpcctl::clock::Clock;
use vpcctl::failure::Failure;
use vpcctl::teach::{TeachArguments, teach};

use crate::{stderr, vpcctl};

/// The object in the camera frame where the camera is held.
const HELD: Pose = Pose {
    translation: [0.05, -0.03, 0.8],
    rotation: [0.1, -0.05, 0.2],
};

fn points(pose: &Pose) -> Vec<[f64; 2]> {
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let task = Task::new(&scene).unwrap();
    task.features_at(pose).unwrap().to_vec()
}

/// A camera with noise, and the clock: it takes an image each 10 ms while the command waits.
struct Camera<'a> {
    ports: CameraPorts,
    /// What it sees after so many images.
    sees: &'a dyn Fn(u32) -> Vec<[f64; 2]>,
    random: ChaCha8Rng,
    image: u32,
    now_ns: u64,
}

impl Clock for Camera<'_> {
    fn now_ns(&self) -> u64 {
        self.now_ns
    }

    fn pause(&mut self, time: Duration) {
        const PERIOD_NS: u64 = 10_000_000;
        let before = self.now_ns / PERIOD_NS;
        self.now_ns += time.as_nanos() as u64;
        for _ in before..self.now_ns / PERIOD_NS {
            let mut points = (self.sees)(self.image);
            for x in points.as_flattened_mut() {
                *x += self.random.random_range(-0.3..0.3);
            }
            let features = Features::new(&points, self.now_ns);
            self.ports.features.publish(&features).unwrap();
            self.image += 1;
        }
    }
}

/// Runs `teach` beside a camera.
fn taught(
    place: &Path,
    sees: &dyn Fn(u32) -> Vec<[f64; 2]>,
    force: bool,
) -> Result<String, Failure> {
    let (domain, old) = (place.join("domain"), place.join("old.toml"));
    std::fs::write(&old, scene::PAPER_SIM).unwrap();
    let joined = Domain::join(&domain).unwrap();
    let mut camera = Camera {
        ports: CameraPorts::open(&joined).unwrap(),
        sees,
        random: ChaCha8Rng::seed_from_u64(36),
        image: 0,
        now_ns: ipc::now_ns(),
    };
    let arguments = TeachArguments {
        scene: Some(old),
        output: Some(place.join("new.toml")),
        build: false,
        replace: false,
        watch: Duration::from_secs(1),
        accept: Vec::new(),
        force,
    };
    teach(&domain, &arguments, &mut camera)
}

#[test]
fn what_the_camera_sees_becomes_the_goal_and_nothing_else_changes() {
    let place = tempfile::tempdir().unwrap();
    let held = points(&HELD);
    let sees = |_| held.clone();
    let words = taught(place.path(), &sees, false).unwrap();
    assert!(
        words.starts_with("taught from ") && words.contains("next: vpc-memory build "),
        "{words}"
    );
    let new = Scene::read(&place.path().join("new.toml")).unwrap();
    let goal = Task::new(&new).unwrap().goal;
    for (goal, held) in goal.iter().zip(&held) {
        let off_px = (goal[0] - held[0]).hypot(goal[1] - held[1]);
        assert!(off_px < 0.3, "{goal:?} {held:?}");
    }
    for (k, (new, held)) in new
        .goal
        .translation
        .iter()
        .zip(HELD.translation)
        .enumerate()
    {
        assert!((new - held).abs() < 0.005, "{k}: {new} {held}");
    }
    let old = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let (min, max) = (new.starts.translation_min, new.starts.translation_max);
    assert!((min[0] - old.starts.translation_min[0] - HELD.translation[0]).abs() < 0.005);
    assert!(min[2] > 0.0 && max[2] > min[2]);
    let mut same = new;
    (same.goal, same.starts) = (old.goal, old.starts);
    assert_eq!(same, old);
    // It overwrites nothing unasked.
    let refused = taught(place.path(), &sees, false).unwrap_err();
    assert_eq!(refused.exit, Exit::Refused, "{refused}");
    taught(place.path(), &sees, true).unwrap();
}

#[test]
fn what_is_no_goal_is_refused_and_nothing_is_written() {
    let place = tempfile::tempdir().unwrap();
    let held = points(&HELD);
    let refused = |sees: &dyn Fn(u32) -> Vec<[f64; 2]>, words: &str| {
        let failure = taught(place.path(), sees, false).unwrap_err();
        assert_eq!(failure.exit, Exit::Refused, "{words}: {failure}");
        assert!(failure.to_string().contains(words), "{failure}");
        assert!(!place.path().join("new.toml").exists());
    };
    let moved = |image: u32| {
        let by = 0.2 * f64::from(image);
        held.iter().map(|p| [p[0] + by, p[1]]).collect()
    };
    refused(&moved, "hold the camera still");
    let mut other = held.clone();
    other[2][0] += 40.0;
    refused(
        &|_| other.clone(),
        "px off every view of the scene's pattern",
    );
    refused(&|_| held[..3].to_vec(), "show all 4 points");
    // In the bar at the top of the image.
    let mut hidden = HELD;
    (hidden.translation, hidden.rotation) = ([0.1, -0.172, 0.8], [0.0; 3]);
    let hidden = points(&hidden);
    refused(&|_| hidden.clone(), "the goal: ");
    let domain = place.path().join("empty");
    std::fs::create_dir(&domain).unwrap();
    let new = place.path().join("new.toml");
    let old = place.path().join("old.toml");
    let [old, new] = [&old, &new].map(|path| path.to_str().unwrap());
    let said = vpcctl(
        &domain,
        &["teach", "--scene", old, "-o", new, "--watch", "0.1"],
    );
    assert_eq!(said.status.code(), Some(4), "{}", stderr(&said));
    assert!(stderr(&said).contains("is a camera at work?"));
}
