//! Configuration of the bridge: a file, then flags, then checks.

use std::path::{Path, PathBuf};

use arm::{Arm, Caps, Chain, JOINTS, Joints, Model, Mount, Pose, Reserve};
use clap::{ArgMatches, Args, Parser, ValueEnum};
use scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use toml_schema::{Document, FileError};

use hand_eye::{Frame, HandEye};

/// How far apart two accounts of the camera may have it, m and rad.
const APART: f64 = 1e-3;

/// Drives a Franka Panda or FR3 by what vpcd commands.
///
/// Connects to the robot's interface, carries out vpc/twist within its own limits, and tells
/// vpc/robot. The arm stands when no command is in force. Exit codes: 0 stopped by SIGTERM with a
/// robot that is idle, or all is well; 1 the robot was not idle then, a check failed, or a mistake
/// was found; 64 usage, 66 a file is missing, 69 the robot or the shared memory cannot be used, 70
/// a defect, 78 configuration.
#[derive(Parser, Debug)]
#[command(name = "vpc-panda", version)]
pub struct Arguments {
    /// Configuration file (TOML), documented in ipc/clients/panda/vpc-panda.toml; flags win over it.
    #[arg(long)]
    pub config: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub keys: Keys,
    /// Connect, read, and print frames and what would be sent, for three seconds; move nothing.
    #[arg(long, conflicts_with = "preflight")]
    pub dry_run: bool,
    /// Check machine, network and robot; hold the arm where it is for two seconds.
    #[arg(long)]
    pub preflight: bool,
    /// Move each axis of the camera by 5 mm or 0.02 rad and back, compare the image with the scene,
    /// and name likely mistakes; asks before anything moves.
    #[arg(long, conflicts_with_all = ["dry_run", "preflight"])]
    pub first_motion: bool,
    /// With --first-motion: do not ask.
    #[arg(long, requires = "first_motion")]
    pub yes: bool,
}

/// Paths are relative to the file. Some keys have a flag, which wins.
#[derive(Args, Clone, Debug, SmartDefault, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "vpc-panda", extend("required" = ["robot", "scene"]))]
pub struct Keys {
    /// Which robot, and the address of its control unit.
    #[arg(long)]
    #[schemars(extend("x-allowed" = "panda:ADDRESS or fr3:ADDRESS, such as panda:172.16.0.2"))]
    pub robot: Option<String>,
    /// The scene of vpcd; its limits hold here, too.
    #[arg(long)]
    #[schemars(extend("x-allowed" = "a file; also by --scene"))]
    pub scene: Option<PathBuf>,
    /// The hand-eye calibration: the camera on the flange. Not needed where the scene names an arm,
    /// whose file has the camera.
    #[arg(long)]
    #[schemars(extend("x-allowed" = "a file: TOML, or YAML of easy_handeye or OpenCV"))]
    pub hand_eye: Option<PathBuf>,
    /// The frame of the hand-eye calibration.
    #[arg(long, value_enum, default_value_t)]
    pub hand_eye_frame: Frame,
    /// What the robot is commanded.
    #[arg(long, value_enum, default_value_t)]
    pub interface: Interface,
    /// Directory of the domain.
    #[arg(long)]
    #[schemars(extend("x-default" = "/tmp/vpc-UID"))]
    pub domain: Option<PathBuf>,
    /// SCHED_FIFO priority of the loop, above vpcd's.
    #[arg(skip = 85)]
    #[default = 85]
    #[schemars(range(min = 1, max = 99))]
    pub priority: i32,
    /// Greatest speed of the camera.
    #[arg(skip = 0.05)]
    #[default = 0.05]
    #[schemars(range(min = 0.001, max = 0.5), extend("x-unit" = "m/s"))]
    pub linear: f64,
    /// Greatest angular speed of the camera.
    #[arg(skip = 0.25)]
    #[default = 0.25]
    #[schemars(range(min = 0.001, max = 1), extend("x-unit" = "rad/s"))]
    pub angular: f64,
    /// Distance of joints from the ends of their ranges; nearer, they creep.
    #[arg(skip = 0.1)]
    #[default = 0.1]
    #[schemars(range(min = 0.01, max = 1), extend("x-unit" = "rad"))]
    pub joint_margin: f64,
    /// Greatest share of the joints' speed limits.
    #[arg(skip = 0.3)]
    #[default = 0.3]
    #[schemars(range(min = 0.01, max = 0.9))]
    pub joint_speed: f64,
    #[arg(skip)]
    #[allow(missing_docs)]
    pub workspace: Workspace,
}

