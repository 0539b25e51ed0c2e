//! Chessboards, ChArUco boards and AprilGrids: pictures of them, and their corners.

use tag_board::{Board, Kind};
use vision_calibration_core::Iso3;
use vpc_calib::detector::Detector;
use vpc_calib::picture::Picture;
use vpc_calib::target::{Point, Target};

use crate::synthetic::{Chance, PINHOLE};

/// Samples along a side of a pixel, and levels of paper and ink.
const SAMPLES: usize = 5;
const BLACK: f64 = 30.0;
const GREY: f64 = 120.0;
const WHITE: f64 = 210.0;
/// What the lens blurs, and what the sensor adds: standard deviations, px and levels.
const BLUR: f64 = 0.7;
const NOISE: f64 = 2.0;

fn board(kind: Kind, family: &str, columns: u32, rows: u32) -> Board {
    let is_chess = matches!(kind, Kind::Charuco | Kind::Chessboard);
    Board {
        kind,
        family: family.parse().unwrap(),
        columns,
        rows,
        tag_size: 0.021,
        gap: 0.3 * 0.021,
        square_size: is_chess.then_some(0.028),
        ..Board::default()
    }
}

pub fn boards() -> Vec<(&'static str, Board)> {
    let charuco = |family: &str| board(Kind::Charuco, family, 7, 6);
    vec![
        ("chessboard", board(Kind::Chessboard, "DICT_4X4_50", 6, 5)),
        ("ChArUco 4x4", charuco("DICT_4X4_50")),
        ("ChArUco 5x5", charuco("DICT_5X5_100")),
        ("ChArUco 36h11", charuco("DICT_APRILTAG_36h11")),
        (
            "ChArUco, legacy",
            Board {
                legacy: true,
                ..charuco("DICT_6X6_250")
            },
        ),
        (
            "AprilGrid",
            board(Kind::Aprilgrid, "DICT_APRILTAG_36h11", 6, 5),
        ),
    ]
}

/// The level of a place on a board, m.
fn level(board: &Board, [x, y]: Point) -> f64 {
    let within = |corner: Point, side: f64| {
        let inner = [x - corner[0], y - corner[1]].map(|off| off / side);
        inner
            .iter()
            .all(|off| (0.0..1.0).contains(off))
            .then_some(inner)
    };
    for (number, corner) in board.tags() {
        if let Some(inner) = within(corner, board.tag_size) {
            let black = board.family.black();
            let place = inner.map(|off| ((off * black as f64) as usize).min(black - 1));
            let is_turned = board.kind == Kind::Charuco && board.family.is_upside_down();
            let place = if is_turned {
                place.map(|k| black - 1 - k)
            } else {
                place
            };
            let is_white = board.family.is_white(number, place);
            return if is_white { WHITE } else { BLACK };
        }
    }
    if board
        .squares()
        .any(|(corner, side)| within(corner, side).is_some())
    {
        return BLACK;
    }
    let is_paper = [x, y]
        .iter()
        .zip(board.extent())
        .all(|(x, side)| x.abs() < 0.5 * side + 0.01);
    if is_paper { WHITE } else { GREY }
}

