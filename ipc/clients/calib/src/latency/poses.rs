//! The offset from poses alone: of the flange and of the target, each with its own stamps.
//!
//! Source: F. Furrer et al., "Evaluation of combined time-offset estimation and hand-eye
//! calibration on robotic datasets" (2017): correlate how fast both turn, which no mounting
//! changes; then fit offset and mounting together.

use vision_calibration_core::Iso3;

use super::peak::Peak;
use super::{FEWEST, Latency, LatencyError, Residual};
use crate::motion;
use crate::pose_fit::{COUNT, Problem};
use crate::trajectory::Track;

/// Turns are compared over this time, s: longer than noise, shorter than a motion.
const SPAN: f64 = 0.4;
/// Most poses that are fitted, and of which the mounting's start is computed.
const MOST: usize = 1500;
const START: usize = 40;
/// Parts of the recording that are left out in turn: the errors of neighbours are alike.
const PARTS: usize = 10;

/// Finds what is to be added to the stamps of `seen`, poses of the target in the camera; neither
/// the mounting nor the target's place are known.
///
/// # Errors
/// [`LatencyError`]: poses or motion say too little.
pub fn estimate_poses(seen: &[(f64, Iso3)], arm: &Track) -> Result<Latency, LatencyError> {
    let is_known = |pose: &&(f64, Iso3)| arm.at(pose.0).is_some();
    let seen: Vec<(f64, Iso3)> = seen.iter().filter(is_known).copied().collect();
    if seen.len() < FEWEST {
        return Err(LatencyError::TooFew { found: seen.len() });
    }
    let peak = Peak::find(|shift| correlation(&seen, arm, shift));
    let step = seen.len() / MOST + 1;
    let used: Vec<(f64, Iso3)> = seen.into_iter().step_by(step).collect();
    let unrelated = LatencyError::Unrelated(peak.height);
    if peak.height < 0.5 {
        return Err(unrelated);
    }
    let at = |shift: f64| {
        let step = used.len() / START;
        let pairs = used.iter().step_by(step);
        pairs.filter_map(move |(time, pose)| Some((arm.at(time + shift)?, *pose)))
    };
    let (robots, boards): (Vec<Iso3>, Vec<Iso3>) = at(peak.shift).unzip();
    let mount = motion::mounting(&robots, &boards).ok_or(unrelated)?;
    let target = robots[0] * mount * boards[0];
    let without = |part: Option<usize>, start: [Iso3; 2], shift: f64, sigma| {
        let problem = Problem {
            count: used.len(),
            extra: 1,
            at: &|k, extra| {
                let (time, seen) = used[k];
                let is_out = Some(k * PARTS / used.len()) == part;
                let robot = arm.at(time + shift + extra.first()?)?;
                (!is_out).then_some([robot, seen])
            },
            is_robust: true,
        };
        problem.solve(start[0], start[1], sigma)
    };
    let fit = without(None, [mount, target], peak.shift, None).ok_or(unrelated)?;
    let offset = peak.shift + fit.state.extra[0];
    let start = [fit.state.mount, fit.state.target];
    let mut squares = 0.0;
    for part in 0..PARTS {
        let other = without(Some(part), start, offset, Some(fit.sigma)).ok_or(unrelated)?;
        squares += other.state.extra[0].powi(2);
    }
    let jackknife = (squares * (PARTS - 1) as f64 / PARTS as f64).sqrt();
    Ok(Latency {
        offset,
        sigma: jackknife.max(fit.covariance[(COUNT, COUNT)].sqrt()),
        readout: None,
        correlation: peak.height,
        other: peak.other,
        residual: Residual::Poses(fit.sigma),
        frames: used.len(),
    })
}

/// Of the angles through which both turn; `None` where too few are known.
fn correlation(seen: &[(f64, Iso3)], arm: &Track, shift: f64) -> Option<f64> {
    let mut angles = Vec::new();
    for (from, start) in seen {
        let end = seen.partition_point(|(time, _)| *time < from + SPAN);
        let Some((to, end)) = seen.get(end).filter(|(to, _)| to - from < 1.5 * SPAN) else {
            continue;
        };
        let robot = arm.at(from + shift).zip(arm.at(to + shift));
        let Some((a, b)) = robot else { continue };
        let time = to - from;
        let angle = |a: &Iso3, b: &Iso3| a.rotation.angle_to(&b.rotation) / time;
        // The camera's own turn: of the target in the camera, inverted.
        angles.push([angle(&start.inverse(), &end.inverse()), angle(&a, &b)]);
    }
    if angles.len() < FEWEST / 2 {
        return None;
    }
    let count = angles.len() as f64;
    let mean = [0, 1].map(|k| angles.iter().map(|angle| angle[k]).sum::<f64>() / count);
    let product = |i: usize, j: usize| {
        let each = angles.iter();
        let each = each.map(|angle| (angle[i] - mean[i]) * (angle[j] - mean[j]));
        each.sum::<f64>()
    };
    let size = (product(0, 0) * product(1, 1)).sqrt();
    (size > 0.0).then(|| product(0, 1) / size)
}
