//! What a cycle decides follows from its input and from the state alone, whatever a controller has
//! computed before: a replay may begin anywhere.

use scene::Scene;
use vpc::{Law, Measurement, Settings, State, Strategy, Twist};

use crate::world::{World, is_long};

const CYCLES: u64 = 40;

/// A camera, and the state of the law that steers it.
struct Run {
    world: World,
    state: State,
}

impl Run {
    /// One cycle by this controller: the command, and the state afterwards.
    fn cycle(&self, controller: &mut Law<Vec<f64>>, now_ns: u64) -> (Twist, State) {
        controller.restore(&self.state);
        let measurement = Measurement::from_points(&self.world.features()).taken(now_ns, now_ns);
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
    let every = if is_long() { 5 } else { 25 };
    for pair in starts.as_chunks::<2>().0.iter().step_by(every) {
        let mut runs = pair.map(|start| Run {
            world: World::of(scene.clone(), &start),
            state: fresh,
        });
        for k in 0..CYCLES {
            let now_ns = (1e9 * k as f64 * scene.sampling_time()).round() as u64;
            let by_one = [0, 1].map(|i| runs[i].cycle(&mut one, now_ns));
            let mut by_other = [1, 0].map(|i| runs[i].cycle(&mut other, now_ns));
            by_other.reverse();
            assert_eq!(by_one, by_other, "{pair:?}, cycle {k}");
            for (run, (twist, state)) in runs.iter_mut().zip(by_one) {
                run.world.obey(&twist, scene.sampling_time());
                run.state = state;
            }
        }
    }
}
