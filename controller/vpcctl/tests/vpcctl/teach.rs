//! `teach`, against a camera that is held at a goal, moves, or sees something else.

use std::path::Path;
use std::process::Output;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ipc::{CameraPorts, Domain, now_ns};
use messages::Features;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Pose, Scene};
use vpc::Task;

use crate::{stderr, stdout, vpcctl};

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

/// Runs `teach` while a camera publishes what `sees` says after so many images, with noise.
fn taught(place: &Path, sees: impl Fn(u32) -> Vec<[f64; 2]> + Sync, more: &[&str]) -> Output {
    let (domain, end) = (place.join("domain"), AtomicBool::new(false));
    let old = place.join("old.toml");
    std::fs::write(&old, scene::PAPER_SIM).unwrap();
    let new = place.join("new.toml");
    let [old, new] = [&old, &new].map(|path| path.to_str().unwrap());
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut random = ChaCha8Rng::seed_from_u64(36);
            let joined = Domain::join(&domain).unwrap();
            let mut camera = CameraPorts::open(&joined).unwrap();
            for image in 0.. {
                let noisy: Vec<_> = sees(image)
                    .iter()
                    .map(|point| point.map(|x| x + random.random_range(-0.3..0.3)))
                    .collect();
                let features = Features::new(&noisy, now_ns());
                camera.features.publish(&features).unwrap();
                std::thread::sleep(Duration::from_millis(10));
                if end.load(Ordering::Relaxed) {
                    break;
                }
            }
        });
        testkit::eventually("a domain", || domain.exists().then_some(()));
        let words = [&["teach", "--scene", old, "-o", new], more].concat();
        let said = vpcctl(&domain, &words);
        end.store(true, Ordering::Relaxed);
        said
    })
}

#[test]
fn what_the_camera_sees_becomes_the_goal_and_nothing_else_changes() {
    let place = tempfile::tempdir().unwrap();
    let held = points(&HELD);
    let said = taught(place.path(), |_| held.clone(), &[]);
    assert_eq!(said.status.code(), Some(0), "{}", stderr(&said));
    let words = stdout(&said);
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
    let said = taught(place.path(), |_| held.clone(), &[]);
    assert_eq!(said.status.code(), Some(2), "{}", stderr(&said));
    let said = taught(place.path(), |_| held.clone(), &["--force"]);
    assert_eq!(said.status.code(), Some(0), "{}", stderr(&said));
}

#[test]
fn what_is_no_goal_is_refused_and_nothing_is_written() {
    let place = tempfile::tempdir().unwrap();
    let held = points(&HELD);
    let refused = |sees: &(dyn Fn(u32) -> Vec<[f64; 2]> + Sync), code: i32, words: &str| {
        let said = taught(place.path(), sees, &[]);
        let told = stderr(&said);
        let all = format!("{words}: {told}{}", stdout(&said));
        assert_eq!(said.status.code(), Some(code), "{all}");
        assert!(told.contains(words), "{told}");
        assert!(!place.path().join("new.toml").exists());
    };
    let moved = |image: u32| {
        let by = 0.2 * f64::from(image);
        held.iter().map(|p| [p[0] + by, p[1]]).collect()
    };
    refused(&moved, 2, "hold the camera still");
    let mut other = held.clone();
    other[2][0] += 40.0;
    refused(
        &|_| other.clone(),
        2,
        "px off every view of the scene's pattern",
    );
    refused(&|_| held[..3].to_vec(), 2, "show all 4 points");
    // In the bar at the top of the image.
    let mut hidden = HELD;
    (hidden.translation, hidden.rotation) = ([0.1, -0.172, 0.8], [0.0; 3]);
    let hidden = points(&hidden);
    refused(&|_| hidden.clone(), 2, "the goal: ");
    let domain = place.path().join("empty");
    std::fs::create_dir(&domain).unwrap();
    let new = place.path().join("new.toml");
    let old = place.path().join("old.toml");
    let [old, new] = [&old, &new].map(|path| path.to_str().unwrap());
    let said = vpcctl(&domain, &["teach", "--scene", old, "-o", new]);
    assert_eq!(said.status.code(), Some(4), "{}", stderr(&said));
    assert!(stderr(&said).contains("is a camera at work?"));
}
