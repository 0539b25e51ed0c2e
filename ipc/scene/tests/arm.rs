//! Arm files: what they describe, and what is refused of them.

use std::collections::HashMap;
use std::io;

use scene::{FileError, Scene};

const ARM: &str = include_str!("../scenes/panda.toml");
const PANDA: &str = include_str!("../scenes/panda.urdf");
const FR3_ARM: &str = include_str!("../scenes/fr3.toml");
const FR3: &str = include_str!("../scenes/fr3.urdf");

/// The paper's robot scene with an arm of these two files.
fn read(arm: &str, urdf: &str) -> Result<Scene, FileError> {
    let text = format!("arm = \"cell/a.toml\"\n{}", scene::PAPER_ROBOT);
    let files = HashMap::from([("cell/a.toml", arm), ("cell/panda.urdf", urdf)]);
    Scene::parse_with(&text, "s.toml", &|name| {
        let file = files.get(name).ok_or(io::ErrorKind::NotFound)?;
        Ok(file.as_bytes().to_vec())
    })
}

fn refused(arm: &str, urdf: &str) -> String {
    read(arm, urdf).unwrap_err().to_string()
}

#[test]
fn the_shipped_files_describe_a_panda_and_a_research_3_with_their_camera() {
    for (arm, urdf, end, acceleration) in [(ARM, PANDA, 2.8973, 7.5), (FR3_ARM, FR3, 2.7437, 10.0)]
    {
        let arm = arm.replace("fr3.urdf", "panda.urdf");
        let arm = read(&arm, urdf).unwrap().arm.unwrap();
        assert_eq!((arm.joints.len(), arm.joints[0].range), (7, [-end, end]));
        assert!(arm.is_elbow_free);
        assert_eq!(arm.joints[1].acceleration, acceleration);
        // Straight up with its hand forward and down; the camera 4 cm before the flange, 7 cm
        // aside.
        let [x, y, z] = arm.translation;
        let aside = 0.07 * 0.5f64.sqrt();
        let there = [x - 0.088 - aside, y - aside, z - 0.926 + 0.04];
        assert!(there.iter().all(|apart| apart.abs() < 1e-12), "{there:?}");
        let looks = arm.rotation.map(|row| row[2]);
        assert!((looks[2] + 1.0).abs() < 1e-12, "{looks:?}");
        // The last joint turns about the flange's axis.
        let last = arm.joints[6];
        let apart = [last.axis[2] + 1.0, last.point[0] - 0.088, last.point[1]];
        assert!(apart.iter().all(|apart| apart.abs() < 1e-12), "{last:?}");
    }
}

#[test]
fn an_arm_with_six_joints_has_no_free_elbow() {
    let six = ARM.replace("panda_link8", "panda_link6");
    let six = six.replace("15.0, 7.5", "7.5");
    let error = refused(&six, PANDA);
    assert!(error.contains("elbow = free"), "{error}");
    assert!(error.contains("held: an arm with 6 joints"), "{error}");
}

#[test]
fn a_scene_without_the_key_knows_no_arm() {
    assert_eq!(Scene::parse(scene::PAPER_ROBOT, "s").unwrap().arm, None);
}

#[test]
fn walls_and_points_are_in_the_frames_that_the_schema_says() {
    let text = ARM.replace(
        "[camera]",
        "points = [[0.0, 0.0, 0.1]]\n[[wall]]\nname = \"table\"\nnormal = [0.0, 0.0, 2.0]\noffset = 0.02\n[camera]",
    );
    let arm = read(&text, PANDA).unwrap().arm.unwrap();
    assert_eq!(arm.walls[0].normal, [0.0, 0.0, 1.0]);
    assert_eq!(
        (&*arm.wall_names[0], &*arm.joint_names[3]),
        ("table", "panda_joint4")
    );
    // Along the camera's axes it is 6 cm farther on, and as far back as the camera is aside.
    let [x, y, z] = arm.points[0];
    assert!((z - 0.06).abs() < 1e-12 && (x.hypot(y) - 0.07).abs() < 1e-12);
}

