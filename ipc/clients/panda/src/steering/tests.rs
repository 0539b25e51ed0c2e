use nalgebra::{Rotation3, Translation3};
use panda::{Command, Mode, Motion, MotionKind, READY, Robot, RobotSettings, State};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use arm::{Caps, Pose, Reserve};

use super::*;
use crate::config::Workspace;

const NS: u64 = 1_000_000;
/// In the middle of the emulated robot's reach.
const BOUNDS: Bounds = Bounds {
    caps: Caps {
        linear: 0.1,
        angular: 0.5,
        axes: [1.0; 6],
    },
    reserve: Reserve {
        margin: 0.1,
        speed: 0.3,
    },
    workspace: Workspace {
        lower: [0.25, -0.25, 0.15],
        upper: [0.6, 0.25, 0.7],
    },
};

const WELL_INSIDE: Bounds = Bounds {
    caps: Caps {
        linear: 0.05,
        angular: 0.25,
        axes: [1.0; 6],
    },
    workspace: Workspace {
        lower: [0.25, -0.2, 0.2],
        upper: [0.5, 0.2, 0.55],
    },
    ..BOUNDS
};

fn mount() -> Mount {
    let turn = Rotation3::new(Vector3::z() * std::f64::consts::FRAC_PI_4);
    Mount {
        flange_from_camera: Pose::from_parts(Translation3::new(0.05, -0.05, 0.04), turn),
    }
}

fn measured(state: &State) -> Measured {
    Measured {
        end_effector: arm::Measured {
            base_from_ee: state.o_t_ee,
            flange_from_ee: state.f_t_ee,
            echo: Echo {
                twist: state.o_dp_ee_c,
                acceleration: state.o_ddp_ee_c,
            },
        },
        desired: Setpoint {
            q: state.q_d,
            dq: state.dq_d,
            ddq: state.ddq_d,
        },
    }
}

fn emulated(model: Model) -> panda::Model {
    match model {
        Model::Panda => panda::Model::Panda,
        Model::Fr3 => panda::Model::Fr3,
    }
}

/// The bridge and the emulated robot.
struct Bench {
    robot: Robot,
    steering: Steering,
    command: TwistCommand,
    ms: u64,
}

impl Bench {
    fn new(interface: Interface, model: Model, bounds: Bounds) -> Self {
        let settings = RobotSettings {
            model: emulated(model),
            ..RobotSettings::with_hand()
        };
        let mut robot = Robot::new(settings, Joints::from(READY)).unwrap();
        robot
            .start(match interface {
                Interface::Joint => MotionKind::Joint,
                Interface::Cartesian => MotionKind::Cartesian,
            })
            .unwrap();
        let state = measured(robot.state());
        Self {
            steering: Steering::new(mount(), bounds, interface, model, &state).unwrap(),
            robot,
            command: TwistCommand::default(),
            ms: 0,
        }
    }

    fn aim(&mut self, twist: [f64; 6]) {
        self.command.twist = twist;
        self.command.stamp.published_ns = self.ms * NS;
        self.command.valid_until_ns = (self.ms + 100) * NS;
    }

    /// A millisecond; where it is `lost`, the robot hears nothing.
    fn step(&mut self, lost: bool) {
        let state = measured(self.robot.state());
        self.answer(&state, lost);
    }

    /// The same, where the robot says this of itself.
    fn answer(&mut self, state: &Measured, lost: bool) {
        let output = self.steering.step(&self.command, state, self.ms * NS);
        let command = Command {
            id: self.robot.state().id,
            motion: match output {
                Output::Joint(dq) => Motion::Joint(dq),
                Output::Cartesian(twist) => Motion::Cartesian(twist),
            },
            elbow: None,
            finished: false,
        };
        self.robot.step(if lost {
            &[]
        } else {
            std::slice::from_ref(&command)
        });
        self.ms += 1;
        let state = self.robot.state();
        assert_eq!(
            state.robot_mode,
            Mode::Move,
            "{:?}",
            state.last_motion_errors
        );
    }

    fn camera(&self) -> Twist {
        let state = self.robot.state();
        mount().to_camera(&state.o_t_ee.rotation, &state.f_t_ee, &state.o_dp_ee_d)
    }
}

