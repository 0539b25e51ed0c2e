//! Recordings of real arms: OpenCV and a published method judge.
//!
//! They are not here: `VPC_REAL` names a folder with `franka/` (github.com/kvasios/franka-handeye),
//! `hand-eye/` (apps/calibration/hand-eye of github.com/lagadic/visp) and `time/`
//! (github.com/ethz-asl/hand_eye_calibration).

use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use tag_board::{Board, Kind};
use testkit::python::{Environment, run, script};
use vision_calibration_core::{Iso3, Vec3};
use vpc_calib::camera::Camera;
use vpc_calib::detector::Detector;
use vpc_calib::hand_eye::{Mounting, Pair, Reason, calibrate, calibrate_poses};
use vpc_calib::latency::estimate_poses;
use vpc_calib::picture::Picture;
use vpc_calib::pose_file::RobotPose;
use vpc_calib::target::Target;
use vpc_calib::trajectory::Track;

use crate::boards;
use crate::drawn::apart;

type Matrix = [[f64; 4]; 4];

fn pose(rows: &Matrix) -> Iso3 {
    let turn = nalgebra::Matrix3::from_fn(|row, column| rows[row][column]);
    let turn = nalgebra::Rotation3::from_matrix_unchecked(turn).scaled_axis();
    let place = Vec3::new(rows[0][3], rows[1][3], rows[2][3]);
    Iso3::new(place, Vec3::new(turn.x, turn.y, turn.z))
}

/// What the judge says of a folder; `None`, after `not_run`, where there is none.
fn judged<T: DeserializeOwned>(what: &str, kind: &str, folder: &str) -> Option<T> {
    let real = testkit::real(what, folder)?;
    let python = Environment::JUDGES.python(what)?;
    let program = testkit::root().join("ipc/clients/calib/tests/judges/real.py");
    let said = run(script(&python, &program).arg(kind).arg(real.parent()?)).unwrap();
    Some(serde_json::from_str(&said).unwrap())
}

#[derive(Deserialize)]
struct Set {
    name: String,
    poses: Vec<[Matrix; 2]>,
    scatter: BTreeMap<String, f64>,
    /// fx, fy, cx, cy, px, of pictures.
    camera: Option<[f64; 4]>,
}

impl Set {
    /// OpenCV's best of three methods.
    fn best(&self) -> f64 {
        self.scatter.values().copied().fold(f64::INFINITY, f64::min)
    }
}

#[test]
fn a_real_chessboards_corners_are_opencvs_and_calibrate_a_mounting_as_well() {
    let what = "a real chessboard";
    let Some(folder) = testkit::real(what, "hand-eye/data-eye-in-hand") else {
        return;
    };
    let Some(sets) = judged::<Vec<Set>>(what, "hand-eye", "hand-eye") else {
        return;
    };
    let set = sets.iter().find(|set| set.name == "eye in hand").unwrap();
    let board = Board {
        kind: Kind::Chessboard,
        columns: 9,
        rows: 6,
        square_size: Some(0.0236),
        ..Board::default()
    };
    let files: Vec<_> = (1..=8)
        .map(|number| folder.join(format!("franka_image-{number}.png")))
        .collect();
    let theirs = boards::judged(what, &board, &files).unwrap();
    let mut detector = Detector::new(&board).unwrap();
    let (mut off, mut pairs) = (Vec::new(), Vec::new());
    for ((file, theirs), [flange, _]) in files.iter().zip(&theirs).zip(&set.poses) {
        let picture = Picture::read(file).unwrap();
        let view = detector
            .view(file.to_str().unwrap(), &picture.grey().unwrap())
            .unwrap();
        assert_eq!((view.points.len(), theirs.len()), (54, 54), "{file:?}");
        off.extend(theirs.iter().map(|(_, at)| {
            let each = view.points.values().map(|ours| apart(*ours, *at));
            each.fold(f64::INFINITY, f64::min)
        }));
        let flange = pose(flange);
        pairs.push(Pair { flange, view });
    }
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    let [fx, fy, cx, cy] = set.camera.unwrap();
    let camera = Camera {
        size: [640, 480],
        focal: [fx, fy],
        center: [cx, cy],
        distortion: [0.0; 5],
    };
    let target = Target::from(&board);
    let result = calibrate(&pairs, Mounting::EyeInHand, &camera, &target).unwrap();
    // By OpenCV's poses of the board: its place depends on where a board's frame is.
    let places: Vec<_> = set
        .poses
        .iter()
        .map(|[flange, board]| {
            (pose(flange) * result.camera * pose(board))
                .translation
                .vector
        })
        .collect();
    let middle = places.iter().sum::<Vec3>() / places.len() as f64;
    let squares = places.iter().map(|place| (place - middle).norm_squared());
    let scatter = (squares.sum::<f64>() / places.len() as f64).sqrt();
    testkit::tell(format_args!(
        "{what}: corners {mean:.3} px from OpenCV's on the mean; OpenCV's boards scatter by {:.2} mm RMS, under OpenCV's mounting by {:.2}\n{result}",
        1e3 * scatter,
        1e3 * set.best()
    ));
    assert!(mean < 0.05, "{mean}");
    assert!(scatter <= 1.02 * set.best(), "{scatter}");
}