/// Where the end effector's origin may be, in the robot's base frame.
#[derive(Clone, Copy, Debug, PartialEq, SmartDefault, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Workspace {
    /// Least x, y, z.
    #[default(_code = "[0.2, -0.5, 0.05]")]
    #[schemars(inner(range(min = -1.5, max = 1.5)), extend("x-unit" = "m"))]
    pub lower: [f64; 3],
    /// Greatest x, y, z.
    #[default(_code = "[0.8, 0.5, 0.9]")]
    #[schemars(inner(range(min = -1.5, max = 1.5)), extend("x-unit" = "m"))]
    pub upper: [f64; 3],
}

/// What the robot is commanded.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Deserialize, Serialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Interface {
    /// Joint velocities, by the bridge's inverse kinematics.
    #[default]
    Joint,
    /// The end effector's velocity, by the robot's inverse kinematics.
    Cartesian,
}

/// The bridge's own limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Of the camera's motion: the bridge's own and the scene's.
    pub caps: Caps,
    /// Of the joints.
    pub reserve: Reserve,
    /// Of the place of the end effector's origin.
    pub workspace: Workspace,
}

/// A checked configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// Which robot.
    pub model: Model,
    /// The address of its control unit.
    pub robot: String,
    /// The scene of vpcd.
    pub scene: Scene,
    /// The camera on the flange, or on the end effector; where the scene's arm file has it, if it
    /// names one.
    pub hand_eye: HandEye,
    /// What the robot is commanded.
    pub interface: Interface,
    /// Directory of the domain.
    pub domain: PathBuf,
    /// SCHED_FIFO priority of the loop.
    pub priority: i32,
    /// The bridge's own limits.
    pub bounds: Bounds,
}

impl Config {
    /// Reads the file that the command line names, lays the flags over it, and checks the whole.
    ///
    /// # Errors
    /// [`FileError`] names the file or flag, key, value and what is allowed.
    pub fn load(matches: &ArgMatches) -> Result<Self, FileError> {
        let arguments: Arguments = toml_schema::arguments(matches)?;
        let (file, paths) = (arguments.config.as_deref(), ["scene", "hand_eye"]);
        let document = Document::with_flags::<Arguments>(file, &paths, &arguments.keys, matches)?;
        let keys: Keys = document.check()?;
        document.readable(&paths)?;
        Self::of(&document, keys)
    }

    fn of(document: &Document, keys: Keys) -> Result<Self, FileError> {
        let Workspace { lower, upper } = keys.workspace;
        for k in 0..3 {
            if lower[k] >= upper[k] {
                let key = format!("workspace.lower[{k}]");
                let allowed = format!("below workspace.upper[{k}] = {}", upper[k]);
                return Err(document.refuse(&key, lower[k], allowed));
            }
        }
        let robot = keys.robot.unwrap_or_default();
        let named = robot.split_once(':').filter(|(_, at)| !at.is_empty());
        let named = named.and_then(|(model, at)| Some((model.parse::<Model>().ok()?, at)));
        let Some((model, address)) = named else {
            let allowed = "panda:ADDRESS or fr3:ADDRESS".to_owned();
            return Err(document.refuse("robot", &robot, allowed));
        };
        let scene = Scene::read(&keys.scene.unwrap_or_default())?;
        let file = keys
            .hand_eye
            .as_deref()
            .map(|file| (file, keys.hand_eye_frame));
        let hand_eye = match (&scene.arm, file) {
            (Some(arm), file) => {
                let camera = mounted(document, arm, (keys.joint_margin, keys.joint_speed))?;
                if arm.is_elbow_free && keys.interface == Interface::Cartesian {
                    let allowed = "joint: the elbow of the scene's arm is free";
                    return Err(document.refuse("interface", "cartesian", allowed));
                }
                file.map_or(Ok(()), |file| agrees(document, &camera, file))?;
                HandEye {
                    frame: Frame::Flange,
                    camera,
                }
            }
            (None, Some((file, frame))) => hand_eye::read(file, frame)?,
            (None, None) => {
                let allowed = "a file, or a scene that names an arm";
                return Err(document.missing("hand_eye", allowed));
            }
        };
        Ok(Self {
            model,
            robot: address.to_owned(),
            hand_eye,
            interface: keys.interface,
            domain: keys.domain.unwrap_or_else(ipc::default_directory),
            priority: keys.priority,
            bounds: Bounds {
                caps: Caps {
                    linear: keys.linear,
                    angular: keys.angular,
                    axes: scene.limits.velocity(),
                },
                reserve: Reserve {
                    margin: keys.joint_margin,
                    speed: keys.joint_speed,
                },
                workspace: keys.workspace,
            },
            scene,
        })
    }

