//! How much later or earlier an image was exposed than its stamp says.
//!
//! The target stands still: seen at the right instants of the arm's motion, it does. First the
//! velocity of the camera that the images show is correlated with the one that the joints give, over
//! shifts of the stamps; then shift, readout time, mounting and target are fitted to the corners in
//! the images by least squares.

use std::fmt;

use nalgebra::{SMatrix, SVector};
use vision_calibration_core::{Iso3, Vec3};

use crate::camera::Camera;
use crate::pose;
use crate::target::Target;
use crate::trajectory::Trajectory;
use crate::verdict::Verdict;
use crate::view::View;

/// Shifts that are tried: to both sides, and the step, s.
pub const WINDOW: f64 = 0.5;
const STEP: f64 = 0.005;
/// Two frames that are further apart give no velocity, s.
const FRAME: f64 = 0.2;
/// Fewest frames in which the camera moves.
const FEWEST: usize = 60;
/// Fewest frames of a correlation.
const COMMON: usize = 30;
/// Least correlation of a good result.
const CORRELATION: f64 = 0.9;
/// Another peak this far away, s, and nearly as high: the motion repeats itself.
const OTHER: f64 = 0.06;
const REPEATED: f64 = 0.97;
/// Greatest standard deviation of a good result: half of what it may be off, 2 ms.
const SIGMA: f64 = 1e-3;
/// Greatest residual, RMS, px.
const RMS_PX: f64 = 1.5;
/// What the mounting is known to before, one standard deviation, m and rad; and the readout, s.
const MOUNT: [f64; 2] = [0.005, 0.02];
const READOUT: f64 = 0.02;
/// Most corners that are fitted.
const CORNERS: usize = 8000;
/// Steps of the fit.
const STEPS: usize = 12;
/// Corners that miss by so many standard deviations are dropped.
const OUTLIER: f64 = 5.0;
/// Parts of the recording that are taken for independent.
const PARTS: usize = 30;

/// What was seen in an image.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The stamp: what is taken for the middle of the exposure, s.
    pub time: f64,
    /// The tags.
    pub view: View,
}

/// A result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latency {
    /// What is to be added to the stamps, s.
    pub offset: f64,
    /// Its standard deviation, s.
    pub sigma: f64,
    /// From the first row's exposure to the last one's, s, with its standard deviation.
    pub readout: [f64; 2],
    /// Correlation of seen and measured motion.
    pub correlation: f64,
    /// The highest other peak, of this one, 0 if there is none.
    pub other: f64,
    /// What corners miss by, RMS, px.
    pub rms_px: f64,
    /// Frames that were used.
    pub frames: usize,
}

/// There is no result.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LatencyError {
    /// Too little was seen.
    #[error(
        "{found} images with tags in which the arm's pose is known; {FEWEST} at least: wiggle the camera for longer, with the tags in sight"
    )]
    #[allow(missing_docs)]
    TooFew { found: usize },
    /// Nothing fits.
    #[error(
        "the seen motion does not follow the arm's: correlation {0:.2}; did the arm move, and are hand-eye file and board the right ones?"
    )]
    Unrelated(f64),
}

/// What is known before.
#[derive(Clone, Copy, Debug)]
pub struct Setup<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// The camera in the flange frame.
    pub mount: &'a Iso3,
    /// What is looked at; it stands still.
    pub target: &'a Target,
}

/// Finds the offset.
///
/// # Errors
/// [`LatencyError`]: frames or motion say too little.
pub fn estimate(
    frames: &[Frame],
    arm: &Trajectory,
    setup: &Setup,
) -> Result<Latency, LatencyError> {
    let mut frames = frames.to_vec();
    for frame in &mut frames {
        frame.view.keep_known(setup.target);
    }
    let seen: Vec<(Frame, Iso3)> = frames
        .into_iter()
        .filter(|frame| arm.joints(frame.time).is_some())
        .filter_map(|frame| {
            let pose = pose::start(setup.camera, &frame.view, setup.target)?;
            Some((frame, pose))
        })
        .collect();
    if seen.len() < FEWEST {
        return Err(LatencyError::TooFew { found: seen.len() });
    }
    let peak = Peak::find(&seen, arm, setup);
    if peak.height < 0.5 {
        return Err(LatencyError::Unrelated(peak.height));
    }
    let fit = Fit::solve(&seen, arm, setup, peak.shift);
    let fit = fit.ok_or(LatencyError::Unrelated(peak.height))?;
    Ok(Latency {
        offset: fit.state.shift,
        sigma: fit.sigma,
        readout: [fit.state.readout, fit.sigma_readout],
        correlation: peak.height,
        other: peak.other,
        rms_px: fit.rms_px,
        frames: seen.len(),
    })
}

/// The highest peak of the correlation.
#[derive(Clone, Copy, Debug)]
struct Peak {
    /// s.
    shift: f64,
    /// Of at most 1.
    height: f64,
    /// The next one, of it.
    other: f64,
}

