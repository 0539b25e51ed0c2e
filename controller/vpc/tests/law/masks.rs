//! Clearances from painted areas against geometry, and the law among them.

use scene::{Area, Scene, write_mask};
use vpc::clearance::Clearance;
use vpc::obstacle::Obstacle;
use vpc::{Law, Measurement, Settings, Strategy, Task, constraint, field};

/// The paper's simulated scene with a painted mask instead of its occlusions.
fn painted(is_white: impl Fn(u32, u32) -> bool) -> Scene {
    let directory = tempfile::tempdir().unwrap();
    write_mask(&directory.path().join("mask.png"), 1024, 1024, is_white).unwrap();
    let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
    let path = directory.path().join("scene.toml");
    let text = format!("{head}[[occlusion]]\nname = \"painted\"\nmask = \"mask.png\"\n");
    std::fs::write(&path, text).unwrap();
    Scene::read(&path).unwrap()
}

/// A pixel is white where the shape, negative inside, covers its middle.
fn filled(distance: impl Fn([f64; 2]) -> f64) -> Scene {
    painted(|i, j| distance([f64::from(i), f64::from(j)]) < 0.0)
}

fn only_area(scene: &Scene) -> &'static Area {
    assert_eq!(scene.areas().count(), 1);
    scene.areas().next().unwrap()
}

const CENTRE: [f64; 2] = [499.5, 199.5];
const RADIUS: f64 = 90.0;
const HALF: [f64; 2] = [140.0, 60.0];

fn disc([u, v]: [f64; 2]) -> f64 {
    (u - CENTRE[0]).hypot(v - CENTRE[1]) - RADIUS
}

fn box_([u, v]: [f64; 2]) -> f64 {
    let out = [
        (u - CENTRE[0]).abs() - HALF[0],
        (v - CENTRE[1]).abs() - HALF[1],
    ];
    out[0].max(out[1]).min(0.0) + out[0].max(0.0).hypot(out[1].max(0.0))
}

/// Points on lines that no grid shares.
fn points() -> impl Iterator<Item = [f64; 2]> {
    (0..103u32).flat_map(|i| {
        (0..61).map(move |j| [300.3 + 3.89 * f64::from(i), 60.7 + 4.57 * f64::from(j)])
    })
}

/// Least and greatest excess of the clearance over a distance, where `counts` says of the distance
/// that it matters.
fn excess(
    area: &Area,
    distance: impl Fn([f64; 2]) -> f64,
    counts: impl Fn([f64; 2]) -> bool,
) -> (f64, f64) {
    points()
        .filter(|p| counts(*p))
        .map(|p| field::clearance(area, p).distance - distance(p))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
            (low.min(x), high.max(x))
        })
}

#[test]
fn clearances_from_a_disc_match_its_pixels() {
    let scene = filled(disc);
    let near = |p| (-40.0..200.0).contains(&disc(p));
    let (low, high) = excess(only_area(&scene), disc, near);
    // The staircase itself is up to 0.71 px off.
    assert!(low > -1.3 && high < 0.75, "{low} {high}");
}

#[test]
fn clearances_from_a_box_are_exact_beside_its_sides() {
    let scene = filled(box_);
    let area = only_area(&scene);
    let beside = |p: [f64; 2]| {
        let inside = |k: usize| (p[k] - CENTRE[k]).abs() < HALF[k] - 45.0;
        (inside(0) || inside(1)) && box_(p) > -20.0
    };
    let (low, high) = excess(area, box_, beside);
    assert!(low > -1e-3 && high < 1e-3, "{low} {high}");
    // Within four nodes, 10.24 px: deeper inside, along a corner's diagonal, the spline may be
    // above by 0.4 px.
    let (low, high) = excess(area, box_, |p| (-10.0..14.0).contains(&box_(p)));
    assert!(low > -2.0 && high < 0.1, "{low} {high}");
}

#[test]
fn no_white_pixel_has_a_clearance_above_zero() {
    let star = |[u, v]: [f64; 2]| {
        let (x, y) = (u - 300.0, v - 650.0);
        x.hypot(y) - 90.0 - 35.0 * (5.0 * y.atan2(x)).sin()
    };
    let scene = filled(|p| star(p).min(box_(p)));
    let mut worst = f64::NEG_INFINITY;
    let mask = scene.masks().next().unwrap();
    for j in 0..1024 {
        for i in (0..1024).filter(|i| mask.is_forbidden(*i, j)) {
            let middle = [i as f64, j as f64];
            let clearances = scene
                .areas()
                .map(|area| field::clearance(area, middle).distance);
            worst = worst.max(clearances.fold(f64::INFINITY, f64::min));
        }
    }
    assert!(worst < 0.0, "{worst}");
}

#[test]
fn the_gradient_is_that_of_the_clearance_everywhere() {
    let scene = filled(box_);
    let area = only_area(&scene);
    for p in points() {
        let h = 1e-4;
        let slope = |du: f64, dv: f64| {
            let at = |sign: f64| field::clearance(area, [p[0] + sign * du, p[1] + sign * dv]);
            (at(1.0).distance - at(-1.0).distance) / (2.0 * h)
        };
        let Clearance { normal, .. } = field::clearance(area, p);
        let found = [slope(h, 0.0), slope(0.0, h)];
        for k in 0..2 {
            assert!(
                (normal[k] - found[k]).abs() < 1e-4,
                "{p:?}: {normal:?} {found:?}"
            );
        }
        if box_(p) > 20.0 {
            assert!(
                (normal[0].hypot(normal[1]) - 1.0).abs() < 0.03,
                "{p:?} {normal:?}"
            );
        }
    }
}

