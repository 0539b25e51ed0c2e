//! A robot of your own in the place of hw-sim's: the smallest bridge between `vpcd` and a robot
//! with a Cartesian velocity interface at 1 kHz. Copy it, keep [`Bridge`], and put your robot's
//! driver where [`Emulated`] is.
//!
//! ```sh
//! vpcd --scene ipc/scene/scenes/paper-robot.toml --domain /tmp/mine --arm &
//! cargo run --release -p hw-sim --example own_robot -- /tmp/mine 30
//! ```
//! Ends when the features are at the goal (exit code 0), after so many seconds (1), or on SIGINT or
//! SIGTERM (1), each time with a robot that stands. A third argument names a TOML file with your
//! hand-eye calibration: `translation` (m) and `rotation_deg` of the camera in the flange frame. So
//! that it runs alone it plays the camera, too, by the emulated robot's pose: with a camera of your
//! own leave [`Camera`] out.

use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use hw_sim::camera::project;
use hw_sim::pose::from_scene;
use hw_sim::robot::arm::base_from_object;
use hw_sim::robot::calibration::HandEye;
use ipc::{Domain, Publisher, Subscriber, now_ns};
use messages::{Features, RobotFaults, RobotMode, RobotState, TwistCommand};
use nalgebra::Rotation3;
use panda::{
    Chain, Command, Echo, JOINTS, Mode, Model, Motion, MotionKind, Mount, Pose, RobotSettings,
    Shaper, ShaperSettings, Twist, place,
};
use scene::Scene;
use signal_hook::consts::{SIGINT, SIGTERM};

type Failure = Box<dyn std::error::Error>;

/// A robot slower than this stands, m/s and rad/s.
const AT_REST: f64 = 1e-4;

/// What the bridge needs of the robot in every millisecond.
struct Measured {
    /// The rotation in libfranka's O_T_EE.
    base_from_ee: Rotation3<f64>,
    /// libfranka's F_T_EE: the end effector is not the flange, with the hand not even by its axes.
    flange_from_ee: Pose,
    /// What the robot was last commanded: libfranka's O_dP_EE_c and O_ddP_EE_c.
    echo: Echo,
    q: [f64; JOINTS],
    dq: [f64; JOINTS],
    /// The robot stopped itself (libfranka: RobotMode::kReflex), or somebody stopped it.
    is_at_fault: bool,
}

/// A driver: implement it for your robot.
trait Driver {
    fn measured(&self) -> Measured;
    /// Velocity of the end effector's origin along base axes, m/s and rad/s; called once in each of
    /// the robot's milliseconds. With libfranka give `robot.control` the arguments `limit_rate =
    /// false` and `cutoff_frequency = franka::kMaxCutoffFrequency`: behind its low-pass of 100 Hz,
    /// which is on by default, the shaper takes 1.5 s to stop.
    fn command(&mut self, twist: &Twist);
}

/// From `vpc/twist` to the driver, and from the driver to `vpc/robot`.
struct Bridge {
    twists: Subscriber<TwistCommand>,
    states: Publisher<RobotState>,
    mount: Mount,
    shaper: Shaper,
    /// Largest magnitude of each component, m/s and rad/s.
    limits: [f64; 6],
    /// The newest command: camera velocity along camera axes.
    command: TwistCommand,
}

impl Bridge {
    fn new(domain: &Domain, mount: Mount, scene: &Scene) -> Result<Self, Failure> {
        Ok(Self {
            twists: domain.subscriber(4)?,
            states: domain.publisher()?,
            mount,
            shaper: Shaper::new(ShaperSettings::default())?,
            limits: scene.limits.velocity(),
            // A zero twist that is no longer valid: stand still.
            command: TwistCommand::zero(messages::TwistState::Stopped),
        })
    }

    /// One of the robot's milliseconds.
    fn step(&mut self, robot: &mut impl Driver) -> Result<(), Failure> {
        if let Some(newest) = self.twists.latest()? {
            self.command = newest.message;
        }
        let (measured, now) = (robot.measured(), now_ns());
        // The dead man: a controller that fell silent, hangs, or is in lockstep moves nothing.
        let wanted = self.command.in_force(now);
        let cut: [f64; 6] =
            std::array::from_fn(|k| wanted[k].clamp(-self.limits[k], self.limits[k]));
        // Transported with the lever arm anew each time: the base axes turn under the camera.
        let (base_from_ee, flange_from_ee) = (&measured.base_from_ee, &measured.flange_from_ee);
        let camera = Twist::from_column_slice(&cut);
        let base = self.mount.to_base(base_from_ee, flange_from_ee, &camera);
        // From then on the shaper goes to zero by itself.
        self.shaper.aim(&base, self.command.in_force_until_ns());
        robot.command(&self.shaper.step(&measured.echo, now));

        // For observers, and for vpcd, which a robot at fault disarms.
        let mut state = RobotState::free_camera([0.0; 3], [0.0; 3], now);
        let is_stale = self.shaper.is_stale(now);
        let mode = match (measured.is_at_fault, is_stale) {
            (true, _) => RobotMode::Fault,
            (false, true) => RobotMode::Stale,
            (false, false) => RobotMode::Moving,
        };
        state.mode = mode.code();
        for (fault, raised) in [
            (RobotFaults::REFLEX, measured.is_at_fault),
            (RobotFaults::STALE_COMMAND, is_stale),
            (RobotFaults::COMMAND_LIMITED, cut != wanted),
        ] {
            state.faults |= if raised { fault.0 } else { 0 };
        }
        // What is carried out, not what was asked for.
        let carried_out = &measured.echo.twist;
        let camera = self
            .mount
            .to_camera(base_from_ee, flange_from_ee, carried_out);
        state.twist = camera.into();
        state.joints = JOINTS as u32;
        (state.q, state.dq) = (measured.q, measured.dq);
        self.states.publish(&state)?;
        Ok(())
    }
}

