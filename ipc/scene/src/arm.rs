//! Reading an arm file: TOML into tables, its URDF into a chain of joints, checked into an [`Arm`].

use std::collections::HashMap;
use std::path::Path;

use nalgebra::{IsometryMatrix3, Rotation3, Translation3, Unit, Vector3};
use schemars::JsonSchema;
use serde::Deserialize;
use toml_schema::{Document, FileError};
use urdf_rs::{Joint, JointType};

use crate::collision::{BoxTable, Reader};
use crate::model::{Arm, ArmJoint, MAX_BOXES, MAX_JOINTS, MAX_WALL_POINTS, MAX_WALLS, Name, Wall};

/// Largest number of an origin, m and rad; a NaN is none.
const MOST_ORIGIN: f64 = 1e3;
/// Deepest nesting of a URDF's elements: the library recurses.
const MOST_DEPTH: usize = 100;
/// Fewest joints of an arm.
const FEWEST: usize = 4;

/// The arm that carries the camera. A scene names this file by its key `arm`; the law then keeps
/// joints within their ranges and speeds, off singular postures, points of the arm behind walls,
/// and links off each other, boxes and walls.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Arm")]
struct Tables {
    /// The robot's description (URDF), relative to this file.
    #[schemars(extend("x-allowed" = "a URDF file"))]
    urdf: String,
    /// Link that does not move; walls are in its frame.
    #[schemars(extend("x-allowed" = "a link of the URDF"))]
    base: String,
    /// Link that carries the camera, 4 to 7 movable joints from the base.
    #[schemars(extend("x-allowed" = "a link of the URDF"))]
    tip: String,
    /// Greatest acceleration of each joint, which a URDF does not give.
    #[schemars(length(max = MAX_JOINTS), inner(range(min = 0.01, max = 1e4)), extend("x-unit" = "rad/s^2"))]
    acceleration: Vec<f64>,
    /// Distance that joints keep from the ends of their ranges.
    #[serde(default = "margin")]
    #[schemars(range(min = 0, max = 1), extend("x-unit" = "rad"))]
    margin: f64,
    /// Greatest share of a joint's speed limit.
    #[serde(default = "speed")]
    #[schemars(range(min = 0.01, max = 1))]
    speed: f64,
    /// Greatest share of a joint's acceleration that the scene's limits of acceleration may take:
    /// so far the arm keeps off singular postures. No effect in a scene without such limits.
    #[serde(default = "strain")]
    #[schemars(range(min = 0.05, max = 1))]
    strain: f64,
    /// What joint 3 of seven, the elbow, does: it is held where it is, or turns away from the ends
    /// of the joints' ranges and from singular postures, if the robot's bridge obeys that part of
    /// the command.
    #[serde(default)]
    elbow: Elbow,
    /// Position of each joint where the camera sees the goal, if the object is always at the same
    /// place: starts of a memory are then drawn within the arm's reach.
    #[serde(default)]
    #[schemars(length(max = MAX_JOINTS), inner(range(min = -1e3, max = 1e3)), extend("x-unit" = "rad"))]
    goal: Vec<f64>,
    /// The end effector, whose velocity the robot's bridge shapes, in the frame of the tip.
    #[serde(default)]
    #[schemars(inner(range(min = -2, max = 2)), extend("x-unit" = "m"))]
    end_effector: [f64; 3],
    camera: Mounting,
    /// Walls, a table among them, in the base frame.
    #[serde(default)]
    #[schemars(length(max = MAX_WALLS))]
    wall: Vec<WallTable>,
    /// Points beside the camera that keep behind the walls, such as the tip of a tool, in the frame
    /// of the tip.
    #[serde(default)]
    #[schemars(length(max = MAX_WALL_POINTS), inner(inner(range(min = -2, max = 2))), extend("x-unit" = "m"))]
    points: Vec<[f64; 3]>,
    /// Boxes that links keep off, in the base frame.
    #[serde(default)]
    #[schemars(length(max = MAX_BOXES))]
    r#box: Vec<BoxTable>,
    /// Least distance of links from each other, from boxes and from walls. Their shapes are the
    /// URDF's collision shapes, each in a capsule; links that one joint joins are not compared.
    #[serde(default = "clearance")]
    #[schemars(range(min = 0, max = 0.5), extend("x-unit" = "m"))]
    clearance: f64,
    /// What is not compared: a link with a link, box or wall, or one name alone with everything.
    #[serde(default)]
    #[schemars(extend("x-allowed" = "lists of one or two names of links, boxes and walls"))]
    ignore: Vec<Vec<String>>,
}

