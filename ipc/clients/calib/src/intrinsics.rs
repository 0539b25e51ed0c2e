//! Focal lengths, principal point and distortion, from views of a flat target.
//!
//! Source: Z. Zhang, "A flexible new technique for camera calibration" (2000), for the start; then
//! all parameters and poses at once, by least squares on reprojection errors.

mod report;

use std::fmt;

use vision_calibration_core::{
    CameraFix, Iso3, NoMeta, PlanarDataset, Uncertainty, UncertaintyUnavailable, Vec3,
};
use vision_calibration_linear::prelude::{
    DistortionFitOptions, IterativeIntrinsicsOptions, estimate_intrinsics_iterative,
};
use vision_calibration_optim::{
    BackendSolveOptions, PlanarIntrinsicsEstimate, PlanarIntrinsicsParams,
    PlanarIntrinsicsSolveOptions, optimize_planar_intrinsics,
};

use crate::camera::Camera;
use crate::pose;
use crate::target::{Point, Target};
use crate::view::View;

/// Fewest views that determine the parameters, with one to spare.
pub const FEWEST: usize = 4;
/// Fewest views of a result that is good.
const ENOUGH: usize = 8;
/// Fewest points of a view that is used.
const POINTS: usize = 8;
/// A point that misses by so many standard deviations, and by so many px, is dropped.
const OUTLIER: f64 = 6.0;
const OUTLIER_PX: f64 = 0.5;

/// A result.
#[derive(Clone, Debug)]
pub struct Intrinsics {
    /// The camera.
    pub camera: Camera,
    /// Standard deviations by name: fx fy cx cy (px), k1 k2 p1 p2 and k3 if it was estimated.
    /// `Err` has what the views do not determine.
    pub sigma: Result<Vec<(String, f64)>, String>,
    /// Reprojection error of a corner, RMS, px.
    pub rms_px: f64,
    /// Each view that was used.
    pub views: Vec<ViewFit>,
    /// Points that were used, and those that were dropped because they miss.
    pub points: [usize; 2],
    /// Points that each ninth of the image has shown, row by row.
    pub coverage: [usize; 9],
}

/// How well a view fits.
#[derive(Clone, Debug)]
pub struct ViewFit {
    /// Its name.
    pub name: String,
    /// Reprojection error of a corner, RMS, px.
    pub rms_px: f64,
    /// The target in the camera frame.
    pub target: Iso3,
}

/// There is no result.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IntrinsicsError {
    /// Too few views.
    #[error(
        "{found} views with {POINTS} corners of the board or more; {FEWEST} at least, {ENOUGH} for a good result"
    )]
    #[allow(missing_docs)]
    TooFew { found: usize },
    /// The library found no camera.
    #[error(
        "no camera explains these views ({0}); are they tilted against each other, by more than 20 deg?"
    )]
    Unsolved(String),
}

/// Calibrates a camera from views of its images of this size. `k3` is estimated where asked for,
/// else 0: only lenses with a strong distortion need it.
///
/// # Errors
/// [`IntrinsicsError`].
pub fn calibrate(
    views: &[View],
    target: &Target,
    size: [u32; 2],
    k3: bool,
) -> Result<Intrinsics, IntrinsicsError> {
    let mut views = views.to_vec();
    for view in &mut views {
        view.keep_known(target);
    }
    views.retain(|view| view.points.len() >= POINTS);
    if views.len() < FEWEST {
        return Err(IntrinsicsError::TooFew { found: views.len() });
    }
    let mut estimate = solve(&views, target, size, k3)?;
    let all: usize = views.iter().map(|view| view.points.len()).sum();
    drop_outliers(&mut views, target, &estimate, size);
    let kept: usize = views.iter().map(|view| view.points.len()).sum();
    views.retain(|view| view.points.len() >= POINTS);
    if kept < all {
        if views.len() < FEWEST {
            return Err(IntrinsicsError::TooFew { found: views.len() });
        }
        estimate = solve(&views, target, size, k3)?;
    }
    let camera = camera(&estimate, size)?;
    let poses = &estimate.params.camera_se3_target;
    let fit = |(view, pose): (&View, &Iso3)| ViewFit {
        name: view.name.clone(),
        rms_px: rms(misses(&camera, pose, target, view)),
        target: *pose,
    };
    let every = views.iter().zip(poses);
    Ok(Intrinsics {
        rms_px: rms(every.flat_map(|(view, pose)| misses(&camera, pose, target, view))),
        views: views.iter().zip(poses).map(fit).collect(),
        sigma: sigma(&estimate.uncertainty),
        points: [kept, all - kept],
        coverage: coverage(&views, size),
        camera,
    })
}

