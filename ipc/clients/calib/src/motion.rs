//! The motions between poses of the robot: whether they are rich enough for a hand-eye calibration,
//! and whether the camera saw the same ones.

use std::fmt;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use vision_calibration_core::{Iso3, Vec3};

/// A rotation counts from here on, deg.
pub const ROTATION_DEG: f64 = 10.0;
/// Two axes are different from here on, deg.
const APART_DEG: f64 = 20.0;
/// Rotations about different axes that a calibration wants.
pub const AXES: usize = 3;
/// Rotations of robot and camera agree to this, deg, where poses and images belong together.
const AGREE_DEG: f64 = 3.0;
/// Another reading of the poses that agrees so much better is the right one.
const BETTER: f64 = 5.0;

/// Counts rotations about different axes among the motions from pose to pose.
pub fn axes(poses: &[Iso3]) -> usize {
    let mut turns: Vec<Vec3> = pairs(poses.len())
        .map(|(i, j)| (poses[i].rotation.inverse() * poses[j].rotation).scaled_axis())
        .filter(|turn| turn.norm().to_degrees() >= ROTATION_DEG)
        .collect();
    turns.sort_by(|a, b| b.norm().total_cmp(&a.norm()));
    let mut axes: Vec<Vec3> = Vec::new();
    for turn in turns {
        let axis = turn.normalize();
        // As lines: the sense does not matter.
        let is_new = |known: &Vec3| known.cross(&axis).norm() > APART_DEG.to_radians().sin();
        if axes.iter().all(is_new) {
            axes.push(axis);
        }
    }
    axes.len()
}

/// How robot poses are to be read so that the camera saw their motions, if not as they are.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MotionError {
    /// Another reading fits.
    #[error("robot poses and images disagree by {found}; they agree to {fits} if {how}")]
    #[allow(missing_docs)]
    Otherwise {
        found: Disagreement,
        fits: Disagreement,
        how: &'static str,
    },
    /// None does.
    #[error(
        "robot poses and images disagree by {0}; is each pose that of its image, did the board stand still?"
    )]
    Unknown(Disagreement),
}

/// How far the motions of robot and camera are apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disagreement {
    /// deg.
    pub rotation_deg: f64,
    /// m.
    pub position: f64,
}

impl fmt::Display for Disagreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            rotation_deg,
            position,
        } = self;
        write!(f, "{rotation_deg:.2} deg and {:.1} mm", 1e3 * position)
    }
}

impl Disagreement {
    const NONE: Self = Self {
        rotation_deg: 180.0,
        position: 10.0,
    };

    /// One number: a degree is as bad as a centimetre.
    fn score(&self) -> f64 {
        self.rotation_deg + 100.0 * self.position
    }
}

/// Compares the robot's motions with the camera's: `flanges` in the base, `targets` in the camera.
///
/// # Errors
/// [`MotionError`]: they are not the same, and how they may be.
pub fn check(flanges: &[Iso3], targets: &[Iso3]) -> Result<(), MotionError> {
    let found = disagreement(flanges, targets);
    if found.rotation_deg <= AGREE_DEG {
        return Ok(());
    }
    let best = readings(flanges)
        .into_iter()
        .map(|(how, poses)| (disagreement(&poses, targets), how))
        .min_by(|a, b| a.0.score().total_cmp(&b.0.score()));
    match best {
        Some((fits, how))
            if BETTER * fits.score() < found.score() && fits.rotation_deg <= AGREE_DEG =>
        {
            Err(MotionError::Otherwise { found, fits, how })
        }
        _ => Err(MotionError::Unknown(found)),
    }
}

