//! Latency from a simulated wiggle.

use tag_board::Board;
use vision_calibration_core::{Iso3, Vec3};
use vpc_calib::latency::{Frame, Latency, LatencyError, Setup, estimate, estimate_poses};
use vpc_calib::target::Target;
use vpc_calib::trajectory::{Sample, Track, Trajectory};

use crate::synthetic::{CAMERA, Chance};

fn mount() -> Iso3 {
    Iso3::new(Vec3::new(0.0495, -0.0495, 0.04), Vec3::new(0.0, 0.0, 0.8))
}

/// How the arm is wiggled.
struct Wiggle {
    /// Each joint: amplitude, rad, and frequency, Hz, of two oscillations.
    joints: [[[f64; 2]; 2]; 7],
    seconds: f64,
}

impl Wiggle {
    fn by_hand(chance: &mut Chance) -> Self {
        let mut one = || {
            [
                0.012 * (1.0 + 0.5 * chance.unit()),
                0.7 + 0.4 * chance.unit(),
            ]
        };
        Self {
            joints: std::array::from_fn(|_| [one(), one()]),
            seconds: 12.0,
        }
    }

    fn sample(&self, time: f64) -> Sample {
        let mut sample = Sample {
            time,
            q: arm::READY,
            dq: [0.0; 7],
        };
        for (k, [amplitude, hertz]) in (0..7).flat_map(|k| self.joints[k].map(|one| (k, one))) {
            let omega = std::f64::consts::TAU * hertz;
            let phase = omega * time + k as f64;
            sample.q[k] += amplitude * phase.sin();
            sample.dq[k] += amplitude * omega * phase.cos();
        }
        sample
    }
}

/// Truth: what is to be added to the stamps, and the readout, s.
struct Truth {
    offset: f64,
    readout: f64,
    noise: f64,
}

fn record(chance: &mut Chance, wiggle: &Wiggle, truth: &Truth) -> (Vec<Frame>, Trajectory) {
    let mut arm = Trajectory::default();
    // The robot tells every millisecond; a tenth of that is enough here.
    for k in 0..(wiggle.seconds * 100.0) as u32 {
        arm.push(wiggle.sample(0.01 * f64::from(k)));
    }
    let rest = vpc_calib::pose_file::flange(wiggle.sample(0.0).q);
    let board = rest * mount() * Iso3::new(Vec3::new(0.0, 0.0, 0.38), Vec3::new(0.1, 0.2, 0.3));
    let mut frames = Vec::new();
    let mut time = truth.offset.abs() + 0.05;
    while time < wiggle.seconds - truth.offset.abs() - 0.05 {
        // Each row has its time: once with that of the middle, then with that of each corner.
        let exposed = |row: f64| {
            let q = wiggle.sample(time + truth.offset + row * truth.readout).q;
            (vpc_calib::pose_file::flange(q) * mount()).inverse() * board
        };
        let mut view = chance.view(&CAMERA, &Board::default(), &exposed(0.0), 0.0);
        let target = Target::from(&Board::default());
        for (number, corner) in &mut view.points {
            for _ in 0..3 {
                let row = (corner[1] + 0.5) / f64::from(CAMERA.size[1]) - 0.5;
                let place = target.point(*number).unwrap();
                *corner = CAMERA.project(&exposed(row), place).unwrap();
            }
            *corner = corner.map(|x| x + chance.normal(truth.noise));
        }
        // One frame in fifty is lost.
        if chance.unit() < 0.96 {
            frames.push(Frame { time, view });
        }
        time += 1.0 / 30.0;
    }
    (frames, arm)
}

fn found(frames: &[Frame], arm: &Trajectory, mount: &Iso3) -> Result<Latency, LatencyError> {
    let setup = Setup {
        camera: &CAMERA,
        mount,
        target: &Target::from(&Board::default()),
    };
    estimate(frames, arm, &setup)
}

#[test]
fn the_offset_is_found_with_its_sign_and_the_readout_with_it() {
    let mut worst = 0.0f64;
    for (seed, offset) in (0..).zip([-0.12, -0.013, 0.0, 0.004, 0.033, 0.21]) {
        let mut chance = Chance::new(seed);
        let wiggle = Wiggle::by_hand(&mut chance);
        let truth = Truth {
            offset,
            readout: 0.015,
            noise: 0.1,
        };
        let (frames, arm) = record(&mut chance, &wiggle, &truth);
        // The hand-eye file is a little wrong.
        let off = Iso3::new(chance.vector(1e-3), chance.vector(0.002));
        let result = found(&frames, &arm, &(mount() * off)).unwrap();
        let verdict = result.verdict();
        assert!(verdict.is_good(), "{offset}: {verdict}\n{result}");
        let miss = result.offset - offset;
        assert!(
            miss.abs() < 0.5e-3 && miss.abs() < 5.0 * result.sigma.max(2e-5),
            "{offset}: {result}"
        );
        let [readout, _] = result.readout.unwrap();
        assert!((readout - 0.015).abs() < 2e-3, "{result}");
        worst = worst.max(miss.abs());
    }
    testkit::tell(format_args!("latency off by {:.3} ms at most", 1e3 * worst));
}

