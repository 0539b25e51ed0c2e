//! The bridge beside the robot: from the 30 Hz twist of the camera to the 1 kHz command of the end
//! effector.

use panda::ik::joint_velocities;
use panda::{
    Chain, Command, Echo, Motion, Mount, Reserve, Shaper, ShaperError, ShaperSettings, State,
    Twist, singularity,
};
use scene::Limits;

use crate::standing::Standing;

/// As `vpc-panda.toml` has it, with a wider margin for what the robot does with its elbow. Near the end of
/// the arm's reach a little motion of the camera takes much of the joints' speed.
const RESERVE: Reserve = Reserve {
    margin: 0.15,
    speed: 0.3,
};

/// Turns camera twists into robot commands. It knows the calibration that a real bridge would be
/// given, not the truth.
#[derive(Clone, Debug)]
pub struct Bridge {
    mount: Mount,
    limits: Limits,
    joints: &'static panda::Limits,
    /// `None` where the staircase goes out as it is.
    shaper: Option<Shaper>,
    standing: Standing,
}

impl Bridge {
    /// A bridge that commands standing still until its first command.
    ///
    /// # Errors
    /// A bound of the shaper that is not a positive number.
    pub fn new(
        mount: Mount,
        limits: Limits,
        joints: &'static panda::Limits,
        shaping: Shaping,
    ) -> Result<Self, ShaperError> {
        let shaper = match shaping {
            Shaping::On(settings) => Some(Shaper::new(settings)?),
            Shaping::Off => None,
        };
        Ok(Self {
            mount,
            limits,
            joints,
            shaper,
            standing: Standing::default(),
        })
    }

    /// Takes a command of the controller: camera velocity in the camera frame (m/s, rad/s), to hold
    /// until `until_ns`. Returns whether it was outside the limits and was cut.
    pub fn command(&mut self, twist: &[f64; 6], until_ns: u64) -> bool {
        self.standing = Standing::new(twist, until_ns, &self.limits.velocity());
        self.standing.was_limited()
    }

    /// Takes a command of the robot's own side, to which the limits of the servoing do not apply.
    pub fn move_by_itself(&mut self, twist: &[f64; 6], until_ns: u64) {
        self.standing = Standing::new(twist, until_ns, &[f64::INFINITY; 6]);
    }

    /// The command that stands.
    pub fn standing(&self) -> &Standing {
        &self.standing
    }

    /// The command that answers a state of the robot. The camera's velocity is transported to the
    /// end effector anew in every millisecond, because the base axes turn under it.
    pub fn answer(&mut self, state: &State, now_ns: u64) -> Command {
        let camera = Twist::from_column_slice(&self.standing.twist());
        let base = self
            .mount
            .to_base(&state.o_t_ee.rotation, &state.f_t_ee, &camera);
        let twist = match &mut self.shaper {
            Some(shaper) => {
                let share = joint_share(state, &base, self.joints, shaper.settings());
                shaper.aim(&(base * share), self.standing.until_ns());
                shaper.step(&Echo::from(state), now_ns)
            }
            None if self.standing.is_stale(now_ns) => Twist::zeros(),
            None => base,
        };
        Command {
            id: state.id,
            motion: Motion::Cartesian(twist),
            finished: false,
        }
    }
}

/// How much of this motion of the end effector the joints allow, 0 to 1.
fn joint_share(
    state: &State,
    twist: &Twist,
    limits: &panda::Limits,
    shaper: &ShaperSettings,
) -> f64 {
    let chain = Chain::new(state.f_t_ee);
    let dq = joint_velocities(&chain, &state.q_d, twist);
    let clear = singularity::share(&chain, limits, shaper, &state.q_d, &dq);
    clear.min(RESERVE.share(limits, &state.q_d, &dq))
}

/// Whether commands are shaped for the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shaping {
    /// Bounded acceleration and jerk.
    On(ShaperSettings),
    /// The 30 Hz staircase as it is: to show what the robot says to that.
    Off,
}

impl Default for Shaping {
    fn default() -> Self {
        Self::On(ShaperSettings::default())
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use scene::{Pose, Scene, parse_starts};

    use super::*;
    use crate::pose::seen_after;
    use crate::robot::arm::{Arm, ArmSettings};

    const MS: u64 = 1_000_000;

    fn scene() -> Scene {
        Scene::parse(scene::PAPER_ROBOT, "robot").unwrap()
    }

    fn arm(start: &Pose, shaping: Shaping) -> Arm {
        let settings = ArmSettings {
            shaping,
            ..ArmSettings::default()
        };
        Arm::new(&scene(), start, &settings).unwrap()
    }

    /// Full-speed twists at 30 Hz that change their mind in every frame, back and forth so that the
    /// arm stays; some frames bring none.
    fn tear(arm: &mut Arm, random: &mut ChaCha8Rng, seconds: u64) {
        let limits = scene().limits;
        let mut twist = [0.0; 6];
        for ms in 0..1000 * seconds {
            if ms % 33 == 0 && random.random::<f64>() > 0.1 {
                let sign = |random: &mut ChaCha8Rng| f64::from(random.random_range(-1..=1));
                twist = if random.random() {
                    twist.map(|v: f64| -v)
                } else {
                    std::array::from_fn(|k| {
                        sign(random) * if k < 3 { limits.linear } else { limits.angular }
                    })
                };
                arm.bridge.command(&twist, (ms + 100) * MS);
            }
            arm.step(ms * MS);
        }
    }

    #[test]
    fn at_the_end_of_its_reach_and_of_its_joints_ranges_the_arm_slows_down() {
        let mut scene = scene();
        (scene.limits.linear, scene.limits.angular) = (0.1, 0.3);
        let starts = parse_starts(scene::PAPER_ROBOT_STARTS, "starts").unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(11);
        for start in &starts[..40] {
            let most = scene.limits.velocity();
            let twist = most.map(|most| most * random.random_range(-1.0..1.0));
            let mut arm = Arm::new(&scene, start, &ArmSettings::default()).unwrap();
            for ms in 0..8_000 {
                if ms % 33 == 0 {
                    arm.bridge.command(&twist, (ms + 100) * MS);
                }
                arm.step(ms * MS);
            }
            let report = arm.inspector().report();
            assert!(report.is_clean(), "{twist:?}: {:?}", report.errors);
        }
    }

    #[test]
    fn random_staircases_never_trip_the_robot_and_unshaped_they_do() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let starts = parse_starts(scene::PAPER_ROBOT_STARTS, "starts").unwrap();
        for start in starts.iter().step_by(10) {
            let mut shaped = arm(start, Shaping::default());
            tear(&mut shaped, &mut random, 20);
            let report = shaped.inspector().report();
            assert!(report.is_clean(), "{report:?}");
            assert!(report.joint_acceleration > 0.05 && report.joint_acceleration < 0.9);
            let mut raw = arm(start, Shaping::Off);
            tear(&mut raw, &mut random, 1);
            assert!(raw.inspector().report().reflexes > 0);
        }
    }

