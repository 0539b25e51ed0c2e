//! The law with a camera that delivers late, against the truth: the twist for delayed features is
//! the one for the true features of now, and nothing changes where there is no delay.

use vpc::{DOF, Law, Measurement, Model, Refusal, Settings, Twist};

use crate::world::World;

/// A camera that obeys exactly, in simulated time.
struct Camera {
    world: World,
    cycle: u64,
    /// The first point is shown beside where it is by this much, px.
    bias: f64,
    /// Of the law that looks.
    filter_s: f64,
}

impl Camera {
    fn new() -> Self {
        let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
        Self {
            world: World::new(&starts[0]),
            cycle: 0,
            bias: 0.0,
            filter_s: Settings::default().filter_s,
        }
    }

    fn controller(&self, compensated: bool) -> Law<Vec<f64>> {
        let settings = Settings {
            delay_compensation: compensated,
            filter_s: self.filter_s,
            // A point that is not where it is looks like a motion of the pattern.
            drift_compensation: self.bias == 0.0,
            ..Settings::default()
        };
        Law::new(&self.world.scene, settings, |len| vec![0.0; len]).unwrap()
    }

    fn features(&self) -> Vec<[f64; 2]> {
        let mut features = self.world.features();
        features[0] = features[0].map(|x| x + self.bias);
        features
    }

    fn time_ns(&self, cycle: u64) -> u64 {
        (cycle as f64 * self.world.scene.sampling_time() * 1e9).round() as u64
    }

    fn now_ns(&self) -> u64 {
        self.time_ns(self.cycle)
    }

    fn obey(&mut self, twist: &Twist) {
        self.world.obey(twist, self.world.scene.sampling_time());
        self.cycle += 1;
    }
}

/// Runs for `cycles` with a delay of `frames`, the delayed law steering; beside it a law that sees
/// the present. Twists of both for each cycle in which a frame was delivered.
fn side_by_side(
    mut camera: Camera,
    frames: usize,
    cycles: usize,
    compensated: bool,
) -> Vec<(Twist, Twist)> {
    let (mut late, mut present) = (camera.controller(compensated), camera.controller(true));
    let (mut frames_under_way, mut twists) = (Vec::new(), Vec::new());
    for k in 0..cycles {
        let now_ns = camera.now_ns();
        frames_under_way.push((camera.features(), now_ns));
        let mut twist = [0.0; DOF];
        if let Some((seen, exposed_ns)) = k.checked_sub(frames).map(|k| &frames_under_way[k]) {
            let seen = Measurement::from_points(seen).taken(*exposed_ns, now_ns);
            twist = late.step(&seen, None).unwrap().twist;
            let truth = Measurement::from_points(&camera.features()).taken(now_ns, now_ns);
            twists.push((twist, present.step(&truth, None).unwrap().twist));
        }
        late.sent(&twist, now_ns);
        present.sent(&twist, now_ns);
        camera.obey(&twist);
    }
    twists
}

fn difference((a, b): &(Twist, Twist)) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

#[test]
fn late_features_are_answered_as_the_true_ones_of_now_would_be() {
    for frames in [1, 2, 4] {
        let twists = side_by_side(Camera::new(), frames, 60, true);
        assert!(twists.len() >= 50 && twists.iter().any(|(a, _)| a[0].abs() > 0.1));
        let worst = twists.iter().map(difference).fold(0.0, f64::max);
        assert!(worst < 1e-5, "{frames} frames: {worst}");
        // Not for want of motion: taken for present ones, they are answered otherwise.
        let naive = side_by_side(Camera::new(), frames, 10 + frames, false);
        let worst = naive.iter().map(difference).fold(0.0, f64::max);
        assert!(worst > 1e-2, "{frames} frames, not compensated: {worst}");
    }
}

#[test]
fn without_delay_nothing_changes_by_a_bit() {
    let mut camera = Camera::new();
    camera.bias = 0.7;
    let (mut on, mut off) = (camera.controller(true), camera.controller(false));
    for _ in 0..60 {
        let now_ns = camera.now_ns();
        let plain = Measurement::from_points(&camera.features());
        let stamped = plain.clone().taken(now_ns, now_ns);
        let step = on.step(&stamped, None).unwrap();
        assert_eq!(step, off.step(&plain, None).unwrap());
        on.sent(&step.twist, now_ns);
        off.sent(&step.twist, now_ns);
        camera.obey(&step.twist);
    }
}

#[test]
fn the_mismatch_of_late_features_is_that_of_their_exposure() {
    // One point is always shown beside where it is, so that no pose explains the features and eps
    // is never zero. A law that sees late and compares like with like answers as one that sees at
    // once; the rest is how the error of the fit changes along the way of four frames.
    let camera = Camera {
        bias: 3.0,
        filter_s: 0.0,
        ..Camera::new()
    };
    let twists = side_by_side(camera, 4, 60, true);
    let worst = twists.iter().map(difference).fold(0.0, f64::max);
    assert!(worst < 0.05, "{worst}");
}

#[test]
fn features_older_than_the_known_commands_are_refused() {
    let camera = Camera::new();
    let mut law = camera.controller(true);
    law.go_live(100_000_000);
    let seen = |k: u64, frames: u64| {
        let (now_ns, then_ns) = (camera.time_ns(k), camera.time_ns(k - frames));
        Measurement::from_points(&camera.features()).taken(then_ns, now_ns)
    };
    let mut refused = 0;
    for k in 10..20 {
        match law.step(&seen(k, 4), None) {
            Ok(_) => break,
            Err(Refusal::Late { age_ns, known_ns }) => {
                assert!(known_ns < age_ns);
                refused += 1;
            }
            Err(other) => panic!("{other}"),
        }
        law.sent(&[0.0; DOF], camera.time_ns(k));
    }
    assert_eq!(refused, 4);
    // A delay beyond what is remembered is never known.
    let (last, most) = (100, 34);
    (20..last).for_each(|k| law.sent(&[0.0; DOF], camera.time_ns(k)));
    assert!(law.step(&seen(last, most), None).is_ok());
    let refusal = law.step(&seen(last, most + 1), None).unwrap_err();
    assert!(matches!(refusal, Refusal::Late { .. }), "{refusal}");
    assert!(
        refusal
            .to_string()
            .contains("exposed 1166.7 ms ago; allowed: 1133.3 ms"),
        "{refusal}"
    );
}

#[test]
fn every_model_and_the_classic_law_step_on_late_features() {
    for (model, strategy) in [
        (Model::AreaDepth, vpc::Strategy::Previous),
        (Model::TargetDepth, vpc::Strategy::Previous),
        (Model::Pose, vpc::Strategy::Ibvs),
    ] {
        let camera = Camera::new();
        let settings = Settings {
            model,
            strategy,
            ..Settings::default()
        };
        let mut law = Law::new(&camera.world.scene, settings, |len| vec![0.0; len]).unwrap();
        law.sent(&[0.3, -0.2, 0.1, 0.2, -0.3, 0.4], 0);
        let seen = Measurement::from_points(&camera.features());
        let late = law.step(&seen.clone().taken(0, 100_000_000), None).unwrap();
        law.reset();
        let present = law.step(&seen, None).unwrap();
        assert!(
            (late.error_px - present.error_px).abs() > 1.0,
            "{model:?} {strategy}"
        );
    }
}
