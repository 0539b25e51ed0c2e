//! The law's state between two cycles, as plain data.

use serde::{Deserialize, Serialize};

use crate::arm::Posture;
use crate::blind::Blind;
use crate::delay::History;
use crate::draft::Draft;
use crate::drift::Drift;
use crate::features::PlainPoints;
use crate::follow::Follow;
use crate::foresight::Foresight;
use crate::joint_path::JointPath;
use crate::patience::Patience;
use crate::pose::Tilt;
use crate::prediction::Plan;
use crate::strategy::Strategy;
use crate::way::Way;
use crate::{DOF, MAX_VARIABLES, Twist};

/// All that a [`Law`](crate::Law) remembers from one cycle to the next. Another law of the same
/// task and settings that continues from this state gives the same commands, bit for bit: solver
/// and previews are workspace, which is written before it is read.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The strategy in use, which an operator may change.
    pub strategy: Strategy,
    /// Whether features are near an occlusion, with hysteresis.
    pub near: bool,
    /// The incumbent, and the state of foresight.
    pub foresight: Foresight,
    /// The path in the arm's joints that was found last.
    pub path: JointPath,
    /// The refined way that was found last.
    pub way: Way,
    /// The way that is being refined.
    pub draft: Draft,
    /// Searches for one so far.
    pub searches: u32,
    /// How long nothing has improved.
    pub patience: Patience,
    /// The last plan, vx vy vz wx wy wz of each free command, m/s and rad/s, camera frame; the rest
    /// is zero.
    pub previous: Plan,
    /// Where the features should be in the next cycle.
    pub predicted: PlainPoints,
    /// Which of two poses the model predicts.
    pub predicted_tilt: Option<Tilt>,
    /// The last measurement that was believed.
    pub seen: PlainPoints,
    /// The filtered features of that measurement.
    pub filtered: PlainPoints,
    /// Which of two poses the model believed in that measurement.
    pub tilt: Option<Tilt>,
    /// The exposure of that measurement, ns; 0 if there was none.
    pub seen_ns: u64,
    /// Whether the last command was in force since then without a gap.
    pub is_linked: bool,
    /// Motion that was commanded while `seen` did not change in any bit, px.
    pub still_px: f64,
    /// The pattern's own motion.
    pub drift: Drift,
    /// How well the pose is known while points are hidden.
    pub blind: Blind,
    /// Where the arm's joints were told to be, where it is known.
    pub joints: Option<Posture>,
    /// The velocity of the arm's elbow that was sent last, rad/s.
    pub elbow: f64,
    /// The recent features and commands, to check that the image follows.
    pub follow: Follow,
    /// The command that was sent last.
    pub standing: Twist,
    /// The commands that were sent.
    pub history: History,
}

