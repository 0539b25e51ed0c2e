//! Configuration of the gateway: a file, then flags, then checks.

use std::net::IpAddr;
use std::path::PathBuf;

use clap::{ArgMatches, Parser};
use scene::Scene;
use toml_schema::{Document, FileError};

pub use crate::keys::{
    CameraKeys, CommandFrame, Executed, FeaturesKind, Keys, Mount, PolicyKeys, Reliability,
    RobotKeys, Services,
};

/// Most joints that vpc/robot has room for.
const MOST_JOINTS: usize = 7;
/// What is allowed as a name in the graph of ROS.
const NAME: &str = "an absolute name: parts of letters, digits and single _, each behind a /";

/// Connects ROS 2 with vpcd: tags, joints and velocities in, velocities and diagnostics out.
///
/// Plays camera, robot or policy for the vpcd of the domain; links no ROS. Exit codes: 0
/// stopped by SIGTERM, after zero twists; 1 the preflight found a fault; 64 usage, 66 a file is
/// missing, 69 DDS or the shared memory cannot be used, 70 a defect, 78 configuration.
#[derive(Parser, Debug)]
#[command(name = "vpc-ros2", version)]
pub struct Arguments {
    /// Configuration file (TOML), documented in ipc/clients/ros2/vpc-ros2.toml; flags win over it.
    #[arg(long)]
    pub config: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub keys: Keys,
    /// Listen for three seconds, and say what comes, from whom it does not, and what is refused;
    /// publish nothing.
    #[arg(long)]
    pub preflight: bool,
}

/// Which tags are features.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Targets {
    /// The centres of these, in the pattern's order.
    Centres(Vec<u32>),
    /// The corners of this one.
    Corners(u32),
}

/// A checked configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// The scene of vpcd.
    pub scene: Scene,
    /// Directory of the shared memory.
    pub domain: PathBuf,
    /// The number of the DDS domain.
    pub ros_domain_id: u16,
    /// Addresses of the network interfaces; none: all.
    pub interfaces: Vec<IpAddr>,
    /// Namespace and name of the node.
    pub node: [String; 2],
    /// How requests of services are numbered.
    pub services: Services,
    /// Oldest stamp that is taken, ns.
    pub max_age_ns: u64,
    /// The keys of the camera.
    pub camera: CameraKeys,
    /// Which tags are features.
    pub targets: Targets,
    /// Where the sender has the centre of the upper left pixel, px.
    pub pixel_centre: f64,
    /// Added to each of the camera's stamps, ns.
    pub stamp_offset_ns: i64,
    /// The keys of the robot.
    pub robot: RobotKeys,
    /// How long zeros follow, ns.
    pub zeros_ns: u64,
    /// The keys of what another program wants.
    pub policy: PolicyKeys,
    /// How long such a twist counts, ns.
    pub valid_ns: u64,
    /// The camera on the tool.
    pub mount: Mount,
}

impl Config {
    /// Reads the file that the command line names, lays the flags over it, and checks the whole.
    ///
    /// # Errors
    /// [`FileError`] names the file or flag, key, value and what is allowed.
    pub fn load(matches: &ArgMatches) -> Result<Self, FileError> {
        let arguments: Arguments = toml_schema::arguments(matches)?;
        let file = arguments.config.as_deref();
        let keys = &arguments.keys;
        let document = Document::with_flags::<Arguments>(file, &["scene"], keys, matches)?;
        document.readable(&["scene"])?;
        Self::of(&document, document.check()?)
    }

    fn of(document: &Document, keys: Keys) -> Result<Self, FileError> {
        let address = |text: &String| {
            let allowed = "addresses of this machine, such as 127.0.0.1";
            let refuse = |_| document.refuse("interfaces", text, allowed);
            text.parse::<IpAddr>().map_err(refuse)
        };
        let interfaces = keys.interfaces.iter().map(address);
        let interfaces = interfaces.collect::<Result<_, _>>()?;
        if !is_name(&keys.node) {
            return Err(document.refuse("node", &keys.node, NAME));
        }
        let (namespace, name) = keys.node.rsplit_once('/').unwrap_or_default();
        let namespace = if namespace.is_empty() { "/" } else { namespace };
        let scene = Scene::read(&keys.scene.clone().unwrap_or_default())?;
        let targets = targets(document, &keys.camera, scene.pattern.len())?;
        let default_centre = match keys.camera.features {
            FeaturesKind::Tags => 0.5,
            _ => 0.0,
        };
        check_topics(document, &keys)?;
        let ns = |ms: f64| (1e6 * ms).round();
        Ok(Self {
            interfaces,
            domain: keys.domain.unwrap_or_else(ipc::default_directory),
            ros_domain_id: keys.ros_domain_id,
            node: [namespace.to_owned(), name.to_owned()],
            services: keys.services,
            max_age_ns: ns(keys.max_age_ms) as u64,
            targets,
            pixel_centre: keys.camera.pixel_centre.unwrap_or(default_centre),
            stamp_offset_ns: ns(keys.camera.stamp_offset_ms) as i64,
            zeros_ns: ns(keys.robot.zeros_ms) as u64,
            valid_ns: ns(keys.policy.valid_ms) as u64,
            camera: keys.camera,
            robot: keys.robot,
            policy: keys.policy,
            mount: keys.mount,
            scene,
        })
    }

