//! Markers that have a size: the law keeps them wholly in sight, as another geometry measures it.

use nalgebra::Vector3;
use scene::{Pose, Scene};
use vpc::motion::Motion;
use vpc::{Law, Measurement, Model, Settings, Strategy, Task, camera, constraint, task};

/// Instants of a period that are judged.
const INSTANTS: u32 = 4;

fn tags() -> (Scene, Vec<Pose>) {
    let starts = scene::parse_starts(scene::TAGS_ROBOT_STARTS, "starts").unwrap();
    (Scene::parse(scene::TAGS_ROBOT, "tags").unwrap(), starts)
}

/// The robot's law.
fn settings(strategy: Strategy) -> Settings {
    Settings {
        strategy,
        step_s: 0.4,
        foresight_steps: 30,
        ..Settings::default()
    }
}

/// What a run came to.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seen {
    /// Least clearance of a corner of a marker or of the middle of a side, px.
    edge_px: f64,
    /// The law's own, of the circles round the markers, px.
    circle_px: f64,
    arrived: bool,
}

/// Runs a law from a start with an exact camera and judges the markers of `scene`.
fn run(law: &mut Law<Vec<f64>>, scene: &Scene, start: &Pose, seconds: f64) -> Seen {
    let judge = Task::new(&Scene::parse(scene::PAPER_ROBOT, "robot").unwrap()).unwrap();
    let edges = edges(scene);
    let mut points: Vec<_> = task::placed(&scene.pattern, start).collect();
    let mut places: Vec<_> = task::placed(&edges, start).collect();
    let pixel = |x: &Vector3<f64>| camera::project(&scene.camera, (*x).into()).unwrap();
    let mut seen = Seen {
        edge_px: f64::INFINITY,
        circle_px: f64::INFINITY,
        arrived: false,
    };
    let period = scene.sampling_time();
    for k in 0..(seconds / period) as u64 {
        let now_ns = (k as f64 * period * 1e9).round() as u64;
        let pixels: Vec<_> = points.iter().map(pixel).collect();
        let measured = Measurement::from_points(&pixels).taken(now_ns, now_ns);
        let step = law.step(&measured, None).unwrap();
        law.sent(&step.twist, now_ns);
        law.think(None);
        seen.circle_px = seen.circle_px.min(step.clearance_px);
        seen.arrived = step.error_px < scene.success.convergence_px;
        if seen.arrived {
            break;
        }
        for _ in 0..INSTANTS {
            let motion = Motion::of_camera(&step.twist, period / f64::from(INSTANTS));
            points.iter_mut().for_each(|x| *x = motion.apply(x));
            places.iter_mut().for_each(|x| *x = motion.apply(x));
            for pixel in places.iter().map(pixel) {
                let border = constraint::border_clearance(&judge, pixel);
                let clearance = constraint::least_clearance(&judge, pixel).min(border);
                seen.edge_px = seen.edge_px.min(clearance);
            }
        }
    }
    seen
}

/// Corners and middles of the sides of the markers, in the object frame, m.
fn edges(scene: &Scene) -> Vec<[f64; 3]> {
    let half = 0.5 * scene.marker_size;
    let about = |[x, y, _]: [f64; 3]| {
        let steps = [-half, 0.0, half];
        steps.map(|a| steps.map(|b| [x + a, y + b, 0.0]))
    };
    let places = scene.pattern.iter().copied().flat_map(about);
    places.flatten().collect()
}

/// The deepest that a marker is hidden in runs from every fourth start, px, and how many arrive.
fn worst(scene: &Scene, law: &Scene, settings: Settings) -> (f64, usize) {
    let (_, starts) = tags();
    let runs = starts.iter().step_by(4).map(|start| {
        let mut law = Law::new(law, settings, |len| vec![0.0; len]).unwrap();
        run(&mut law, scene, start, 25.0)
    });
    let runs: Vec<_> = runs.collect();
    let deepest = runs.iter().map(|seen| -seen.edge_px).fold(0.0, f64::max);
    let arrived = runs.iter().filter(|seen| seen.arrived).count();
    let size = law.marker_size;
    println!(
        "law with markers of {size} m: {deepest:.2} px hidden at most, {arrived} of 25 arrived"
    );
    (deepest, arrived)
}

#[test]
fn markers_stay_whole_only_if_their_size_is_known() {
    let (scene, _) = tags();
    let settings = settings(Strategy::Previous);
    let (hidden_px, arrived) = worst(&scene, &scene, settings);
    assert!(
        hidden_px < 0.3 && arrived >= 20,
        "{hidden_px} px, {arrived} of 25"
    );
    let mut points = scene.clone();
    points.marker_size = 0.0;
    let (hidden_px, arrived) = worst(&scene, &points, settings);
    assert!(
        hidden_px > 10.0 && arrived >= 20,
        "{hidden_px} px, {arrived} of 25"
    );
}

#[test]
fn markers_stay_in_sight_however_fast_they_come_nearer() {
    let (mut scene, _) = tags();
    (scene.limits.linear, scene.limits.angular) = (0.1, 0.3);
    let (hidden_px, arrived) = worst(&scene, &scene, settings(Strategy::Previous));
    assert!(
        hidden_px < 0.3 && arrived >= 20,
        "{hidden_px} px, {arrived} of 25"
    );
}

#[test]
fn constant_depth_models_keep_markers_in_sight() {
    let (scene, _) = tags();
    for model in [Model::AreaDepth, Model::TargetDepth] {
        let settings = Settings {
            model,
            ..settings(Strategy::Previous)
        };
        let (hidden_px, arrived) = worst(&scene, &scene, settings);
        assert!(
            hidden_px < 1.0 && arrived >= 20,
            "{hidden_px} px, {arrived} of 25"
        );
    }
}

#[test]
fn the_trigger_and_the_clearance_count_from_the_markers_edge() {
    let (scene, _) = tags();
    let mut points = scene.clone();
    points.marker_size = 0.0;
    let [seen, bare] = [&scene, &points].map(|scene| {
        let mut law = Law::new(scene, Settings::default(), |len| vec![0.0; len]).unwrap();
        let goal = law.task().goal.clone();
        let step = law.step(&Measurement::from_points(&goal), None).unwrap();
        step.clearance_px
    });
    let radius = 615.0 * 0.03 / 0.35 / std::f64::consts::SQRT_2;
    assert!((bare - seen - radius).abs() < 1e-6, "{bare} {seen}");
}
