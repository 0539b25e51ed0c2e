//! How much later or earlier an image was exposed than its stamp says.
//!
//! The target stands still: seen at the right instants of the arm's motion, it does. First the
//! velocity of the camera that the images show is correlated with the one that the joints give, over
//! shifts of the stamps; then shift, readout time, mounting and target are fitted to the corners in
//! the images by least squares.

mod fit;
mod peak;
mod poses;

use std::fmt;

use vision_calibration_core::Iso3;

use self::fit::Fit;
use self::peak::{OTHER, Peak, WINDOW};
pub use self::poses::estimate_poses;
use crate::camera::Camera;
use crate::pose;
use crate::target::Target;
use crate::trajectory::Trajectory;
use crate::verdict::Verdict;
use crate::view::View;

/// Fewest frames in which the camera moves.
const FEWEST: usize = 60;
/// Least correlation of a good result.
const CORRELATION: f64 = 0.9;
/// Another peak this high, of the highest: the motion repeats itself.
const REPEATED: f64 = 0.97;
/// Greatest standard deviation of a good result: half of what it may be off, 2 ms.
const SIGMA: f64 = 1e-3;
/// Greatest residual, RMS, px.
const RMS_PX: f64 = 1.5;

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
    /// From the first row's exposure to the last one's, s, with its standard deviation; `None`
    /// without images.
    pub readout: Option<[f64; 2]>,
    /// Correlation of seen and measured motion.
    pub correlation: f64,
    /// The highest other peak, of this one, 0 if there is none.
    pub other: f64,
    /// What is left.
    pub residual: Residual,
    /// Frames that were used.
    pub frames: usize,
}

/// What corners or poses miss by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Residual {
    /// Corners, RMS, px.
    Corners(f64),
    /// Poses, along and about an axis, one standard deviation: m, rad.
    Poses([f64; 2]),
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
    let peak = Peak::find(|shift| peak::correlation(&seen, arm, setup, shift));
    if peak.height < 0.5 {
        return Err(LatencyError::Unrelated(peak.height));
    }
    let fit = Fit::solve(&seen, arm, setup, peak.shift);
    let fit = fit.ok_or(LatencyError::Unrelated(peak.height))?;
    Ok(Latency {
        offset: fit.state.shift,
        sigma: fit.sigma[0],
        readout: Some([fit.state.readout, fit.sigma[1]]),
        correlation: peak.height,
        other: peak.other,
        residual: Residual::Corners(fit.rms_px),
        frames: seen.len(),
    })
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
        if let Residual::Corners(rms_px) = self.residual {
            verdict.refuse_if(rms_px > RMS_PX, || {
                format!(
                    "tags miss their places by {rms_px:.1} px RMS, {RMS_PX} px at most; does the board stand still, are stamps regular?"
                )
            });
        }
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
        if let Some([readout, sigma]) = self.readout {
            let [readout, sigma] = [readout, sigma].map(|s| 1e3 * s);
            writeln!(f, "rolling shutter: readout {readout:.1} ms +- {sigma:.1}")?;
        }
        write!(
            f,
            "{} images; correlation {:.4}; ",
            self.frames, self.correlation
        )?;
        match self.residual {
            Residual::Corners(rms) => writeln!(f, "residual {rms:.2} px RMS"),
            Residual::Poses([moved, turned]) => writeln!(
                f,
                "poses miss by {:.2} mm, {:.3} deg along and about each axis",
                1e3 * moved,
                turned.to_degrees()
            ),
        }
    }
}