    /// Whether it is the camera of the domain.
    pub fn is_camera(&self) -> bool {
        self.camera.features != FeaturesKind::None
    }

    /// Whether it is the robot of the domain.
    pub fn is_robot(&self) -> bool {
        self.robot.executed != Executed::None
    }

    /// Whether it is the policy of the domain.
    pub fn is_policy(&self) -> bool {
        !self.policy.desired.is_empty()
    }
}

fn targets(document: &Document, keys: &CameraKeys, points: usize) -> Result<Targets, FileError> {
    match keys.corners_of {
        Some(_) if keys.tags.is_some() => {
            let allowed = "tags or corners_of, not both";
            Err(document.refuse("camera.corners_of", "given with tags", allowed))
        }
        Some(number) if points == 4 => Ok(Targets::Corners(number)),
        Some(number) => {
            let allowed = format!("a pattern of 4 points; the scene's has {points}");
            Err(document.refuse("camera.corners_of", number, allowed))
        }
        None => {
            let numbers = keys.tags.clone();
            let numbers = numbers.unwrap_or_else(|| (0..points as u32).collect());
            let is_double = |i: usize| numbers[..i].contains(&numbers[i]);
            if numbers.len() != points || (0..points).any(is_double) {
                let allowed =
                    format!("{points} different numbers, one for each point of the scene");
                return Err(document.refuse("camera.tags", format!("{numbers:?}"), allowed));
            }
            Ok(Targets::Centres(numbers))
        }
    }
}

fn check_topics(document: &Document, keys: &Keys) -> Result<(), FileError> {
    let Keys {
        camera,
        robot,
        policy,
        ..
    } = keys;
    let has_camera = camera.features != FeaturesKind::None;
    let has_robot = robot.executed != Executed::None;
    if !has_camera && !has_robot && policy.desired.is_empty() {
        let allowed = "tags or points, unless the robot is played (robot.executed) or a policy \
                       (policy.desired)";
        return Err(document.refuse("camera.features", "none", allowed));
    }
    let joints = &robot.joints;
    if (0..joints.len()).any(|k| joints[..k].contains(&joints[k])) {
        let allowed = format!("at most {MOST_JOINTS} different names");
        return Err(document.refuse("robot.joints", format!("{joints:?}"), allowed));
    }
    let needs_pose =
        robot.executed == Executed::Pose || has_robot && robot.command_frame == CommandFrame::Base;
    if needs_pose && robot.pose.is_empty() {
        let allowed =
            "a topic: the pose is needed for executed = \"pose\" and command_frame = \"base\"";
        return Err(document.refuse("robot.pose", "", allowed));
    }
    for (key, topic, is_optional) in [
        ("camera.topic", &camera.topic, false),
        ("camera.info", &camera.info, true),
        ("robot.twist", &robot.twist, false),
        ("robot.pose", &robot.pose, true),
        ("robot.joint_states", &robot.joint_states, false),
        ("robot.command", &robot.command, false),
        ("policy.desired", &policy.desired, true),
    ] {
        if !(is_optional && topic.is_empty() || is_name(topic)) {
            return Err(document.refuse(key, topic, NAME));
        }
    }
    if robot.executed == Executed::Twist && robot.twist == robot.command {
        let allowed = "a topic of the robot: on robot.command vpcd would hear itself";
        return Err(document.refuse("robot.twist", &robot.twist, allowed));
    }
    if [&robot.command, &robot.twist].contains(&&policy.desired) {
        let allowed = "a topic of the policy, other than robot.command and robot.twist";
        return Err(document.refuse("policy.desired", &policy.desired, allowed));
    }
    let names = [&camera.frame, &robot.tool, &robot.base];
    let turns = has_robot || !policy.desired.is_empty();
    if turns && (names[0] == names[1] || names[0] == names[2] || names[1] == names[2]) {
        let allowed = "three different names for camera.frame, robot.tool and robot.base";
        return Err(document.refuse("robot.tool", names[1], allowed));
    }
    Ok(())
}

/// Whether ROS takes this as an absolute name.
fn is_name(topic: &str) -> bool {
    let is_part = |part: &str| {
        let begins = part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
        let is_good = |c: char| c.is_ascii_alphanumeric() || c == '_';
        begins && part.chars().all(is_good) && !part.contains("__")
    };
    let parts = topic.strip_prefix('/');
    parts.is_some_and(|parts| parts.split('/').all(is_part))
}

/// Returns the JSON Schema of a configuration file.
pub fn schema() -> serde_json::Value {
    toml_schema::schema::<Keys>()
}

/// A configuration of `paper-sim` with these keys behind the scene's.
#[cfg(all(test, feature = "dds"))]
pub(crate) fn of_keys(keys: &str) -> Config {
    let scene = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../scene/scenes/paper-sim.toml"
    );
    let text = format!("scene = {scene:?}\n{keys}");
    let document = Document::parse(&text, "test.toml").unwrap();
    Config::of(&document, document.check().unwrap()).unwrap()
}
