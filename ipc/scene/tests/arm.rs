//! Arm files: what they describe, and what is refused of them.

use std::collections::HashMap;
use std::io;

use scene::{FileError, Scene, SceneFiles};

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
fn links_have_the_shapes_of_the_urdf_each_in_a_capsule() {
    // A cylinder and the balls at its ends are one.
    let shapes = "<collision><origin xyz=\"0 0 0.1\"/><geometry><sphere radius=\"0.05\"/></geometry></collision>\
        <collision><geometry><cylinder radius=\"0.05\" length=\"0.2\"/></geometry></collision>\
        <collision><origin xyz=\"0 0 -0.1\"/><geometry><sphere radius=\"0.05\"/></geometry></collision>\
        <collision><origin xyz=\"0.5 0 0\"/><geometry><box size=\"0.06 0.4 0.08\"/></geometry></collision>";
    let link = format!("<link name=\"panda_link8\">{shapes}</link>");
    let urdf = PANDA.replace("<link name=\"panda_link8\"/>", &link);
    let [before, arm] = [PANDA, &urdf].map(|urdf| read(ARM, urdf).unwrap().arm.unwrap());
    assert_eq!((before.shapes.len(), arm.shapes.len()), (10, 12));
    let mut found = arm.shapes.iter().zip(&arm.shape_links);
    let [tube, bar] = [0, 1].map(|_| found.find(|(_, name)| *name == "panda_link8").unwrap().0);
    assert_eq!((tube.joints, tube.radius), (7, 0.05));
    // The flange is there at zero, and looks down.
    let close = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
    assert!(close(tube.ends[0], [0.088, 0.0, 0.926 + 0.1]), "{tube:?}");
    assert!(close(tube.ends[1], [0.088, 0.0, 0.926 - 0.1]), "{tube:?}");
    assert!((bar.radius - 0.05).abs() < 1e-12);
    assert!(close(bar.ends[0], [0.588, 0.2, 0.926]), "{bar:?}");
    // The hand, fixed to the flange, is a link of the arm.
    assert!(arm.shape_links.iter().any(|name| name == "panda_hand"));
}

#[test]
fn neighbours_and_what_the_file_ignores_are_not_compared() {
    let boxed = |more: &str| {
        let walls = "[[wall]]\nname = \"floor\"\nnormal = [0.0, 0.0, 1.0]\noffset = 0.0\n\
            [[box]]\nname = \"bin\"\nsize = [0.2, 0.3, 0.4]\ntranslation = [0.5, 0.0, 0.2]\n\
            rotation = [0.0, 0.0, 1.5707963267948966]\n[camera]";
        let text = ARM.replace("ignore = [", &format!("ignore = [{more}"));
        read(&text.replace("[camera]", walls), PANDA)
            .unwrap()
            .arm
            .unwrap()
    };
    let told = |arm: &scene::Arm| {
        let name = |pair: &scene::Pair| {
            let other = match pair.other {
                scene::Other::Link(k) => &arm.shape_links[usize::from(k)],
                scene::Other::Box(k) => &arm.box_names[usize::from(k)],
                scene::Other::Wall(k) => &arm.wall_names[usize::from(k)],
            };
            [
                arm.shape_links[usize::from(pair.shape)].to_string(),
                other.to_string(),
            ]
        };
        arm.pairs.iter().map(name).collect::<Vec<_>>()
    };
    let arm = boxed("");
    let pairs = told(&arm);
    let has = |pairs: &[[String; 2]], a: &str, b: &str| pairs.iter().any(|pair| pair == &[a, b]);
    assert!(has(&pairs, "panda_hand", "panda_link0") && has(&pairs, "panda_link5", "panda_link2"));
    assert!(!has(&pairs, "panda_link7", "panda_link6"), "neighbours");
    assert!(!has(&pairs, "panda_hand", "panda_link5"), "ignored");
    assert!(has(&pairs, "panda_link1", "bin") && has(&pairs, "panda_hand", "floor"));
    assert!(!has(&pairs, "panda_link0", "bin"), "neither moves");
    let turned = arm.boxes[0];
    assert_eq!(
        (turned.half, turned.center),
        ([0.1, 0.15, 0.2], [0.5, 0.0, 0.2])
    );
    assert!((turned.rotation[0][1] + 1.0).abs() < 1e-12, "{turned:?}");
    let pairs = told(&boxed("[\"bin\", \"panda_link1\"], [\"panda_link2\"],"));
    assert!(!has(&pairs, "panda_link1", "bin") && has(&pairs, "panda_link3", "bin"));
    assert!(!pairs.iter().flatten().any(|name| name == "panda_link2"));
}

