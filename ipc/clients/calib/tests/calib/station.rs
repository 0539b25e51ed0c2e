//! A camera on a robot that misses, before a board.

use tag_board::Board;
use vision_calibration_core::{Iso3, Vec3};
use vpc_calib::hand_eye::Pair;

use crate::synthetic::{CAMERA, Chance};

/// A Panda's repeatability, m and deg.
pub const PANDA: [f64; 2] = [1e-4, 0.02];

/// The camera in the flange.
pub fn mount() -> Iso3 {
    Iso3::new(
        Vec3::new(0.0495, -0.0495, 0.04),
        Vec3::new(0.05, -0.03, 0.8),
    )
}

/// The board in the base.
pub fn place() -> Iso3 {
    Iso3::new(Vec3::new(0.5, 0.05, 0.0), Vec3::new(3.1, 0.0, 0.1))
}

/// Poses at which the camera sees the board; the robot misses by so much along and about each axis.
pub fn pairs(chance: &mut Chance, count: usize, tilt_deg: f64, robot: [f64; 2]) -> Vec<Pair> {
    let mut pairs = Vec::new();
    while pairs.len() < count {
        let pose = chance.pose(tilt_deg);
        let mut view = chance.view(&CAMERA, &Board::default(), &pose, 0.05);
        if view.points.len() >= 40 {
            view.name = format!("{:02}.png", pairs.len());
            let flange = place() * pose.inverse() * mount().inverse();
            let miss = Iso3::new(
                chance.vector(robot[0]),
                chance.vector(robot[1].to_radians()),
            );
            pairs.push(Pair {
                flange: flange * miss,
                view,
            });
        }
    }
    pairs
}
