//! What to command: one step of the law, and a last check of its twist.

use messages::{CycleRecord, Features, TwistState};
use scene::{Limits, Scene};

use crate::contract;
use crate::decision::{Decision, HoldReason};
use crate::gate::Link;
use crate::loaded::LoadedController;

/// A twist whose components are all below this share of their limits is near zero: ten times the
/// changes by which a camera with a noise of 0.3 px regulates.
const AT_REST: f64 = 0.05;
/// A camera that has arrived leaves the goal when the error is this multiple of the threshold of
/// convergence.
const LEAVES: f64 = 2.0;
/// Rounding that a command may have beyond the limits, as a share of them.
const ROUNDING: f64 = 1e-9;

/// Decides what to command on these features by a command that takes effect at `effective_ns`, on
/// the clock of their exposure; the numbers of the step go into `record`. `had_arrived` is whether
/// the last decision was [`TwistState::Arrived`]. Never allocates.
pub fn decide(
    loaded: &mut LoadedController,
    features: &Features,
    effective_ns: u64,
    link: Link,
    had_arrived: bool,
    record: &mut CycleRecord,
) -> Decision {
    match link {
        Link::Next => (),
        Link::Broken => loaded.controller.skip_mismatch(),
        Link::New => loaded.controller.reset(),
    }
    let step = match loaded.step(&contract::measurement(features, effective_ns)) {
        Ok(step) => step,
        Err(refusal) => return Decision::hold(contract::hold_reason(refusal)),
    };
    contract::record_step(&step, record);
    if step.status == vpc::Status::NumericalFailure {
        return Decision::hold(HoldReason::Solver);
    }
    if !is_within(&step.twist, &loaded.scene().limits) {
        return Decision::hold(HoldReason::BadTwist);
    }
    if step.stands {
        return Decision::hold(HoldReason::NoWay);
    }
    let had_arrived = had_arrived && link != Link::New;
    Decision {
        twist: step.twist,
        state: match has_arrived(&step, loaded.scene(), had_arrived) {
            true => TwistState::Arrived,
            false => TwistState::Moving,
        },
        hold: None,
    }
}

/// Whether the camera has arrived: it is at the goal and all but at rest; and from then on until it
/// is clearly away.
fn has_arrived(step: &vpc::Step, scene: &Scene, had_arrived: bool) -> bool {
    let threshold_px = scene.success.convergence_px;
    if had_arrived {
        return step.error_px < LEAVES * threshold_px;
    }
    let mut pairs = step.twist.iter().zip(scene.limits.velocity());
    step.error_px < threshold_px && pairs.all(|(v, limit)| v.abs() <= AT_REST * limit)
}

/// The last check of a command before it is sent, independent of the law. A NaN is not within the
/// limits.
fn is_within(twist: &[f64; 6], limits: &Limits) -> bool {
    let mut pairs = twist.iter().zip(limits.velocity());
    pairs.all(|(v, limit)| v.abs() <= limit * (1.0 + ROUNDING))
}

#[cfg(test)]
mod tests {
    use messages::SolverStatus;
    use scene::SceneFiles;
    use vpc::{Settings, Strategy};

    use super::*;

    fn law() -> LoadedController {
        law_with(Settings::default())
    }

    fn law_with(settings: Settings) -> LoadedController {
        let text = scene::PAPER_SIM.to_owned();
        let files = SceneFiles::parse(text, "sim", &|_| unreachable!("no masks")).unwrap();
        LoadedController::of(files, "sim", None, settings).unwrap()
    }

    fn features(law: &LoadedController, offset: f64) -> Features {
        let goal = law.controller.task().goal.clone();
        let points: Vec<_> = goal.iter().map(|p| [p[0] + offset, p[1]]).collect();
        Features::new(&points, 0)
    }

    #[test]
    fn on_the_way_it_moves_and_at_the_goal_it_has_arrived() {
        let mut law = law();
        let mut record = CycleRecord::default();
        let (far, near) = (features(&law, 60.0), features(&law, 0.0));
        let decision = decide(&mut law, &far, 0, Link::New, false, &mut record);
        assert_eq!((decision.state, decision.hold), (TwistState::Moving, None));
        assert!(decision.twist.iter().any(|v| v.abs() > 1e-3));
        assert!((record.error_px - 60.0).abs() < 1e-6 && record.cost > 0.0);
        let decision = decide(&mut law, &near, 0, Link::New, false, &mut record);
        assert_eq!(decision.state, TwistState::Arrived);
    }

    #[test]
    fn it_arrives_at_rest_and_leaves_when_it_is_clearly_away() {
        let mut law = law();
        let mut state = |offset: f64, had_arrived: bool| {
            let features = features(&law, offset);
            let record = &mut CycleRecord::default();
            decide(&mut law, &features, 0, Link::Next, had_arrived, record).state
        };
        // The threshold is 2 px.
        assert_eq!(state(0.5, false), TwistState::Arrived);
        assert_eq!(state(3.0, false), TwistState::Moving);
        assert_eq!(state(3.0, true), TwistState::Arrived);
        assert_eq!(state(5.0, true), TwistState::Moving);
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let mut step = law
            .step(&contract::measurement(&features(&law, 1.0), 0))
            .unwrap();
        assert!(step.error_px < 2.0);
        step.twist = [0.0, 0.0, 0.1 * scene.limits.linear, 0.0, 0.0, 0.0];
        assert!(!has_arrived(&step, &scene, false) && has_arrived(&step, &scene, true));
    }