impl Peak {
    fn find(seen: &[(Frame, Iso3)], arm: &Trajectory, setup: &Setup) -> Self {
        let neighbours = || {
            seen.windows(2).filter_map(|pair| match pair {
                [(a, from), (b, to)] if b.time - a.time < FRAME => {
                    let far = from.translation.vector.norm();
                    Some((
                        [a.time, b.time],
                        velocity(&(from * to.inverse()), b.time - a.time, far),
                        far,
                    ))
                }
                _ => None,
            })
        };
        let correlation = |shift: f64| {
            let (mut product, mut squares, mut count) = (0.0, [0.0; 2], 0);
            for ([from, to], seen, far) in neighbours() {
                let ends = arm.flange(from + shift).zip(arm.flange(to + shift));
                let Some((start, end)) = ends else { continue };
                let moved = (start * setup.mount).inverse() * end * setup.mount;
                let measured = velocity(&moved, to - from, far);
                product += seen.dot(&measured);
                squares = [
                    squares[0] + seen.norm_squared(),
                    squares[1] + measured.norm_squared(),
                ];
                count += 1;
            }
            let is_enough = count >= COMMON && squares[0] * squares[1] > 0.0;
            if is_enough {
                product / (squares[0] * squares[1]).sqrt()
            } else {
                0.0
            }
        };
        let count = (2.0 * WINDOW / STEP).round() as usize;
        let shifts: Vec<f64> = (0..=count).map(|k| k as f64 * STEP - WINDOW).collect();
        let heights: Vec<f64> = shifts.iter().map(|shift| correlation(*shift)).collect();
        let highest = (0..=count).max_by(|a, b| heights[*a].total_cmp(&heights[*b]));
        let highest = highest.unwrap_or(0);
        let is_peak = |k: &usize| {
            let sides = [k.checked_sub(1), Some(k + 1)];
            sides
                .iter()
                .flatten()
                .all(|j| heights.get(*j).is_none_or(|side| *side <= heights[*k]))
        };
        let others = (0..=count).filter(is_peak);
        let others = others.filter(|k| (shifts[*k] - shifts[highest]).abs() > OTHER);
        let other = others.map(|k| heights[k]).fold(0.0, f64::max);
        // The top of the parabola through three heights.
        let around = |k: usize| heights.get(k).copied().unwrap_or(heights[highest]);
        let (before, at, after) = (
            around(highest.wrapping_sub(1)),
            heights[highest],
            around(highest + 1),
        );
        let bend = before - 2.0 * at + after;
        let top = if bend < 0.0 {
            0.5 * (before - after) / bend
        } else {
            0.0
        };
        Self {
            shift: shifts[highest] + top * STEP,
            height: at,
            other: other / at.max(1e-9),
        }
    }
}

/// A camera's velocity over a motion, as a point this far before it moves in the image.
fn velocity(moved: &Iso3, time: f64, far: f64) -> SVector<f64, 6> {
    let (linear, angular) = (moved.translation.vector, moved.rotation.scaled_axis());
    let [x, y, z] = (linear / (far * time)).into();
    let [a, b, c] = (angular / time).into();
    SVector::from([x, y, z, a, b, c])
}

/// Parameters: shift, readout, mounting, target.
const COUNT: usize = 14;
type Normal = SMatrix<f64, COUNT, COUNT>;
type Gradient = SVector<f64, COUNT>;
/// Steps of the numeric derivative: s, s, m and rad.
const DELTA: [f64; 2] = [1e-4, 1e-5];