const ALL: [(Interface, Model); 4] = [
    (Interface::Joint, Model::Panda),
    (Interface::Joint, Model::Fr3),
    (Interface::Cartesian, Model::Panda),
    (Interface::Cartesian, Model::Fr3),
];

#[test]
fn random_twists_cause_no_reflex_and_keep_the_bounds() {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    for (interface, model) in ALL {
        for _ in 0..4 {
            // The robot's own inverse kinematics has reflexes where the arm is stretched out.
            let bounds = match interface {
                Interface::Joint => BOUNDS,
                Interface::Cartesian => WELL_INSIDE,
            };
            let mut bench = Bench::new(interface, model, bounds);
            let mut least_room = f64::INFINITY;
            for frame in 0..30 * 60 {
                // One direction for seconds, so that walls and joints are met; some are nonsense.
                if frame % 60 == 0 || random.random::<f64>() < 0.05 {
                    let scale = [0.02, 0.2, 5.0][random.random_range(0..3)];
                    let twist = [(); 6].map(|()| scale * random.random_range(-1.0..1.0));
                    bench.aim(twist);
                }
                let twist = bench.command.twist;
                match random.random::<f64>() {
                    x if x < 0.05 => (),
                    x if x < 0.06 => bench.aim([f64::NAN; 6]),
                    _ => bench.aim(twist),
                }
                for _ in 0..33 {
                    bench.step(random.random::<f64>() < 0.02);
                    let state = bench.robot.state();
                    let at = &state.o_t_ee.translation.vector;
                    for k in 0..3 {
                        let (lower, upper) = (bounds.workspace.lower[k], bounds.workspace.upper[k]);
                        assert!(at[k] > lower - 3e-3 && at[k] < upper + 3e-3, "{at}");
                    }
                    for (k, bound) in emulated(model).limits().joints.iter().enumerate() {
                        let room = (state.q[k] - bound.lower).min(bound.upper - state.q[k]);
                        least_room = least_room.min(room);
                    }
                    let (linear, angular) = (
                        bench.camera().fixed_rows::<3>(0).norm(),
                        bench.camera().fixed_rows::<3>(3).norm(),
                    );
                    // Each axis has its ramp, so that a turn of the way is not the shortest.
                    assert!(
                        linear < 1.5 * bounds.caps.linear && angular < 1.5 * bounds.caps.angular
                    );
                }
                bench.command.twist = if twist[0].is_nan() { [0.0; 6] } else { twist };
            }
            assert!(
                least_room > 0.5 * BOUNDS.reserve.margin,
                "{interface:?} {model}: {least_room}"
            );
        }
    }
}

#[test]
fn the_camera_moves_as_commanded() {
    let twist = [0.02, -0.01, 0.015, 0.03, -0.02, 0.05];
    for (interface, model) in ALL {
        let mut bench = Bench::new(interface, model, BOUNDS);
        for _ in 0..1000 {
            bench.aim(twist);
            bench.step(false);
        }
        let apart = (bench.camera() - Twist::from(twist)).norm();
        assert!(apart < 1e-4, "{interface:?} {model}: {apart}");
        assert_eq!(bench.steering.limited(), Limited::default());
    }
}

#[test]
fn the_elbow_turns_as_commanded_while_the_camera_stands() {
    for model in [Model::Panda, Model::Fr3] {
        let mut bench = Bench::new(Interface::Joint, model, BOUNDS);
        let (camera, elbow) = (bench.robot.state().o_t_ee_d, bench.robot.state().q_d[2]);
        bench.command.elbow = 0.1;
        for _ in 0..2000 {
            bench.aim([0.0; 6]);
            bench.step(false);
        }
        let state = bench.robot.state();
        let turned = state.q_d[2] - elbow;
        assert!((0.17..0.2).contains(&turned), "{model}: {turned}");
        let apart = camera.translation.vector - state.o_t_ee_d.translation.vector;
        assert!(apart.norm() < 1e-4, "{model}: {apart}");
        // It stays there.
        bench.command.elbow = 0.0;
        for _ in 0..1000 {
            bench.aim([0.0, 0.01, 0.0, 0.0, 0.0, 0.0]);
            bench.step(false);
        }
        assert!((bench.robot.state().q_d[2] - elbow - turned).abs() < 0.02);
    }
}

