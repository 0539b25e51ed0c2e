//! Hand-eye calibration from noisy corners and a robot that misses.

use tag_board::Board;
use vision_calibration_core::{Iso3, Vec3};
use vpc_calib::hand_eye::{HandEye, HandEyeError, Mounting, Pair, Reason};
use vpc_calib::hand_eye::{calibrate, calibrate_poses};
use vpc_calib::pose_file::RobotPose;
use vpc_calib::target::Target;

use crate::station::{PANDA, mount, pairs, place};
use crate::synthetic::{CAMERA, Chance};

fn found(pairs: &[Pair]) -> Result<HandEye, HandEyeError> {
    calibrate(
        pairs,
        Mounting::EyeInHand,
        &CAMERA,
        &Target::from(&Board::default()),
    )
}

#[test]
fn the_mounting_is_found_and_its_uncertainty_is_true() {
    let (mut scores, mut worst) = (Vec::new(), [0.0f64; 2]);
    for seed in 0..testkit::repeats("hand-eye", 1, 40) as u64 {
        let result = found(&pairs(&mut Chance::new(seed), 12, 35.0, PANDA)).unwrap();
        let verdict = result.verdict();
        assert!(verdict.is_good(), "{seed}: {verdict}\n{result}");
        let off = mount().inverse() * result.camera;
        let (moved, turned) = (off.translation.vector, off.rotation.angle().to_degrees());
        worst = [worst[0].max(moved.norm()), worst[1].max(turned)];
        assert!(
            moved.norm() < 0.5e-3 && turned < 0.06,
            "{seed}: {moved} {turned}"
        );
        let sigma = result.sigma.unwrap();
        scores.extend((0..3).map(|k| moved[k] / sigma[k]));
        let size = result.scale.unwrap();
        assert!(
            (size.size - 1.0).abs() < 0.002_f64.max(4.0 * size.sigma),
            "{size:?}"
        );
    }
    testkit::tell(format_args!(
        "hand-eye off by {:.2} mm, {:.3} deg at most",
        1e3 * worst[0],
        worst[1]
    ));
    // Of one calibration alone, three standard deviations at most.
    let spread = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
    let allowed = if testkit::is_long() {
        0.2..3.0
    } else {
        0.0..9.0
    };
    assert!(allowed.contains(&spread), "{spread}: {scores:?}");
}

#[test]
fn motions_that_say_too_little_are_refused() {
    let mut chance = Chance::new(1);
    let few = pairs(&mut chance, 4, 35.0, PANDA);
    assert_eq!(found(&few).unwrap_err(), HandEyeError::TooFew { found: 4 });
    // Turned about the optical axis only.
    let flat = pairs(&mut chance, 12, 1.0, PANDA);
    let error = found(&flat).unwrap_err();
    assert_eq!(error, HandEyeError::Axes { found: 1 });
    let said = error.to_string();
    assert!(
        said.contains("about its x axis, its y axis and its z axis"),
        "{said}"
    );
}

#[test]
#[ignore = "long: the optimizer is others' code, which a dev build does not optimize"]
fn a_board_of_another_size_is_told_by_the_motion() {
    let pairs = pairs(&mut Chance::new(2), 12, 35.0, PANDA);
    // Printed at 97 %, to fit the page.
    let believed = Board {
        tag_size: 0.030 / 0.97,
        gap: 0.0075 / 0.97,
        ..Board::default()
    };
    let result = calibrate(
        &pairs,
        Mounting::EyeInHand,
        &CAMERA,
        &Target::from(&believed),
    )
    .unwrap();
    let size = result.scale.unwrap();
    let most = 0.002_f64.max(4.0 * size.sigma);
    assert!((size.size - 0.97).abs() < most, "{size:?}");
    let said = result.verdict().to_string();
    assert!(said.contains("the board is 3."), "{said}");
    assert!(said.contains("% smaller than its file says"), "{said}");
}

