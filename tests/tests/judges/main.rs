//! Judges from outside: other libraries and a real robot say where the joints of an arm file put
//! the camera, and how far its links are apart; pictures of real cameras where its tags are; other
//! simulators whether their arms arrive. Other programs judge the documents, too, and what they say
//! runs in real time.

mod book;
#[allow(dead_code, reason = "`documents` has all of it")]
#[path = "../documents/call.rs"]
mod call;
mod clients;
#[path = "../documents/commands.rs"]
mod commands;
mod documents;
mod external;
mod families;
#[allow(dead_code, reason = "`documents` has all of it")]
#[path = "../documents/markdown.rs"]
mod markdown;
mod own_robot;
mod pictures;
#[allow(dead_code, reason = "`documents` has all of it")]
#[path = "../documents/reference.rs"]
mod reference;
mod refit;
#[allow(dead_code, reason = "`documents` has all of it")]
#[path = "../documents/session.rs"]
mod session;
mod worlds;

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

use arm::{Arm, Chain, JOINTS, Jacobian, Joints, Other, Pose};
use nalgebra::{Matrix3, Rotation3, Translation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::Scene;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use testkit::python::Environment;
use testkit::{Place, real, root, tell};

/// Postures of each arm.
const POSTURES: usize = 300;
/// What two kinematics may differ by, m and rad.
const EXACT: f64 = 1e-9;
/// What two libraries' distances of the same bodies may differ by, m.
const SEPARATION: f64 = 1e-6;
/// The Cartesian pose of a real robot's reading, m.
const READING: f64 = 1e-6;
/// How far the robot's own rotations, of single precision, are from being rotations.
const SINGLE: f64 = 5e-5;

/// The arm that a file describes, as programs read it.
fn arm(file: &Path) -> (scene::Arm, arm::Arm) {
    let place = Place::new();
    let text = format!("arm = {:?}\n{}", file, scene::PAPER_ROBOT);
    let scene = Scene::read(&place.file("scene.toml", text)).unwrap();
    let described = scene.arm.unwrap();
    let arm = Arm::from(&described);
    (described, arm)
}

/// What Pinocchio says of a posture.
#[derive(Deserialize)]
struct Judged {
    pose: [[f64; 4]; 3],
    camera: [Vec<f64>; 6],
    end_effector: [Vec<f64>; 6],
}

/// What a judge says of each posture of an arm file.
fn judged<T: DeserializeOwned>(
    python: &Path,
    judge: &str,
    file: &Path,
    postures: &[Vec<f64>],
) -> Vec<T> {
    let program = root().join("tests/tests/judges").join(judge);
    let mut judge = testkit::command(python);
    judge.arg(program);
    judge.arg(file).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut judge = judge.spawn().unwrap();
    let asked = serde_json::to_vec(postures).unwrap();
    judge.stdin.take().unwrap().write_all(&asked).unwrap();
    let answer = judge.wait_with_output().unwrap();
    assert!(answer.status.success(), "{}", file.display());
    serde_json::from_slice(&answer.stdout).unwrap()
}

/// A Panda on a slanted stand, its first joint a rail, another's axis askew.
fn askew() -> Place {
    let place = Place::new();
    let scenes = root().join("ipc/scene/scenes");
    let read = |name: &str| fs::read_to_string(scenes.join(name)).unwrap();
    let (head, tail) = ("type=\"revolute\"", "<axis xyz=\"0 0 1\"/>");
    let urdf = read("panda.urdf").replacen(head, "type=\"prismatic\"", 1);
    let (before, after) = urdf.split_once("panda_joint3").unwrap();
    let after = after.replacen(tail, "<axis xyz=\"0.3 -0.5 0.8\"/>", 1);
    let stand = "<link name=\"cell\"/><joint name=\"stand\" type=\"fixed\"><parent link=\"cell\"/>\
                 <child link=\"panda_link0\"/><origin xyz=\"0.1 0.2 0.3\" rpy=\"0.4 0.5 0.6\"/></joint>";
    let urdf = format!("{before}panda_joint3{after}").replace("</robot>", stand);
    place.file("panda.urdf", urdf + "</robot>");
    place.file("arm.toml", read("panda.toml"));
    place
}

#[test]
fn camera_and_jacobian_of_every_arm_file_are_those_of_pinocchio() {
    let Some(python) = Environment::JUDGES.python("Pinocchio as a judge") else {
        return;
    };
    let (shipped, tested) = (root().join("ipc/scene/scenes"), root().join("tests/arms"));
    let askew = askew();
    let files = [
        shipped.join("panda.toml"),
        shipped.join("fr3.toml"),
        tested.join("ur5e.toml"),
        tested.join("xarm6.toml"),
        askew.path("arm.toml"),
    ];
    let mut random = ChaCha8Rng::seed_from_u64(33);
    for file in files {
        let (described, arm) = arm(&file);
        let postures = postures(&described, &mut random);
        let judged: Vec<Judged> = judged(&python, "pinocchio_judge.py", &file, &postures);
        assert_eq!(judged.len(), POSTURES);
        let mut apart = [0.0_f64; 3];
        for (posture, judged) in postures.iter().zip(judged) {
            let q = arm::joints(posture);
            let (camera, jacobian) = arm.chain.at(&q);
            let found = camera.to_homogeneous();
            let entries = (0..3).flat_map(|i| (0..4).map(move |j| (i, j)));
            let pose = entries.map(|(i, j)| (found[(i, j)] - judged.pose[i][j]).abs());
            let each = [
                pose.fold(0.0, f64::max),
                difference(&jacobian, &judged.camera),
                difference(&arm.shaped.jacobian(&q), &judged.end_effector),
            ];
            apart = [0, 1, 2].map(|k| apart[k].max(each[k]));
        }
        tell(format!(
            "{}: {POSTURES} postures: pose to {:.0e}, Jacobians to {:.0e} and {:.0e}",
            file.display(),
            apart[0],
            apart[1],
            apart[2],
        ));
        assert!(apart.iter().all(|apart| *apart < EXACT), "{apart:?}");
    }
}

/// Anywhere within the ranges.
fn postures(arm: &scene::Arm, random: &mut ChaCha8Rng) -> Vec<Vec<f64>> {
    let mut posture = |_| {
        let joints = arm.joints.iter();
        let at = joints.map(|joint| random.random_range(joint.range[0]..joint.range[1]));
        at.collect()
    };
    (0..POSTURES).map(&mut posture).collect()
}

/// An arm file with a table that is a box, and a slanted one.
fn boxed(file: &Path) -> Place {
    let place = Place::new();
    let text = fs::read_to_string(file).unwrap();
    let urdf = file.with_extension("urdf");
    let name = urdf.file_name().unwrap().to_str().unwrap();
    place.file(name, fs::read_to_string(&urdf).unwrap());
    let boxes = "[[box]]\nname = \"table\"\nsize = [1.2, 1.6, 0.1]\ntranslation = [0.3, 0.1, -0.05]\n\
        [[box]]\nname = \"fixture\"\nsize = [0.1, 0.2, 0.3]\ntranslation = [0.4, 0.2, 0.3]\n\
        rotation = [0.4, -0.7, 1.1]\n";
    place.file("arm.toml", text + boxes);
    place
}

/// The distance of two bodies, by their names.
type Distances = BTreeMap<String, f64>;

#[test]
fn distances_of_links_and_boxes_are_those_of_coal() {
    let Some(python) = Environment::JUDGES.python("coal as a judge") else {
        return;
    };
    let mut random = ChaCha8Rng::seed_from_u64(35);
    let shipped = root().join("ipc/scene/scenes");
    let files = ["panda.toml", "fr3.toml"].map(|name| shipped.join(name));
    for file in files
        .into_iter()
        .chain([root().join("tests/arms/ur5e.toml")])
    {
        let place = boxed(&file);
        let (described, arm) = arm(&place.path("arm.toml"));
        let postures = postures(&described, &mut random);
        let judged: Vec<Distances> =
            judged(&python, "coal_judge.py", &place.path("arm.toml"), &postures);
        assert_eq!(judged.len(), POSTURES);
        let (mut apart, mut count, mut near) = (0.0_f64, 0, 0);
        for (posture, judged) in postures.iter().zip(judged) {
            let q = arm::joints(posture);
            let mut ours = Distances::new();
            for (pair, distance) in arm.distances(&q) {
                let name = |k: u8| described.shape_links[usize::from(k)].as_str();
                let other = match pair.other {
                    Other::Link(k) => name(k),
                    Other::Box(k) => described.box_names[usize::from(k)].as_str(),
                    Other::Wall(_) => continue,
                };
                let key = format!("{} {other}", name(pair.shape));
                let least = ours.entry(key).or_insert(f64::INFINITY);
                *least = least.min(distance);
            }
            for (key, ours) in ours {
                // Where axes touch, both know only that bodies overlap.
                let theirs = judged[&key];
                if theirs > 0.0 || ours > 0.0 {
                    apart = apart.max((ours - theirs).abs());
                    near += usize::from(ours < 0.1);
                }
                count += 1;
            }
        }
        tell(format!(
            "{}: {count} distances, {near} of them below 10 cm: to {apart:.0e} m",
            file.display()
        ));
        assert!(near > 100, "{near}");
        assert!(apart < SEPARATION, "{apart}");
    }
}

/// The largest entry in which a Jacobian differs from another one with a column for each joint.
fn difference(jacobian: &Jacobian, judged: &[Vec<f64>; 6]) -> f64 {
    let entries = (0..6).flat_map(|i| (0..JOINTS).map(move |j| (i, j)));
    let each = entries.map(|(i, j)| {
        let judged = judged[i].get(j).copied().unwrap_or_default();
        (jacobian[(i, j)] - judged).abs()
    });
    each.fold(0.0, f64::max)
}

/// The emulator has kinematics of its own.
#[test]
fn the_emulated_arm_of_a_file_is_where_the_laws_is() {
    let (askew, tested) = (askew(), root().join("tests/arms"));
    let files =
        ["ur5e.toml", "xarm6.toml", "five.toml", "scara.toml"].map(|name| tested.join(name));
    let mut random = ChaCha8Rng::seed_from_u64(34);
    let goal = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap().goal;
    for file in files.into_iter().chain([askew.path("arm.toml")]) {
        let (described, arm) = arm(&file);
        let robot = hw_sim::robot::described::settings(&described, &goal).robot;
        let camera = robot.model.chain(Pose::identity());
        let end_effector = robot.model.chain(robot.flange_from_ee());
        for _ in 0..POSTURES {
            let q = Joints::from_fn(|k, _| match k < described.joints.len() {
                true => random.random_range(-3.0..3.0),
                false => 0.0,
            });
            let (emulated, (pose, jacobian)) = (camera.posture(&q), arm.chain.at(&q));
            let apart = emulated.pose.to_homogeneous() - pose.to_homogeneous();
            assert!(apart.amax() < EXACT, "{apart}");
            assert!((emulated.jacobian - jacobian).amax() < EXACT);
            let jacobian = end_effector.posture(&q).jacobian;
            assert!((jacobian - arm.shaped.jacobian(&q)).amax() < EXACT);
        }
    }
}

/// A reading of the robot's interface.
#[derive(Deserialize)]
struct Reading {
    joint_pose: [f64; 7],
    #[serde(rename = "O_T_EE")]
    base_from_hand: [f64; 16],
}

/// Their author states no licence, so that they are not here: `VPC_REAL` names a folder with
/// `franka/captured-data/pose_00/data.json` and so on, which github.com/kvasios/franka-handeye
/// publishes.
#[test]
fn a_real_panda_is_where_the_arm_file_has_it() {
    let what = "readings of a real Panda";
    let Some(place) = real(what, "franka/captured-data") else {
        return;
    };
    let (_, arm) = arm(&root().join("ipc/scene/scenes/panda.toml"));
    // The flange, by the camera's mounting: 45 degrees on it, 7 cm aside and 4 cm above.
    let aside = 0.07 * 0.5_f64.sqrt();
    let turned = |angle: f64| Rotation3::new(Vector3::z() * angle.to_radians());
    let camera = Pose::from_parts(Translation3::new(aside, -aside, 0.04), turned(45.0));
    let hand = Pose::from_parts(Translation3::new(0.0, 0.0, 0.1034), turned(-45.0));
    let chain: Chain = arm.chain.with_ee(camera.inverse() * hand);
    let (mut count, mut most) = (0, 0.0_f64);
    for folder in fs::read_dir(place).unwrap() {
        let text = fs::read(folder.unwrap().path().join("data.json")).unwrap();
        let reading: Reading = serde_json::from_slice(&text).unwrap();
        let pose = chain.pose(&Joints::from(reading.joint_pose));
        let told = |i: usize, j: usize| reading.base_from_hand[4 * i + j];
        let apart = pose.translation.vector - Vector3::from_fn(|i, _| told(i, 3));
        let turn = pose.rotation.matrix() - Matrix3::from_fn(told);
        assert!(apart.norm() < READING, "{apart}");
        assert!(turn.norm() < SINGLE, "{turn}");
        (count, most) = (count + 1, most.max(apart.norm()));
    }
    assert_eq!(count, 12);
    tell(format!("{count} {what}: to {most:.0e} m"));
}
