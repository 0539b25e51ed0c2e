//! The camera on the flange, from poses of the robot and views of a target that stands still.
//!
//! Source: R. Tsai and R. Lenz, "A new technique for fully autonomous and efficient 3D robotics
//! hand/eye calibration" (1989), for the start; then mounting, target and an error of each robot
//! pose at once, by least squares on reprojection errors. The robot's accuracy is estimated with
//! them.

use std::fmt;

use vision_calibration_core::{CameraFix, Iso3, RigView, RigViewObs, Uncertainty, Vec3};
use vision_calibration_linear::handeye::estimate_handeye_dlt;
use vision_calibration_optim::{
    BackendSolveOptions, HandeyeDataset, HandeyeEstimate, HandeyeMode, HandeyeParams,
    HandeyeSolveOptions, RobotPoseMeta, handeye_observer_se3_target, optimize_handeye,
};

use crate::camera::Camera;
use crate::motion::{self, AXES, MotionError, ROTATION_DEG};
use crate::pose;
use crate::scale::{self, Scale};
use crate::target::Target;
use crate::verdict::Verdict;
use crate::view::View;

/// Fewest pairs that are solved, and fewest of a good result.
pub const FEWEST: usize = 5;
const ENOUGH: usize = 8;
/// Greatest standard deviations of a good result: half of what it may be off, 1 mm and 0.1 deg.
const SIGMA_M: f64 = 0.5e-3;
const SIGMA_DEG: f64 = 0.05;
/// A robot's poses miss by less: a Panda repeats to 0.1 mm, and is accurate to 1 mm or so.
const ROBOT_M: f64 = 3e-3;
const ROBOT_DEG: f64 = 0.3;
/// What the robot's poses are taken to miss by at first.
const FIRST_M: f64 = 0.5e-3;
const FIRST_DEG: f64 = 0.1;
/// Greatest reprojection error, RMS, px.
const RMS_PX: f64 = 0.5;
/// The board's size may be off by this share, and by so many standard deviations.
const SCALE: f64 = 0.005;
const SCALE_SIGMAS: f64 = 4.0;
/// Farthest that a camera on a wrist is from the flange, m: what vpc-panda takes.
const FARTHEST: f64 = 1.0;

/// A pose of the robot and what its camera saw there.
#[derive(Clone, Debug)]
pub struct Pair {
    /// The flange in the base (O_T_F), m.
    pub flange: Iso3,
    /// What was seen.
    pub view: View,
}

/// A result.
#[derive(Clone, Debug)]
pub struct HandEye {
    /// The camera in the flange frame (F_T_C), m.
    pub camera: Iso3,
    /// The target in the base (O_T_B), m.
    pub target: Iso3,
    /// Standard deviations of the camera's place and turn, along and about its axes, m and rad;
    /// `Err` has what the pairs do not determine.
    pub sigma: Result<[f64; 6], String>,
    /// What the robot's poses are estimated to miss by, one standard deviation: m, rad.
    pub robot: [f64; 2],
    /// Reprojection error of a corner, RMS, px.
    pub rms_px: f64,
    /// Each pair that was used.
    pub pairs: Vec<PairFit>,
    /// The size of the target.
    pub scale: Option<Scale>,
}

/// How well a pair fits.
#[derive(Clone, Debug)]
pub struct PairFit {
    /// The image's name.
    pub name: String,
    /// Reprojection error of a corner, RMS, px.
    pub rms_px: f64,
    /// By how much the robot's pose would have to be moved and turned, m and rad.
    pub miss: [f64; 2],
}

/// There is no result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum HandEyeError {
    /// Too few pairs.
    #[error(
        "{found} poses at which the board was seen; {FEWEST} at least, {ENOUGH} for a good result"
    )]
    #[allow(missing_docs)]
    TooFew { found: usize },
    /// The motions say too little.
    #[error(
        "the arm turned about {found} axes only, {AXES} are needed; take poses in which the camera is turned by {ROTATION_DEG} deg or more about its x axis, its y axis and its z axis"
    )]
    #[allow(missing_docs)]
    Axes { found: usize },
    /// Robot and camera saw different motions.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// The library found no mounting.
    #[error("no mounting explains these pairs: {0}")]
    Unsolved(String),
}