/// What the elbow does.
#[derive(Clone, Copy, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
enum Elbow {
    /// It stays where it is.
    #[default]
    Held,
    /// It turns.
    Free,
}

/// The camera (x right, y down, z forward) in the frame of the tip.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Mounting {
    /// Origin of the camera.
    #[schemars(inner(range(min = -2, max = 2)), extend("x-unit" = "m"))]
    translation: [f64; 3],
    /// Rotation vector from the camera's frame to the tip's.
    #[schemars(inner(range(min = -7, max = 7)), extend("x-unit" = "rad"))]
    rotation: [f64; 3],
}

/// A wall: points stay on the side that its normal shows to.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct WallTable {
    /// Name in messages.
    #[serde(default)]
    #[schemars(extend("x-allowed" = "at most 32 bytes"))]
    name: String,
    /// Direction away from the wall; of any length but zero.
    #[schemars(inner(range(min = -1e3, max = 1e3)))]
    normal: [f64; 3],
    /// Distance of the wall from the base's origin along the normal.
    #[schemars(range(min = -10, max = 10), extend("x-unit" = "m"))]
    offset: f64,
}

/// More than a bridge keeps by itself, so that it need not slow the camera down.
fn margin() -> f64 {
    0.2
}

fn speed() -> f64 {
    0.25
}

fn strain() -> f64 {
    0.6
}

fn clearance() -> f64 {
    0.02
}

/// Returns the JSON Schema of an arm file.
pub fn schema() -> serde_json::Value {
    toml_schema::schema::<Tables>()
}

/// Checks an arm file; `name` and `directory` are how the scene calls it and where the scene is,
/// and `read` returns the file of a name.
///
/// # Errors
/// [`FileError`] names the file, the key, the value and what is allowed.
pub(crate) fn parse(
    name: &str,
    directory: &Path,
    read: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
) -> Result<Arm, FileError> {
    let shown = |name: &str| directory.join(name).display().to_string();
    let text = |name: &str| {
        let bytes = read(name).map_err(|source| FileError::Read {
            path: shown(name),
            source,
        })?;
        String::from_utf8(bytes).map_err(|error| FileError::Syntax {
            path: shown(name),
            message: error.to_string(),
        })
    };
    let document = Document::parse(&text(name)?, &shown(name))?;
    let tables: Tables = document.check()?;
    let beside = Path::new(name).parent().unwrap_or(Path::new(""));
    let urdf = beside.join(&tables.urdf).display().to_string();
    let described = text(&urdf)?;
    let checker = Checker {
        document,
        urdf: shown(&urdf),
    };
    checker.arm(&described, &tables)
}

/// The checks that need the URDF.
struct Checker {
    document: Document,
    urdf: String,
}

