use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

/// The world as it is, where the scene and the mount are what the user believes.
struct World {
    mount: Mount,
    scene: Scene,
    flip: fn([f64; 2]) -> [f64; 2],
}

fn believed() -> (Scene, Mount) {
    let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
    let turn = Rotation3::new(Vector3::z() * std::f64::consts::FRAC_PI_4);
    let at = Translation3::new(0.05, -0.05, 0.04);
    let flange_from_camera = Pose::from_parts(at, turn);
    (scene, Mount { flange_from_camera })
}

impl World {
    fn right() -> Self {
        let (scene, mount) = believed();
        Self {
            mount,
            scene,
            flip: |p| p,
        }
    }

    fn off(shift: [f64; 3], turn: [f64; 3]) -> Self {
        let mut world = Self::right();
        let error = Pose::from_parts(
            Translation3::from(shift),
            Rotation3::new(Vector3::from(turn)),
        );
        world.mount.flange_from_camera *= error;
        world
    }

    /// What the moves of `vpc-panda --first-motion` show, with 0.1 px of noise.
    fn moves(&self, seed: u64) -> Vec<Move> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (_, believed) = believed();
        let start = Pose::from_parts(
            Translation3::new(0.4, 0.1, 0.5),
            Rotation3::new(Vector3::new(3.0, 0.2, 0.1)),
        );
        // The pattern 0.4 m before the true camera.
        let object = Pose::from_parts(
            Translation3::new(0.03, -0.02, 0.4),
            Rotation3::new(Vector3::new(0.1, -0.15, 0.3)),
        );
        let base_from_object = self.mount.camera(&start) * object;
        let mut look = |flange: &Pose| {
            let seen = self.mount.camera(flange).inverse() * base_from_object;
            let points = self.scene.pattern.iter().map(|p| {
                let at = seen * Point3::from(*p);
                let Camera { fx, fy, cx, cy, .. } = self.scene.camera;
                let pixel = [fx * at.x / at.z + cx, fy * at.y / at.z + cy];
                (self.flip)(pixel.map(|x| x + random.random_range(-0.17..0.17)))
            });
            points.collect::<Vec<_>>()
        };
        let moves = (0..6).map(|axis| {
            let mut by = SVector::<f64, 6>::zeros();
            by[axis] = if axis < 3 { 0.005 } else { 0.02 };
            let step = Pose::from_parts(
                Translation3::new(by[0], by[1], by[2]),
                Rotation3::new(by.fixed_rows::<3>(3).into_owned()),
            );
            let mount = believed.flange_from_camera;
            let flange = [start, start * mount * step * mount.inverse()];
            Move {
                flange,
                image: [look(&flange[0]), look(&flange[1])],
            }
        });
        moves.collect()
    }

    fn findings(&self, seed: u64) -> Findings {
        let (scene, mount) = believed();
        explain(&scene, &mount, &self.moves(seed)).unwrap()
    }

    /// What is said of it, in any of some worlds with other noise.
    fn said(&self) -> Vec<String> {
        let all: Vec<_> = (1..=5).map(|seed| self.findings(seed).mistakes()).collect();
        let first = all[0].clone();
        for said in &all {
            let kinds = |said: &[String]| {
                let kinds = said.iter().filter_map(|words| words.split_once(':'));
                kinds.map(|(kind, _)| kind.to_owned()).collect::<Vec<_>>()
            };
            assert_eq!(kinds(said), kinds(&first), "{all:?}");
        }
        first
    }
}

fn is_about(said: &[String], kind: &str, words: &str) {
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(
        said[0].starts_with(kind) && said[0].contains(words),
        "{said:?}"
    );
}

#[test]
fn where_all_is_right_nothing_is_said() {
    for world in [
        World::right(),
        // What the law stands.
        World::off([0.005, -0.005, 0.0], [0.0, 0.02, 0.01]),
    ] {
        assert_eq!(world.said(), Vec::<String>::new());
        assert!(world.findings(9).after_px < 0.4);
    }
}

#[test]
fn each_mistake_is_named() {
    let turned = World::off([0.0; 3], [0.0, 0.0, FRAC_PI_2]);
    is_about(&turned.said(), "axes", "the hand-eye file");
    assert!((turned.findings(1).turn.z - FRAC_PI_2).abs() < 0.05);
    let reversed = World::off([0.0; 3], [0.0, 0.0, std::f64::consts::PI]);
    is_about(&reversed.said(), "axes", "the hand-eye file");
    assert!((reversed.findings(1).turn.norm() - std::f64::consts::PI).abs() < 0.05);
    let askew = World::off([0.0; 3], [0.1, 0.1, 0.1]);
    is_about(&askew.said(), "hand-eye", "calibrate again");
    let shifted = World::off([0.05, 0.0, -0.05], [0.0; 3]);
    is_about(&shifted.said(), "hand-eye", "cm from where");
    let mut zoomed = World::right();
    (zoomed.scene.camera.fx, zoomed.scene.camera.fy) = (615.0 * 1.15, 615.0 * 1.15);
    is_about(&zoomed.said(), "focal length", "times the scene's");
    assert!((zoomed.findings(1).focal - 1.15).abs() < 0.04);
    let mut large = World::right();
    for point in &mut large.scene.pattern {
        *point = point.map(|x| 1.3 * x);
    }
    is_about(&large.said(), "pattern", "times as large");
    assert!((large.findings(1).size - 1.3).abs() < 0.08);
    for (flip, words) in [
        (
            (|[u, v]| [639.0 - u, v]) as fn([f64; 2]) -> [f64; 2],
            "left and right",
        ),
        (|[u, v]| [u, 479.0 - v], "top and bottom"),
    ] {
        let mut mirrored = World::right();
        mirrored.flip = flip;
        is_about(&mirrored.said(), "sign", words);
    }
    let mut swapped = World::right();
    swapped.flip = |[u, v]| [v, u];
    is_about(&swapped.said(), "axes", "u and v are swapped");
}

#[test]
fn features_that_do_not_follow_are_not_explained() {
    let mut moves = World::right().moves(1);
    for other in &mut moves {
        other.image[1] = other.image[0]
            .iter()
            .map(|[u, v]| [u + 30.0, v - 25.0])
            .collect();
    }
    let (scene, mount) = believed();
    let found = explain(&scene, &mount, &moves).unwrap();
    assert!(!found.mistakes().is_empty());
    assert!(
        found
            .mistakes()
            .iter()
            .any(|said| said.starts_with("unknown")),
        "{found:?}"
    );
}

#[test]
fn there_are_24_ways_to_turn_a_frame_onto_itself() {
    let all = axes();
    assert_eq!(all.len(), 24);
    for (k, a) in all.iter().enumerate() {
        assert!(
            all[..k]
                .iter()
                .all(|b| (a.matrix() - b.matrix()).amax() > 0.5)
        );
    }
}
