//! The free camera's frames: what hides points, and its flaws, pixel noise, delay and lost frames,
//! all seeded.

use std::collections::VecDeque;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use scene::Scene;

use crate::camera::Points;
use crate::occlusion::Shape;

/// Flaws of the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flaws {
    /// Standard deviation of each pixel coordinate, px.
    pub noise_px: f64,
    /// Frames between exposure and delivery.
    pub delay_frames: usize,
    /// Probability that a frame is lost, 0 to 1.
    pub drop: f64,
    /// Probability that a frame does not show one of its points, 0 to 1.
    pub hide: f64,
    /// Once, in the first two seconds, frames show no point for so long, s.
    pub blackout_s: f64,
    /// Seed of all of these.
    pub seed: u64,
}

/// A delivered frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Measured features, px.
    pub points: Points,
    /// Bit i is set if point i is seen.
    pub visible: u32,
    /// When they were exposed, ns on the monotonic clock.
    pub exposure_ns: u64,
}

/// The sensor with its frames under way.
#[derive(Clone, Debug)]
pub struct Sensor {
    flaws: Flaws,
    /// What may hide points.
    shapes: Vec<Shape>,
    under_way: VecDeque<Frame>,
    random: ChaCha8Rng,
    /// Of hidden points.
    hiding: ChaCha8Rng,
    /// When the blackout begins and ends, s after the first frame.
    blackout_s: [f64; 2],
    first_ns: Option<u64>,
}

/// A blackout begins within this time, s.
const BLACKOUT_S: f64 = 2.0;

impl Sensor {
    /// A sensor with these flaws, behind the crossable occlusions of a scene.
    pub fn new(scene: &Scene, flaws: Flaws) -> Self {
        let crossable = scene.occlusions.iter().filter(|one| one.crossable);
        let random = ChaCha8Rng::seed_from_u64(flaws.seed);
        let mut hiding = ChaCha8Rng::seed_from_u64(flaws.seed);
        hiding.set_stream(1);
        let begin_s = BLACKOUT_S * hiding.random::<f64>();
        Self {
            hiding,
            blackout_s: [begin_s, begin_s + flaws.blackout_s],
            first_ns: None,
            shapes: crossable.map(Shape::new).collect(),
            flaws,
            under_way: VecDeque::with_capacity(flaws.delay_frames + 1),
            random,
        }
    }

    /// Exposes a frame and delivers the one whose time has come, unless it is lost.
    pub fn expose(&mut self, points: &Points, exposure_ns: u64) -> Option<Frame> {
        // Drawn for every frame, so that one flaw does not change the numbers of another.
        let lost = self.random.random::<f64>() < self.flaws.drop;
        let covered = self.covered(points);
        let mut points = points.clone();
        if let Ok(noise) = Normal::new(0.0, self.flaws.noise_px) {
            points
                .iter_mut()
                .flatten()
                .for_each(|x| *x += noise.sample(&mut self.random));
        }
        let visible = self.visible(points.len(), exposure_ns) & !covered;
        self.under_way.push_back(Frame {
            points,
            visible,
            exposure_ns,
        });
        let due = self.under_way.len() > self.flaws.delay_frames;
        due.then(|| self.under_way.pop_front())
            .flatten()
            .filter(|_| !lost)
    }

    /// The points behind an occlusion.
    fn covered(&self, points: &Points) -> u32 {
        let is_covered = |pixel| self.shapes.iter().any(|shape| shape.covers(pixel));
        let points = points.iter().enumerate();
        points.fold(0, |bits, (point, &pixel)| {
            bits | u32::from(is_covered(pixel)) << point
        })
    }

    /// The points that no flaw hides in a frame.
    fn visible(&mut self, count: usize, exposure_ns: u64) -> u32 {
        let [is_hidden, which] = [(); 2].map(|()| self.hiding.random::<f64>());
        let first_ns = *self.first_ns.get_or_insert(exposure_ns);
        let since_s = exposure_ns.saturating_sub(first_ns) as f64 * 1e-9;
        let [begin_s, end_s] = self.blackout_s;
        let all = (1 << count) - 1;
        if (begin_s..end_s).contains(&since_s) {
            return 0;
        }
        match is_hidden < self.flaws.hide {
            true => all & !(1 << (which * count as f64) as u32),
            false => all,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> Points {
        [[10.0, 20.0], [30.0, 40.0]].into_iter().collect()
    }

    fn sensor(flaws: Flaws) -> Sensor {
        Sensor::new(&Scene::parse(scene::PAPER_SIM, "sim").unwrap(), flaws)
    }

    #[test]
    fn what_may_be_crossed_hides_points() {
        let mut scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let middle = scene.occlusions[1].parts[0].center;
        let points = [[10.0, 20.0], middle].into_iter().collect();
        for (crossable, visible) in [(false, 0b11), (true, 0b01)] {
            scene.occlusions[1].crossable = crossable;
            let mut sensor = Sensor::new(&scene, Flaws::default());
            assert_eq!(sensor.expose(&points, 7).unwrap().visible, visible);
        }
    }

    #[test]
    fn without_flaws_what_is_exposed_is_delivered() {
        let frame = sensor(Flaws::default()).expose(&points(), 7);
        assert_eq!(
            frame,
            Some(Frame {
                points: points(),
                visible: 0b11,
                exposure_ns: 7
            })
        );
    }

    #[test]
    fn delayed_frames_keep_their_exposure_stamp() {
        let mut sensor = sensor(Flaws {
            delay_frames: 2,
            ..Flaws::default()
        });
        let stamps: Vec<Option<u64>> = (0..4)
            .map(|k| sensor.expose(&points(), k).map(|frame| frame.exposure_ns))
            .collect();
        assert_eq!(stamps, [None, None, Some(0), Some(1)]);
    }

    #[test]
    fn noise_and_losses_have_the_size_asked_for_and_follow_the_seed() {
        let flaws = Flaws {
            noise_px: 0.5,
            drop: 0.25,
            seed: 3,
            ..Flaws::default()
        };
        let deliver = |flaws| {
            let mut sensor = sensor(flaws);
            (0..4000)
                .map(|k| sensor.expose(&points(), k))
                .collect::<Vec<_>>()
        };
        let frames = deliver(flaws);
        assert_eq!(frames, deliver(flaws));
        let delivered: Vec<&Frame> = frames.iter().flatten().collect();
        assert!((2850..3150).contains(&delivered.len()));
        let square: f64 = delivered
            .iter()
            .map(|f| (f.points[0][0] - 10.0).powi(2))
            .sum();
        assert!((square / delivered.len() as f64 - 0.25).abs() < 0.03);
    }
}