/// What is fitted.
#[derive(Clone, Copy, Debug)]
struct State {
    shift: f64,
    readout: f64,
    mount: Iso3,
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

#[derive(Debug)]
struct Fit {
    state: State,
    sigma: f64,
    sigma_readout: f64,
    rms_px: f64,
}

impl Fit {
    fn solve(seen: &[(Frame, Iso3)], arm: &Trajectory, setup: &Setup, shift: f64) -> Option<Self> {
        let mut corners = corners(seen, setup.target);
        let middle = seen
            .iter()
            .find_map(|(frame, pose)| Some(arm.flange(frame.time + shift)? * setup.mount * pose))?;
        let mut state = State {
            shift,
            readout: 0.0,
            mount: *setup.mount,
            target: middle,
        };
        let start = state;
        let mut noise = 1.0;
        for step in 0..STEPS {
            let height = f64::from(setup.camera.size[1]);
            let miss = |state: &State, corner: &Corner| {
                let row = (corner.pixel[1] + 0.5) / height - 0.5;
                let flange = arm.flange(corner.time + state.shift + row * state.readout)?;
                let pose = (flange * state.mount).inverse() * state.target;
                let [u, v] = setup.camera.project(&pose, corner.place)?;
                Some([u - corner.pixel[0], v - corner.pixel[1]])
            };
            let (mut normal, mut right) = prior(&start, &state, noise);
            let (mut sum, mut count) = (0.0, 0);
            for corner in &corners {
                let Some((now, by)) = derivative(&miss, &state, corner) else {
                    continue;
                };
                for k in 0..2 {
                    normal += by[k] * by[k].transpose();
                    right -= by[k] * now[k];
                    sum += now[k] * now[k];
                    count += 1;
                }
            }
            if count < 4 * FEWEST {
                return None;
            }
            noise = (sum / count as f64).sqrt().max(1e-3);
            let factor = normal.cholesky()?;
            state = state.moved(&factor.solve(&right));
            if step == STEPS / 2 {
                let most = OUTLIER * noise;
                corners
                    .retain(|corner| miss(&state, corner).is_some_and(|[u, v]| u.hypot(v) <= most));
            }
            if step + 1 == STEPS {
                let inverse = factor.inverse();
                let formal = |k: usize| noise * inverse[(k, k)].max(0.0).sqrt();
                let clustered = clustered(&miss, &state, &corners, seen.len(), &inverse);
                return Some(Self {
                    state,
                    sigma: clustered.max(formal(0)),
                    sigma_readout: formal(1),
                    rms_px: 2f64.sqrt() * noise,
                });
            }
        }
        None
    }
}

/// What is known of the mounting and the readout before.
fn prior(start: &State, state: &State, noise: f64) -> (Normal, Gradient) {
    let off = start.mount.inverse() * state.mount;
    let (moved, turned) = (off.translation.vector, off.rotation.scaled_axis());
    let mut normal = Normal::zeros();
    let mut right = Gradient::zeros();
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

type Miss<'a> = dyn Fn(&State, &Corner) -> Option<[f64; 2]> + 'a;

/// What a corner misses by, and the derivatives of both components.
fn derivative(miss: &Miss, state: &State, corner: &Corner) -> Option<([f64; 2], [Gradient; 2])> {
    let now = miss(state, corner)?;
    let mut by = [Gradient::zeros(); 2];
    for k in 0..COUNT {
        let delta = if k < 2 { DELTA[0] } else { DELTA[1] };
        let mut step = Gradient::zeros();
        step[k] = delta;
        let there = miss(&state.moved(&step), corner)?;
        for axis in 0..2 {
            by[axis][k] = (there[axis] - now[axis]) / delta;
        }
    }
    Some((now, by))
}

/// The standard deviation of the shift where the misses of neighbouring images are not independent:
/// each part of the recording counts as one observation.
fn clustered(
    miss: &Miss,
    state: &State,
    corners: &[Corner],
    frames: usize,
    inverse: &Normal,
) -> f64 {
    let mut gradients = [Gradient::zeros(); PARTS];
    for corner in corners {
        let Some((now, by)) = derivative(miss, state, corner) else {
            continue;
        };
        let gradient = &mut gradients[corner.frame * PARTS / frames.max(1)];
        *gradient += by[0] * now[0] + by[1] * now[1];
    }
    let shifts = gradients
        .iter()
        .map(|gradient| (inverse * gradient)[0].powi(2));
    (shifts.sum::<f64>() * PARTS as f64 / (PARTS - 1) as f64).sqrt()
}

/// Corners of all frames, evenly thinned out.
fn corners(seen: &[(Frame, Iso3)], target: &Target) -> Vec<Corner> {
    let all: Vec<Corner> = seen
        .iter()
        .enumerate()
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
    let step = (all.len() / CORNERS + 1) | 1;
    all.into_iter().step_by(step).collect()
}

impl Latency {
    /// Whether it can be used, and what to do if not.
    pub fn verdict(&self) -> Verdict {
        let mut verdict = Verdict::default();
        verdict.refuse_if(self.correlation < CORRELATION, || {
            format!(
                "the seen motion follows the arm's with a correlation of {:.2}, {CORRELATION} is asked for; are hand-eye file and board the right ones?",
                self.correlation
            )
        });
        verdict.refuse_if(self.other > REPEATED, || {
            "the motion repeats itself, so that several offsets fit; wiggle irregularly".to_owned()
        });
        verdict.refuse_if(self.sigma > SIGMA, || {
            format!(
                "the offset is known to {:.1} ms (one standard deviation), {:.1} ms are asked for; wiggle faster, or for longer, with more tags in sight",
                1e3 * self.sigma,
                1e3 * SIGMA
            )
        });
        verdict.refuse_if(self.rms_px > RMS_PX, || {
            format!(
                "tags miss their places by {:.1} px RMS, {RMS_PX} px at most; does the board stand still, are stamps regular?",
                self.rms_px
            )
        });
        let edge = WINDOW - OTHER;
        verdict.refuse_if(self.offset.abs() > edge, || {
            format!(
                "the offset is {:.0} ms, {:.0} ms at most are looked at",
                1e3 * self.offset,
                1e3 * edge
            )
        });
        verdict
    }
}

impl fmt::Display for Latency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "offset of the stamps {:+.2} ms +- {:.2}: images were exposed {} than their stamps say",
            1e3 * self.offset,
            1e3 * self.sigma,
            if self.offset < 0.0 {
                "earlier"
            } else {
                "later"
            }
        )?;
        writeln!(
            f,
            "rolling shutter: readout {:.1} ms +- {:.1}",
            1e3 * self.readout[0],
            1e3 * self.readout[1]
        )?;
        writeln!(
            f,
            "{} images; correlation {:.4}; residual {:.2} px RMS",
            self.frames, self.correlation, self.rms_px
        )
    }
}