/// Finds the mounting.
///
/// # Errors
/// [`HandEyeError`] says what is wrong with the pairs.
pub fn calibrate(
    pairs: &[Pair],
    camera: &Camera,
    target: &Target,
) -> Result<HandEye, HandEyeError> {
    let unsolved = |error: &dyn fmt::Display| HandEyeError::Unsolved(error.to_string());
    let mut pairs = pairs.to_vec();
    for pair in &mut pairs {
        pair.view.keep_known(target);
    }
    let views: Vec<View> = pairs.iter().map(|pair| pair.view.clone()).collect();
    let seen = pose::poses(camera, &views, target).map_err(|error| unsolved(&error))?;
    let known = pairs.into_iter().zip(seen);
    let (pairs, seen): (Vec<_>, Vec<_>) =
        known.filter_map(|(pair, seen)| Some((pair, seen?))).unzip();
    if pairs.len() < FEWEST {
        return Err(HandEyeError::TooFew { found: pairs.len() });
    }
    let flanges: Vec<Iso3> = pairs.iter().map(|pair| pair.flange).collect();
    let found = motion::axes(&flanges);
    if found < AXES {
        return Err(HandEyeError::Axes { found });
    }
    motion::check(&flanges, &seen)?;
    let cameras: Vec<_> = seen.iter().map(Iso3::inverse).collect();
    let mount = estimate_handeye_dlt(&flanges, &cameras, 0.5 * ROTATION_DEG);
    let mount = mount.map_err(|error| unsolved(&error))?;
    let scale = scale::estimate(&flanges, &seen, &mount);
    let estimate = solve(&pairs, camera, target, mount, flanges[0] * mount * seen[0]);
    let estimate = estimate.map_err(|error| unsolved(&error))?;
    let fits = fits(&pairs, camera, target, &flanges, &estimate);
    let squares = fits.iter().map(|fit| fit.rms_px.powi(2)).sum::<f64>();
    let robot = estimate.robot_pose_sigma;
    Ok(HandEye {
        camera: estimate.params.handeye,
        target: estimate
            .params
            .target_poses
            .first()
            .copied()
            .unwrap_or_default(),
        sigma: sigma(&estimate.uncertainty),
        robot: robot.map_or([0.0; 2], |robot| [robot.trans_sigma, robot.rot_sigma]),
        rms_px: (squares / fits.len() as f64).sqrt(),
        pairs: fits,
        scale,
    })
}

fn solve(
    pairs: &[Pair],
    camera: &Camera,
    target: &Target,
    mount: Iso3,
    board: Iso3,
) -> Result<HandeyeEstimate, vision_calibration_optim::Error> {
    let views = pairs.iter().filter_map(|pair| {
        let obs = pair.view.correspondences(target)?;
        let meta = RobotPoseMeta {
            base_se3_gripper: pair.flange,
        };
        let obs = RigViewObs {
            cameras: vec![Some(obs)],
        };
        Some(RigView { meta, obs })
    });
    let parameters = camera.parameters();
    let options = HandeyeSolveOptions {
        fix: vec![parameters.spec().map(CameraFix::all).unwrap_or_default()],
        fix_extrinsics: vec![true],
        refine_robot_poses: true,
        robot_rot_sigma: FIRST_DEG.to_radians(),
        robot_trans_sigma: FIRST_M,
        estimate_robot_sigma: true,
        ..Default::default()
    };
    let start = HandeyeParams {
        cameras: vec![parameters],
        cam_to_rig: vec![Iso3::identity()],
        handeye: mount,
        target_poses: vec![board],
    };
    let dataset = HandeyeDataset::new(views.collect(), 1, HandeyeMode::EyeInHand)?;
    optimize_handeye(dataset, start, options, BackendSolveOptions::default())
}

fn fits(
    pairs: &[Pair],
    camera: &Camera,
    target: &Target,
    flanges: &[Iso3],
    estimate: &HandeyeEstimate,
) -> Vec<PairFit> {
    let params = &estimate.params;
    let board = params.target_poses.first().copied().unwrap_or_default();
    let none = vec![[0.0; 6]; pairs.len()];
    let deltas = estimate.robot_deltas.as_ref().unwrap_or(&none);
    let seen = handeye_observer_se3_target(
        HandeyeMode::EyeInHand,
        &params.handeye,
        &board,
        flanges,
        Some(deltas),
    );
    let fit = |((pair, pose), delta): ((&Pair, &Iso3), &[f64; 6])| {
        let misses = pair.view.pairs(target).filter_map(|(place, pixel)| {
            let [u, v] = camera.project(pose, place)?;
            Some((u - pixel[0]).powi(2) + (v - pixel[1]).powi(2))
        });
        let (sum, count) = misses.fold((0.0, 0), |(sum, count), miss| (sum + miss, count + 1));
        let [rx, ry, rz, x, y, z] = *delta;
        PairFit {
            name: pair.view.name.clone(),
            rms_px: (sum / f64::from(count.max(1))).sqrt(),
            miss: [Vec3::new(x, y, z).norm(), Vec3::new(rx, ry, rz).norm()],
        }
    };
    pairs.iter().zip(&seen).zip(deltas).map(fit).collect()
}