/// Zhang's start, then least squares.
fn solve(
    views: &[View],
    target: &Target,
    size: [u32; 2],
    k3: bool,
) -> Result<PlanarIntrinsicsEstimate, IntrinsicsError> {
    let unsolved = |error: &dyn fmt::Display| IntrinsicsError::Unsolved(error.to_string());
    let known = views.iter().filter_map(|view| view.correspondences(target));
    let known = known.map(|obs| vision_calibration_core::View::new(obs, NoMeta));
    let dataset = PlanarDataset::new(known.collect()).map_err(|error| unsolved(&error))?;
    let options = IterativeIntrinsicsOptions {
        distortion_opts: DistortionFitOptions {
            fix_k3: true,
            ..Default::default()
        },
        ..Default::default()
    };
    let width = f64::from(size[0]);
    let guess = Camera {
        size,
        focal: [width; 2],
        center: [0.5 * (width - 1.0), 0.5 * (f64::from(size[1]) - 1.0)],
        distortion: [0.0; 5],
    };
    // Views that are not tilted give Zhang's method nothing; then the uncertainty tells.
    let zhang = estimate_intrinsics_iterative(&dataset, options).ok();
    let zhang = zhang.and_then(|found| {
        let found = Camera::of(
            &vision_calibration_core::pinhole_camera_params(&found),
            size,
        )?;
        let is_lens = found
            .focal
            .iter()
            .all(|f| (0.2..20.0).contains(&(f / width)));
        is_lens.then_some(found)
    });
    let start = zhang.unwrap_or(guess);
    let poses = views.iter().map(|view| pose::start(&start, view, target));
    let poses: Option<Vec<_>> = poses.collect();
    let poses = poses.ok_or_else(|| unsolved(&"a view without a pose"))?;
    let fixed = match k3 {
        true => vec![],
        false => vec!["k3".to_owned()],
    };
    let options = PlanarIntrinsicsSolveOptions {
        fix: CameraFix {
            distortion: Some(fixed),
            ..Default::default()
        },
        ..Default::default()
    };
    let start = PlanarIntrinsicsParams::new(start.parameters(), poses);
    let start = start.map_err(|error| unsolved(&error))?;
    optimize_planar_intrinsics(&dataset, &start, options, BackendSolveOptions::default())
        .map_err(|error| unsolved(&error))
}

fn camera(estimate: &PlanarIntrinsicsEstimate, size: [u32; 2]) -> Result<Camera, IntrinsicsError> {
    let found = Camera::of(&estimate.params.camera, size);
    let is_finite = |camera: &Camera| {
        let numbers = camera
            .focal
            .iter()
            .chain(&camera.center)
            .chain(&camera.distortion);
        numbers.into_iter().all(|x| x.is_finite()) && camera.focal.iter().all(|f| *f > 0.0)
    };
    found
        .filter(is_finite)
        .ok_or_else(|| IntrinsicsError::Unsolved("it is not finite".to_owned()))
}

/// How far a point is from where it is expected, px; `None` for one behind the camera.
fn miss(camera: &Camera, pose: &Iso3, (place, seen): (Point, Point)) -> Option<f64> {
    let [u, v] = camera.project(pose, place)?;
    Some((u - seen[0]).hypot(v - seen[1]))
}

fn misses<'a>(
    camera: &'a Camera,
    pose: &'a Iso3,
    target: &'a Target,
    view: &'a View,
) -> impl Iterator<Item = f64> + 'a {
    let pairs = view.pairs(target);
    pairs.filter_map(|pair| miss(camera, pose, pair))
}

fn drop_outliers(
    views: &mut [View],
    target: &Target,
    estimate: &PlanarIntrinsicsEstimate,
    size: [u32; 2],
) {
    let Some(camera) = Camera::of(&estimate.params.camera, size) else {
        return;
    };
    let noise = match estimate.uncertainty.covariance() {
        Some(covariance) => covariance
            .noise
            .iter()
            .map(|noise| noise.level.value())
            .fold(0.0, f64::max),
        None => return,
    };
    let most = OUTLIER_PX.max(OUTLIER * noise);
    for (view, pose) in views.iter_mut().zip(&estimate.params.camera_se3_target) {
        view.points.retain(|number, seen| {
            let off = |place| miss(&camera, pose, (place, *seen));
            target
                .point(*number)
                .and_then(off)
                .is_none_or(|off| off <= most)
        });
    }
}

fn sigma(uncertainty: &Uncertainty) -> Result<Vec<(String, f64)>, String> {
    let covariance = match uncertainty {
        Uncertainty::Available(covariance) => covariance,
        Uncertainty::Unavailable { reason } => {
            return Err(match reason {
                UncertaintyUnavailable::RankDeficient { unobservable } => unobservable.join(", "),
                reason => format!("{reason:?}"),
            });
        }
    };
    let known = covariance.labels.iter();
    Ok(known
        .filter_map(|label| Some((label.clone(), covariance.std_dev(label)?)))
        .collect())
}

fn coverage(views: &[View], [width, height]: [u32; 2]) -> [usize; 9] {
    let mut coverage = [0; 9];
    for [u, v] in views.iter().flat_map(|view| view.points.values()) {
        let third = |x: &f64, side: u32| ((3.0 * (x + 0.5) / f64::from(side)) as usize).min(2);
        coverage[3 * third(v, height) + third(u, width)] += 1;
    }
    coverage
}

fn rms(errors: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = errors.fold((0.0, 0), |(sum, count), e| (sum + e * e, count + 1));
    (sum / f64::from(count.max(1))).sqrt()
}

impl ViewFit {
    /// By how much the target's plane is tilted against the image: about the image's horizontal
    /// and its vertical axis, deg.
    pub fn tilt_deg(&self) -> [f64; 2] {
        let normal = self.target.rotation * Vec3::z();
        [-normal.y, normal.x].map(|side| side.atan2(normal.z).to_degrees())
    }
}

impl Intrinsics {
    /// The standard deviation of a parameter.
    pub fn sigma_of(&self, name: &str) -> Option<f64> {
        let all = self.sigma.as_ref().ok()?;
        all.iter()
            .find(|(known, _)| known == name)
            .map(|(_, sigma)| *sigma)
    }

    /// The view that fits worst.
    pub fn worst(&self) -> Option<&ViewFit> {
        self.views
            .iter()
            .max_by(|a, b| a.rms_px.total_cmp(&b.rms_px))
    }
}
