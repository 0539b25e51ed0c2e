//! Seeds of discs: over the whole frame, or near a prediction.

use crate::disc::{CONTRAST, Disc, measure};
use crate::homography::{Point, distance};
use crate::image::Image;

/// Most discs that are examined in one frame.
pub(crate) const MAX_DISCS: usize = 12;
/// Discs found in a frame.
pub(crate) type Discs = heapless::Vec<Disc, MAX_DISCS>;

/// Pixels between samples; a disc of the least radius holds one at least.
const STEP: usize = 4;
/// Most seeds tried near one prediction.
const TRIES: usize = 6;

/// Every disc of the frame, the first [`MAX_DISCS`] of them.
///
/// Tried at thresholds that lie half of the least contrast apart: one of them separates each disc
/// from what it lies on, whatever else is near.
pub(crate) fn whole_frame(image: &Image, radius_px: [f64; 2]) -> Discs {
    let mut discs = Discs::new();
    let longest = (2.0 * radius_px[1]) as usize / STEP + 1;
    let step = 0.5 * CONTRAST;
    for k in 1..(255.0 / step) as usize {
        let threshold = step * k as f64;
        for v in (0..image.height()).step_by(STEP) {
            let mut run = 0;
            let row = &image.pixels()[v * image.width()..(v + 1) * image.width()];
            for (i, level) in row.iter().step_by(STEP).enumerate() {
                if f64::from(*level) > threshold {
                    run += 1;
                    continue;
                }
                if run > 0 && run <= longest {
                    let middle = STEP as f64 * (i as f64 - 0.5 * (run + 1) as f64);
                    add(&mut discs, image, [middle, v as f64], threshold, radius_px);
                }
                run = 0;
            }
        }
    }
    discs
}

fn add(discs: &mut Discs, image: &Image, seed: Point, threshold: f64, radius_px: [f64; 2]) {
    let known = |discs: &Discs, at: Point| {
        discs
            .iter()
            .any(|d| distance(d.center, at) < d.radius + 2.0)
    };
    if discs.is_full() || known(discs, seed) {
        return;
    }
    if let Some(disc) = measure(image, seed, threshold, radius_px)
        && !known(discs, disc.center)
    {
        let _ = discs.push(disc);
    }
}

/// The disc nearest to a prediction and at most `gate` px away; `levels` are those of discs seen
/// lately, `radius` is about theirs. None if there is no disc, or a second one within the gate:
/// it is not clear then which.
pub(crate) fn near(
    image: &Image,
    prediction: Point,
    gate: f64,
    levels: [f64; 2],
    radius: f64,
    radius_px: [f64; 2],
) -> Option<Disc> {
    let half = 0.5 * (levels[0] + levels[1]);
    let step = (0.7 * radius).max(2.0);
    let mut found: heapless::Vec<Disc, 2> = heapless::Vec::new();
    let mut tried: heapless::Vec<Point, TRIES> = heapless::Vec::new();
    // Squares about the prediction, from the inside out.
    let rings = (gate / step).ceil() as i32;
    for ring in 0..=rings {
        for (i, j) in square(ring) {
            let seed = [
                prediction[0] + step * f64::from(i),
                prediction[1] + step * f64::from(j),
            ];
            let bright = image
                .level(seed[0], seed[1])
                .is_some_and(|level| level > half);
            let known = found
                .iter()
                .any(|disc| distance(disc.center, seed) < disc.radius + 2.0);
            let near_tried = tried.iter().any(|at| distance(*at, seed) < 1.5 * step);
            if !bright || known || (near_tried && ring > 0) || tried.push(seed).is_err() {
                continue;
            }
            let Some(disc) = measure(image, seed, half, radius_px) else {
                continue;
            };
            let again = found
                .iter()
                .any(|other| distance(other.center, disc.center) < disc.radius);
            if distance(disc.center, prediction) <= gate && !again && found.push(disc).is_err() {
                return None;
            }
        }
    }
    match found.as_slice() {
        [disc] => Some(*disc),
        _ => None,
    }
}

/// The points of the border of a square of side 2 ring.
fn square(ring: i32) -> impl Iterator<Item = (i32, i32)> {
    (-ring..=ring).flat_map(move |j| {
        let step = if j.abs() == ring {
            1
        } else {
            (2 * ring).max(1)
        };
        (-ring..=ring).step_by(step as usize).map(move |i| (i, j))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Look, Renderer};

    const RADIUS_PX: [f64; 2] = [4.0, 24.0];

    fn goal() -> Image {
        let scene = scene::Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let mut renderer = Renderer::new(&scene, &Look::default());
        renderer.render(&scene.goal).clone()
    }

    #[test]
    fn the_whole_frame_has_four_discs() {
        assert_eq!(whole_frame(&goal(), RADIUS_PX).len(), 4);
    }

    #[test]
    fn near_a_prediction_there_is_one_and_far_from_it_none() {
        let levels = [200.0, 90.0];
        let at = [320.0 - 105.4, 240.0 - 17.6 - 79.1];
        let find = |shift: f64, gate| {
            near(
                &goal(),
                [at[0] + shift, at[1] - shift],
                gate,
                levels,
                10.0,
                RADIUS_PX,
            )
        };
        assert!(distance(find(12.0, 25.0).unwrap().center, at) < 0.2);
        assert_eq!(find(30.0, 25.0), None);
        // All four within the gate: not clear which.
        assert_eq!(find(100.0, 300.0), None);
    }

    #[test]
    fn squares_cover_the_plane_once() {
        let mut all: Vec<(i32, i32)> = (0..=3).flat_map(square).collect();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), 49);
        assert_eq!((0..=3).flat_map(square).count(), 49);
    }
}