impl State {
    /// The state of a law before its first cycle.
    pub const fn new(strategy: Strategy) -> Self {
        Self {
            strategy,
            near: false,
            foresight: Foresight::NONE,
            path: JointPath::NONE,
            way: Way::NONE,
            draft: Draft::NONE,
            searches: 0,
            patience: Patience::NEW,
            previous: [0.0; MAX_VARIABLES],
            predicted: PlainPoints::NONE,
            predicted_tilt: None,
            seen: PlainPoints::NONE,
            filtered: PlainPoints::NONE,
            tilt: None,
            seen_ns: 0,
            is_linked: false,
            still_px: 0.0,
            drift: Drift::NONE,
            blind: Blind::NEW,
            joints: None,
            elbow: 0.0,
            follow: Follow::NEW,
            standing: [0.0; DOF],
            history: History::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Law, Measurement, Settings};

    /// One period of the scene's camera, ns.
    const PERIOD: u64 = 33_333_333;

    /// A drifting square that passes the occlusions of the scene.
    fn view(k: usize, age_ns: u64) -> Measurement {
        let (u, v) = (400.0 + 3.0 * k as f64, 350.0 + 1.7 * k as f64);
        Measurement::from_points(&[[u, v], [u + 90.0, v], [u + 90.0, v + 95.0], [u, v + 90.0]])
            .taken(PERIOD * k as u64, PERIOD * k as u64 + age_ns)
    }

    #[test]
    fn a_restored_law_goes_on_with_the_same_bits() {
        let scene = scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        for (nc, age_ns) in [(1, 0), (3, 0), (1, 4 * PERIOD)] {
            let settings = Settings {
                nc,
                ..Settings::default()
            };
            let mut first = Law::new(&scene, settings, |len| vec![0.0; len]).unwrap();
            let mut second = Law::new(&scene, settings, |len| vec![0.0; len]).unwrap();
            for k in 0..150 {
                // The second one has another past: what is not in the state must not matter.
                let _ = second.step(&view(300 - k, age_ns), None);
                second.restore(&first.state());
                assert_eq!(second.state(), first.state());
                let (a, b) = (
                    first.step(&view(k, age_ns), None),
                    second.step(&view(k, age_ns), None),
                );
                let (a, b) = (a.unwrap(), b.unwrap());
                assert_eq!(a.twist.map(f64::to_bits), b.twist.map(f64::to_bits), "{k}");
                first.sent(&a.twist, PERIOD * k as u64 + age_ns);
                second.sent(&b.twist, PERIOD * k as u64 + age_ns);
                assert_eq!((a, first.state()), (b, second.state()), "{k}");
            }
        }
    }

    #[test]
    fn every_part_of_the_state_matters() {
        every_part_matters(Settings::default());
        every_part_matters(Settings {
            filter_s: 0.0,
            ..Settings::default()
        });
    }

    fn every_part_matters(settings: Settings) {
        let scene = scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let mut law = Law::new(&scene, settings, |len| vec![0.0; len]).unwrap();
        for k in 0..20 {
            let twist = law.step(&view(k, 0), None).unwrap().twist;
            law.sent(&twist, PERIOD * k as u64);
        }
        let state = law.state();
        assert_eq!(state.predicted.count, 4);
        assert_eq!(state.seen.count, 4);
        let mut after = |age_ns: u64, change: fn(&mut State)| {
            let mut changed = state;
            change(&mut changed);
            law.restore(&changed);
            let step = law.step(&view(20, age_ns), None).unwrap();
            (step, law.state())
        };
        let late = after(PERIOD, |_| ());
        assert_eq!(late, after(PERIOD, |_| ()));
        assert_ne!(
            late,
            after(PERIOD, |state| state.filtered.points[0][1] += 1.0)
        );
        assert_ne!(late, after(PERIOD, |state| state.filtered.count = 0));
        assert_ne!(late, after(PERIOD, |state| state.standing[0] += 0.1));
        let moves = |state: &mut State| state.drift.believed.twist[0] += 0.1;
        assert_ne!(late.0, after(PERIOD, moves).0);
        if settings.filter_s == 0.0 {
            assert_ne!(late, after(PERIOD, |state| state.is_linked = false));
        }
        assert_ne!(late, after(PERIOD, |state| state.still_px = 1.0));
        assert_ne!(late, after(PERIOD, |state| state.seen_ns = u64::MAX));
        assert_ne!(
            late.0,
            after(PERIOD, |state| state.history = History::new()).0
        );
        let mut after = |change: fn(&mut State)| after(0, change);
        let same = after(|_| ());
        assert_eq!(same, after(|_| ()));
        assert_ne!(same, after(|state| state.predicted.count = 0));
        assert_ne!(same, after(|state| state.predicted.points[1][0] += 1.0));
        assert_ne!(same, after(|state| state.strategy = Strategy::Ibvs));
        assert_ne!(same, after(|state| state.previous = [0.3; MAX_VARIABLES]));
    }

    #[test]
    fn the_tilt_matters_where_two_poses_look_alike() {
        // 10 m away the pattern is small.
        let scene = scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let mut law = Law::new(&scene, Settings::default(), |len| vec![0.0; len]).unwrap();
        let pose = scene::Pose {
            translation: [0.3, 0.2, 10.0],
            rotation: [0.0, 0.5, 0.0],
        };
        let noise = [[0.02, -0.01], [-0.015, 0.02], [0.01, 0.015], [-0.02, -0.01]];
        let points = crate::task::placed(&scene.pattern, &pose).zip(noise);
        let points = points.map(|(x, noise)| {
            let [u, v] = crate::camera::project(&law.task().camera, x.into()).unwrap();
            [u + noise[0], v + noise[1]]
        });
        let view = Measurement::from_points(&points.collect::<Vec<_>>());
        let twists = [0.48, -0.48].map(|x| {
            let mut state = State::new(Strategy::Previous);
            state.predicted = view.points.as_slice().into();
            state.predicted_tilt = Some(Tilt {
                normal: [x, 0.0, 0.88],
                evidence: 1.0,
            });
            law.restore(&state);
            law.step(&view, None).unwrap().twist
        });
        assert_ne!(twists[0], twists[1]);
    }
}
