//! What a cycle decides follows from its input and from the state alone, whatever a controller has
//! computed before: a replay may begin anywhere.

use nalgebra::Vector3;
use scene::{Pose, Scene};
use vpc::motion::Motion;
use vpc::{Law, Measurement, Settings, State, Strategy, Twist, camera, task};

const CYCLES: u64 = 40;

/// A camera that obeys exactly, and the state of the law that steers it.
struct Run {
    points: Vec<Vector3<f64>>,
    state: State,
}

impl Run {
    fn new(scene: &Scene, start: &Pose, state: State) -> Self {
        Self {
            points: task::placed(&scene.pattern, start).collect(),
            state,
        }
    }

    /// One cycle by this controller: the command, and the state afterwards.
    fn cycle(&self, scene: &Scene, controller: &mut Law<Vec<f64>>, now_ns: u64) -> (Twist, State) {
        let see = |x: &Vector3<f64>| camera::project(&scene.camera, (*x).into()).unwrap();
        let pixels: Vec<_> = self.points.iter().map(see).collect();
        controller.restore(&self.state);
        let measurement = Measurement::from_points(&pixels).taken(now_ns, now_ns);
        let twist = controller.step(&measurement, None).unwrap().twist;
        controller.sent(&twist, now_ns);
        controller.think(None);
        (twist, controller.state())
    }
}

#[test]
fn another_past_of_the_workspace_changes_nothing() {
    let scene = Scene::parse(scene::PAPER_SIM, "paper-sim").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
    let settings = Settings {
        strategy: Strategy::Foresight,
        ..Settings::default()
    };
    let controller = || Law::new(&scene, settings, |len| vec![0.0; len]).unwrap();
    let (mut one, mut other) = (controller(), controller());
    let fresh = one.state();
    // Two runs at a time: each controller computes them in another order.
    for pair in starts.as_chunks::<2>().0.iter().step_by(5) {
        let mut runs = pair.map(|start| Run::new(&scene, &start, fresh));
        for k in 0..CYCLES {
            let now_ns = (1e9 * k as f64 * scene.sampling_time()).round() as u64;
            let by_one = [0, 1].map(|i| runs[i].cycle(&scene, &mut one, now_ns));
            let mut by_other = [1, 0].map(|i| runs[i].cycle(&scene, &mut other, now_ns));
            by_other.reverse();
            assert_eq!(by_one, by_other, "{pair:?}, cycle {k}");
            for (run, (twist, state)) in runs.iter_mut().zip(by_one) {
                let motion = Motion::of_camera(&twist, scene.sampling_time());
                run.points.iter_mut().for_each(|x| *x = motion.apply(x));
                run.state = state;
            }
        }
    }
}
