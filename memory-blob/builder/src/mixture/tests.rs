//! Tests of the mixture as a whole.

use rand::SeedableRng;
use rand_distr::StandardNormal;

use super::gaussian::{Point, Square};
use super::*;

/// `count` points about `mean` with independent axes of the given deviations.
fn cloud(
    mean: [f64; DIMENSION],
    deviation: [f64; DIMENSION],
    count: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<[f64; DIMENSION]> {
    let mut draw =
        |axis: usize| mean[axis] + deviation[axis] * rng.sample::<f64, _>(StandardNormal);
    (0..count).map(|_| std::array::from_fn(&mut draw)).collect()
}

const LEFT: [f64; DIMENSION] = [-0.3, 0.1, 0.6, 0.0, 0.4, 0.0];
const RIGHT: [f64; DIMENSION] = [0.3, -0.1, 0.8, 0.5, 0.0, -1.0];

fn two_clouds() -> Vec<[f64; DIMENSION]> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut points = cloud(LEFT, [0.05, 0.05, 0.05, 0.1, 0.1, 0.1], 150, &mut rng);
    points.extend(cloud(
        RIGHT,
        [0.02, 0.06, 0.04, 0.2, 0.1, 0.1],
        50,
        &mut rng,
    ));
    points
}

#[test]
fn two_separate_clouds_are_found_with_their_shares() {
    let mixture = Mixture::fit(&two_clouds(), &MixtureSettings::default(), 1).unwrap();
    assert_eq!(mixture.components().len(), 2);
    let mut found: Vec<_> = mixture.components().iter().collect();
    found.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    assert!((found[0].weight - 0.75).abs() < 1e-3, "{}", found[0].weight);
    assert!((found[0].gaussian.mean() - Point::from(LEFT)).amax() < 0.03);
    assert!((found[1].gaussian.mean() - Point::from(RIGHT)).amax() < 0.08);
    let deviation = found[1].gaussian.covariance().diagonal().map(f64::sqrt);
    assert!((deviation[0] - 0.02).abs() < 0.006, "{deviation}");
    assert!((deviation[3] - 0.2).abs() < 0.06, "{deviation}");
}

#[test]
fn one_cloud_gets_one_component_although_more_are_allowed() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let points = cloud(LEFT, [0.1; DIMENSION], 120, &mut rng);
    let mixture = Mixture::fit(&points, &MixtureSettings::default(), 1).unwrap();
    assert_eq!(mixture.components().len(), 1);
}

#[test]
fn likelihood_never_decreases_over_iterations() {
    let points: Vec<Point> = two_clouds().into_iter().map(Point::from).collect();
    // the floor is wider than the clouds along some axes, so that the constraint binds on the way
    let settings = MixtureSettings {
        floor: [0.05; DIMENSION],
        ..MixtureSettings::default()
    };
    let mut steps = 0;
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let Some(run) = em::maximise(&points, 4, &settings, &mut rng) else {
            continue;
        };
        for pair in run.log_likelihoods.windows(2) {
            assert!(
                pair[1] >= pair[0] - 1e-9 * pair[0].abs(),
                "{} then {}",
                pair[0],
                pair[1]
            );
        }
        steps += run.log_likelihoods.len() - 1;
    }
    assert!(steps > 50, "only {steps} iterations were seen");
}