/// The camera in the flange frame, in closed form: its turn carries the axes of the camera's turns
/// to those of the robot's, then its place is linear. `None` where turns do not tell.
///
/// An axis counts by the sine of its angle: near half a turn its sense is not known.
pub fn mounting(flanges: &[Iso3], targets: &[Iso3]) -> Option<Iso3> {
    let motion = |(i, j): (usize, usize)| {
        let robot = flanges[i].inverse() * flanges[j];
        (robot, targets[i] * targets[j].inverse())
    };
    let motions: Vec<(Iso3, Iso3)> = pairs(flanges.len()).map(motion).collect();
    let own = |v: Vec3| Vector3::new(v.x, v.y, v.z);
    let sine = |pose: &Iso3| own(pose.rotation.imag() * (2.0 * pose.rotation.w));
    let axes = motions.iter().map(|(a, b)| sine(a) * sine(b).transpose());
    let svd = axes.sum::<Matrix3<f64>>().svd(true, true);
    let (left, right) = (svd.u?, svd.v_t?);
    let mirror = Vector3::new(1.0, 1.0, (left * right).determinant().signum());
    let turn = left * Matrix3::from_diagonal(&mirror) * right;
    let (mut normal, mut sum) = (Matrix3::zeros(), Vector3::zeros());
    for (robot, camera) in &motions {
        let turned = |k: usize| own(robot.rotation * Vec3::ith(k, 1.0) - Vec3::ith(k, 1.0));
        let rows = Matrix3::from_columns(&[turned(0), turned(1), turned(2)]);
        let shift = turn * own(camera.translation.vector) - own(robot.translation.vector);
        normal += rows.transpose() * rows;
        sum += rows.transpose() * shift;
    }
    let place = normal.cholesky()?.solve(&sum);
    let turn = Rotation3::from_matrix_unchecked(turn);
    let turn = UnitQuaternion::from_rotation_matrix(&turn).scaled_axis();
    let is_finite = place.iter().chain(turn.iter()).all(|x| x.is_finite());
    let three = |v: Vector3<f64>| Vec3::new(v.x, v.y, v.z);
    is_finite.then(|| Iso3::new(three(place), three(turn)))
}

/// The medians over all motions, under the mounting that fits best.
fn disagreement(flanges: &[Iso3], targets: &[Iso3]) -> Disagreement {
    let Some(mount) = mounting(flanges, targets) else {
        return Disagreement::NONE;
    };
    // The board in the base, as each pose has it.
    let boards = flanges.iter().zip(targets);
    let boards: Vec<Iso3> = boards
        .map(|(flange, target)| flange * mount * target)
        .collect();
    let median = |difference: &dyn Fn(&Iso3, &Iso3) -> f64, none: f64| {
        let each = pairs(boards.len()).map(|(i, j)| difference(&boards[i], &boards[j]));
        let mut each: Vec<f64> = each.collect();
        each.sort_by(f64::total_cmp);
        let median = each.get(each.len() / 2).copied();
        median.filter(|x| x.is_finite()).unwrap_or(none)
    };
    let Disagreement {
        rotation_deg,
        position,
    } = Disagreement::NONE;
    Disagreement {
        rotation_deg: median(
            &|a, b| a.rotation.angle_to(&b.rotation).to_degrees(),
            rotation_deg,
        ),
        position: median(
            &|a, b| (a.translation.vector - b.translation.vector).norm(),
            position,
        ),
    }
}

/// Mistakes that users make, with the poses as they would be without.
fn readings(flanges: &[Iso3]) -> Vec<(&'static str, Vec<Iso3>)> {
    let each = |change: &dyn Fn(&Iso3) -> Iso3| flanges.iter().map(change).collect::<Vec<_>>();
    let moved = |by: usize| {
        let mut poses = flanges.to_vec();
        poses.rotate_left(by);
        poses
    };
    let w_first = |pose: &Iso3| {
        let mut turned = *pose;
        let q = pose.rotation.coords;
        // Read as x y z w, written as w x y z.
        let vector = Vec3::new(q.y, q.z, q.w);
        let half = vector.norm().atan2(q.x);
        if vector.norm() > 1e-12 {
            let turn = vector * (2.0 * half / vector.norm());
            turned.rotation = Iso3::rotation(turn).rotation;
        }
        turned
    };
    vec![
        (
            "each pose is inverted (the base in the flange, or --eye-to-hand)",
            each(&|pose| pose.inverse()),
        ),
        ("quaternions are written w first", each(&w_first)),
        (
            "the order of the poses is reversed",
            flanges.iter().rev().copied().collect(),
        ),
        ("each image belongs to the pose of the next line", moved(1)),
        (
            "each image belongs to the pose of the line before",
            moved(flanges.len().saturating_sub(1)),
        ),
    ]
}

