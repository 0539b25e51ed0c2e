//! Shift, readout time, mounting and target, fitted to the corners in the images by least squares.

use nalgebra::{SMatrix, SVector};
use vision_calibration_core::{Iso3, Vec3};

use super::{Frame, Setup};
use crate::target::Target;
use crate::trajectory::Trajectory;

/// What the mounting is known to before, one standard deviation, m and rad; and the readout, s.
const MOUNT: [f64; 2] = [0.005, 0.02];
const READOUT: f64 = 0.02;
/// Most corners that are fitted, and fewest components of their errors.
const MOST_CORNERS: usize = 8000;
const FEWEST: usize = 240;
/// Steps of the fit.
const STEPS: usize = 12;
/// Corners that miss by so many standard deviations are dropped.
const OUTLIER: f64 = 5.0;
/// Parts of the recording that are taken for independent.
const PARTS: usize = 30;
/// Steps of the numeric derivative: of shift and readout, s; of the poses, m and rad.
const DELTA: [f64; 2] = [1e-4, 1e-5];

/// Parameters: shift, readout, mounting, target.
const COUNT: usize = 14;
type Normal = SMatrix<f64, COUNT, COUNT>;
type Gradient = SVector<f64, COUNT>;

/// What is fitted.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    /// What is to be added to the stamps, s.
    pub shift: f64,
    /// From the first row's exposure to the last one's, s.
    pub readout: f64,
    /// The camera in the flange frame.
    mount: Iso3,
    /// The target in the base.
    target: Iso3,
}

impl State {
    fn moved(&self, by: &Gradient) -> Self {
        let part = |first: usize| {
            let vector = |k: usize| Vec3::new(by[k], by[k + 1], by[k + 2]);
            Iso3::new(vector(first), vector(first + 3))
        };
        Self {
            shift: self.shift + by[0],
            readout: self.readout + by[1],
            mount: self.mount * part(2),
            target: self.target * part(8),
        }
    }
}

/// A corner: its frame, its place on the target and in the image.
#[derive(Clone, Copy, Debug)]
struct Corner {
    frame: usize,
    time: f64,
    place: [f64; 2],
    pixel: [f64; 2],
}

/// A result.
#[derive(Debug)]
pub(super) struct Fit {
    pub state: State,
    /// Standard deviations of shift and readout, s.
    pub sigma: [f64; 2],
    /// What corners miss by, RMS, px.
    pub rms_px: f64,
}

impl Fit {
    /// Begins at a shift; `None` where the corners do not determine the parameters.
    pub fn solve(
        seen: &[(Frame, Iso3)],
        arm: &Trajectory,
        setup: &Setup,
        shift: f64,
    ) -> Option<Self> {
        let model = Model { arm, setup };
        let mut corners = corners(seen, setup.target);
        let target = seen
            .iter()
            .find_map(|(frame, pose)| Some(arm.flange(frame.time + shift)? * setup.mount * pose))?;
        let start = State {
            shift,
            readout: 0.0,
            mount: *setup.mount,
            target,
        };
        let (mut state, mut noise) = (start, 1.0);
        for step in 0..STEPS {
            let (mut normal, mut right) = prior(&start, &state, noise);
            let (mut sum, mut count) = (0.0, 0);
            for corner in &corners {
                let Some((miss, by)) = model.derivative(&state, corner) else {
                    continue;
                };
                for k in 0..2 {
                    normal += by[k] * by[k].transpose();
                    right -= by[k] * miss[k];
                    sum += miss[k] * miss[k];
                    count += 1;
                }
            }
            if count < FEWEST {
                return None;
            }
            noise = (sum / f64::from(count as u32)).sqrt().max(1e-3);
            let factor = normal.cholesky()?;
            state = state.moved(&factor.solve(&right));
            if step == STEPS / 2 {
                let most = OUTLIER * noise;
                let fits = |miss: [f64; 2]| miss[0].hypot(miss[1]) <= most;
                corners.retain(|corner| model.miss(&state, corner).is_some_and(fits));
            }
            if step + 1 == STEPS {
                let inverse = factor.inverse();
                let formal = [0, 1].map(|k| noise * inverse[(k, k)].max(0.0).sqrt());
                let clustered = model.clustered(&state, &corners, seen.len(), &inverse);
                return Some(Self {
                    state,
                    sigma: [clustered.max(formal[0]), formal[1]],
                    rms_px: 2f64.sqrt() * noise,
                });
            }
        }
        None
    }
}

