//! The bars that the detector must reach, on rendered images of the robot scene.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Pose, Scene};
use testkit::repeats;
use vision::{Detector, DetectorSettings, Image, Look, Renderer, Truth, truth};

const RADIUS: f64 = 0.006;

fn robot() -> Scene {
    Scene::parse(scene::PAPER_ROBOT, "paper-robot.toml").unwrap()
}

fn detector(scene: &Scene) -> Detector {
    Detector::new(scene, &DetectorSettings::default())
}

fn random(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

fn between(random: &mut ChaCha8Rng, least: f64, most: f64) -> f64 {
    least + (most - least) * random.random::<f64>()
}

/// A pose of the start region, or of one twice as wide that also shows markers cut by the image
/// border.
fn any_pose(scene: &Scene, random: &mut ChaCha8Rng, wider: f64) -> Pose {
    let starts = &scene.starts;
    let translation = [0, 1, 2].map(|k| {
        let (a, b) = (starts.translation_min[k], starts.translation_max[k]);
        if k == 2 {
            between(random, a, b)
        } else {
            between(random, wider * a, wider * b)
        }
    });
    let tilts = [(); 2].map(|()| between(random, -starts.tilt_max, starts.tilt_max));
    let roll = between(random, -starts.roll_max, starts.roll_max);
    Pose {
        translation,
        rotation: [tilts[0], tilts[1], roll],
    }
}

fn all(scene: &Scene, pose: &Pose) -> Vec<Truth> {
    truth(scene, pose, RADIUS, |_| true).to_vec()
}

fn error(truth: &Truth, pixel: [f64; 2]) -> f64 {
    (truth.pixel[0] - pixel[0]).hypot(truth.pixel[1] - pixel[1])
}

/// What a detector did over many frames.
#[derive(Default, Debug)]
struct Tally {
    seen: usize,
    square: f64,
    worst_clear: f64,
    worst_partial: f64,
    occluded: usize,
    false_alarms: usize,
    clear: usize,
    clear_missed: usize,
    partial_seen: usize,
}

impl Tally {
    fn add(&mut self, truths: &[Truth], detector: &Detector) {
        // One or two discs of a frame alone could be any marker.
        let known = truths.iter().filter(|truth| truth.covered == 0.0).count() >= 3;
        for (truth, marker) in truths.iter().zip(detector.sightings()) {
            assert!(marker.pixel.iter().all(|x| x.is_finite()));
            let clear = truth.covered == 0.0;
            self.occluded += usize::from(truth.occluded);
            self.clear += usize::from(clear && known);
            self.clear_missed += usize::from(clear && known && !marker.visible);
            if !marker.visible {
                continue;
            }
            let error = error(truth, marker.pixel);
            self.false_alarms += usize::from(truth.occluded);
            self.seen += 1;
            if clear {
                self.square += error * error;
                self.worst_clear = self.worst_clear.max(error);
            } else {
                self.partial_seen += 1;
                self.worst_partial = self.worst_partial.max(error);
            }
        }
    }

    fn rms(&self) -> f64 {
        (self.square / (self.seen - self.partial_seen) as f64).sqrt()
    }
}

/// Random frames, each found anew, more than a quarter of which have an occluded marker.
#[test]
fn occluded_markers_are_never_visible_and_the_others_are_where_they_are() {
    let scene = robot();
    let mut renderer = Renderer::new(&scene, &Look::default());
    let mut detector = detector(&scene);
    let mut random = random(1);
    let mut tally = Tally::default();
    let frames = repeats("random frames", 200, 10_000);
    for _ in 0..frames {
        let pose = any_pose(&scene, &mut random, 1.6);
        detector.expect(&pose);
        detector.detect(renderer.render(&pose)).unwrap();
        tally.add(&all(&scene, &pose), &detector);
    }
    println!("{} px RMS, {tally:?}", tally.rms());
    assert!(tally.occluded > frames / 4, "{tally:?}");
    assert_eq!(tally.false_alarms, 0, "{tally:?}");
    assert!(tally.rms() < 0.05, "{tally:?}");
    assert!(
        tally.worst_clear < 0.25 && tally.worst_partial < 0.5,
        "{tally:?}"
    );
    // Not by closing its eyes.
    assert!(20 * tally.clear_missed < tally.clear, "{tally:?}");
}

/// A camera that wanders smoothly: sums of sines, faster than the scene's limits allow.
struct Walk {
    phases: [[f64; 3]; 6],
}

impl Walk {
    fn new(random: &mut ChaCha8Rng) -> Self {
        let mut phase = || between(random, 0.0, std::f64::consts::TAU);
        Self {
            phases: [(); 6].map(|()| [phase(), phase(), phase()]),
        }
    }

    fn pose(&self, frame: usize) -> Pose {
        let sines = |k: usize| {
            let wave = |i: usize, period: f64| {
                (std::f64::consts::TAU * frame as f64 / period + self.phases[k][i]).sin()
            };
            0.6 * wave(0, 331.0 + 20.0 * k as f64) + 0.3 * wave(1, 127.0) + 0.1 * wave(2, 53.0)
        };
        Pose {
            translation: [0.13 * sines(0), 0.13 * sines(1), 0.44 + 0.11 * sines(2)],
            rotation: [0.2 * sines(3), 0.2 * sines(4), 0.8 * sines(5)],
        }
    }
}

/// Frames in sequences of 1,000, with losses of frames: behind object, spot and border, and
/// back again.
#[test]
fn identity_is_never_swapped() {
    let scene = robot();
    let mut renderer = Renderer::new(&scene, &Look::default());
    let mut detector = detector(&scene);
    let mut random = random(2);
    let mut tally = Tally::default();
    let mut returns = 0;
    let sequences = repeats("sequences of 1,000 frames", 1, 10);
    for _ in 0..sequences {
        let walk = Walk::new(&mut random);
        detector.expect(&walk.pose(0));
        let mut before = 0;
        for frame in 0..1_000 {
            if random.random::<f64>() < 0.01 {
                continue;
            }
            let pose = walk.pose(frame);
            detector.detect(renderer.render(&pose)).unwrap();
            // A swapped marker would be wrong by the distance of two: 60 px at least.
            tally.add(&all(&scene, &pose), &detector);
            returns += (detector.visible() & !before).count_ones();
            before = detector.visible();
        }
    }
    println!("{} px RMS, {returns} returns, {tally:?}", tally.rms());
    assert!(returns as usize > 20 * sequences, "{returns}");
    assert!(
        tally.worst_clear < 0.25 && tally.worst_partial < 0.5,
        "{tally:?}"
    );
    assert_eq!(tally.false_alarms, 0, "{tally:?}");
    assert!(50 * tally.clear_missed < tally.clear, "{tally:?}");
}

/// Strong tilt and large discs, where centroids are off by a quarter to half a pixel: what the
/// correction is for.
#[test]
fn centres_are_right_even_where_centroids_are_not() {
    let scene = robot();
    let look = Look {
        marker_radius_m: 0.014,
        ..Look::default()
    };
    let settings = DetectorSettings {
        marker_radius_m: 0.014,
        radius_px: [4.0, 40.0],
    };
    let mut renderer = Renderer::new(&scene, &look);
    let mut detector = Detector::new(&scene, &settings);
    let mut random = random(3);
    let (mut square, mut count) = (0.0, 0);
    for _ in 0..200 {
        let pose = Pose {
            translation: [0.0, -0.02, between(&mut random, 0.33, 0.4)],
            rotation: [
                between(&mut random, 0.35, 0.5),
                between(&mut random, -0.2, 0.2),
                0.0,
            ],
        };
        detector.expect(&pose);
        detector.detect(renderer.render(&pose)).unwrap();
        if detector.visible() == 0b1111 {
            for (truth, marker) in all(&scene, &pose).iter().zip(detector.sightings()) {
                square += error(truth, marker.pixel).powi(2);
                count += 1;
            }
        }
    }
    let rms = f64::sqrt(square / f64::from(count));
    println!("{rms} px RMS of {count}");
    assert!(count > 400 && rms < 0.1, "{rms} {count}");
}

/// The starts of the scene: clear of occlusions by 15 px, so that all markers must be seen.
#[test]
fn every_start_of_the_scene_is_seen_whole() {
    let scene = robot();
    let starts = scene::parse_starts(scene::PAPER_ROBOT_STARTS, "starts").unwrap();
    let mut renderer = Renderer::new(&scene, &Look::default());
    let mut detector = detector(&scene);
    for (k, start) in starts.iter().enumerate() {
        detector.expect(start);
        detector.detect(renderer.render(start)).unwrap();
        assert_eq!(detector.visible(), 0b1111, "start {k}");
    }
}

/// A frame in which nothing can be seen.
#[test]
fn a_dark_or_a_noisy_frame_has_no_markers() {
    let scene = robot();
    let mut detector = detector(&scene);
    let mut random = random(4);
    let dark = Image::new(640, 480);
    let mut noisy = dark.clone();
    noisy.pixels_mut().fill_with(|| random.random());
    for image in [dark, noisy] {
        detector.detect(&image).unwrap();
        assert_eq!(detector.visible(), 0);
    }
}