/// Stands in for your driver.
struct Emulated(panda::Robot);

impl Driver for Emulated {
    fn measured(&self) -> Measured {
        let state = self.0.state();
        Measured {
            base_from_ee: state.o_t_ee.rotation,
            flange_from_ee: state.f_t_ee,
            echo: Echo::from(state),
            q: state.q.into(),
            dq: state.dq.into(),
            is_at_fault: state.robot_mode == Mode::Reflex,
        }
    }

    fn command(&mut self, twist: &Twist) {
        let (id, motion) = (self.0.state().id, Motion::Cartesian(*twist));
        let finished = false;
        self.0.step(&[Command {
            id,
            motion,
            finished,
        }]);
    }
}

/// Stands in for your camera: true projections by the emulated robot's pose.
struct Camera {
    features: Publisher<Features>,
    scene: Scene,
    goal: Vec<[f64; 2]>,
}

impl Camera {
    /// Publishes a frame that is exposed now; returns the largest component of s - s*, px.
    fn expose(&mut self, robot: &Emulated, mount: &Mount) -> Result<f64, Failure> {
        let camera = mount.camera(&robot.0.state().flange());
        let object = camera.inverse() * base_from_object();
        let points = project(&self.scene, &object)?;
        self.features.publish(&Features::new(&points, now_ns()))?;
        let pairs = points.iter().flatten().zip(self.goal.iter().flatten());
        Ok(pairs.map(|(s, goal)| (s - goal).abs()).fold(0.0, f64::max))
    }
}

fn main() -> ExitCode {
    match run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("own_robot: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<bool, Failure> {
    let mut arguments = std::env::args().skip(1);
    let usage = "usage: own_robot DOMAIN [SECONDS [HAND_EYE.toml]]";
    let directory = arguments.next().ok_or(usage)?;
    let seconds: f64 = arguments.next().unwrap_or("30".into()).parse()?;
    let hand_eye: HandEye = match arguments.next() {
        Some(file) => toml::from_str(&std::fs::read_to_string(file)?)?,
        None => HandEye::default(),
    };
    let end = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&end))?;
    }
    let scene = Scene::parse(scene::PAPER_ROBOT, "paper-robot.toml")?;
    let mount = hand_eye.mount();

    // The robot, 2 cm beside the goal.
    let mut object = from_scene(&scene.goal);
    let goal = project(&scene, &object)?.to_vec();
    object.translation.x += 0.02;
    let camera = base_from_object() * object.inverse();
    let settings = RobotSettings::with_hand();
    let hand = settings.flange_from_ee();
    let joints = place(
        &Chain::new(hand),
        Model::Panda.limits(),
        &(mount.flange(&camera) * hand),
    )?;
    let mut robot = Emulated(panda::Robot::new(settings, joints)?);
    robot.0.start(MotionKind::Cartesian)?;

    let domain = Domain::join(Path::new(&directory))?;
    let mut bridge = Bridge::new(&domain, mount, &scene)?;
    let mut camera = Camera {
        features: domain.publisher()?,
        goal,
        scene,
    };
    let begin = now_ns();
    let (mut first, mut error) = (None, f64::INFINITY);
    let (mut has_arrived, mut is_over) = (false, false);
    let mut millisecond = 0;
    loop {
        has_arrived |= error <= camera.scene.success.convergence_px;
        let is_late = millisecond as f64 > 1e3 * seconds;
        is_over |= has_arrived || is_late || end.load(Ordering::Relaxed);
        // However it ends, the robot comes to rest first.
        if is_over {
            bridge.limits = [0.0; 6];
            if robot.measured().echo.twist.amax() < AT_REST {
                break;
            }
        }
        // With libfranka this is `robot.control(...)`, which calls at its own pace.
        let due = begin + millisecond * 1_000_000;
        std::thread::sleep(Duration::from_nanos(due.saturating_sub(now_ns())));
        if millisecond.is_multiple_of(33) {
            error = camera.expose(&robot, &mount)?;
            first.get_or_insert(error);
        }
        bridge.step(&mut robot)?;
        millisecond += 1;
    }
    let state = robot.0.state();
    println!(
        "{{\"first_px\":{:.2},\"error_px\":{error:.2},\"seconds\":{:.2},\"mode\":\"{}\"}}",
        first.unwrap_or(f64::NAN),
        1e-3 * millisecond as f64,
        state.robot_mode.name()
    );
    Ok(has_arrived && state.robot_mode == Mode::Move)
}