fn pairs(count: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..count).flat_map(move |i| (i + 1..count).map(move |j| (i, j)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turned(axis: [f64; 3], deg: f64) -> Iso3 {
        Iso3::new(
            Vec3::new(0.4, 0.1, 0.5),
            Vec3::from(axis) * deg.to_radians(),
        )
    }

    const X: [f64; 3] = [1.0, 0.0, 0.0];
    const Y: [f64; 3] = [0.0, 1.0, 0.0];
    const Z: [f64; 3] = [0.0, 0.0, 1.0];

    #[test]
    fn rotations_about_one_axis_count_once_however_many() {
        let one: Vec<_> = [-40.0, -10.0, 20.0, 50.0]
            .map(|deg| turned(Z, deg))
            .to_vec();
        assert_eq!(axes(&one), 1);
        let small: Vec<_> = [X, Y, Z].map(|axis| turned(axis, 4.0)).to_vec();
        assert_eq!(axes(&small), 0);
        let rich = [
            turned(X, 0.0),
            turned(X, 20.0),
            turned(Y, 20.0),
            turned(Z, 30.0),
        ];
        assert!(axes(&rich) >= AXES);
    }

    fn rich() -> (Vec<Iso3>, Vec<Iso3>) {
        let turns = [
            [0.3, 0.0, 0.1],
            [0.0, 0.4, -0.2],
            [-0.3, 0.2, 0.6],
            [0.2, -0.5, 0.3],
            [0.5, 0.3, -0.4],
        ];
        let flanges: Vec<_> = turns
            .map(|turn| Iso3::new(Vec3::new(0.4, turn[0], 0.5 + turn[1]), Vec3::from(turn)))
            .to_vec();
        let mount = Iso3::new(Vec3::new(0.05, -0.05, 0.04), Vec3::new(0.1, 0.0, 0.8));
        let board = Iso3::new(Vec3::new(0.5, 0.0, 0.0), Vec3::new(3.1, 0.1, 0.0));
        let targets = flanges
            .iter()
            .map(|flange| (flange * mount).inverse() * board);
        let targets = targets.collect();
        (flanges, targets)
    }

    #[test]
    fn a_mounting_is_found_from_turns_beyond_a_third_of_a_circle() {
        let turns = [
            [0.1, 0.2, -2.9],
            [3.0, 0.3, 0.0],
            [0.0, 0.4, 2.8],
            [0.3, -3.0, 0.2],
            [1.0, 2.0, 2.0],
        ];
        let flange =
            |turn: [f64; 3]| Iso3::new(Vec3::new(0.4, turn[0] / 9.0, 0.5), Vec3::from(turn));
        let flanges = turns.map(flange).to_vec();
        let mount = Iso3::new(Vec3::new(0.05, -0.05, 0.04), Vec3::new(0.1, 0.0, 3.1));
        let target = Iso3::new(Vec3::new(0.5, 0.0, 0.0), Vec3::new(3.1, 0.1, 0.0));
        let seen = flanges
            .iter()
            .map(|flange| (flange * mount).inverse() * target);
        let seen: Vec<Iso3> = seen.collect();
        let off = mount.inverse() * mounting(&flanges, &seen).unwrap();
        assert!(
            off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-6,
            "{off}"
        );
        assert_eq!(mounting(&flanges[..1], &seen[..1]), None);
    }

    #[test]
    fn a_wrong_reading_of_the_poses_is_named() {
        let (flanges, targets) = rich();
        assert_eq!(check(&flanges, &targets), Ok(()));
        let said = |flanges: &[Iso3]| check(flanges, &targets).unwrap_err().to_string();
        let inverted: Vec<_> = flanges.iter().map(Iso3::inverse).collect();
        assert!(said(&inverted).contains("inverted"), "{}", said(&inverted));
        let reversed: Vec<_> = flanges.iter().rev().copied().collect();
        assert!(said(&reversed).contains("order of the poses is reversed"));
        let mut late = flanges.clone();
        late.rotate_right(1);
        assert!(said(&late).contains("next line"));
        let w_first = flanges.iter().map(|pose| {
            let q = pose.rotation.coords;
            let vector = Vec3::new(q.w, q.x, q.y);
            let turn = vector * (2.0 * vector.norm().atan2(q.z) / vector.norm());
            Iso3::new(pose.translation.vector, turn)
        });
        assert!(said(&w_first.collect::<Vec<_>>()).contains("w first"));
        let mut mixed = flanges.clone();
        mixed.swap(0, 2);
        mixed.swap(1, 4);
        assert!(said(&mixed).contains("is each pose that of its image"));
    }
}