#[test]
fn beyond_the_image_the_clearance_goes_on_along_its_gradient() {
    let area = only_area(&filled(box_));
    for p in [
        [-300.0, 205.0],
        [1400.0, 203.0],
        [512.0, -250.0],
        [498.0, 1300.0],
    ] {
        let found = field::clearance(area, p).distance;
        assert!((found - box_(p)).abs() < 0.02 * box_(p), "{p:?} {found}");
    }
}

#[test]
fn clearance_and_gradient_have_no_jumps() {
    let scene = filled(box_);
    let area = only_area(&scene);
    // Along a line through side, corner and interior, in steps that no cell shares.
    let line = (0..40_000).map(|i| [330.0 + 0.01 * f64::from(i), 130.0 + 0.0031 * f64::from(i)]);
    let all: Vec<Clearance> = line.map(|p| field::clearance(area, p)).collect();
    for pair in all.windows(2) {
        assert!((pair[0].distance - pair[1].distance).abs() < 0.02);
        for k in 0..2 {
            assert!((pair[0].normal[k] - pair[1].normal[k]).abs() < 0.02);
        }
    }
}

#[test]
fn white_at_the_images_edge_has_no_way_out_beyond_it() {
    let scene = painted(|i, _| i < 100);
    let here = field::clearance(only_area(&scene), [2.5, 500.0]);
    assert!((here.distance + 97.0).abs() < 1e-3, "{here:?}");
    assert!((here.normal[0] - 1.0).abs() < 1e-4 && here.normal[1].abs() < 1e-4);
}

#[test]
fn a_box_cheaply_bounds_the_clearance() {
    let scene = filled(box_);
    let area = only_area(&scene);
    for p in points() {
        let bound = Obstacle::Area(area).outside_box(p);
        let clearance = field::clearance(area, p).distance;
        assert!(
            bound <= clearance.max(0.0) + 1e-6,
            "{p:?}: {bound} {clearance}"
        );
    }
}

#[test]
fn violations_count_areas_as_they_count_parts() {
    let task = Task::new(&filled(disc)).unwrap();
    let inside = [CENTRE[0] + 60.0, CENTRE[1]];
    assert!((constraint::violation(&task, inside, 0.0) - 30.0).abs() < 1.0);
    let outside = [CENTRE[0] + 120.0, CENTRE[1]];
    assert!((constraint::least_clearance(&task, outside) - 30.0).abs() < 1.0);
    assert_eq!(constraint::violation(&task, outside, 0.0), 0.0);
    assert!((constraint::violation(&task, outside, 40.0) - 10.0).abs() < 1.0);
}

#[test]
fn a_goal_under_a_mask_is_refused() {
    let scene = painted(|i, j| (300..320).contains(&i) && (300..320).contains(&j));
    let message = Task::new(&scene).unwrap_err().to_string();
    assert!(
        message.contains("point 0") && message.contains("inside a mask"),
        "{message}"
    );
}

/// Steers to the goal from a start, exactly as the model says; the deepest that a feature got into
/// the box, px.
fn deepest(scene: &Scene, start: [f64; 3]) -> (f64, f64) {
    let settings = Settings {
        strategy: Strategy::Previous,
        ..Settings::default()
    };
    let mut controller = Law::new(scene, settings, |len| vec![0.0; len]).unwrap();
    let task = controller.task().clone();
    let mut points: Vec<nalgebra::Vector3<f64>> = task
        .pattern
        .iter()
        .map(|p| nalgebra::Vector3::from(*p) + nalgebra::Vector3::from(start))
        .collect();
    let (mut deepest, mut error) = (f64::NEG_INFINITY, f64::INFINITY);
    for _ in 0..450 {
        let seen: Vec<[f64; 2]> = points
            .iter()
            .map(|x| vpc::camera::project(&task.camera, (*x).into()).unwrap())
            .collect();
        deepest = seen.iter().map(|p| -box_(*p)).fold(deepest, f64::max);
        let step = controller
            .step(&Measurement::from_points(&seen), None)
            .unwrap();
        error = step.error_px;
        let motion = vpc::motion::Motion::of_camera(&step.twist, task.ts);
        points.iter_mut().for_each(|x| *x = motion.apply(x));
    }
    (deepest, error)
}

#[test]
fn the_law_goes_round_a_painted_box_as_round_shapes() {
    // The upper left feature starts above the box, at (512, 80); its goal (312, 312) lies below and
    // to the left.
    let start = [0.15, -0.174, 0.6];
    let (free, error) = deepest(&painted(|i, j| i > 1000 && j > 1000), start);
    assert!(
        free > 20.0 && error < 2.0,
        "the straight way must cross: {free}"
    );
    let (depth, error) = deepest(&filled(box_), start);
    assert!(depth < 0.5 && error < 2.0, "{depth} {error}");
}
