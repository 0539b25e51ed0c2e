//! A robot of your own in the place of hw-sim's: the smallest bridge between `vpcd` and a robot
//! with a Cartesian velocity interface at 1 kHz. Copy it, keep [`Bridge`], and put your robot's
//! driver where [`Emulated`] is.
//!
//! ```sh
//! vpcd --scene ipc/scene/scenes/paper-robot.toml --domain /tmp/mine --arm &
//! cargo run --release -p hw-sim --example own_robot -- /tmp/mine 30
//! ```
//! Ends when the features are at the goal (exit code 0), or after so many seconds (1). So that it
//! runs alone it plays the camera, too, by the emulated robot's pose: with a camera of your own
//! leave [`Camera`] out.

use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use hw_sim::camera::project;
use hw_sim::pose::from_scene;
use hw_sim::robot::arm::base_from_object;
use hw_sim::robot::calibration::HandEye;
use ipc::{
    Domain, Features, Publisher, RobotFaults, RobotMode, RobotState, Subscriber, TwistCommand,
    now_ns,
};
use nalgebra::Rotation3;
use panda::{
    Chain, Command, Echo, JOINTS, Mode, Motion, MotionKind, Mount, RobotSettings, Shaper,
    ShaperSettings, Twist, place,
};
use scene::Scene;

type Failure = Box<dyn std::error::Error>;

/// What the bridge needs of the robot in every millisecond.
struct Measured {
    /// From the flange frame to the base frame: the rotation in libfranka's O_T_EE, with the flange
    /// as end effector.
    base_from_flange: Rotation3<f64>,
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
    /// Velocity of the flange's origin along base axes, m/s and rad/s; called once in each of the
    /// robot's milliseconds.
    fn command(&mut self, twist: &Twist);
}

/// From `vpc/twist` to the driver, and from the driver to `vpc/robot`.
struct Bridge {
    twists: Subscriber<TwistCommand>,
    states: Publisher<RobotState>,
    mount: Mount,
    shaper: Shaper,
    /// The newest command: camera velocity along camera axes.
    command: TwistCommand,
}

impl Bridge {
    fn new(domain: &Domain, mount: Mount) -> Result<Self, Failure> {
        Ok(Self {
            twists: domain.subscriber(4)?,
            states: domain.publisher()?,
            mount,
            shaper: Shaper::new(ShaperSettings::default())?,
            // A zero twist that is no longer valid: stand still.
            command: TwistCommand::zero(ipc::TwistState::Stopped),
        })
    }

    /// One of the robot's milliseconds.
    fn step(&mut self, robot: &mut impl Driver) -> Result<(), Failure> {
        if let Some(newest) = self.twists.latest()? {
            self.command = newest.message;
        }
        let measured = robot.measured();
        // Transported with the lever arm anew each time: the base axes turn under the camera.
        let camera = Twist::from_column_slice(&self.command.twist);
        let base = self.mount.to_base(&measured.base_from_flange, &camera);
        // From `valid_until_ns` on the shaper goes to zero by itself: a controller that fell silent
        // moves nothing.
        self.shaper.aim(&base, self.command.valid_until_ns);
        let now = now_ns();
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
        ] {
            state.faults |= if raised { fault.0 } else { 0 };
        }
        state.twist = self.command.twist;
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
            base_from_flange: state.o_t_ee.rotation,
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
        let camera = mount.camera(&robot.0.state().o_t_ee);
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
    let directory = arguments.next().ok_or("usage: own_robot DOMAIN SECONDS")?;
    let seconds: f64 = arguments.next().unwrap_or("30".into()).parse()?;
    let scene = Scene::parse(scene::PAPER_ROBOT, "paper-robot.toml")?;
    let mount = HandEye::default().mount();

    // The robot, 2 cm beside the goal.
    let mut object = from_scene(&scene.goal);
    let goal = project(&scene, &object)?.to_vec();
    object.translation.x += 0.02;
    let camera = base_from_object() * object.inverse();
    let settings = RobotSettings {
        // The flange is the end effector.
        flange_from_ee: panda::Pose::identity(),
        ..RobotSettings::default()
    };
    let joints = place(&Chain::new(settings.flange_from_ee), &mount.flange(&camera))?;
    let mut robot = Emulated(panda::Robot::new(settings, joints)?);
    robot.0.start(MotionKind::Cartesian)?;

    let domain = Domain::join(Path::new(&directory))?;
    let mut bridge = Bridge::new(&domain, mount)?;
    let mut camera = Camera {
        features: domain.publisher()?,
        goal,
        scene,
    };
    let begin = now_ns();
    let (mut first, mut error) = (None, f64::INFINITY);
    let mut millisecond = 0;
    while millisecond as f64 <= 1e3 * seconds && error > camera.scene.success.convergence_px {
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
    Ok(error <= camera.scene.success.convergence_px && state.robot_mode == Mode::Move)
}