impl Checker {
    fn arm(&self, urdf: &str, tables: &Tables) -> Result<Arm, FileError> {
        if depth(urdf) > MOST_DEPTH {
            let message = format!("elements within elements; allowed: {MOST_DEPTH} deep");
            return Err(self.bad(message));
        }
        let robot = urdf_rs::read_from_string(urdf).map_err(|error| self.bad(error.to_string()))?;
        let links: Vec<&str> = robot.links.iter().map(|link| link.name.as_str()).collect();
        for (key, link) in [("base", &tables.base), ("tip", &tables.tip)] {
            if !links.contains(&link.as_str()) {
                let allowed = format!("a link of {}: {}", self.urdf, links.join(", "));
                return Err(self.document.refuse(key, link, &allowed));
            }
        }
        let path = self.path(&robot.joints, tables)?;
        let count = path
            .iter()
            .filter(|joint| joint.joint_type != JointType::Fixed)
            .count();
        if !(FEWEST..=MAX_JOINTS).contains(&count) {
            let found = format!("{count} movable joints from {}", tables.base);
            let allowed = format!("{FEWEST} to {MAX_JOINTS} movable joints");
            return Err(self.document.refuse("tip", found, &allowed));
        }
        if tables.acceleration.len() != count {
            let found = format!("a list of {}", tables.acceleration.len());
            let allowed = format!("a list of {count}, one for each movable joint");
            return Err(self.document.refuse("acceleration", found, &allowed));
        }
        let mut at = IsometryMatrix3::identity();
        let mut arm = Arm {
            joints: heapless::Vec::new(),
            translation: [0.0; 3],
            rotation: [[0.0; 3]; 3],
            end_effector: [0.0; 3],
            margin: tables.margin,
            speed: tables.speed,
            strain: tables.strain,
            is_elbow_free: tables.elbow == Elbow::Free,
            goal: heapless::Vec::new(),
            joint_names: heapless::Vec::new(),
            walls: heapless::Vec::new(),
            wall_names: heapless::Vec::new(),
            points: heapless::Vec::new(),
            clearance: tables.clearance,
            shapes: heapless::Vec::new(),
            shape_links: heapless::Vec::new(),
            boxes: heapless::Vec::new(),
            box_names: heapless::Vec::new(),
            pairs: heapless::Vec::new(),
        };
        for joint in &path {
            let given = joint.origin.xyz.0.iter().chain(&joint.origin.rpy.0);
            if !given.clone().all(|x| x.abs() < MOST_ORIGIN) {
                return Err(self.wrong(joint, "origin", "numbers below 1000"));
            }
            let (xyz, [roll, pitch, yaw]) = (joint.origin.xyz.0, joint.origin.rpy.0);
            let rotation = Rotation3::from_euler_angles(roll, pitch, yaw);
            at *= IsometryMatrix3::from_parts(Translation3::from(xyz), rotation);
            if joint.joint_type != JointType::Fixed {
                let name = Name::try_from(joint.name.as_str());
                arm.joint_names.extend([name.unwrap_or_default()]);
                let acceleration = tables.acceleration.get(arm.joints.len());
                // There is room: they were counted.
                arm.joints.extend([self.joint(
                    joint,
                    &at,
                    acceleration.copied(),
                    tables.margin,
                )?]);
            }
        }
        if tables.elbow == Elbow::Free && count < MAX_JOINTS {
            let allowed = format!("held: an arm with {count} joints has no free elbow");
            return Err(self.document.refuse("elbow", "free", &allowed));
        }
        arm.goal = self.goal(&tables.goal, &arm)?;
        let Mounting {
            translation,
            rotation,
        } = tables.camera;
        let rotation = Rotation3::new(Vector3::from(rotation));
        let mounted = IsometryMatrix3::from_parts(Translation3::from(translation), rotation);
        let camera = at * mounted;
        arm.end_effector = (at * nalgebra::Point3::from(tables.end_effector)).into();
        arm.translation = camera.translation.vector.into();
        arm.rotation = camera.rotation.matrix().transpose().into();
        for (i, wall) in tables.wall.iter().enumerate() {
            let normal = Unit::try_new(Vector3::from(wall.normal), 1e-6).ok_or_else(|| {
                let (key, found) = (format!("wall[{i}].normal"), format!("{:?}", wall.normal));
                self.document.refuse(&key, found, "a direction, not zero")
            })?;
            let name = Name::try_from(wall.name.as_str());
            arm.wall_names.extend([name.map_err(|_| {
                let key = format!("wall[{i}].name");
                (self.document).refuse(&key, &wall.name, "at most 32 bytes")
            })?]);
            arm.walls.extend([Wall {
                normal: normal.into_inner().into(),
                offset: wall.offset,
            }]);
        }
        let seen = |point: &[f64; 3]| (mounted.inverse() * nalgebra::Point3::from(*point)).into();
        arm.points.extend(tables.points.iter().map(seen));
        let reader = Reader {
            robot: &robot,
            path: &path,
            base: &tables.base,
            boxes: &tables.r#box,
            ignore: &tables.ignore,
            document: &self.document,
            urdf: &self.urdf,
        };
        reader.read(&mut arm)?;
        Ok(arm)
    }