#[test]
fn what_is_wrong_is_named_with_its_file_its_value_and_what_is_allowed() {
    let arm = |from: &str, to: &str| refused(&ARM.replacen(from, to, 1), PANDA);
    let urdf = |from: &str, to: &str| refused(ARM, &PANDA.replacen(from, to, 1));
    for (error, parts) in [
        (
            arm("panda.urdf", "no.urdf"),
            vec!["cell/no.urdf: cannot read"],
        ),
        (
            arm("panda_link8", "hand"),
            vec!["cell/a.toml: tip = hand", "panda_link8"],
        ),
        (
            arm("tip = \"panda_link8\"", "tip = \"panda_link5\""),
            vec!["5 movable", "6 to 7"],
        ),
        (
            arm("base = \"panda_link0\"", "base = \"panda_link8\""),
            vec!["0 movable"],
        ),
        (
            arm("15.0, 7.5", "15.0, 0.0"),
            vec!["acceleration[1] = 0", "0.01 to"],
        ),
        (
            arm("15.0, 7.5,", "15.0,"),
            vec!["acceleration = a list of 6", "a list of 7"],
        ),
        (arm("\nacceleration", "\n# "), vec!["acceleration"]),
        (
            arm("elbow = \"free\"", "elbow = \"up\""),
            vec!["cell/a.toml: elbow = up; allowed: held, free"],
        ),
        (
            arm("[camera]", "goal = [0.0, 0.0]\n[camera]"),
            vec!["goal = a list of 2", "a list of 7"],
        ),
        (
            arm(
                "[camera]",
                "goal = [0, -0.8, 0, -3.0, 0, 1.6, 0.8]\n[camera]",
            ),
            vec!["goal[3] = -3", "-2.872 to -0.270"],
        ),
        (
            arm(
                "[camera]",
                "[[wall]]\nnormal = [0.0, 0.0, 0.0]\noffset = 0.0\n[camera]",
            ),
            vec!["wall[0].normal"],
        ),
        (
            arm(
                "[camera]",
                "[[wall]]\nname = \"a table in the middle of the cell\"\nnormal = [0.0, 0.0, 1.0]\noffset = 0.0\n[camera]",
            ),
            vec!["wall[0].name = a table", "at most 32 bytes"],
        ),
        (arm("urdf =", "ufo = 1\nurdf ="), vec!["ufo"]),
        (urdf("<robot", "<rob"), vec!["cell/panda.urdf: "]),
        (
            urdf("velocity=\"2.175\"", "velocity=\"0\""),
            vec!["panda_joint1: limit velocity", "above 0"],
        ),
        (
            urdf("lower=\"-2.8973\"", "lower=\"2.9\""),
            vec!["lower below upper"],
        ),
        (
            urdf("lower=\"-2.8973\"", "lower=\"nan\""),
            vec!["cell/panda.urdf"],
        ),
        (
            urdf("type=\"revolute\"", "type=\"floating\""),
            vec!["panda_joint1: type", "revolute"],
        ),
        (
            urdf("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>"),
            vec!["panda_joint1: axis"],
        ),
        (
            urdf(
                "<parent link=\"panda_link0\"/>",
                "<parent link=\"panda_link3\"/>",
            ),
            vec!["tip = panda_link8"],
        ),
        (
            urdf("<origin xyz=\"0 0 0.107\"", "<origin xyz=\"nan 0 0.107\""),
            vec!["panda_joint8: origin"],
        ),
        (
            urdf("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"1e200 0 0\"/>"),
            vec!["panda_joint1: axis"],
        ),
        (
            urdf("velocity=\"2.175\"", "velocity=\"inf\""),
            vec!["panda_joint1: limit velocity"],
        ),
        (
            urdf(
                "lower=\"-2.8973\" upper=\"2.8973\"",
                "lower=\"0\" upper=\"0.3\"",
            ),
            vec!["a range of more than twice the key `margin`"],
        ),
    ] {
        for part in parts {
            assert!(error.contains(part), "{error}\nlacks {part}");
        }
    }
}

#[test]
fn no_byte_of_the_files_makes_the_reader_panic() {
    let mut number = 1_u64;
    let mut draw = |most: usize| {
        number = number
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (number >> 33) as usize % most
    };
    for k in 0..4000 {
        let (mut arm, mut urdf) = (ARM.as_bytes().to_vec(), PANDA.as_bytes().to_vec());
        let text = if k % 2 == 0 { &mut arm } else { &mut urdf };
        for _ in 0..=k % 3 {
            let (at, byte) = (draw(text.len()), draw(256) as u8);
            match draw(3) {
                0 => text[at] = byte,
                1 => drop(text.remove(at)),
                _ => text.insert(at, byte),
            }
        }
        let text = format!("arm = \"a.toml\"\n{}", scene::PAPER_ROBOT);
        let _ = Scene::parse_with(&text, "s.toml", &|name| match name {
            "a.toml" => Ok(arm.clone()),
            _ => Ok(urdf.clone()),
        });
    }
}

#[test]
fn a_urdf_that_nests_without_end_is_refused() {
    let deep = format!(
        "<robot>{}{}</robot>",
        "<a>".repeat(200_000),
        "</a>".repeat(200_000)
    );
    let error = refused(ARM, &deep);
    assert!(error.contains("panda.urdf: elements within"), "{error}");
}