    #[test]
    fn a_stale_command_ramps_to_zero_in_60_ms_and_the_robot_stands() {
        let mut arm = arm(&scene().goal, Shaping::default());
        let limits = scene().limits;
        let fast = [limits.linear; 3].into_iter().chain([limits.angular; 3]);
        let twist: Vec<f64> = fast.collect();
        arm.bridge.command(&twist.try_into().unwrap(), 100 * MS);
        for ms in 0..100 {
            arm.step(ms * MS);
        }
        assert!(!arm.is_at_rest() && arm.bridge.standing().is_stale(100 * MS));
        let mut before = arm.camera_twist();
        for ms in 100..160 {
            arm.step(ms * MS);
            let after = arm.camera_twist();
            // A ramp, not a jump: 0.5 m/s^2 along each axis of the base are 0.9 mm/s in a
            // millisecond.
            let jump = (0..3)
                .map(|k| (after[k] - before[k]).abs())
                .fold(0.0, f64::max);
            assert!(jump < 1e-3, "{jump}");
            before = after;
        }
        assert!(arm.is_at_rest());
        let stand = arm.state().q_d;
        (160..500).for_each(|ms| arm.step(ms * MS));
        assert!((arm.state().q_d - stand).amax() < 1e-4);
        assert!(arm.inspector().report().is_clean());
    }

    #[test]
    fn the_end_effector_is_at_rest_while_the_elbow_still_creeps() {
        let starts = parse_starts(scene::PAPER_ROBOT_STARTS, "starts").unwrap();
        let mut arm = arm(&starts[40], Shaping::default());
        for ms in 0..18_000 {
            let roll = [0.0, 0.0, 0.0, 0.0, 0.0, -0.03];
            arm.bridge.command(&roll, (ms + 100) * MS);
            arm.step(ms * MS);
        }
        assert!(!arm.is_at_rest());
        (18_000..18_500).for_each(|ms| arm.step(ms * MS));
        let (stand, elbow) = (arm.object().translation.vector, arm.state().q_d[2]);
        assert!(arm.is_at_rest(), "{}", arm.state().o_dp_ee_d);
        (18_500..20_000).for_each(|ms| arm.step(ms * MS));
        assert!((arm.state().q_d[2] - elbow).abs() > 1e-4);
        assert!((arm.object().translation.vector - stand).amax() < 1e-4);
        assert!(arm.inspector().report().is_clean());
    }

    #[test]
    fn the_camera_moves_as_told_where_the_calibration_is_true_and_askew_where_it_is_not() {
        let twist = [0.004, -0.006, 0.002, 0.01, 0.02, -0.01];
        let apart = |settings: ArmSettings| {
            let mut arm = Arm::new(&scene(), &scene().goal, &settings).unwrap();
            arm.bridge.command(&twist, u64::MAX);
            (0..300).for_each(|ms| arm.step(ms * MS));
            let before = arm.object();
            (300..400).for_each(|ms| arm.step(ms * MS));
            // Against exact motion under the twist that was told: m.
            let told = seen_after(&before, &twist, 0.1).translation.vector;
            (arm.object().translation.vector - told).norm()
        };
        assert!(apart(ArmSettings::default()) < 5e-6);
        let mut askew = ArmSettings::default();
        askew.truth.hand_eye_deg = [0.0, 0.0, 5.0];
        assert!(apart(askew) > 5e-5);
    }

    #[test]
    fn what_is_beyond_the_limits_is_cut_and_said_so() {
        let mount = crate::robot::calibration::HandEye::default().mount();
        let mut bridge = Bridge::new(
            mount,
            scene().limits,
            panda::Model::Panda.limits(),
            Shaping::default(),
        )
        .unwrap();
        assert!(bridge.command(&[1.0, f64::NAN, 0.0, 0.0, 0.0, 0.0], 10));
        assert_eq!(
            bridge.standing().twist_at(9),
            [0.01, 0.0, 0.0, 0.0, 0.0, 0.0]
        );
        assert_eq!(bridge.standing().twist_at(10), [0.0; 6]);
    }
}