#[test]
fn poses_that_are_not_those_of_the_images_are_refused() {
    let mut pairs = pairs(&mut Chance::new(3), 12, 35.0, PANDA);
    let mut flanges: Vec<Iso3> = pairs.iter().map(|pair| pair.flange).collect();
    flanges.reverse();
    for (pair, flange) in pairs.iter_mut().zip(&flanges) {
        pair.flange = *flange;
    }
    let said = found(&pairs).unwrap_err().to_string();
    assert!(
        said.contains("the order of the poses is reversed"),
        "{said}"
    );
}

#[test]
#[ignore = "long: the optimizer is others' code, which a dev build does not optimize"]
fn a_moved_arm_or_pushed_board_is_not_good_enough() {
    let mut chance = Chance::new(4);
    let shaky = found(&pairs(&mut chance, 12, 35.0, [4e-3, 0.5])).unwrap();
    let said = shaky.verdict().to_string();
    assert!(said.contains("did the arm stand still"), "{said}");
    let mut pushed = pairs(&mut chance, 12, 35.0, PANDA);
    for pair in &mut pushed[6..] {
        pair.flange = Iso3::translation(0.02, 0.0, 0.0) * pair.flange;
    }
    let said = found(&pushed).unwrap().verdict().to_string();
    assert!(said.contains("did the board"), "{said}");
}

/// A camera that stands, 1 m from the base, and the board on the flange.
fn standing() -> [Iso3; 2] {
    [
        Iso3::new(Vec3::new(0.9, -0.2, 0.5), Vec3::new(-1.1, -1.1, 1.2)),
        Iso3::new(Vec3::new(0.02, 0.01, 0.06), Vec3::new(0.1, 3.0, 0.1)),
    ]
}

/// The same views, of a camera that stands.
fn stand(pairs: &mut [Pair], chance: &mut Chance) {
    let [camera, board] = standing();
    for pair in pairs {
        // As the camera on the wrist sees it, without the robot's error.
        let seen = (pair.flange * mount()).inverse() * place();
        let miss = Iso3::new(
            chance.vector(PANDA[0]),
            chance.vector(PANDA[1].to_radians()),
        );
        pair.flange = camera * seen * board.inverse() * miss;
    }
}

/// What the camera measures of the board, where the poses of the flange are exact.
fn measured(pairs: &[Pair], chance: &mut Chance, error: [f64; 2]) -> Vec<RobotPose> {
    let pose = |pair: &Pair| RobotPose {
        image: pair.view.name.clone(),
        flange: pair.flange,
        board: Some({
            let off = Iso3::new(
                chance.vector(error[0]),
                chance.vector(error[1].to_radians()),
            );
            (pair.flange * mount()).inverse() * place() * off
        }),
    };
    pairs.iter().map(pose).collect()
}

#[test]
#[ignore = "long: the optimizer is others' code, which a dev build does not optimize"]
fn a_camera_that_stands_is_found_and_its_uncertainty_is_true() {
    let [camera, board] = standing();
    let (mut scores, mut worst) = (Vec::new(), [0.0f64; 2]);
    for seed in 0..testkit::repeats("eye to hand", 2, 40) as u64 {
        let mut chance = Chance::new(seed);
        let mut pairs = pairs(&mut chance, 12, 35.0, [0.0; 2]);
        stand(&mut pairs, &mut chance);
        let target = Target::from(&Board::default());
        let result = calibrate(&pairs, Mounting::EyeToHand, &CAMERA, &target).unwrap();
        assert!(result.verdict().is_good(), "{seed}: {}", result.verdict());
        let off = camera.inverse() * result.camera;
        let (moved, turned) = (off.translation.vector, off.rotation.scaled_axis());
        let sigma = result.sigma.unwrap();
        scores.extend((0..3).map(|k| moved[k] / sigma[k]));
        scores.extend((0..3).map(|k| turned[k] / sigma[3 + k]));
        worst = [worst[0].max(moved.norm()), worst[1].max(turned.norm())];
        let off = board.inverse() * result.target;
        assert!(off.translation.vector.norm() < 1e-3, "{off}");
    }
    testkit::tell(format_args!(
        "eye to hand off by {:.2} mm, {:.3} deg at most",
        1e3 * worst[0],
        worst[1].to_degrees()
    ));
    assert!(worst[0] < 1e-3 && worst[1].to_degrees() < 0.1, "{worst:?}");
    let spread = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
    assert!((0.2..3.0).contains(&spread), "{spread}: {scores:?}");
}

