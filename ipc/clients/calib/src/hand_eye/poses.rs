//! The mounting by least squares on poses.

use vision_calibration_core::{Iso3, Vec3};

use super::{FEWEST, HandEyeError};
use crate::motion::{self, AXES};
use crate::pose_fit::{Fit, Problem};

/// A change of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// Places of the target are larger by a share.
    Size,
    /// Depths of the target are.
    Focal,
    /// The target moved before this pose.
    Moved(usize),
    /// This pose is left out.
    Without(usize),
}

impl Change {
    pub fn parameters(self) -> usize {
        match self {
            Self::Size | Self::Focal => 1,
            Self::Moved(_) => 6,
            Self::Without(_) => 0,
        }
    }

    /// The target in the camera, changed.
    pub fn apply(self, pose: usize, mut seen: Iso3, by: &[f64]) -> Option<Iso3> {
        match (self, by) {
            (Self::Size, [share]) => seen.translation.vector *= 1.0 + share,
            (Self::Focal, [share]) => seen.translation.vector.z *= 1.0 + share,
            (Self::Moved(first), [x, y, z, a, b, c]) if pose >= first => {
                seen *= Iso3::new(Vec3::new(*x, *y, *z), Vec3::new(*a, *b, *c));
            }
            (Self::Without(one), _) if pose == one => return None,
            _ => {}
        }
        Some(seen)
    }
}

/// What robot and camera say of each other.
pub(super) struct Poses {
    /// Of the images.
    pub names: Vec<String>,
    /// The frame that the camera is fixed in, in the one of the target.
    pub robots: Vec<Iso3>,
    /// The target in the camera.
    pub seen: Vec<Iso3>,
}

impl Poses {
    /// Fits the mounting.
    pub fn fit(&self) -> Result<Fit, HandEyeError> {
        if self.seen.len() < FEWEST {
            return Err(HandEyeError::TooFew {
                found: self.seen.len(),
            });
        }
        let found = motion::axes(&self.robots);
        if found < AXES {
            return Err(HandEyeError::Axes { found });
        }
        motion::check(&self.robots, &self.seen)?;
        let start = motion::mounting(&self.robots, &self.seen).ok_or(HandEyeError::Unsolved)?;
        let target = self.robots[0] * start * self.seen[0];
        let fit = self.problem(
            0,
            |_, seen, _| Some(seen),
            |problem| problem.solve(start, target, None),
        );
        fit.ok_or(HandEyeError::Unsolved)
    }

    /// Fits again with a change, from a fit; `sigma` as in [`Problem::solve`].
    pub fn with(&self, change: Change, fit: &Fit, sigma: Option<[f64; 2]>) -> Option<Fit> {
        let changed = |pose: usize, seen: Iso3, by: &[f64]| change.apply(pose, seen, by);
        self.problem(change.parameters(), changed, |problem| {
            problem.solve(fit.state.mount, fit.state.target, sigma)
        })
    }

    fn problem(
        &self,
        extra: usize,
        seen: impl Fn(usize, Iso3, &[f64]) -> Option<Iso3>,
        solve: impl Fn(&Problem) -> Option<Fit>,
    ) -> Option<Fit> {
        solve(&Problem {
            count: self.seen.len(),
            extra,
            at: &|pose, by| Some([self.robots[pose], seen(pose, self.seen[pose], by)?]),
            is_robust: false,
        })
    }

    /// Distance of the target, as each pose has it, from its mean, RMS, m.
    pub fn scatter(&self, mount: &Iso3) -> f64 {
        let pairs = self.robots.iter().zip(&self.seen);
        let places = pairs.map(|(robot, seen)| (robot * mount * seen).translation.vector);
        let places: Vec<Vec3> = places.collect();
        let mean = places.iter().sum::<Vec3>() / places.len() as f64;
        let squares = places.iter().map(|place| (place - mean).norm_squared());
        (squares.sum::<f64>() / places.len() as f64).sqrt()
    }
}