    #[test]
    fn what_the_law_refuses_is_held_with_its_cause() {
        let mut law = law();
        let mut off = features(&law, 0.0);
        off.points[0] = 1e6;
        let mut nan = features(&law, 0.0);
        nan.points[1] = f64::NAN;
        let mut five = features(&law, 0.0);
        five.count = 5;
        let mut mixed = features(&law, 0.0);
        mixed.points[..4].rotate_left(2);
        let mut zeros = features(&law, 0.0);
        zeros.points.fill(0.0);
        for (bad, cause) in [
            (off, HoldReason::OffImage),
            (nan, HoldReason::NotFinite),
            (five, HoldReason::Count),
            (mixed, HoldReason::Mixed),
            (zeros, HoldReason::Mixed),
        ] {
            let decision = decide(
                &mut law,
                &bad,
                0,
                Link::Next,
                false,
                &mut CycleRecord::default(),
            );
            assert_eq!(decision, Decision::hold(cause));
        }
    }

    #[test]
    fn where_the_law_has_no_answer_the_camera_is_held() {
        let mut law = law_with(Settings {
            strategy: Strategy::Ibvs,
            ..Settings::default()
        });
        // Seen as a line, nearly: the interaction matrix is singular.
        let points = [
            [300.0, 299.0],
            [500.0, 299.0],
            [500.0, 301.0],
            [300.0, 301.0],
        ];
        let mut record = CycleRecord::default();
        let decision = decide(
            &mut law,
            &Features::new(&points, 0),
            0,
            Link::New,
            false,
            &mut record,
        );
        assert_eq!(decision, Decision::hold(HoldReason::Solver));
        assert_eq!(record.status, SolverStatus::NumericalFailure.code());
    }

    #[test]
    fn on_a_live_robot_features_from_before_the_first_command_are_stale() {
        let mut law = law();
        law.controller.go_live(100);
        let mut far = features(&law, 60.0);
        // The instant of the exposure is not known: it is no later than this.
        far.stamp.published_ns = 30;
        let step = |law: &mut LoadedController| {
            decide(law, &far, 50, Link::New, false, &mut CycleRecord::default())
        };
        assert_eq!(step(&mut law), Decision::hold(HoldReason::Stale));
        law.controller.sent(&[0.0; 6], 0);
        assert_eq!(step(&mut law).state, TwistState::Moving);
        law.controller.forget_sent();
        assert_eq!(step(&mut law), Decision::hold(HoldReason::Stale));
    }

    #[test]
    fn a_live_robot_whose_image_ignores_the_commands_is_not_believed() {
        const PERIOD: u64 = 33_000_000;
        let mut law = law();
        law.controller.go_live(3 * PERIOD);
        let mut frame = features(&law, 60.0);
        let mut holds = Vec::new();
        for k in 1..20 {
            frame.stamp.data_ns = k * PERIOD;
            law.controller
                .sent(&[0.1, 0.0, 0.0, 0.0, 0.0, 0.0], k * PERIOD);
            let decision = decide(
                &mut law,
                &frame,
                k * PERIOD,
                Link::Next,
                false,
                &mut CycleRecord::default(),
            );
            holds.push(decision.hold);
        }
        assert!(holds.contains(&Some(HoldReason::Frozen)), "{holds:?}");
        // The points by other names, in the place of the old ones: until they were out of sight.
        frame.points[..8].rotate_left(2);
        let mut step = |law: &mut LoadedController, k: u64| {
            frame.stamp.data_ns = k * PERIOD;
            decide(
                law,
                &frame,
                k * PERIOD,
                Link::Next,
                false,
                &mut CycleRecord::default(),
            )
            .hold
        };
        assert_eq!(step(&mut law, 20), Some(HoldReason::Mixed));
        law.controller.lose_sight();
        assert_eq!(step(&mut law, 21), None);
    }

    #[test]
    fn on_a_live_robot_a_point_that_leaps_is_not_believed_at_once() {
        const PERIOD: u64 = 33_000_000;
        let mut law = law();
        law.controller.go_live(100 * PERIOD);
        law.controller.sent(&[0.0; 6], 0);
        let good = features(&law, 60.0);
        let mut leapt = good;
        leapt.points[0] += 100.0;
        let mut step = |k: u64, mut frame: Features| {
            frame.stamp.data_ns = k * PERIOD;
            // No two images are the same.
            frame.points[1] += 1e-6 * k as f64;
            decide(
                &mut law,
                &frame,
                k * PERIOD,
                Link::Next,
                false,
                &mut CycleRecord::default(),
            )
            .hold
        };
        assert_eq!(step(1, good), None);
        assert_eq!(step(2, leapt), Some(HoldReason::Mixed));
        assert_eq!(step(3, good), None);
        // It stays where it went: whoever it was is now the point.
        for k in 4..7 {
            assert_eq!(step(k, leapt), Some(HoldReason::Mixed), "{k}");
        }
        assert_eq!(step(7, leapt), None);
    }

    #[test]
    fn a_command_beyond_the_limits_or_not_finite_is_not_within() {
        let law = law();
        let limits = law.scene().limits;
        let linear = |v| is_within(&[v, 0.0, 0.0, 0.0, 0.0, 0.0], &limits);
        assert!(linear(limits.linear) && linear(-limits.linear));
        assert!(!linear(limits.linear * 1.01) && !linear(f64::NAN) && !linear(f64::INFINITY));
        assert!(!is_within(
            &[0.0, 0.0, 0.0, 0.0, 0.0, -1.01 * limits.angular],
            &limits
        ));
    }
}