/// Of the mounting; its place first.
fn sigma(uncertainty: &Uncertainty) -> Result<[f64; 6], String> {
    let Uncertainty::Available(covariance) = uncertainty else {
        return Err(format!("{uncertainty:?}"));
    };
    let mut sigma = [0.0; 6];
    for (slot, name) in sigma.iter_mut().zip(["tx", "ty", "tz", "rx", "ry", "rz"]) {
        let label = format!("gripper_se3_camera.{name}");
        *slot = covariance.std_dev(&label).ok_or(label)?;
    }
    Ok(sigma)
}

impl HandEye {
    /// The largest standard deviation of its place, m, and of its turn, deg.
    pub fn uncertainty(&self) -> Option<[f64; 2]> {
        let [place, turn] = self.sigma.as_ref().ok()?.as_chunks::<3>().0 else {
            return None;
        };
        let most = |each: &[f64; 3]| each.iter().copied().fold(0.0, f64::max);
        Some([most(place), most(turn).to_degrees()])
    }

    /// Whether it can be used, and what to do if not.
    pub fn verdict(&self) -> Verdict {
        let mut verdict = Verdict::default();
        let count = self.pairs.len();
        verdict.refuse_if(count < ENOUGH, || {
            format!("{count} poses; take {ENOUGH} or more")
        });
        if let Err(what) = &self.sigma {
            verdict.refuse_if(true, || {
                format!("the poses do not determine {what}; take more, turned about other axes")
            });
        }
        let [place, turn] = self.uncertainty().unwrap_or_default();
        verdict.refuse_if(place > SIGMA_M || turn > SIGMA_DEG, || {
            format!(
                "the mounting is known to {:.2} mm and {turn:.3} deg (one standard deviation), {} mm and {SIGMA_DEG} deg are asked for; take more poses, turned by more than 20 deg about different axes",
                1e3 * place,
                1e3 * SIGMA_M
            )
        });
        let [moved, turned] = [self.robot[0], self.robot[1].to_degrees()];
        verdict.refuse_if(moved > ROBOT_M || turned > ROBOT_DEG, || {
            format!(
                "arm and images miss each other by {:.1} mm and {turned:.2} deg; did the arm stand still in each image, did the board?",
                1e3 * moved
            )
        });
        verdict.refuse_if(self.rms_px > RMS_PX, || {
            format!(
                "reprojection errors of {:.2} px RMS, {RMS_PX} px at most; is this the calibration of this camera, is the board flat?",
                self.rms_px
            )
        });
        if let Some(scale) = self.scale {
            let off = scale.size - 1.0;
            let is_off = off.abs() > SCALE.max(SCALE_SIGMAS * scale.sigma);
            verdict.refuse_if(is_off, || {
                format!(
                    "by the arm's motion the board is {:.1} % {} than its file says; measure the side of a black square, or calibrate the focal length again",
                    100.0 * off.abs(),
                    if off > 0.0 { "larger" } else { "smaller" }
                )
            });
        }
        let far = self.camera.translation.vector.norm();
        verdict.refuse_if(far > FARTHEST, || {
            format!("the camera is {far:.2} m from the flange; {FARTHEST} m at most")
        });
        verdict
    }
}

impl fmt::Display for HandEye {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place = self.camera.translation.vector * 1e3;
        let turn = self.camera.rotation.scaled_axis() * 180.0 / std::f64::consts::PI;
        write!(
            f,
            "camera in the flange: {:.2} {:.2} {:.2} mm, ",
            place.x, place.y, place.z
        )?;
        write!(
            f,
            "rotation vector {:.3} {:.3} {:.3} deg",
            turn.x, turn.y, turn.z
        )?;
        if let Some([place, turn]) = self.uncertainty() {
            write!(f, "; +- {:.2} mm, {turn:.3} deg", 1e3 * place)?;
        }
        let place = self.target.translation.vector * 1e3;
        writeln!(
            f,
            "\nboard in the base: {:.1} {:.1} {:.1} mm",
            place.x, place.y, place.z
        )?;
        writeln!(
            f,
            "{} poses; reprojection error {:.3} px RMS; the arm's poses miss by {:.2} mm, {:.3} deg",
            self.pairs.len(),
            self.rms_px,
            1e3 * self.robot[0],
            self.robot[1].to_degrees()
        )?;
        if let Some(scale) = self.scale {
            writeln!(
                f,
                "size of the board by the arm's motion: {:.4} of the file's, +- {:.4}",
                scale.size, scale.sigma
            )?;
        }
        let score = |fit: &PairFit| fit.miss[0] / ROBOT_M + fit.miss[1].to_degrees() / ROBOT_DEG;
        let worst = self
            .pairs
            .iter()
            .max_by(|a, b| score(a).total_cmp(&score(b)));
        if let Some(worst) = worst {
            writeln!(
                f,
                "worst pose {}: {:.2} mm, {:.3} deg, {:.3} px",
                worst.name,
                1e3 * worst.miss[0],
                worst.miss[1].to_degrees(),
                worst.rms_px
            )?;
        }
        Ok(())
    }
}
