//! Conversions between the codes of the contract and the types of the control law.

use messages::{
    ArmBound, Bound, CycleRecord, Features, ForesightCode, Hold, JointFault, RecallCode,
    SolverStatus, Stamp, StrategyCode,
};
use vpc::arm::{Cause, Other, Pair};
use vpc::foresight::{Foresight, Outcome, PLACES};
use vpc::guide::Kind;
use vpc::{Asked, Law, Measurement, Refusal, Status, Step, Strategy};

// A step takes all the points that a message can have: more than the law has room for would panic
// in the loop. And a path has its places and points side by side in both.
const _: () = assert!(messages::MAX_POINTS == vpc::MAX_POINTS);
const _: () = assert!(messages::PATH_PLACES == PLACES);
const _: () = assert!(messages::MAX_NEIGHBOURS as usize == vpc::strategy::MAX_NEIGHBOURS);

/// Code of a strategy, and the neighbours of k-NN or 0.
pub fn strategy_code(strategy: Strategy) -> (StrategyCode, u32) {
    let code = match strategy {
        Strategy::Previous => StrategyCode::Previous,
        Strategy::Knn { .. } => StrategyCode::Knn,
        Strategy::Gpr => StrategyCode::Gpr,
        Strategy::Ibvs => StrategyCode::Ibvs,
        Strategy::Foresight => StrategyCode::Foresight,
        Strategy::Follow => StrategyCode::Follow,
    };
    (code, strategy.neighbours() as u32)
}

/// The strategy of a code; `None` if the number of neighbours does not belong to it.
pub fn strategy(code: StrategyCode, neighbours: u32) -> Option<Strategy> {
    let strategies = Strategy::ALL.into_iter();
    let mut named = strategies.filter(|&strategy| strategy_code(strategy).0 == code);
    named.next()?.averaging(neighbours as usize)
}

/// The measurement in a message, for a command that takes effect at `effective_ns`.
pub fn measurement(features: &Features, effective_ns: u64) -> Measurement {
    let exposed_ns = exposed_ns(&features.stamp);
    let mut measurement = Measurement::from_points(&[]).taken(exposed_ns, effective_ns);
    measurement.visible = features.visible;
    measurement.points.extend(features.pairs());
    measurement
}

/// When what a message with this head tells was measured, or the latest instant that this may have
/// been.
pub fn exposed_ns(stamp: &Stamp) -> u64 {
    match stamp.data_ns {
        // Unknown: not later than the publication.
        0 => stamp.published_ns,
        data_ns => data_ns,
    }
}

/// The hold for a refusal by the law.
pub fn hold_of(refusal: Refusal) -> Hold {
    match refusal {
        Refusal::Hidden { .. } => Hold::Hidden,
        Refusal::Count { .. } => Hold::Count,
        Refusal::NotFinite { .. } => Hold::NotFinite,
        Refusal::OffImage { .. } | Refusal::Lost => Hold::OffImage,
        Refusal::Mixed { .. }
        | Refusal::Leap { .. }
        | Refusal::Coincident { .. }
        | Refusal::Flat { .. } => Hold::Mixed,
        Refusal::Frozen { .. } => Hold::Frozen,
        Refusal::NotFollowing { .. } => Hold::NotFollowing,
        Refusal::Exceeding { .. } => Hold::ImageExceeds,
        Refusal::Lagging { .. } => Hold::ImageLate,
        Refusal::Elsewhere { .. } => Hold::Elsewhere,
        Refusal::Late { .. } => Hold::Stale,
        Refusal::NoJoints => Hold::NoJoints,
    }
}

/// Copies what is foreseen into the record of the cycle that follows it.
pub fn record_foresight(foresight: &Foresight, step_s: f64, record: &mut CycleRecord) {
    record.foresight = match foresight.guide.kind {
        Kind::Goal => ForesightCode::Goal,
        Kind::Sample => ForesightCode::Sample,
        Kind::Aside => ForesightCode::Aside,
        Kind::Neighbour => ForesightCode::Neighbour,
        Kind::Regression => ForesightCode::Regression,
        Kind::Joints => ForesightCode::Joints,
        Kind::Refined => ForesightCode::Refined,
    }
    .code();
    record.candidates = foresight.tried;
    record.simulated = foresight.simulated;
    record.switches = foresight.switches;
    record.arrival_s = match foresight.outcome {
        Outcome::Arrives { steps, .. } => steps * step_s,
        Outcome::Nears { .. } | Outcome::Unknown => f64::NAN,
    };
    let path = &foresight.path;
    record.path_every_s = f64::from(path.every) * step_s;
    record.path_count = path.count;
    record.path_points = path.points;
    let places = path.places.iter().flatten().flatten();
    (record.path.iter_mut().zip(places)).for_each(|(to, &from)| *to = f64::from(from));
}

