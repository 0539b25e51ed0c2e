//! From what moves to what does not: the pixels that hide the view.

use super::activity::Activity;
use super::error::{LEAST_CHANGE, LEAST_IMAGES, LearnError, MOST_STILL, MOST_TIMES};
use super::frames::Frames;
use super::plane::{Plane, box_mean};
use super::region::{Region, StillArea};

/// A pixel is still if its variance is at most this many times that of noise.
const STILL: f32 = 1.5;
/// Radii of the discs that must fit into what is still, px: by the level, and by the fine
/// structure, whose windows are larger.
const OPEN_LEVEL: f64 = 2.0;
const OPEN_FINE: f64 = 3.0;
/// A soft border: pixels at most `REACH` px from what is still that have lost this share of the
/// variance of what lies between `BESIDE` px from it, within a window of this half side.
const LOST: f32 = 0.5;
const REACH: f32 = 10.0;
const BESIDE: [f32; 2] = [7.0, 14.0];
const BESIDE_HALF: usize = 8;
/// Radii of the discs that smooth the result, px.
const CLOSE: f64 = 3.0;
const OPEN: f64 = 4.0;
/// An area is trusted if structure is seen along at least this share of its border.
const LEAST_SEEN: f64 = 0.5;

/// What the mask is made by.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// How far the mask reaches beyond what was found, px (Euclidean).
    pub grow_px: f64,
    /// Least area that counts, px.
    pub least_px: usize,
    /// Standard deviation of the noise, levels; estimated from the images where it is not given.
    pub noise: Option<f64>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            grow_px: 5.0,
            least_px: 150,
            noise: None,
        }
    }
}

/// What hides the view.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The pixels that do not move, before growth.
    pub still: Region,
    /// The same, grown: the mask.
    pub mask: Region,
    /// The areas of `still`.
    pub areas: Vec<StillArea>,
    /// The share of the image that moved for sure, or is in one of the areas.
    pub sure: f64,
    /// Standard deviation of the noise, levels.
    pub noise: f64,
}

/// Learns what hides the view from images in which it does not move while the background does.
///
/// A pixel is still if its level, or its fine structure (the difference of two Gaussians), varies
/// over time by little more than the camera's noise: what is opaque keeps its level, and behind a
/// blurred spot levels still change but fine structure is lost. From there the mask goes on, up to
/// 10 px, as long as less than half of the variance of what lies beside it is seen: half a soft
/// border. Discs of 3 and 4 px close gaps and open bridges.
///
/// # Errors
/// [`LearnError`]: too few images, or the background did not move or has no texture; with where.
pub fn learn(frames: &Frames, settings: &Settings) -> Result<Learned, LearnError> {
    let (width, height) = (frames.width(), frames.height());
    if frames.count() < LEAST_IMAGES {
        return Err(LearnError::Few(frames.count()));
    }
    let activity = Activity::of(frames, settings.noise);
    let (level, fine) = (&activity.level.values, &activity.fine.values);
    let (level_limit, fine_limit) = (STILL * activity.noise, STILL * activity.fine_noise);
    let quiet_level = Region::of(width, height, |k| level[k] <= level_limit);
    let quiet_fine = Region::of(width, height, |k| fine[k] <= fine_limit);
    let core = quiet_level
        .opened(OPEN_LEVEL)
        .or(&quiet_fine.opened(OPEN_FINE));
    let core = core.without_specks(settings.least_px);
    let soft = soft_border(&activity, &core);
    let still = core.or(&soft).closed(CLOSE).opened(OPEN);
    let still = still.without_specks(settings.least_px);

    let total = (width * height) as f64;
    let parts = still.areas(1);
    let described = |seen: &[f64]| -> Vec<StillArea> {
        let areas = parts.iter().zip(seen);
        areas.map(|(area, seen)| area.described(*seen)).collect()
    };
    let share = still.count() as f64 / total;
    if share > MOST_STILL {
        let areas = described(&vec![0.0; parts.len()]);
        return Err(LearnError::Motionless { share, areas });
    }
    let change = change(&activity, &still);
    if change < LEAST_CHANGE {
        return Err(LearnError::Slight { change });
    }
    let areas = described(&seen_beside(frames, &activity, &parts));
    if areas.is_empty() {
        return Err(LearnError::Nothing {
            least_px: settings.least_px,
        });
    }
    let is_doubtful = |area: &StillArea| area.seen < LEAST_SEEN;
    if areas.iter().any(is_doubtful) {
        let areas = areas.into_iter().filter(is_doubtful).collect();
        return Err(LearnError::Doubtful { areas });
    }
    let is_quiet = |k: usize| quiet_level.holds(k) || quiet_fine.holds(k);
    let sure = (0..width * height).filter(|k| still.holds(*k) || !is_quiet(*k));
    Ok(Learned {
        mask: still.grown(settings.grow_px),
        areas,
        sure: sure.count() as f64 / total,
        noise: f64::from(activity.noise.sqrt()),
        still,
    })
}