/// What the camera without distortion sees.
fn picture(board: &Board, pose: &Iso3, chance: &mut Chance) -> Picture {
    let size = PINHOLE.size.map(|side| side as usize);
    let turn = *pose.rotation.to_rotation_matrix().matrix();
    let mut matrix = turn;
    matrix.set_column(2, &pose.translation.vector);
    let back = matrix.try_inverse().unwrap();
    let look = |u: f64, v: f64| {
        let ray = [
            (u - PINHOLE.center[0]) / PINHOLE.focal[0],
            (v - PINHOLE.center[1]) / PINHOLE.focal[1],
        ];
        let p = back * vision_calibration_core::Vec3::new(ray[0], ray[1], 1.0);
        level(board, [p.x / p.z, p.y / p.z])
    };
    let offset = |k: usize| (k as f64 + 0.5) / SAMPLES as f64 - 0.5;
    // Where pixels meet.
    let row = size[0] + 1;
    let between: Vec<f64> = (0..row * (size[1] + 1))
        .map(|n| look((n % row) as f64 - 0.5, (n / row) as f64 - 0.5))
        .collect();
    let mut levels: Vec<f64> = (0..size[0] * size[1])
        .map(|n| {
            let [u, v] = [n % size[0], n / size[0]];
            let at = v * row + u;
            let [u, v] = [u as f64, v as f64];
            // Most pixels are of one level.
            let levels = [
                between[at],
                between[at + 1],
                between[at + row],
                between[at + row + 1],
                look(u, v),
            ];
            if levels.iter().all(|level| *level == levels[0]) {
                return levels[0];
            }
            let samples = (0..SAMPLES * SAMPLES)
                .map(|k| look(u + offset(k % SAMPLES), v + offset(k / SAMPLES)));
            samples.sum::<f64>() / (SAMPLES * SAMPLES) as f64
        })
        .collect();
    let weights =
        [-3, -2, -1, 0, 1, 2, 3].map(|k: i32| (-0.5 * (f64::from(k) / BLUR).powi(2)).exp());
    let sum: f64 = weights.iter().sum();
    for step in [1, size[0]] {
        let before = levels.clone();
        for n in 3 * step..levels.len() - 3 * step {
            let near = weights
                .iter()
                .enumerate()
                .map(|(k, weight)| weight * before[n + k * step - 3 * step]);
            levels[n] = near.sum::<f64>() / sum;
        }
    }
    let noisy = levels
        .iter()
        .map(|level| (level + chance.normal(NOISE) + 0.5) as u8);
    Picture {
        size: PINHOLE.size,
        pixels: noisy.collect(),
    }
}

/// What was seen of a board.
#[derive(Default)]
pub struct Seen {
    /// How far our corners are from the truth, px.
    pub ours: Vec<f64>,
    /// The true corners of each picture, by their numbers.
    pub truths: Vec<Vec<(u32, Point)>>,
    /// The pictures.
    pub pictures: Vec<Picture>,
}

/// Looks at so many pictures of a board.
pub fn seen(board: &Board, pictures: usize) -> Seen {
    let (target, mut chance) = (Target::from(board), Chance::new(34));
    let mut detector = Detector::new(board).unwrap();
    let mut seen = Seen::default();
    for _ in 0..pictures {
        // Wholly in the image, and upside down as often as not.
        let pose = loop {
            let turn = Iso3::rotation(vision_calibration_core::Vec3::z() * (3.0 * chance.unit()));
            let pose = chance.pose(35.0) * turn;
            let is_inside =
                |[u, v]: Point| (12.0..627.0).contains(&u) && (12.0..467.0).contains(&v);
            let [width, height] = board.extent().map(|side| 0.5 * side);
            let ends = [
                [-width, -height],
                [width, -height],
                [width, height],
                [-width, height],
            ];
            if ends
                .iter()
                .all(|end| PINHOLE.project(&pose, *end).is_some_and(is_inside))
            {
                break pose;
            }
        };
        let picture = picture(board, &pose, &mut chance);
        let view = detector.view("picture", &picture.grey().unwrap()).unwrap();
        let truth = |number: &u32| {
            PINHOLE
                .project(&pose, target.point(*number).unwrap())
                .unwrap()
        };
        seen.ours.extend(
            view.points
                .iter()
                .map(|(number, at)| apart(*at, truth(number))),
        );
        seen.truths.push(
            (0..4 * 60)
                .filter_map(|n| Some((n, PINHOLE.project(&pose, target.point(n)?)?)))
                .collect::<Vec<_>>(),
        );
        seen.pictures.push(picture);
    }
    seen
}

pub fn apart(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// The root of the mean square.
pub fn rms(off: &[f64]) -> f64 {
    (off.iter().map(|off| off * off).sum::<f64>() / off.len() as f64).sqrt()
}
