//! Intrinsics from noisy corners.

use tag_board::Board;
use vpc_calib::intrinsics::{Intrinsics, IntrinsicsError, calibrate};
use vpc_calib::target::Target;
use vpc_calib::view::View;

use crate::synthetic::{CAMERA, Chance};

/// Views that show ten tags or more.
fn views(chance: &mut Chance, count: usize, tilt_deg: f64, noise: f64) -> Vec<View> {
    let board = Board::default();
    let mut views = Vec::new();
    while views.len() < count {
        let pose = chance.pose(tilt_deg);
        let view = chance.view(&CAMERA, &board, &pose, noise);
        if view.points.len() >= 40 {
            let name = format!("{:02}.png", views.len());
            views.push(View { name, ..view });
        }
    }
    views
}

fn found(views: &[View]) -> Result<Intrinsics, IntrinsicsError> {
    calibrate(views, &Target::from(&Board::default()), CAMERA.size, false)
}

#[test]
fn focal_lengths_are_found_to_a_tenth_of_a_percent() {
    let mut scores = Vec::new();
    for seed in 0..testkit::repeats("intrinsics", 2, 60) as u64 {
        let views = views(&mut Chance::new(seed), 14, 35.0, 0.05);
        let result = found(&views).unwrap();
        let (camera, verdict) = (&result.camera, result.verdict());
        assert!(verdict.is_good(), "{seed}: {verdict}\n{result}");
        for k in 0..2 {
            let off = camera.focal[k] / CAMERA.focal[k] - 1.0;
            assert!(off.abs() < 0.001, "{seed}: {off}");
            assert!((camera.center[k] - CAMERA.center[k]).abs() < 1.0, "{seed}");
        }
        assert!((result.rms_px - 0.05 * 2f64.sqrt()).abs() < 0.01);
        let sigma = result.sigma_of("fx").unwrap();
        scores.push((camera.focal[0] - CAMERA.focal[0]) / sigma);
    }
    let spread = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
    assert!((0.2..3.0).contains(&spread), "{spread}: {scores:?}");
}

#[test]
fn views_that_are_not_tilted_are_not_good_enough() {
    let mut chance = Chance::new(1);
    for tilt_deg in [1e-9, 2.0, 8.0] {
        let views = views(&mut chance, 14, tilt_deg, 0.05);
        let said = match found(&views) {
            Ok(result) => result.verdict().to_string(),
            Err(error) => error.to_string(),
        };
        assert!(said.contains("tilted") && said.contains("20 deg"), "{said}");
    }
}

#[test]
fn too_few_views_are_refused_and_few_are_not_good_enough() {
    let views = views(&mut Chance::new(2), 6, 35.0, 0.05);
    let error = found(&views[..3]).unwrap_err();
    assert_eq!(error, IntrinsicsError::TooFew { found: 3 });
    let said = found(&views).unwrap().verdict().to_string();
    assert!(said.contains("6 views; take 8 or more"), "{said}");
}

#[test]
fn a_misread_corner_is_dropped_and_a_bent_board_refused() {
    let mut views = views(&mut Chance::new(3), 14, 35.0, 0.05);
    for view in &mut views[..4] {
        let first = view.points.first_entry();
        first.unwrap().get_mut()[0] += 4.0;
    }
    let result = found(&views).unwrap();
    assert_eq!(result.points[1], 4);
    assert!(result.verdict().is_good(), "{}", result.verdict());
    assert!((result.camera.focal[0] / CAMERA.focal[0] - 1.0).abs() < 0.001);
    // Every third tag sits elsewhere: a board whose paper is wavy.
    for (number, point) in views.iter_mut().flat_map(|view| &mut view.points) {
        point[0] += f64::from(number / 4 % 3) * 2.0;
    }
    let said = found(&views).unwrap().verdict().to_string();
    assert!(said.contains("is the board flat"), "{said}");
}

#[test]
fn views_in_one_part_of_the_image_are_not_good_enough() {
    let mut views = views(&mut Chance::new(4), 40, 35.0, 0.05);
    for view in &mut views {
        view.points.retain(|_, [u, v]| *u < 420.0 && *v > 165.0);
    }
    let said = found(&views).unwrap().verdict().to_string();
    assert!(
        said.contains("upper left, upper middle, upper right, middle right, lower right"),
        "{said}"
    );
}