    /// The joints' positions at the goal, within their ranges and margins.
    fn goal(&self, goal: &[f64], arm: &Arm) -> Result<heapless::Vec<f64, MAX_JOINTS>, FileError> {
        let count = arm.joints.len();
        if !goal.is_empty() && goal.len() != count {
            let found = format!("a list of {}", goal.len());
            let allowed = format!("a list of {count}, one for each movable joint");
            return Err(self.document.refuse("goal", found, &allowed));
        }
        for (k, (q, joint)) in goal.iter().zip(&arm.joints).enumerate() {
            let [least, most] = joint.range;
            let (least, most) = (least + arm.margin, most - arm.margin);
            if !(least..=most).contains(q) {
                let allowed = format!("{least:.3} to {most:.3}, the joint's range less its margin");
                return Err(self.document.refuse(&format!("goal[{k}]"), q, &allowed));
            }
        }
        Ok(goal.iter().copied().collect())
    }

    /// The joints from the base to the tip.
    fn path<'a>(&self, joints: &'a [Joint], tables: &Tables) -> Result<Vec<&'a Joint>, FileError> {
        let above: HashMap<&str, &Joint> = joints
            .iter()
            .map(|joint| (joint.child.link.as_str(), joint))
            .collect();
        let (mut path, mut link) = (Vec::new(), tables.tip.as_str());
        while link != tables.base {
            let joint = above.get(link).filter(|_| path.len() <= joints.len());
            let joint = joint.ok_or_else(|| {
                let allowed = format!("a link that joints lead to from {}", tables.base);
                self.document.refuse("tip", &tables.tip, &allowed)
            })?;
            path.push(*joint);
            link = &joint.parent.link;
        }
        path.reverse();
        Ok(path)
    }

    /// A joint in its frame `at`, where all joints stand at zero.
    fn joint(
        &self,
        joint: &Joint,
        at: &IsometryMatrix3<f64>,
        acceleration: Option<f64>,
        margin: f64,
    ) -> Result<ArmJoint, FileError> {
        let limit = &joint.limit;
        let is_endless = joint.joint_type == JointType::Continuous;
        let range = match joint.joint_type {
            JointType::Continuous => [f64::NEG_INFINITY, f64::INFINITY],
            JointType::Revolute | JointType::Prismatic => [limit.lower, limit.upper],
            _ => {
                let allowed = "revolute, continuous, prismatic or fixed";
                return Err(self.wrong(joint, "type", allowed));
            }
        };
        let axis = Unit::try_new(Vector3::from(joint.axis.xyz.0), 1e-6);
        // A NaN fails each.
        for (holds, what, allowed) in [
            (joint.mimic.is_none(), "mimic", "none between base and tip"),
            (
                range[0] < range[1] && (is_endless || range.iter().all(|end| end.is_finite())),
                "limit",
                "lower below upper, both finite",
            ),
            (
                range[1] - range[0] > 2.0 * margin,
                "limit",
                "a range of more than twice the key `margin`",
            ),
            (
                limit.velocity > 0.0 && limit.velocity.is_finite(),
                "limit velocity",
                "above 0, finite",
            ),
            (
                axis.is_some_and(|axis| (axis.norm() - 1.0).abs() < 1e-6),
                "axis",
                "a direction, not zero",
            ),
        ] {
            if !holds {
                return Err(self.wrong(joint, what, allowed));
            }
        }
        let axis = axis.map_or_else(Vector3::z, Unit::into_inner);
        Ok(ArmJoint {
            axis: (at.rotation * axis).into(),
            point: at.translation.vector.into(),
            slides: joint.joint_type == JointType::Prismatic,
            range,
            velocity: limit.velocity,
            acceleration: acceleration.unwrap_or_default(),
        })
    }

    fn wrong(&self, joint: &Joint, what: &str, allowed: &str) -> FileError {
        self.bad(format!("joint {}: {what}; allowed: {allowed}", joint.name))
    }

    fn bad(&self, message: String) -> FileError {
        FileError::Syntax {
            path: self.urdf.clone(),
            message,
        }
    }
}

/// How deep the elements of a document are nested, by its tags.
fn depth(xml: &str) -> usize {
    let (mut depth, mut most) = (0_usize, 0);
    for tag in xml.split('<').skip(1) {
        let is_empty = tag.split('>').next().is_some_and(|tag| tag.ends_with('/'));
        if tag.starts_with('/') {
            depth = depth.saturating_sub(1);
        } else if !tag.starts_with(['?', '!']) && !is_empty {
            depth += 1;
        }
        most = most.max(depth);
    }
    most
}
