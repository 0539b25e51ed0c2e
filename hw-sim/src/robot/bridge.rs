//! The emulator's own bridge, a driver of the core that real bridges have. Nothing
//! else of the emulator may use the crate `arm`.

use arm::{
    Chain, Driver, Echo, Limits, Measured, Mount, PERIOD, Ramp, Reserve, Room, ShaperSettings,
};
use panda::{Command, Model, Motion, Pose, Robot, Twist};
use scene::Scene;

pub use arm::{Caps, ShaperError};

/// As `vpc-panda.toml` has it, with a wider margin for what the robot does with its elbow. Near the
/// end of the arm's reach a little motion of the camera takes much of the joints' speed.
const RESERVE: Reserve = Reserve {
    margin: 0.15,
    speed: 0.3,
};

/// The index of joint 3.
const ELBOW: usize = 2;
/// The most that the elbow's command is ahead of the joint, rad.
const ELBOW_LEAD: f64 = 0.05;

/// Ramps that reach any velocity within a millisecond.
const STAIRCASE: ShaperSettings = {
    let ramp = Ramp {
        acceleration: 1e6,
        jerk: 1e12,
    };
    ShaperSettings {
        linear: ramp,
        angular: ramp,
    }
};

/// Turns camera twists into robot commands. It knows the calibration that a real bridge would be
/// given, not the truth.
pub type Bridge = arm::Bridge<Emulated>;

/// The emulated robot as the bridge drives it.
#[derive(Clone, Debug)]
pub struct Emulated {
    /// The robot.
    pub robot: Robot,
    /// `None` where the bridge does not know the joints.
    limits: Option<&'static Limits>,
    /// `None` where the staircase goes out as it is.
    shaper: Option<ShaperSettings>,
    /// Where joint 3 is to be, rad; `None` before it was to turn.
    elbow: Option<f64>,
}

/// The ramps of a robot in this scene. One that is not Franka's accelerates by the scene's limits,
/// where these are lower.
pub fn ramps(model: Model, scene: &Scene) -> ShaperSettings {
    let mut ramps = ShaperSettings::default();
    if let Model::Other(_) = model {
        let [linear, .., angular] = scene.limits.acceleration();
        ramps.linear.acceleration = ramps.linear.acceleration.min(linear);
        ramps.angular.acceleration = ramps.angular.acceleration.min(angular);
    }
    ramps
}

/// A bridge that believes the camera to be mounted there. Commands at 30 Hz go out as the
/// staircase that they are, or shaped.
///
/// # Errors
/// A bound of the shaper that is not a positive number.
pub fn bridge(
    robot: Robot,
    flange_from_camera: Pose,
    shaper: Option<ShaperSettings>,
) -> Result<Bridge, ShaperError> {
    let model = match robot.model() {
        Model::Panda => Some(arm::Model::Panda),
        Model::Fr3 => Some(arm::Model::Fr3),
        Model::Other(_) => None,
    };
    let driver = Emulated {
        robot,
        limits: model.map(arm::Model::limits),
        shaper,
        elbow: None,
    };
    let mount = Mount { flange_from_camera };
    Bridge::new(driver, mount, shaper.unwrap_or(STAIRCASE))
}

impl Driver for Emulated {
    fn measured(&self) -> Measured {
        let state = self.robot.state();
        Measured {
            base_from_ee: state.o_t_ee,
            flange_from_ee: state.f_t_ee,
            echo: Echo {
                twist: state.o_dp_ee_c,
                acceleration: state.o_ddp_ee_c,
            },
        }
    }

    fn room(&self, twist: &Twist) -> Room {
        let state = self.robot.state();
        let chain = Chain::FRANKA.with_ee(state.f_t_ee);
        let known = self.limits.zip(self.shaper);
        known.map_or(Room::FULL, |(limits, shaper)| {
            RESERVE.room(&chain, limits, &shaper, &state.q_d, twist)
        })
    }

    fn turn_elbow(&mut self, elbow: f64) {
        if elbow == 0.0 {
            return;
        }
        let at = self.robot.state().q_d[ELBOW];
        let led = self.elbow.unwrap_or(at) + elbow * PERIOD;
        self.elbow = Some(led.clamp(at - ELBOW_LEAD, at + ELBOW_LEAD));
    }

    fn command(&mut self, twist: &Twist) {
        let command = Command {
            id: self.robot.state().id,
            motion: Motion::Cartesian(*twist),
            elbow: self.elbow,
            finished: false,
        };
        self.robot.step(&[command]);
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use scene::{Pose, Scene, parse_starts};

    use crate::pose::seen_after;
    use crate::robot::arm::{Arm, ArmSettings};

    const MS: u64 = 1_000_000;

    fn scene() -> Scene {
        Scene::parse(scene::PAPER_ROBOT, "robot").unwrap()
    }

    fn arm(start: &Pose, is_shaped: bool) -> Arm {
        let settings = ArmSettings {
            is_shaped,
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
                arm.obey(&twist, 0.0, (ms + 100) * MS);
            }
            arm.step(ms * MS);
        }
    }

    #[test]
    fn at_the_end_of_its_reach_the_arm_slows_down() {
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
                    arm.obey(&twist, 0.0, (ms + 100) * MS);
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
            let mut shaped = arm(start, true);
            tear(&mut shaped, &mut random, 20);
            let report = shaped.inspector().report();
            assert!(report.is_clean(), "{report:?}");
            assert!(report.joint_acceleration > 0.05 && report.joint_acceleration < 0.9);
            let mut raw = arm(start, false);
            tear(&mut raw, &mut random, 1);
            assert!(raw.inspector().report().reflexes > 0);
        }
    }

    #[test]
    fn a_stale_command_ramps_to_zero_in_60_ms_and_the_robot_stands() {
        let mut arm = arm(&scene().goal, true);
        let limits = scene().limits;
        let fast = [limits.linear; 3].into_iter().chain([limits.angular; 3]);
        let twist: Vec<f64> = fast.collect();
        arm.obey(&twist.try_into().unwrap(), 0.0, 100 * MS);
        for ms in 0..100 {
            arm.step(ms * MS);
        }
        assert!(!arm.is_at_rest() && arm.bridge.is_stale(100 * MS));
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
        let mut arm = arm(&starts[40], true);
        for ms in 0..18_000 {
            let roll = [0.0, 0.0, 0.0, 0.0, 0.0, -0.03];
            arm.obey(&roll, 0.0, (ms + 100) * MS);
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
    fn the_camera_moves_as_told_only_if_calibrated() {
        let twist = [0.004, -0.006, 0.002, 0.01, 0.02, -0.01];
        let apart = |settings: ArmSettings| {
            let mut arm = Arm::new(&scene(), &scene().goal, &settings).unwrap();
            arm.obey(&twist, 0.0, u64::MAX);
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
    fn what_is_beyond_the_limits_is_cut_along_its_way_and_said_so() {
        let mut arm = arm(&scene().goal, true);
        assert!(arm.obey(&[1.0, 0.5, 0.0, 0.0, 0.0, 0.0], 0.0, 10));
        assert_eq!(arm.bridge.aimed(9), [0.01, 0.005, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(arm.bridge.aimed(10), [0.0; 6]);
        assert!(arm.obey(&[f64::NAN, 0.01, 0.0, 0.0, 0.0, 0.0], 0.0, 10));
        assert_eq!(arm.bridge.aimed(9), [0.0; 6]);
        assert!(!arm.obey(&[0.01, 0.0, 0.0, 0.0, 0.0, -0.03], 0.0, 10));
    }
}