#[test]
fn samples_have_the_mean_and_covariance_of_the_mixture() {
    let mixture = Mixture::fit(&two_clouds(), &MixtureSettings::default(), 1).unwrap();
    let mut mean = Point::zeros();
    let mut second = Square::zeros();
    for component in mixture.components() {
        let centre = component.gaussian.mean();
        mean += centre * component.weight;
        second +=
            (component.gaussian.covariance() + centre * centre.transpose()) * component.weight;
    }
    let covariance = second - mean * mean.transpose();

    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let count = 40_000;
    let samples: Vec<Point> = (0..count)
        .map(|_| mixture.sample(&mut rng).into())
        .collect();
    let sample_mean = samples.iter().sum::<Point>() / f64::from(count);
    let sample_covariance = samples
        .iter()
        .map(|s| (s - sample_mean) * (s - sample_mean).transpose())
        .sum::<Square>()
        / f64::from(count);
    for row in 0..DIMENSION {
        let deviation = covariance[(row, row)].sqrt();
        assert!(
            (sample_mean[row] - mean[row]).abs() < 0.025 * deviation,
            "mean of axis {row}"
        );
        for column in 0..DIMENSION {
            let unit = deviation * covariance[(column, column)].sqrt();
            let error = sample_covariance[(row, column)] - covariance[(row, column)];
            assert!(
                error.abs() < 0.03 * unit,
                "covariance ({row}, {column}) is off by {error}"
            );
        }
    }
}

#[test]
fn density_of_one_gaussian_is_the_textbook_value() {
    let mixture = Mixture::fit(&two_clouds()[..150], &MixtureSettings::default(), 1).unwrap();
    let gaussian = &mixture.components()[0].gaussian;
    let point = Point::from([-0.25, 0.15, 0.55, 0.1, 0.3, -0.1]);
    let covariance = gaussian.covariance();
    let difference = point - gaussian.mean();
    let distance = (difference.transpose() * covariance.try_inverse().unwrap() * difference)[0];
    let volume = (covariance * std::f64::consts::TAU).determinant().ln();
    let expected = -0.5 * (distance + volume);
    assert!((gaussian.log_density(&point) - expected).abs() < 1e-9);
}

#[test]
fn few_points_give_one_gaussian_with_independent_axes_above_the_floor() {
    let settings = MixtureSettings::default();
    let points = two_clouds();
    for count in 1..FEWEST_POINTS {
        let mixture = Mixture::fit(&points[..count], &settings, 1).unwrap();
        assert_eq!(mixture.components().len(), 1);
        let covariance = mixture.components()[0].gaussian.covariance();
        for row in 0..DIMENSION {
            assert!(covariance[(row, row)] >= settings.floor[row].powi(2) * (1.0 - 1e-12));
            for column in 0..row {
                assert!(covariance[(row, column)].abs() < 1e-15);
            }
        }
    }
}

#[test]
fn equal_points_give_the_floor() {
    let settings = MixtureSettings::default();
    let mixture = Mixture::fit(&[LEFT; 60], &settings, 1).unwrap();
    assert_eq!(mixture.components().len(), 1);
    let deviation = mixture.components()[0]
        .gaussian
        .covariance()
        .diagonal()
        .map(f64::sqrt);
    assert!((deviation - Point::from(settings.floor)).amax() < 1e-9);
}

#[test]
fn same_seed_gives_the_same_mixture_and_samples() {
    let draw = |seed| {
        let mixture = Mixture::fit(&two_clouds(), &MixtureSettings::default(), seed).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        std::array::from_fn::<_, 8, _>(|_| mixture.sample(&mut rng).map(f64::to_bits))
    };
    assert_eq!(draw(5), draw(5));
    assert_ne!(draw(5), draw(6));
}

#[test]
fn bad_points_and_settings_are_named() {
    let settings = MixtureSettings::default();
    assert_eq!(
        Mixture::fit(&[], &settings, 1).unwrap_err(),
        MixtureError::NoPoints
    );
    let mut points = two_clouds();
    points[17][4] = f64::NAN;
    let message = Mixture::fit(&points, &settings, 1).unwrap_err().to_string();
    assert!(
        message.contains("coordinate 4 of point 17") && message.contains("NaN"),
        "{message}"
    );
    let settings = MixtureSettings {
        tolerance: -1.0,
        ..settings
    };
    let message = Mixture::fit(&two_clouds(), &settings, 1)
        .unwrap_err()
        .to_string();
    assert!(message.contains("tolerance is -1"), "{message}");
}
