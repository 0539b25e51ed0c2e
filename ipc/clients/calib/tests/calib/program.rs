//! The program on folders of rendered images: what it writes, what it refuses, and with which exit
//! code.

use std::path::{Path, PathBuf};

use tag_board::Board;
use testkit::{Ended, Place, ended};
use vision_calibration_core::Iso3;
use vpc_calib::picture::Picture;

use crate::rendered::Studio;
use crate::station::{mount, place};
use crate::synthetic::{Chance, PINHOLE};

fn calib(arguments: &[&str]) -> Ended {
    let mut command = testkit::command(env!("CARGO_BIN_EXE_vpc-calib"));
    command.args(arguments);
    ended(command)
}

/// Exit code, and what was said.
fn said(arguments: &[&str]) -> (Option<i32>, String) {
    let Ended {
        code,
        stdout,
        stderr,
        ..
    } = calib(arguments);
    (code, stdout + &stderr)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A folder of images of a board with the poses of the robot.
struct Folder {
    place: Place,
    poses: Vec<Iso3>,
}

const HEADER: &str = "image,x,y,z,qx,qy,qz,qw\n";

impl Folder {
    fn new(seed: u64, count: usize) -> Self {
        let (board, place) = (Board::default(), Place::new());
        let (mut studio, mut chance) = (Studio::new(&board, seed), Chance::new(seed));
        std::fs::create_dir(place.path("images")).unwrap();
        let folder = Self {
            poses: (0..count).map(|_| chance.pose(35.0)).collect(),
            place,
        };
        for (number, pose) in folder.poses.iter().enumerate() {
            studio.picture(pose).write(&folder.image(number)).unwrap();
        }
        folder.write_poses(&folder.lines());
        folder
    }

    fn images(&self) -> PathBuf {
        self.place.path("images")
    }

    fn image(&self, number: usize) -> PathBuf {
        self.images().join(format!("{number:02}.png"))
    }

    fn lines(&self) -> Vec<String> {
        let line = |(number, pose): (usize, &Iso3)| {
            let flange = place() * pose.inverse() * mount().inverse();
            let (t, q) = (flange.translation.vector, flange.rotation.coords);
            let numbers = [t.x, t.y, t.z, q.x, q.y, q.z, q.w].map(|x| format!("{x:.7}"));
            format!("{number:02}.png,{}\n", numbers.join(","))
        };
        self.poses.iter().enumerate().map(line).collect()
    }

    fn write_poses(&self, lines: &[String]) {
        std::fs::write(
            self.images().join("poses.csv"),
            HEADER.to_owned() + &lines.concat(),
        )
        .unwrap();
    }
}

#[test]
fn a_folder_of_images_gives_the_calibration_files() {
    let folder = Folder::new(1, 14);
    let (camera, ros) = (
        folder.place.path("camera.toml"),
        folder.place.path("wrist.yaml"),
    );
    let images = folder.images();
    let arguments = [
        "intrinsics",
        "--images",
        text(&images),
        "-o",
        text(&camera),
        "-o",
        text(&ros),
    ];
    let (code, words) = said(&arguments);
    assert_eq!(code, Some(0), "{words}");
    assert!(
        words.contains("\ngood\n") && words.contains("[camera]"),
        "{words}"
    );
    for path in [&camera, &ros] {
        let lens = vpc_camera::lens::read(path).unwrap();
        assert_eq!(lens.size, PINHOLE.size);
        for k in 0..2 {
            assert!(
                (lens.focal[k] / PINHOLE.focal[k] - 1.0).abs() < 0.003,
                "{lens:?}"
            );
            assert!((lens.centre[k] - PINHOLE.center[k]).abs() < 1.5, "{lens:?}");
        }
        // A corner of the image, where an error of the distortion shows most.
        let pixel = [20.0, 20.0];
        let point = lens.normalize(pixel).unwrap();
        let seen = PINHOLE
            .project(&Iso3::translation(0.0, 0.0, 1.0), point)
            .unwrap();
        assert!(
            (seen[0] - pixel[0]).hypot(seen[1] - pixel[1]) < 2.0,
            "{seen:?}"
        );
    }
    let before = std::fs::read_to_string(&camera).unwrap();
    let (code, words) = said(&arguments);
    assert_eq!(code, Some(73), "{words}");
    assert!(
        words.contains("camera.toml: exists; --force overwrites it"),
        "{words}"
    );
    assert_eq!(std::fs::read_to_string(&camera).unwrap(), before);
    let file = folder.place.path("hand-eye.toml");
    let arguments = [
        "hand-eye",
        "--images",
        text(&images),
        "--camera",
        text(&camera),
        "-o",
        text(&file),
    ];
    let (code, words) = said(&arguments);
    assert_eq!(code, Some(0), "{words}");
    let read = hand_eye::read(&file, hand_eye::Frame::Flange)
        .unwrap()
        .camera;
    let turn = nalgebra::UnitQuaternion::from_rotation_matrix(&read.rotation).scaled_axis();
    let read = Iso3::new(
        <[f64; 3]>::from(read.translation.vector).into(),
        <[f64; 3]>::from(turn).into(),
    );
    let off = mount().inverse() * read;
    assert!(off.translation.vector.norm() < 1e-3, "{words}");
    assert!(off.rotation.angle().to_degrees() < 0.1, "{words}");
}

#[test]
fn bad_input_is_refused_with_words_and_an_exit_code() {
    let folder = Folder::new(2, 6);
    let images = folder.images();
    let camera = folder.place.file(
        "camera.toml",
        "width = 640\nheight = 480\nfx = 615.0\nfy = 612.0\ncx = 322.3\ncy = 236.8\ndistortion = [0, 0, 0, 0, 0]\n",
    );
    let out = folder.place.path("out.toml");
    let lens = |more: &[&str]| {
        let arguments = ["intrinsics", "--images", text(&images), "-o", text(&out)];
        said(&[&arguments[..], more].concat())
    };
    let hand_with = |more: &[&str]| {
        let (images, camera, out) = (text(&images), text(&camera), text(&out));
        let arguments = [
            "hand-eye", "--images", images, "--camera", camera, "-o", out,
        ];
        said(&[&arguments[..], more].concat())
    };
    let hand = || hand_with(&[]);
    let expect = |(code, words): (Option<i32>, String), expected: i32, part: &str| {
        assert!(words.contains(part), "{part}: {words}");
        assert_eq!(code, Some(expected), "{words}");
        assert!(!out.exists());
    };
    // Not enough, and another board.
    expect(lens(&[]), 1, "6 views; take 8 or more");
    let other = folder.place.file("other.toml", "columns = 5\nrows = 7\n");
    expect(lens(&["--board", text(&other)]), 1, "columns = 7");
    let wrong = folder.place.file("wrong.toml", "columns = 0\n");
    expect(
        lens(&["--board", text(&wrong)]),
        78,
        "columns = 0; allowed: 1 to 40",
    );
    expect(
        said(&["intrinsics", "--images", "/nowhere"]),
        66,
        "/nowhere: No such file",
    );
    expect(lens(&["--views", "9"]), 64, "--views");
    let device = folder.place.file(
        "vpc-camera.toml",
        format!(
            "source = \"v4l2:/dev/video99\"\nscene = {:?}\n",
            testkit::scene_file()
        ),
    );
    let live = said(&["intrinsics", "--config", text(&device)]);
    expect(live, 69, "/dev/video99: there is no such device");
    let nowhere = said(&["intrinsics", "--config", "/nowhere.toml"]);
    expect(nowhere, 66, "/nowhere.toml: cannot read");
    let chess = "kind = \"chessboard\"\nsquare_size = 0.02\ncolumns = 9\nrows = 7\n";
    let chess = folder.place.file("chess.toml", chess);
    let same = "9 x 7 inner corners looks the same upside down";
    expect(hand_with(&["--board", text(&chess)]), 78, same);
    // Poses.
    let lines = folder.lines();
    let change = |number: usize, to: &dyn Fn(&str) -> String| {
        let mut lines = lines.clone();
        lines[number] = to(&lines[number]);
        folder.write_poses(&lines);
    };
    change(2, &|line| line.replacen(",0.", ",nan", 1));
    expect(hand(), 78, "line 4, ");
    change(1, &|_| "01.png,400.0,10.0,500.0,0,0,0,1\n".to_owned());
    expect(hand(), 78, "are the units metres?");
    change(3, &|line| line.replace("03.png", "33.png"));
    expect(hand(), 66, "the poses name 33.png, which is not there");
    let mut reversed = folder.lines();
    reversed.reverse();
    let names = lines.iter().map(|line| &line[..6]);
    let reversed: Vec<String> = names
        .zip(&reversed)
        .map(|(name, line)| name.to_owned() + &line[6..])
        .collect();
    folder.write_poses(&reversed);
    expect(hand(), 1, "the order of the poses is reversed");
    folder.write_poses(&lines[..4]);
    expect(hand(), 1, "4 poses at which the board was seen; 5 at least");
    std::fs::remove_file(images.join("poses.csv")).unwrap();
    expect(hand(), 66, "poses.csv");
    // An image of another camera.
    let small = Picture {
        size: [32, 24],
        pixels: vec![0; 32 * 24],
    };
    small.write(&images.join("zz.png")).unwrap();
    expect(lens(&[]), 78, "zz.png: 32x24 px; allowed: 640x480 px");
}

#[test]
fn poses_of_a_file_give_the_mounting_on_the_flange_and_beside_the_arm() {
    let mut chance = Chance::new(9);
    let views: Vec<Iso3> = (0..12).map(|_| chance.pose(35.0)).collect();
    let numbers = |pose: &Iso3| {
        let (t, q) = (pose.translation.vector, pose.rotation.coords);
        [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
            .map(|x| format!("{x:.7}"))
            .join(",")
    };
    let head = HEADER.trim_end();
    let head = format!("{head},board_x,board_y,board_z,board_qx,board_qy,board_qz,board_qw\n");
    let file = |flange: &dyn Fn(&Iso3) -> Iso3| {
        let line = |(number, seen): (usize, &Iso3)| {
            format!("{number},{},{}\n", numbers(&flange(seen)), numbers(seen))
        };
        head.clone() + &views.iter().enumerate().map(line).collect::<String>()
    };
    let files = Place::new();
    let in_hand = file(&|seen| place() * seen.inverse() * mount().inverse());
    let wrist = files.file("wrist.csv", &in_hand);
    let out = files.path("wrist.toml");
    let arguments = ["hand-eye", "--poses", text(&wrist), "-o", text(&out)];
    let (code, words) = said(&arguments);
    assert_eq!(code, Some(0), "{words}");
    let read = hand_eye::read(&out, hand_eye::Frame::Flange)
        .unwrap()
        .camera;
    let apart = read.translation.vector;
    let known = mount().translation.vector;
    assert!(
        (apart.x - known.x).hypot(apart.z - known.z) < 1e-5,
        "{words}"
    );
    let (camera, board) = (place(), mount());
    let to_hand = file(&|seen| camera * seen * board.inverse());
    let beside = files.file("beside.csv", &to_hand);
    let arguments = ["hand-eye", "--poses", text(&beside)];
    let (code, words) = said(&arguments);
    assert_eq!(code, Some(1), "{words}");
    assert!(words.contains("--eye-to-hand"), "{words}");
    let out = files.path("beside.toml");
    let more = ["--eye-to-hand", "-o", text(&out)];
    let (code, words) = said(&[&arguments[..], &more].concat());
    assert_eq!(code, Some(0), "{words}");
    assert!(
        words.contains("camera in the base: 500.00 50.00 0.00 mm"),
        "{words}"
    );
    // No program takes it for a camera on a wrist.
    let error = hand_eye::read(&out, hand_eye::Frame::Flange).unwrap_err();
    assert!(error.to_string().contains("`frame`"), "{error}");
    // Without the board's columns, and without a camera for images.
    let robot = files.file("robot.csv", format!("{HEADER}0,0.3,0,0.5,0,0,0,1\n"));
    let (code, words) = said(&["hand-eye", "--poses", text(&robot)]);
    assert_eq!(code, Some(78), "{words}");
    assert!(
        words.contains("allowed: columns board_x to board_qw too, or --images"),
        "{words}"
    );
    let images = files.path(".");
    let (code, words) = said(&[
        "hand-eye",
        "--poses",
        text(&robot),
        "--images",
        text(&images),
    ]);
    assert_eq!(code, Some(78), "{words}");
    assert!(
        words.contains("--camera = none; allowed: a calibration"),
        "{words}"
    );
}

#[test]
fn the_board_is_drawn_and_not_drawn_over() {
    let place = Place::new();
    let out = place.path("board.svg");
    let (code, words) = said(&["board", "-o", text(&out)]);
    assert_eq!(code, Some(0), "{words}");
    let svg = std::fs::read_to_string(&out).unwrap();
    assert!(svg.contains("width=\"297mm\" height=\"210mm\""));
    assert_eq!(said(&["board", "-o", text(&out)]).0, Some(73));
    let board = place.file("board.toml", "tag_size = 0.02\ngap = 0.005\n");
    let (code, _) = said(&[
        "board",
        "--board",
        text(&board),
        "-o",
        text(&out),
        "--force",
    ]);
    assert_eq!(code, Some(0));
    assert!(
        std::fs::read_to_string(&out)
            .unwrap()
            .contains("tag_size = 0.02")
    );
}
