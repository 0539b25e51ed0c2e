//! Stands in for your robot and your camera: an emulated Panda, and true projections by its pose.

use arm::{Chain, Driver, Echo, Measured, Model, Mount, Reserve, Room, ShaperSettings, Twist};
use hw_sim::camera::project;
use hw_sim::pose::from_scene;
use hw_sim::robot::arm::base_from_object;
use hw_sim::robot::calibration::HandEye;
use ipc::{Domain, Publisher, now_ns};
use messages::Features;
use panda::{Command, JOINTS, Mode, Motion, MotionKind, RobotSettings, place};
use scene::Scene;

use crate::Failure;

/// The camera on the flange.
pub fn mount() -> Mount {
    Mount {
        flange_from_camera: HandEye::default().flange_from_camera(),
    }
}

pub struct Robot(panda::Robot);

impl Robot {
    /// A robot with its camera 2 cm beside the goal.
    pub fn new(scene: &Scene, mount: &Mount) -> Result<Self, Failure> {
        let mut object = from_scene(&scene.goal);
        object.translation.x += 0.02;
        let camera = base_from_object() * object.inverse();
        let settings = RobotSettings::with_hand();
        let hand = settings.flange_from_ee();
        let limits = settings.model.limits();
        let q = place(
            &panda::Chain::new(hand),
            limits,
            &(mount.flange(&camera) * hand),
        )?;
        let mut robot = panda::Robot::new(settings, q)?;
        robot.start(MotionKind::Cartesian)?;
        Ok(Self(robot))
    }

    /// The robot stopped itself, or somebody stopped it.
    pub fn is_at_fault(&self) -> bool {
        self.0.state().robot_mode != Mode::Move
    }

    pub fn mode(&self) -> &str {
        self.0.state().robot_mode.name()
    }

    /// Positions and velocities.
    pub fn joints(&self) -> ([f64; JOINTS], [f64; JOINTS]) {
        let state = self.0.state();
        (state.q.into(), state.dq.into())
    }
}

/// Write this for your robot.
impl Driver for Robot {
    fn measured(&self) -> Measured {
        let state = self.0.state();
        Measured {
            base_from_ee: state.o_t_ee,
            flange_from_ee: state.f_t_ee,
            echo: Echo {
                twist: state.o_dp_ee_c,
                acceleration: state.o_ddp_ee_c,
            },
        }
    }

    /// A Panda or FR3; leave it out for a robot that keeps within its joints' limits by itself.
    fn room(&self, twist: &Twist) -> Room {
        let state = self.0.state();
        let reserve = Reserve {
            margin: 0.15,
            speed: 0.3,
        };
        let (chain, limits) = (Chain::FRANKA.with_ee(state.f_t_ee), Model::Panda.limits());
        let shaper = ShaperSettings::default();
        reserve.room(&chain, limits, &shaper, &state.q_d, twist)
    }

    /// With libfranka give `robot.control` the arguments `limit_rate = false` and
    /// `cutoff_frequency = franka::kMaxCutoffFrequency`: behind its low-pass of 100 Hz, which is on
    /// by default, the bridge takes 1.5 s to stop.
    fn command(&mut self, twist: &Twist) {
        let (id, motion) = (self.0.state().id, Motion::Cartesian(*twist));
        let finished = false;
        self.0.step(&[Command {
            id,
            motion,
            elbow: None,
            finished,
        }]);
    }
}

pub struct Camera {
    features: Publisher<Features>,
    scene: Scene,
    goal: Vec<[f64; 2]>,
}

impl Camera {
    pub fn new(domain: &Domain, scene: &Scene) -> Result<Self, Failure> {
        Ok(Self {
            features: domain.publisher()?,
            scene: scene.clone(),
            goal: project(scene, &from_scene(&scene.goal))?.to_vec(),
        })
    }

    /// Publishes a frame that is exposed now; returns the largest component of s - s*, px.
    pub fn expose(&mut self, robot: &Robot, mount: &Mount) -> Result<f64, Failure> {
        let camera = mount.camera(&robot.0.state().flange());
        let object = camera.inverse() * base_from_object();
        let points = project(&self.scene, &object)?;
        self.features.publish(&Features::new(&points, now_ns()))?;
        let pairs = points.iter().flatten().zip(self.goal.iter().flatten());
        Ok(pairs.map(|(s, goal)| (s - goal).abs()).fold(0.0, f64::max))
    }
}