#[test]
fn what_is_wrong_is_named_with_its_file_its_value_and_what_is_allowed() {
    let arm = |from: &str, to: &str| refused(&ARM.replacen(from, to, 1), PANDA);
    let urdf = |from: &str, to: &str| refused(ARM, &PANDA.replacen(from, to, 1));
    let ball = |k: u32| {
        format!(
            "<collision><origin xyz=\"{k} 0 0\"/><geometry><sphere radius=\"0.1\"/></geometry></collision>"
        )
    };
    let balls: String = (1..=10).map(ball).collect();
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
            arm("tip = \"panda_link8\"", "tip = \"panda_link3\""),
            vec!["3 movable", "4 to 7"],
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
            urdf("lower=\"-2.8973\"", "lower=\"-inf\""),
            vec!["panda_joint1: limit", "both finite"],
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
        (
            urdf(
                "<cylinder radius=\"0.105\" length=\"0.07\"/>",
                "<mesh filename=\"a.stl\"/>",
            ),
            vec![
                "cell/panda.urdf",
                "panda_link0: its collision shape is a mesh",
                "a box, capsule",
            ],
        ),
        (
            urdf("radius=\"0.105\"", "radius=\"-0.1\""),
            vec!["panda_link0: its collision shape", "above 0"],
        ),
        (
            urdf(
                "hand_joint\" type=\"fixed\"",
                "hand_joint\" type=\"planar\"",
            ),
            vec![
                "panda_hand: a joint beside the way",
                "[\"panda_hand\"]",
                "`ignore`",
            ],
        ),
        (
            urdf("</link>", &format!("{balls}</link>")),
            vec!["one more collision shape", "16 of all links"],
        ),
        (
            arm("ignore = [", "ignore = [[\"elbow\"],"),
            vec!["ignore[0] = elbow", "a link, box or wall: panda_link0"],
        ),
        (
            arm("ignore = [", "ignore = [[],"),
            vec!["ignore[0] = a list of 0", "one or two"],
        ),
        (
            arm(
                "[camera]",
                "[[box]]\nsize = [0.0, 1.0, 1.0]\ntranslation = [0.0, 0.0, 0.0]\n[camera]",
            ),
            vec!["box[0].size[0] = 0", "0.001 to 20 m"],
        ),
        (
            arm("ignore = [", "clearance = 0.6\nignore = ["),
            vec!["clearance = 0.6", "0 to 0.5 m"],
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

#[test]
fn what_differs_in_more_than_goal_and_starts_is_named() {
    let read = |text: &str, arm: &str, urdf: &str| {
        let files = HashMap::from([("cell/a.toml", arm), ("cell/panda.urdf", urdf)]);
        SceneFiles::parse(text.to_owned(), "s.toml", &|name| {
            let file = files.get(name).ok_or(io::ErrorKind::NotFound)?;
            Ok(file.as_bytes().to_vec())
        })
        .unwrap()
    };
    let text = format!("arm = \"cell/a.toml\"\n{}", scene::PAPER_ROBOT);
    let old = read(&text, ARM, PANDA);
    let found = |new: SceneFiles| {
        let found = old.differences(&new);
        found.iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    let goal = scene::with_value(&text, "goal", "rotation", "[0.0, 0.0, 0.1]").unwrap();
    let goal = scene::with_value(&goal, "starts", "roll_max", "0.123").unwrap();
    let elsewhere = format!("goal = [0.1, 0.2, 0.3, -1.4, 0.5, 1.6, 0.7]\n{ARM}");
    assert_eq!(found(read(&goal, &elsewhere, PANDA)), [""; 0]);
    let faster = scene::with_value(&goal, "limits", "linear", "0.1").unwrap();
    assert_eq!(
        found(read(&faster, ARM, PANDA)),
        ["limits.linear: 0.01 -> 0.1"]
    );
    assert_eq!(
        found(read(scene::PAPER_ROBOT, ARM, PANDA)),
        ["arm: \"cell/a.toml\" -> none"]
    );
    let nearer = format!("margin = 0.01\n{ARM}");
    let longer = PANDA.replace("0.384", "0.385");
    let named = found(read(&text, &nearer, &longer));
    assert_eq!(named[0], "cell/a.toml.margin: none -> 0.01");
    assert!(
        named[1].starts_with("cell/panda.urdf: SHA-256 "),
        "{named:?}"
    );
    assert_eq!(named.len(), 2);
}
