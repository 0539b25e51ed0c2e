//! Limits of acceleration: no command changes faster, and at every instant the camera can be braked
//! before a feature is lost.

use nalgebra::Vector3;
use scene::{Limits, Pose, Scene};
use vpc::motion::Motion;
use vpc::{Law, Measurement, Settings, Strategy, Task, Twist, camera, constraint, task};

const ACCELERATION: Limits = Limits {
    linear: 0.5,
    angular: 1.0,
    linear_acceleration: Some(2.0),
    angular_acceleration: Some(4.0),
};
/// Instants of a period that are judged.
const INSTANTS: u32 = 12;
/// What the referee allows between the frames, px.
const DEEPEST_PX: f64 = 3.0;

/// What a run from one start came to.
#[derive(Debug, Default)]
struct Seen {
    /// Greatest change of a component, as a share of what a period allows.
    change: f64,
    /// Deepest point while the camera is braked, from any cycle of the run, px.
    deepest_px: f64,
    arrived: bool,
}

/// The depth of the deepest point, px; `None` where one is behind the camera.
fn depth(task: &Task, points: &[Vector3<f64>]) -> Option<f64> {
    let mut depths = points.iter().map(|x| {
        let pixel = camera::project(&task.camera, (*x).into())?;
        Some(constraint::violation(task, pixel, 0.0))
    });
    depths.try_fold(0.0, |worst: f64, depth| Some(worst.max(depth?)))
}

fn moved(points: &[Vector3<f64>], twist: &Twist, seconds: f64) -> Vec<Vector3<f64>> {
    let motion = Motion::of_camera(twist, seconds);
    points.iter().map(|x| motion.apply(x)).collect()
}

/// Runs the law from a start; an arm that obeys exactly is braked from every cycle, in thought, as
/// fast as `judge` allows.
fn run(law: &Scene, judge: &Task, start: &Pose, strategy: Strategy) -> Seen {
    let settings = Settings {
        strategy,
        ..Settings::default()
    };
    let mut controller = Law::new(law, settings, |len| vec![0.0; len]).unwrap();
    let mut points: Vec<_> = task::placed(&law.pattern, start).collect();
    let (mut seen, mut standing) = (Seen::default(), [0.0; 6]);
    let period = law.sampling_time();
    for k in 0..300_u64 {
        let pixels: Vec<_> = points
            .iter()
            .map(|x| camera::project(&judge.camera, (*x).into()).unwrap())
            .collect();
        let now_ns = (k as f64 * period * 1e9).round() as u64;
        let step = controller
            .step(
                &Measurement::from_points(&pixels).taken(now_ns, now_ns),
                None,
            )
            .unwrap();
        controller.sent(&step.twist, now_ns);
        controller.think(None);
        let change: Twist = std::array::from_fn(|i| step.twist[i] - standing[i]);
        seen.change = seen.change.max(judge.stop_s(&change) / period);
        standing = step.twist;
        points = moved(&points, &standing, period);
        // The stop that could begin here.
        let (mut twist, mut braked) = (standing, points.clone());
        while twist != [0.0; 6] {
            let share = (1.0 - period / judge.stop_s(&twist)).max(0.0);
            twist = twist.map(|v| share * v);
            for _ in 0..INSTANTS {
                braked = moved(&braked, &twist, period / f64::from(INSTANTS));
                let depth = depth(judge, &braked).unwrap_or(f64::INFINITY);
                seen.deepest_px = seen.deepest_px.max(depth);
            }
        }
        seen.arrived |= step.error_px < law.success.convergence_px;
    }
    seen
}

#[test]
fn commands_keep_the_acceleration_and_stop_before_constraints() {
    let mut scene = Scene::parse(scene::PAPER_SIM, "paper-sim").unwrap();
    let unlimited = scene.clone();
    scene.limits = ACCELERATION;
    let judge = Task::new(&scene).unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
    let (mut arrived, mut too_deep) = (0, 0);
    for start in starts.iter().step_by(10) {
        for strategy in [Strategy::Previous, Strategy::Foresight] {
            let seen = run(&scene, &judge, start, strategy);
            assert!(seen.change < 1.0 + 1e-9, "{start:?} {strategy:?}: {seen:?}");
            assert!(
                seen.deepest_px < DEEPEST_PX,
                "{start:?} {strategy:?}: {seen:?}"
            );
            arrived += u32::from(seen.arrived);
        }
        let seen = run(&unlimited, &judge, start, Strategy::Previous);
        assert!(seen.change > 2.0, "{start:?}: {seen:?}");
        too_deep += u32::from(seen.deepest_px > 5.0 * DEEPEST_PX);
    }
    assert!(arrived >= 16, "{arrived} of 20");
    assert!(
        too_deep >= 3,
        "a law that does not know the limits: {too_deep} of 10"
    );
}