#[test]
fn an_arm_that_stands_and_one_that_moves_otherwise_are_refused() {
    let mut chance = Chance::new(7);
    let truth = Truth {
        offset: 0.03,
        readout: 0.0,
        noise: 0.1,
    };
    let still = Wiggle {
        joints: [[[0.0, 1.0]; 2]; 7],
        seconds: 6.0,
    };
    let (frames, arm) = record(&mut chance, &still, &truth);
    let said = found(&frames, &arm, &mount()).unwrap_err().to_string();
    assert!(said.contains("did the arm move"), "{said}");
    let wiggle = Wiggle::by_hand(&mut chance);
    let (frames, _) = record(&mut chance, &wiggle, &truth);
    let (_, other) = record(
        &mut Chance::new(99),
        &Wiggle::by_hand(&mut Chance::new(98)),
        &truth,
    );
    let said = match found(&frames, &other, &mount()) {
        Ok(result) => result.verdict().to_string(),
        Err(error) => error.to_string(),
    };
    assert!(
        said.contains("are hand-eye file and board the right ones"),
        "{said}"
    );
    let (few, arm) = record(
        &mut chance,
        &Wiggle {
            seconds: 1.5,
            ..wiggle
        },
        &truth,
    );
    let error = found(&few, &arm, &mount()).unwrap_err();
    assert!(
        matches!(error, LatencyError::TooFew { found: 1..60 }),
        "{error}"
    );
}

#[test]
fn a_motion_that_repeats_itself_is_not_good_enough() {
    let mut chance = Chance::new(8);
    let mut wiggle = Wiggle::by_hand(&mut chance);
    for joint in &mut wiggle.joints {
        *joint = [[0.01, 4.0]; 2];
    }
    let (frames, arm) = record(
        &mut chance,
        &wiggle,
        &Truth {
            offset: 0.02,
            readout: 0.0,
            noise: 0.1,
        },
    );
    let said = found(&frames, &arm, &mount())
        .unwrap()
        .verdict()
        .to_string();
    assert!(said.contains("wiggle irregularly"), "{said}");
}

/// Poses of the flange at 50 Hz, and of the board at 30 Hz with wrong stamps.
fn poses(chance: &mut Chance, wiggle: &Wiggle, offset: f64) -> (Vec<(f64, Iso3)>, Track) {
    let flange = |time: f64| vpc_calib::pose_file::flange(wiggle.sample(time).q);
    let robot = (0..600).map(|k| 0.02 * f64::from(k));
    let robot: Vec<_> = robot.map(|time| (time, flange(time))).collect();
    let board = Iso3::new(Vec3::new(0.5, 0.0, 0.0), Vec3::new(3.1, 0.0, 0.1));
    let seen = (10..340).map(|k| f64::from(k) / 30.0);
    let pose = |time: f64| {
        let off = Iso3::new(chance.vector(1e-3), chance.vector(2e-3));
        (
            time,
            (flange(time + offset) * mount()).inverse() * board * off,
        )
    };
    (seen.map(pose).collect(), Track::from(robot))
}

#[test]
fn poses_alone_give_the_offset_and_a_true_deviation() {
    let (mut scores, mut worst) = (Vec::new(), 0.0f64);
    for (seed, offset) in [-0.12, -0.04, -0.003, 0.0, 0.017, 0.09, 0.2]
        .into_iter()
        .enumerate()
    {
        let mut chance = Chance::new(seed as u64);
        let mut wiggle = Wiggle::by_hand(&mut chance);
        for joint in &mut wiggle.joints {
            joint.iter_mut().for_each(|one| one[0] *= 5.0);
        }
        let (seen, arm) = poses(&mut chance, &wiggle, offset);
        let result = estimate_poses(&seen, &arm).unwrap();
        assert!(result.verdict().is_good(), "{}\n{result}", result.verdict());
        let off = result.offset - offset;
        worst = worst.max(off.abs());
        scores.push(off / result.sigma);
    }
    testkit::tell(format_args!(
        "poses alone: off by {:.2} ms at most",
        1e3 * worst
    ));
    let spread = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
    assert!(
        worst < 1e-3 && (0.1..3.5).contains(&spread),
        "{worst} {spread} {scores:?}"
    );
    // Of another motion.
    let mut chance = Chance::new(3);
    let [one, other] = [0, 1].map(|_| Wiggle::by_hand(&mut chance));
    let (seen, _) = poses(&mut chance, &one, 0.0);
    let (few, arm) = poses(&mut chance, &other, 0.0);
    let error = estimate_poses(&seen, &arm);
    assert!(
        matches!(error, Err(LatencyError::Unrelated(_))),
        "{error:?}"
    );
    let error = estimate_poses(&few[..50], &arm);
    assert_eq!(error, Err(LatencyError::TooFew { found: 50 }));
}