#[test]
fn a_command_that_ends_stops_arm_and_elbow_within_the_ramp() {
    for (interface, model) in ALL {
        let mut bench = Bench::new(interface, model, BOUNDS);
        bench.command.elbow = 0.2;
        for _ in 0..500 {
            bench.aim([0.05, 0.05, 0.0, 0.1, 0.0, 0.2]);
            bench.step(false);
        }
        let end = bench.command.in_force_until_ns() / NS;
        while bench.ms < end + 350 {
            bench.step(false);
        }
        assert!(bench.steering.limited().is_stale);
        let state = measured(bench.robot.state());
        assert!(bench.steering.is_at_rest(&state), "{interface:?} {model}");
        let stand = bench.robot.state().q_d;
        (0..500).for_each(|_| bench.step(false));
        if interface == Interface::Joint {
            assert!((bench.robot.state().q_d - stand).amax() < 1e-5);
        }
    }
}

#[test]
fn a_late_echo_makes_no_ramp_longer() {
    let target = [0.0, 0.0, 0.05, 0.0, 0.0, 0.25];
    for (is_late, has_acceleration) in [(false, true), (false, false), (true, true), (true, false)]
    {
        let mut bench = Bench::new(Interface::Cartesian, Model::Fr3, BOUNDS);
        let mut last = measured(bench.robot.state()).end_effector.echo;
        // 0.25 rad/s at 1.2 rad/s^2, and the beginning and the end of that.
        for _ in 0..230 {
            bench.aim(target);
            let mut state = measured(bench.robot.state());
            let echo = state.end_effector.echo;
            state.end_effector.echo = if is_late { last } else { echo };
            if !has_acceleration {
                state.end_effector.echo.acceleration = Twist::zeros();
            }
            last = echo;
            bench.answer(&state, false);
        }
        let apart = (bench.camera() - Twist::from(target)).norm();
        assert!(apart < 1e-4, "{is_late} {has_acceleration}: {apart}");
    }
}

#[test]
fn at_a_wall_the_camera_slows_down_along_its_way() {
    for interface in [Interface::Joint, Interface::Cartesian] {
        let mut bench = Bench::new(interface, Model::Panda, BOUNDS);
        // The camera's z is the base's -z here: down to the wall, and to one side.
        let (mut way, mut last) = (
            Vector3::zeros(),
            bench.robot.state().o_t_ee.translation.vector,
        );
        for ms in 0..12_000 {
            bench.aim([0.02, 0.0, 0.04, 0.0, 0.0, 0.0]);
            bench.step(false);
            if ms == 2000 {
                way = (bench.robot.state().o_t_ee.translation.vector - last).normalize();
            }
            if ms == 1000 || ms == 2000 {
                last = bench.robot.state().o_t_ee.translation.vector;
            }
        }
        let at = bench.robot.state().o_t_ee.translation.vector;
        assert!((at[2] - BOUNDS.workspace.lower[2]).abs() < 3e-3, "{at}");
        assert!(bench.steering.limited().by_workspace);
        let straight = (at - last).normalize();
        assert!(straight.dot(&way) > 0.999, "{straight} {way}");
        assert!(bench.camera().norm() < 2e-3);
    }
}

#[test]
fn lockstep_and_the_future_move_nothing() {
    let mut bench = Bench::new(Interface::Joint, Model::Panda, BOUNDS);
    for (published, until) in [(0, u64::MAX), (10_000, 20_000)] {
        bench.command.twist = [0.1; 6];
        bench.command.stamp.published_ns = published * NS;
        bench.command.valid_until_ns = until.saturating_mul(NS);
        for _ in 0..300 {
            bench.step(false);
        }
        assert_eq!(bench.robot.state().dq_d, Joints::zeros());
    }
}

#[test]
fn a_start_outside_is_refused_by_name() {
    let robot = Robot::new(RobotSettings::with_hand(), Joints::from(READY)).unwrap();
    let mut at = measured(robot.state());
    let begin = |at: &Measured| {
        Steering::new(mount(), BOUNDS, Interface::Joint, Model::Panda, at)
            .map(|_| ())
            .unwrap_err()
            .to_string()
    };
    at.end_effector.base_from_ee.translation.x = 0.9;
    assert!(begin(&at).starts_with("the end effector is at x = 0.900 m; allowed: 0.25 to 0.6"));
    at = measured(robot.state());
    at.desired.q[3] = -0.1;
    assert!(begin(&at).starts_with("joint 4 = -0.100 rad"));
}