/// Where corners are expected.
struct Model<'a> {
    arm: &'a Trajectory,
    setup: &'a Setup<'a>,
}

impl Model<'_> {
    /// The flange when a corner's row was exposed.
    fn flange(&self, state: &State, corner: &Corner) -> Option<Iso3> {
        let height = f64::from(self.setup.camera.size[1]);
        let row = (corner.pixel[1] + 0.5) / height - 0.5;
        self.arm
            .flange(corner.time + state.shift + row * state.readout)
    }

    /// What a corner misses by, px.
    fn miss(&self, state: &State, corner: &Corner) -> Option<[f64; 2]> {
        self.miss_at(&self.flange(state, corner)?, state, corner)
    }

    fn miss_at(&self, flange: &Iso3, state: &State, corner: &Corner) -> Option<[f64; 2]> {
        let pose = (flange * state.mount).inverse() * state.target;
        let [u, v] = self.setup.camera.project(&pose, corner.place)?;
        Some([u - corner.pixel[0], v - corner.pixel[1]])
    }

    /// What a corner misses by, and the derivatives of both components.
    fn derivative(&self, state: &State, corner: &Corner) -> Option<([f64; 2], [Gradient; 2])> {
        let flange = self.flange(state, corner)?;
        let now = self.miss_at(&flange, state, corner)?;
        let mut by = [Gradient::zeros(); 2];
        for k in 0..COUNT {
            let delta = DELTA[usize::from(k >= 2)];
            let mut step = Gradient::zeros();
            step[k] = delta;
            let state = state.moved(&step);
            // Only shift and readout move the arm, whose kinematics take most of the time.
            let there = match k < 2 {
                true => self.miss(&state, corner)?,
                false => self.miss_at(&flange, &state, corner)?,
            };
            for axis in 0..2 {
                by[axis][k] = (there[axis] - now[axis]) / delta;
            }
        }
        Some((now, by))
    }

    /// The standard deviation of the shift where the misses of neighbouring images are not
    /// independent: each part of the recording counts as one observation.
    fn clustered(&self, state: &State, corners: &[Corner], frames: usize, inverse: &Normal) -> f64 {
        let mut gradients = [Gradient::zeros(); PARTS];
        for corner in corners {
            if let Some((now, by)) = self.derivative(state, corner) {
                gradients[corner.frame * PARTS / frames.max(1)] += by[0] * now[0] + by[1] * now[1];
            }
        }
        let shifts = gradients
            .iter()
            .map(|gradient| (inverse * gradient)[0].powi(2));
        (shifts.sum::<f64>() * PARTS as f64 / (PARTS - 1) as f64).sqrt()
    }
}

/// What is known of the mounting and the readout before.
fn prior(start: &State, state: &State, noise: f64) -> (Normal, Gradient) {
    let off = start.mount.inverse() * state.mount;
    let (moved, turned) = (off.translation.vector, off.rotation.scaled_axis());
    let (mut normal, mut right) = (Normal::zeros(), Gradient::zeros());
    let mut add = |k: usize, off: f64, sigma: f64| {
        let weight = (noise / sigma).powi(2);
        normal[(k, k)] += weight;
        right[k] -= weight * off;
    };
    add(1, state.readout, READOUT);
    for k in 0..3 {
        add(2 + k, moved[k], MOUNT[0]);
        add(5 + k, turned[k], MOUNT[1]);
    }
    (normal, right)
}

/// Corners of all frames, evenly thinned out.
fn corners(seen: &[(Frame, Iso3)], target: &Target) -> Vec<Corner> {
    let frames = seen.iter().enumerate();
    let all: Vec<Corner> = frames
        .flat_map(|(index, (frame, _))| {
            frame.view.pairs(target).map(move |(place, pixel)| Corner {
                frame: index,
                time: frame.time,
                place,
                pixel,
            })
        })
        .collect();
    // A step that is no multiple of four takes each corner of a tag in turn.
    let step = (all.len() / MOST_CORNERS + 1) | 1;
    all.into_iter().step_by(step).collect()
}