/// Copies the numbers of a step of the law into the record of its cycle.
pub fn record_step(step: &Step, record: &mut CycleRecord) {
    record.status = match step.status {
        Status::Converged => SolverStatus::Converged,
        Status::IterationLimit => SolverStatus::IterationLimit,
        Status::Stalled => SolverStatus::Stalled,
        Status::Infeasible => SolverStatus::Infeasible,
        Status::NumericalFailure => SolverStatus::NumericalFailure,
    }
    .code();
    record.recalled = match step.asked {
        Asked::Not => RecallCode::Unasked,
        Asked::Followed => RecallCode::Followed,
        Asked::Replaced => RecallCode::Replaced,
        Asked::Refused => RecallCode::Refused,
    }
    .code();
    let (bound, index, link) = match step.cause {
        None => (None, 0, None),
        Some(Cause::Joint(k)) => (Some(ArmBound::Range), k, None),
        Some(Cause::Speed(k)) => (Some(ArmBound::Speed), k, None),
        Some(Cause::Singularity) => (Some(ArmBound::Singularity), 0, None),
        Some(Cause::Wall(i)) => (Some(ArmBound::Wall), i, None),
        Some(Cause::Near(Pair { shape, other })) => {
            let (bound, index) = match other {
                Other::Link(i) => (ArmBound::Link, i),
                Other::Box(i) => (ArmBound::Box, i),
                Other::Wall(i) => (ArmBound::Wall, i),
            };
            (Some(bound), index.into(), Some(shape.into()))
        }
    };
    record.arm_bound = bound.map_or(0, ArmBound::code);
    record.arm_bound_index = Bound::coded_index(index, link);
    record.iterations = step.iterations;
    record.qp_iterations = step.qp_iterations;
    record.cost = step.cost;
    record.violation_px = step.violation_px;
    record.clearance_px = step.clearance_px;
    record.error_px = step.error_px;
    if let Some(way_point) = &step.way_point {
        record.way_point_count = way_point.len() as u32;
        let pairs = record.way_point.chunks_exact_mut(2);
        pairs
            .zip(way_point)
            .for_each(|(to, from)| to.copy_from_slice(from));
    }
}

/// Copies where the law believes the points that an image does not show into its cycle's record.
pub fn record_hidden<W: AsRef<[f64]> + AsMut<[f64]>>(law: &Law<W>, record: &mut CycleRecord) {
    let hidden = (0..vpc::MAX_POINTS).filter(|&point| record.visible >> point & 1 == 0);
    let seen = law.seen().unwrap_or_default();
    for point in hidden {
        let (Some(pixel), Some(ellipse)) = (seen.get(point), law.blind().ellipses.get(point))
        else {
            break;
        };
        let (pixels, covariances) = (
            record.points.as_chunks_mut().0,
            record.covariance.as_chunks_mut().0,
        );
        if let (Some(to), Some(covariance)) = (pixels.get_mut(point), covariances.get_mut(point)) {
            (*to, *covariance) = (*pixel, ellipse.map(f64::from));
        }
    }
}

/// Copies what is wrong with the robot's joints into the record of the cycle that heard of it.
pub fn record_joint_fault(fault: Option<JointFault>, record: &mut CycleRecord) {
    record.joint_fault = fault.map_or(0, |fault| fault.code.code());
    if let Some(fault) = fault {
        record.joint_fault_index = fault.joint;
        record.joint_fault_found = fault.found;
        record.joint_fault_allowed = fault.allowed;
    }
}

/// Whether the law ran in the cycle of a record, and if so, whether its solver failed.
pub fn solver_failed(record: &CycleRecord) -> Option<bool> {
    match SolverStatus::from_code(record.status) {
        None | Some(SolverStatus::Idle) => None,
        Some(status) => Some(status == SolverStatus::NumericalFailure),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_of_the_arm_binds_is_recorded_with_its_index() {
        let recorded = |cause| {
            let mut record = CycleRecord::default();
            let step = Step {
                cause,
                ..Step::default()
            };
            record_step(&step, &mut record);
            (record.arm_bound, record.arm_bound_index)
        };
        assert_eq!(recorded(None), (0, 0));
        let at = |bound: ArmBound, index| (bound.code(), index);
        assert_eq!(recorded(Some(Cause::Joint(3))), at(ArmBound::Range, 3));
        assert_eq!(recorded(Some(Cause::Speed(6))), at(ArmBound::Speed, 6));
        let singular = recorded(Some(Cause::Singularity));
        assert_eq!(singular, at(ArmBound::Singularity, 0));
        assert_eq!(recorded(Some(Cause::Wall(1))), at(ArmBound::Wall, 1));
        let near = |other| recorded(Some(Cause::Near(Pair { shape: 4, other })));
        assert_eq!(near(Other::Link(2)), at(ArmBound::Link, 2 + 5 * 256));
        assert_eq!(near(Other::Box(3)), at(ArmBound::Box, 3 + 5 * 256));
        assert_eq!(near(Other::Wall(0)), at(ArmBound::Wall, 5 * 256));
    }
}
