//! The state of the control step as it is published and recorded: `postcard` bytes in a
//! [`Snapshot`].

use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::{String, ToString};

use messages::Snapshot;

use crate::control::State;

/// Changes with the fields of [`State`], so that a state of another build is refused by its number.
pub const VERSION: u32 = 18;

/// Cycles from one snapshot to the next, unless something is lost between.
pub const EVERY: u64 = 32;

/// Why a snapshot cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("snapshot before cycle {cycle}: {reason}")]
pub struct SnapshotError {
    /// The cycle that follows it.
    pub cycle: u64,
    /// What is wrong.
    pub reason: String,
}

/// Encodes the state before a cycle. Allocates nothing, but takes microseconds: for an ordinary
/// thread.
///
/// # Errors
/// If the state has no room in a message, which a test excludes.
pub fn encode(cycle: u64, state: &State) -> Result<Snapshot, SnapshotError> {
    let mut bytes = [0; Snapshot::MAX_LENGTH];
    let refuse = |reason| SnapshotError { cycle, reason };
    let used = postcard::to_slice(state, &mut bytes).map_err(|error| refuse(error.to_string()))?;
    Snapshot::new(cycle, VERSION, used).ok_or_else(|| refuse("too long".to_owned()))
}

/// Decodes what [`encode`] made.
///
/// # Errors
/// [`SnapshotError`] if it is of another version, or damaged.
pub fn decode(snapshot: &Snapshot) -> Result<State, SnapshotError> {
    let refuse = |reason| SnapshotError {
        cycle: snapshot.cycle,
        reason,
    };
    if snapshot.version != VERSION {
        return Err(refuse(format!(
            "version = {}; allowed: {VERSION}, that of this vpcd",
            snapshot.version
        )));
    }
    match postcard::take_from_bytes(snapshot.bytes()) {
        Ok((state, [])) => Ok(state),
        Ok((_, rest)) => Err(refuse(format!("{} bytes too many", rest.len()))),
        Err(error) => Err(refuse(format!("damaged: {error}"))),
    }
}

#[cfg(test)]
mod tests {
    use messages::{Features, Hold, Stamp, TwistState};

    use super::*;
    use crate::control::{Answer, Wish};
    use crate::decision::Decision;
    use crate::gate::Gate;
    use crate::input::Input;
    use crate::joints::JointWatch;
    use crate::robot::RobotWatch;
    use crate::rules::Rules;
    use crate::supervisor::{Situation, Supervisor};

    const STAMP: Stamp = Stamp {
        sequence: u64::MAX,
        published_ns: u64::MAX,
        data_ns: u64::MAX,
    };

    fn panda() -> scene::Arm {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../ipc/scene/scenes/s.toml");
        let text = format!("arm = 'panda.toml'\n{}", scene::PAPER_ROBOT);
        scene::Scene::parse(&text, path).unwrap().arm.unwrap()
    }

