//! The mounting by least squares on corners in images.

use nalgebra::Matrix6;
use vision_calibration_core::{CameraFix, Iso3, RigView, RigViewObs, Uncertainty, Vec3};
use vision_calibration_optim::{
    BackendSolveOptions, HandeyeDataset, HandeyeEstimate, HandeyeParams, HandeyeSolveOptions,
    RobotPoseMeta, handeye_observer_se3_target, optimize_handeye,
};

use super::poses::Poses;
use super::{HandEye, Mounting, Pair, PairFit};
use crate::camera::Camera;
use crate::target::Target;

/// What the robot's poses are taken to miss by at first.
const FIRST_M: f64 = 0.5e-3;
const FIRST_DEG: f64 = 0.1;

/// Fits again, to corners.
pub(super) fn refine(
    start: HandEye,
    pairs: &[Pair],
    camera: &Camera,
    target: &Target,
    poses: &Poses,
) -> Result<HandEye, vision_calibration_optim::Error> {
    let mounting = start.mounting;
    let estimate = solve(&start, pairs, camera, target)?;
    let fits = fits(mounting, pairs, camera, target, &estimate);
    let squares = fits.iter().filter_map(|fit| fit.rms_px);
    let squares = squares.map(|rms| rms.powi(2)).sum::<f64>();
    let robot = estimate.robot_pose_sigma;
    // The library has the base in the camera where the camera stands.
    let found = mounting.robot(&estimate.params.handeye);
    Ok(HandEye {
        camera: found,
        target: estimate
            .params
            .target_poses
            .first()
            .copied()
            .unwrap_or_default(),
        sigma: sigma(mounting, &estimate),
        robot: robot.map_or([0.0; 2], |robot| [robot.trans_sigma, robot.rot_sigma]),
        scatter: poses.scatter(&found),
        rms_px: Some((squares / fits.len() as f64).sqrt()),
        pairs: fits,
        ..start
    })
}

fn solve(
    start: &HandEye,
    pairs: &[Pair],
    camera: &Camera,
    target: &Target,
) -> Result<HandeyeEstimate, vision_calibration_optim::Error> {
    let mounting = start.mounting;
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
        handeye: mounting.robot(&start.camera),
        target_poses: vec![start.target],
    };
    let dataset = HandeyeDataset::new(views.collect(), 1, mounting.mode())?;
    optimize_handeye(dataset, start, options, BackendSolveOptions::default())
}

fn fits(
    mounting: Mounting,
    pairs: &[Pair],
    camera: &Camera,
    target: &Target,
    estimate: &HandeyeEstimate,
) -> Vec<PairFit> {
    let params = &estimate.params;
    let board = params.target_poses.first().copied().unwrap_or_default();
    let none = vec![[0.0; 6]; pairs.len()];
    let deltas = estimate.robot_deltas.as_ref().unwrap_or(&none);
    let flanges: Vec<Iso3> = pairs.iter().map(|pair| pair.flange).collect();
    let seen = handeye_observer_se3_target(
        mounting.mode(),
        &params.handeye,
        &board,
        &flanges,
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
            rms_px: Some((sum / f64::from(count.max(1))).sqrt()),
            miss: [Vec3::new(x, y, z).norm(), Vec3::new(rx, ry, rz).norm()],
        }
    };
    pairs.iter().zip(&seen).zip(deltas).map(fit).collect()
}

/// Of the mounting; its place first.
fn sigma(mounting: Mounting, estimate: &HandeyeEstimate) -> Result<[f64; 6], String> {
    let Uncertainty::Available(covariance) = &estimate.uncertainty else {
        return Err(format!("{:?}", estimate.uncertainty));
    };
    let frame = match mounting {
        Mounting::EyeInHand => "gripper_se3_camera",
        Mounting::EyeToHand => "camera_se3_base",
    };
    let mut rows = [0; 6];
    for (slot, name) in rows.iter_mut().zip(["tx", "ty", "tz", "rx", "ry", "rz"]) {
        let label = format!("{frame}.{name}");
        *slot = covariance.index(&label).ok_or(label)?;
    }
    let mut matrix = Matrix6::from_fn(|i, j| covariance.covariance[rows[i]][rows[j]]);
    if mounting == Mounting::EyeToHand {
        // (T exp d)^-1 = T^-1 exp(-Ad d): what is asked for is the camera in the base.
        let Iso3 {
            translation,
            rotation,
        } = estimate.params.handeye;
        let mut adjoint = Matrix6::zeros();
        for k in 0..3 {
            let turned = rotation * Vec3::ith(k, 1.0);
            let across = translation.vector.cross(&turned);
            for row in 0..3 {
                adjoint[(row, k)] = turned[row];
                adjoint[(row + 3, k + 3)] = turned[row];
                adjoint[(row, k + 3)] = across[row];
            }
        }
        matrix = adjoint * matrix * adjoint.transpose();
    }
    Ok(std::array::from_fn(|k| matrix[(k, k)].max(0.0).sqrt()))
}
