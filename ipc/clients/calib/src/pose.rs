//! Where the target is, as seen by a camera that is known.

use vision_calibration_core::{CameraFix, Iso3, NoMeta, PlanarDataset, Pt2};
use vision_calibration_linear::prelude::estimate_planar_pose_from_bearings;
use vision_calibration_optim::{
    BackendSolveOptions, PlanarIntrinsicsParams, PlanarIntrinsicsSolveOptions,
    optimize_planar_intrinsics,
};

use crate::camera::Camera;
use crate::target::Target;
use crate::view::View;

/// The views that tell where the target is, with the target in the camera frame, by least squares
/// on reprojection errors. `None` for those of too few tags.
///
/// # Errors
/// What the library says: numbers that are not finite.
pub fn poses(
    camera: &Camera,
    views: &[View],
    target: &Target,
) -> Result<Vec<Option<Iso3>>, vision_calibration_optim::Error> {
    let first: Vec<_> = views
        .iter()
        .map(|view| start(camera, view, target))
        .collect();
    let pairs = views.iter().zip(&first);
    let (known, starts): (Vec<_>, Vec<_>) = pairs
        .filter_map(|(view, pose)| {
            let obs = view.correspondences(target)?;
            Some((vision_calibration_core::View::new(obs, NoMeta), (*pose)?))
        })
        .unzip();
    if known.is_empty() {
        return Ok(vec![None; views.len()]);
    }
    let parameters = camera.parameters();
    let options = PlanarIntrinsicsSolveOptions {
        fix: parameters.spec().map(CameraFix::all).unwrap_or_default(),
        ..Default::default()
    };
    let solved = optimize_planar_intrinsics(
        &PlanarDataset::new(known)?,
        &PlanarIntrinsicsParams::new(parameters, starts)?,
        options,
        BackendSolveOptions::default(),
    )?;
    let mut refined = solved.params.camera_se3_target.into_iter();
    let each = first.iter().map(|pose| pose.and_then(|_| refined.next()));
    Ok(each.collect())
}

/// The pose by a linear method; `None` for fewer than four corners, or where there is none.
pub(crate) fn start(camera: &Camera, view: &View, target: &Target) -> Option<Iso3> {
    let (points, rays): (Vec<_>, Vec<_>) = view
        .pairs(target)
        .map(|([x, y], pixel)| (Pt2::new(x, y), camera.ray(pixel)))
        .unzip();
    let pose = estimate_planar_pose_from_bearings(&points, &rays).ok()?;
    let is_finite = pose.to_matrix().iter().all(|x| x.is_finite());
    is_finite.then_some(pose)
}