    /// The camera on a flange whose end effector is there.
    pub fn mount(&self, flange_from_ee: &Pose) -> Mount {
        self.hand_eye.mount(flange_from_ee)
    }
}

/// The camera on the flange where the arm file of a scene has it.
///
/// # Errors
/// The arm is not a Panda or FR3, or the joints' limits contradict it: with them the bridge would
/// stop what the law commands.
fn mounted(
    document: &Document,
    arm: &scene::Arm,
    (margin, speed): (f64, f64),
) -> Result<Pose, FileError> {
    if margin > arm.margin {
        let allowed = format!("at most {}, the margin of the scene's arm", arm.margin);
        return Err(document.refuse("joint_margin", margin, allowed));
    }
    if speed < arm.speed {
        let allowed = format!("at least {}, the speed of the scene's arm", arm.speed);
        return Err(document.refuse("joint_speed", speed, allowed));
    }
    let (robot, theirs) = (Chain::FRANKA, Arm::from(arm).chain);
    let camera = robot.pose(&Joints::zeros()).inverse() * theirs.pose(&Joints::zeros());
    let with_camera = robot.with_ee(camera);
    for joint in 0..JOINTS {
        let mut q = Joints::zeros();
        q[joint] = 1.0;
        let [m, rad] = apart(&with_camera.pose(&q), &theirs.pose(&q));
        if m > APART || rad > APART {
            let found = format!("an arm whose joint {} is another's", joint + 1);
            let allowed = "a scene whose arm file is of a Panda or FR3, its base panda_link0";
            return Err(document.refuse("scene", found, allowed));
        }
    }
    Ok(camera)
}

/// Refuses a hand-eye file that has the camera elsewhere than on the flange at this pose.
fn agrees(
    document: &Document,
    camera: &Pose,
    (file, frame): (&Path, Frame),
) -> Result<(), FileError> {
    if frame == Frame::Ee {
        let allowed = "flange, where the scene names an arm; or leave out hand_eye";
        return Err(document.refuse("hand_eye_frame", "ee", allowed));
    }
    let [m, rad] = apart(&hand_eye::read(file, frame)?.camera, camera);
    if m > APART || rad > APART {
        let (path, mm) = (file.display(), 1e3 * m);
        let found = format!("{path}, {mm:.1} mm and {rad:.3} rad from there");
        let allowed = "the camera where the scene's arm file has it, to 1 mm and 1 mrad";
        return Err(document.refuse("hand_eye", found, allowed));
    }
    Ok(())
}

/// How far apart two poses are, m and rad.
fn apart(a: &Pose, b: &Pose) -> [f64; 2] {
    let shift = a.translation.vector - b.translation.vector;
    [shift.norm(), a.rotation.angle_to(&b.rotation)]
}

/// Returns the JSON Schema of a configuration file.
pub fn schema() -> serde_json::Value {
    toml_schema::schema::<Keys>()
}
