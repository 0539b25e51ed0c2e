//! The frozen-image check: a driver may repeat its last image for ever with fresh time stamps.

use crate::Points;
use crate::measurement::Refusal;

/// Commanded motion of the image, px, after which features without a changed bit show that the
/// image is frozen.
const FROZEN_PX: f64 = 3.0;
/// Share of a motion that counts where the pattern is believed to move along: coarse features of a
/// pattern that is followed well may repeat for a second.
const ALONG: f64 = 1.0 / 30.0;

/// Compares features with those `before`; a point should have moved meanwhile by the first of
/// `moved_px`, and by the second if the pattern stood still. Real features never repeat to the last
/// bit under motion. At rest and without noise they do, and no motion is expected. `still_px` is
/// the largest expected motion of a point since the bits changed, summed over the frames, px.
///
/// # Errors
/// [`Refusal::Frozen`] if more motion was commanded than a live image can hide.
pub fn check(
    still_px: &mut f64,
    points: &Points,
    before: &Points,
    [moved_px, commanded_px]: [f64; 2],
) -> Result<(), Refusal> {
    let moved_px = moved_px.max(ALONG * commanded_px);
    let mut pairs = points.iter().flatten().zip(before.iter().flatten());
    let is_same = pairs.all(|(now, before)| now.to_bits() == before.to_bits());
    if moved_px == 0.0 || !is_same {
        *still_px = 0.0;
        return Ok(());
    }
    *still_px += moved_px;
    match *still_px > FROZEN_PX {
        true => Err(Refusal::Frozen {
            expected_px: *still_px,
        }),
        false => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Task;

    #[test]
    fn an_image_that_ignores_the_commands_to_the_last_bit_is_frozen() {
        let scene = scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let points = Task::new(&scene).unwrap().goal;
        let mut still_px = 0.0;
        let mut frame = |points: &Points, before: &Points, by: f64| {
            check(&mut still_px, points, before, [by, by])
        };
        assert_eq!(frame(&points, &points, 1.4), Ok(()));
        assert_eq!(frame(&points, &points, 1.4), Ok(()));
        let refusal = frame(&points, &points, 1.4);
        assert!(matches!(refusal, Err(Refusal::Frozen { .. })));
        // No motion, or one bit that changes, and nothing is wrong.
        assert_eq!(frame(&points, &points, 0.0), Ok(()));
        assert_eq!(frame(&points, &points, 2.0), Ok(()));
        let mut changed = points.clone();
        changed[2][1] = f64::from_bits(changed[2][1].to_bits() + 1);
        assert_eq!(frame(&changed, &points, 2.0), Ok(()));
        assert_eq!(frame(&changed, &changed, 2.0), Ok(()));
    }
}
