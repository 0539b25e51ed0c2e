//! Whether features can go straight to others: no point's way there cuts an occlusion.

use vpc::Task;
use vpc::obstacle::Obstacle;

/// Whether every point has a straight way in the image to its place among others on which its
/// marker, of such a radius in px, cuts no occlusion deeper than `slide_px`, looked at every
/// `every_px`.
pub fn is_free(
    task: &Task,
    from: &[[f64; 2]],
    to: &[[f64; 2]],
    radii: &[f64],
    slide_px: f64,
    every_px: f64,
) -> bool {
    let ways = from.iter().zip(to).zip(radii);
    let mut ways = ways.map(|((&from, &to), radius)| Way {
        from,
        to,
        clearance: radius - slide_px,
    });
    ways.all(|way| way.is_free(task, every_px))
}

/// A straight way of one point, px.
struct Way {
    from: [f64; 2],
    to: [f64; 2],
    /// Least clearance from an occlusion, px.
    clearance: f64,
}

impl Way {
    /// Whether the way is clear of the occlusions, looked at every `every_px`.
    fn is_free(&self, task: &Task, every_px: f64) -> bool {
        task.obstacles()
            .all(|obstacle| self.passes(obstacle, every_px))
    }

    fn passes(&self, obstacle: Obstacle<'_>, every_px: f64) -> bool {
        let [low, high] = obstacle.bounding_box();
        let about = self.clearance.max(0.0);
        let (low, high) = (low.map(|x| x - about), high.map(|x| x + about));
        let Some((begin, end)) = self.inside(low, high) else {
            return true;
        };
        let [du, dv] = self.along();
        let length = (du.abs() + dv.abs()) * (end - begin);
        let count = (length / every_px).ceil().max(1.0) as u32;
        (0..=count).all(|i| {
            let t = begin + (end - begin) * f64::from(i) / f64::from(count);
            let pixel = [self.from[0] + t * du, self.from[1] + t * dv];
            obstacle.clearance(pixel).distance >= self.clearance
        })
    }

    /// Where the way enters and leaves a box, each a share of it; `None` where it passes by.
    fn inside(&self, low: [f64; 2], high: [f64; 2]) -> Option<(f64, f64)> {
        let (from, to) = (self.from, self.to);
        // Most boxes lie on one side of the way.
        if (0..2).any(|k| from[k].max(to[k]) <= low[k] || from[k].min(to[k]) >= high[k]) {
            return None;
        }
        let (mut begin, mut end) = (0.0_f64, 1.0_f64);
        let along = self.along();
        // Where it does not move in a coordinate, that lies inside.
        for k in (0..2).filter(|&k| along[k].abs() > 1e-9) {
            let one = (low[k] - from[k]) / along[k];
            let other = (high[k] - from[k]) / along[k];
            begin = begin.max(one.min(other));
            end = end.min(one.max(other));
        }
        (begin < end).then_some((begin, end))
    }

    fn along(&self) -> [f64; 2] {
        [self.to[0] - self.from[0], self.to[1] - self.from[1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vpc::constraint;

    const SLIDE_PX: f64 = 3.0;
    const EVERY_PX: f64 = 6.0;

    fn is_free(task: &Task, from: &[[f64; 2]], to: &[[f64; 2]]) -> bool {
        super::is_free(task, from, to, &[0.0; 2], SLIDE_PX, EVERY_PX)
    }

    fn task() -> Task {
        Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap()
    }

    #[test]
    fn an_occlusion_blocks_what_cuts_it_and_nothing_else() {
        // The bar at the top covers u 450 to 750, v 140 to 240.
        let task = task();
        for (from, to, expected) in [
            ([600.0, 120.0], [600.0, 300.0], false),
            ([600.0, 300.0], [600.0, 120.0], false),
            ([430.0, 190.0], [770.0, 190.0], false),
            ([430.0, 190.0], [430.0, 300.0], true),
            ([440.0, 120.0], [770.0, 130.0], true),
            ([600.0, 240.0], [700.0, 300.0], true),
            ([600.0, 240.0], [600.0, 240.0], true),
            ([500.0, 240.0], [700.0, 238.0], true),
            ([500.0, 240.0], [700.0, 232.0], false),
        ] {
            assert_eq!(is_free(&task, &[from], &[to]), expected, "{from:?} {to:?}");
        }
        let (free, blocked) = ([430.0, 190.0], [600.0, 120.0]);
        let there = [[430.0, 300.0], [600.0, 300.0]];
        assert!(!is_free(&task, &[free, blocked], &there));
    }

    #[test]
    fn a_marker_needs_a_wider_way_than_a_point() {
        // Past the right end of the bar at the top, which is at u = 750.
        let task = task();
        let passes = |u: f64, radius: f64| {
            let (from, to) = ([u, 120.0], [u, 260.0]);
            super::is_free(&task, &[from], &[to], &[radius], SLIDE_PX, EVERY_PX)
        };
        assert_eq!([755.0, 765.0, 785.0].map(|u| passes(u, 0.0)), [true; 3]);
        assert_eq!(
            [755.0, 765.0, 785.0].map(|u| passes(u, 30.0)),
            [false, false, true]
        );
        assert!(!passes(740.0, 0.0));
    }

    #[test]
    fn it_is_what_the_clearance_says_all_along() {
        let task = task();
        let mut seen = [0; 2];
        for k in 0..2000 {
            let at = |m: usize| ((k * m) % 1021) as f64;
            let (from, to) = ([at(7919), at(104_729)], [at(1299), at(15_485)]);
            let depth = (0..=2000)
                .map(|i| {
                    let t = f64::from(i) / 2000.0;
                    let pixel = [0, 1].map(|k| from[k] + t * (to[k] - from[k]));
                    constraint::least_clearance(&task, pixel)
                })
                .fold(f64::INFINITY, f64::min);
            let is_free = is_free(&task, &[from], &[to]);
            seen[usize::from(is_free)] += 1;
            // Between two places that are looked at, a corner may be missed.
            match is_free {
                true => assert!(depth >= -SLIDE_PX - EVERY_PX, "{depth} {from:?} {to:?}"),
                false => assert!(depth < -SLIDE_PX, "{depth} {from:?} {to:?}"),
            }
        }
        assert!(seen.iter().all(|&count| count > 200), "{seen:?}");
    }
}