#[test]
fn poses_alone_give_the_mounting_and_a_true_uncertainty() {
    let mut scores = Vec::new();
    for seed in 0..20 {
        let mut chance = Chance::new(seed);
        let pairs = pairs(&mut chance, 12, 35.0, [0.0; 2]);
        let poses = measured(&pairs, &mut chance, [3e-4, 0.05]);
        let result = calibrate_poses(&poses, Mounting::EyeInHand).unwrap();
        assert_eq!(result.cause, None, "{seed}");
        let off = mount().inverse() * result.camera;
        let (moved, turned) = (off.translation.vector, off.rotation.scaled_axis());
        let sigma = result.sigma.unwrap();
        scores.extend((0..3).map(|k| moved[k] / sigma[k]));
        scores.extend((0..3).map(|k| turned[k] / sigma[3 + k]));
        assert!(
            (1e-4..6e-4).contains(&result.robot[0]),
            "{:?}",
            result.robot
        );
    }
    let spread = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
    testkit::tell(format_args!("poses alone: errors spread by {spread:.2}"));
    assert!((0.6..1.6).contains(&spread), "{spread}");
}

#[test]
fn the_cause_of_misses_is_named() {
    let mut chance = Chance::new(7);
    let pairs = pairs(&mut chance, 12, 35.0, [0.0; 2]);
    let good = measured(&pairs, &mut chance, [5e-4, 0.05]);
    let fault = |change: &dyn Fn(usize, &mut Iso3)| {
        let mut poses = good.clone();
        for (number, pose) in poses.iter_mut().enumerate() {
            pose.board
                .iter_mut()
                .for_each(|board| change(number, board));
        }
        calibrate_poses(&poses, Mounting::EyeInHand).unwrap()
    };
    assert_eq!(fault(&|_, _| {}).cause, None);
    let off = Iso3::translation(0.004, 0.003, 0.0);
    let one = fault(&|number, board| {
        if number == 4 {
            *board *= off;
        }
    });
    let said = one.verdict().to_string();
    assert!(said.contains("pose 04.png misses the others by"), "{said}");
    let Some(Reason::Pose { off: [m, _], .. }) = one.cause.map(|cause| cause.reason) else {
        panic!("{said}");
    };
    assert!((m - 5e-3).abs() < 1.5e-3, "{m}");
    let moved = fault(&|number, board| {
        if number >= 7 {
            *board *= off;
        }
    });
    let said = moved.verdict().to_string();
    assert!(said.contains("from pose 07.png on"), "{said}");
    let longer = fault(&|_, board| board.translation.vector.z *= 0.96);
    let said = longer.verdict().to_string();
    let words = "the focal length is 4.";
    assert!(
        said.contains(words) && !said.contains("the board is"),
        "{said}"
    );
    // Tilts that the images show badly.
    let tilted = fault(&|number, board| {
        let sign = if number % 2 == 0 { 1.0 } else { -1.0 };
        let turn = Vec3::new(0.02 * sign, 0.01 * (number as f64).sin(), 0.0);
        board.rotation = Iso3::rotation(turn).rotation * board.rotation;
    });
    let said = tilted.verdict().to_string();
    assert!(said.contains("the images are worse than the arm"), "{said}");
}