#[test]
fn boards_of_real_arms_scatter_no_more_than_under_opencv_and_the_verdict_says_why() {
    let what = "hand-eye calibrations of real arms";
    let Some(sets) = judged::<Vec<Set>>(what, "hand-eye", "hand-eye") else {
        return;
    };
    assert_eq!(sets.len(), 3);
    for set in sets {
        let poses = set.poses.iter().enumerate();
        let poses: Vec<_> = poses
            .map(|(number, [flange, board])| RobotPose {
                image: number.to_string(),
                flange: pose(flange),
                board: Some(pose(board)),
            })
            .collect();
        let mounting = match set.name.as_str() {
            "eye to hand" => Mounting::EyeToHand,
            _ => Mounting::EyeInHand,
        };
        let result = calibrate_poses(&poses, mounting).unwrap();
        let verdict = result.verdict();
        let theirs = set.scatter.iter().map(|(name, m)| (name, 1e3 * m));
        testkit::tell(format_args!(
            "{}: the board scatters by {:.2} mm RMS, OpenCV: {:.2?}\n{result}{verdict}",
            set.name,
            1e3 * result.scatter,
            theirs.collect::<Vec<_>>()
        ));
        let best = set.best();
        assert!(result.scatter <= best, "{}: {best}", set.name);
        let said = verdict.to_string();
        let [place, turn] = result.uncertainty().unwrap();
        assert!(place > 1e-3 && turn > 0.1, "{place} {turn}");
        assert!(said.contains("make the misses smaller first"), "{said}");
        match set.name.as_str() {
            "franka" => {
                // Its author's result.
                let author = Vec3::new(48.18, 9.55, -36.53);
                let off = 1e3 * result.camera.translation.vector - author;
                assert!(off.norm() < 3.0, "{off}");
                assert!(said.contains("cannot be told apart"), "{said}");
            }
            "eye in hand" => {
                let cause = result.cause.unwrap();
                let Reason::Size { board, focal } = cause.reason else {
                    panic!("{said}");
                };
                let shares = board.zip(focal).unwrap();
                assert!((1.06..1.16).contains(&shares.0), "{shares:?}");
                // Half of what poses miss by.
                assert!(cause.sigma[1][0] < 0.6 * cause.sigma[0][0], "{cause:?}");
            }
            _ => assert!(said.contains("the board's tilt is off by"), "{said}"),
        }
    }
}

#[derive(Deserialize)]
struct Answer {
    robot: Vec<(f64, Matrix)>,
    seen: Vec<(f64, Matrix)>,
    step: f64,
    coarse: f64,
    joint: f64,
}

#[test]
fn a_real_arms_latency_is_that_of_the_published_method() {
    let what = "the latency of a real arm's camera";
    let Some(answer) = judged::<Answer>(what, "time", "time") else {
        return;
    };
    let poses = |rows: &[(f64, Matrix)]| {
        let each = rows.iter().map(|(time, rows)| (*time, pose(rows)));
        each.collect::<Vec<_>>()
    };
    let arm = Track::from(poses(&answer.robot));
    let result = estimate_poses(&poses(&answer.seen), &arm).unwrap();
    let [ours, joint, coarse] = [result.offset, answer.joint, answer.coarse].map(|s| 1e3 * s);
    testkit::tell(format_args!(
        "{what}: {ours:.2} ms, the published method {joint:.2} ms, its correlation alone {coarse:.1} ms\n{result}{}",
        result.verdict()
    ));
    assert!((result.offset - answer.joint).abs() < 2e-3);
    assert!((result.offset - answer.coarse).abs() < answer.step);
    // Parts of the recording disagree by more than the fit of the whole would have it.
    assert!((0.5e-3..2e-3).contains(&result.sigma), "{result}");
}