/// Pixels beside the still ones that see less than half of the variance, in levels as well as in
/// fine structure, of what is further away.
fn soft_border(activity: &Activity, core: &Region) -> Region {
    let distances = core.distances();
    let width = activity.level.width;
    let beside = Plane {
        width,
        values: distances
            .iter()
            .map(|px| f32::from(*px > BESIDE[0] && *px <= BESIDE[1]))
            .collect(),
    };
    let weight = box_mean(&beside, BESIDE_HALF);
    let reference = |plane: &Plane| {
        let mut inside = plane.clone();
        let values = inside.values.iter_mut().zip(&beside.values);
        values.for_each(|(value, is_beside)| *value *= is_beside);
        box_mean(&inside, BESIDE_HALF)
    };
    let of_level = reference(&activity.level);
    let of_fine = reference(&activity.fine);
    Region::of(width, distances.len() / width, |k| {
        let has_lost = |value: f32, sum: f32, noise: f32| {
            value < noise + (1.0 - LOST) * (sum / weight.values[k] - noise)
        };
        let (level, fine) = (activity.level.values[k], activity.fine.values[k]);
        distances[k] <= REACH
            && weight.values[k] > 1e-3
            && has_lost(level, of_level.values[k], activity.noise)
            && has_lost(fine, of_fine.values[k], activity.fine_noise)
    })
}

/// The share of the fine structure that changed, at the median of the pixels that are not still.
fn change(activity: &Activity, still: &Region) -> f32 {
    let (fine, energy) = (&activity.fine.values, &activity.energy.values);
    let mut shares: Vec<f32> = (0..fine.len())
        .filter(|k| !still.holds(*k))
        .map(|k| fine[k] / energy[k].max(f32::MIN_POSITIVE))
        .collect();
    let middle = shares.len() / 2;
    *shares.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// For each area, along which share of its border fine structure is seen in most of the images.
/// Along background without texture, it is seen in few.
fn seen_beside(frames: &Frames, activity: &Activity, areas: &[Region]) -> Vec<f64> {
    let rings: Vec<Vec<usize>> = areas
        .iter()
        .map(|area| {
            let distances = area.distances();
            let is_beside = |k: &usize| distances[*k] > 3.0 && distances[*k] <= BESIDE[0];
            (0..distances.len()).filter(is_beside).collect()
        })
        .collect();
    let mut times: Vec<Vec<u32>> = rings.iter().map(|ring| vec![0; ring.len()]).collect();
    let limit = STILL * activity.fine_noise;
    for index in 0..frames.count() {
        let structure = activity.structure(frames, index);
        for (ring, times) in rings.iter().zip(&mut times) {
            for (pixel, times) in ring.iter().zip(times) {
                *times += u32::from(structure.values[*pixel] > limit);
            }
        }
    }
    let enough = MOST_TIMES * frames.count() as f64;
    let share = |times: &Vec<u32>| {
        let seen = times.iter().filter(|times| f64::from(**times) >= enough);
        seen.count() as f64 / times.len().max(1) as f64
    };
    times.iter().map(share).collect()
}