    /// A state with the numbers that take most room, and those that are lost most easily.
    fn extreme() -> State {
        let decision = Decision {
            twist: [
                f64::NAN,
                -0.0,
                f64::INFINITY,
                f64::MIN_POSITIVE / 4.0,
                f64::MAX,
                -f64::NAN,
            ],
            elbow: f64::NEG_INFINITY,
            state: TwistState::Disarmed,
            hold: Some(Hold::Frozen),
        };
        let rules = Rules {
            limits: [f64::MAX; 6],
            change: [f64::MAX; 6],
            brake_ns: u64::MAX,
            ramp_ns: u64::MAX,
            valid_ns: Some(u64::MAX),
            lost_ns: Some(u64::MAX),
            needs_robot: false,
            begins_armed: true,
            after_arrival: Default::default(),
        };
        let mut gate = Gate::new(Some(u64::MAX));
        let mut message = Features::new(&[[1.0; 2]; 4], 0);
        message.stamp = STAMP;
        gate.judge(&Input::Message(message), u64::MAX);
        gate.approve();
        let mut supervisor = Supervisor::new(rules);
        supervisor.begin_again(u32::MAX);
        supervisor.name_vetoes(u64::MAX);
        supervisor.supervise(
            &Situation {
                decision,
                good_ns: Some(u64::MAX),
                solver_failed: Some(true),
                missed: u32::MAX,
                robot: Some(Hold::RobotLost),
                suspended: true,
                shutdown: true,
            },
            u64::MAX,
        );
        let mut robot = RobotWatch::new(&rules);
        robot.sent(&[f64::MIN_POSITIVE / 4.0; 6], u64::MAX);
        let mut state = messages::RobotState::free_camera([0.0; 3], [0.0; 3], 0);
        state.stamp = STAMP;
        robot.look(&Input::Message(state), u64::MAX, |_, _| [f64::MAX; 6]);
        let mut joints = JointWatch::new(&rules);
        (state.joints, state.q) = (7, [f64::MIN_POSITIVE / 4.0; 7]);
        state.mode = messages::RobotMode::Moving.code();
        for q in [0.0, 1.0] {
            state.stamp.data_ns = u64::MAX;
            state.q[0] = q;
            joints.look(&arm::Arm::from(&panda()), &state, u64::MAX);
        }
        let mut law = vpc::State::new(vpc::Strategy::Knn { k: usize::MAX });
        law.history.from_ns.as_flattened_mut().fill(u64::MAX);
        law.history.twists.as_flattened_mut().fill(decision.twist);
        (law.history.count, law.predicted.count, law.seen.count) = (u32::MAX, u32::MAX, u32::MAX);
        law.seen_ns = u64::MAX;
        law.joints = Some(vpc::arm::Posture::new(&[f64::MAX; 7], u64::MAX));
        law.previous.fill(f64::NAN);
        law.predicted.points.fill([f64::NEG_INFINITY, -0.0]);
        State {
            gate,
            robot,
            joints,
            law,
            supervisor,
            standing: Answer {
                stamp: STAMP,
                decision,
            },
            predicted: u32::MAX,
            wish: Some(Wish {
                twist: [f64::NAN; 6],
                until_ns: u64::MAX,
            }),
            lag_s: Some(f64::MAX),
        }
    }

    #[test]
    fn extreme_states_fit_and_come_back_bit_for_bit() {
        let state = extreme();
        let snapshot = encode(7, &state).unwrap();
        // Room for a state twice as large.
        assert!(
            2 * snapshot.length as usize <= Snapshot::MAX_LENGTH,
            "{}",
            snapshot.length
        );
        let back = decode(&snapshot).unwrap();
        assert!(back.standing.decision.twist[0].is_nan());
        assert_eq!(encode(7, &back).unwrap().bytes(), snapshot.bytes());
        let bits = |state: &State| state.standing.decision.twist.map(f64::to_bits);
        assert_eq!(bits(&back), bits(&state));
        // What is not NaN compares by value as well.
        assert_eq!((back.gate, back.robot), (state.gate, state.robot));
        assert_eq!(back.joints, state.joints);
    }

    #[test]
    fn other_versions_and_damaged_snapshots_are_refused() {
        let good = encode(7, &extreme()).unwrap();
        let refused = |change: &dyn Fn(&mut Snapshot)| {
            let mut snapshot = good;
            change(&mut snapshot);
            decode(&snapshot).unwrap_err().to_string()
        };
        let message = refused(&|snapshot| snapshot.version = 99);
        let wanted = format!("before cycle 7: version = 99; allowed: {VERSION}");
        assert!(message.contains(&wanted), "{message}");
        let message = refused(&|snapshot| snapshot.length -= 1);
        assert!(message.contains("damaged"), "{message}");
        let message = refused(&|snapshot| snapshot.length += 1);
        assert!(message.contains("1 bytes too many"), "{message}");
    }
}
