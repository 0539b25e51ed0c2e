//! The collision shapes of a URDF's links as capsules, boxes about the arm, and which of them keep
//! apart.

use std::collections::{HashMap, VecDeque};

use nalgebra::{IsometryMatrix3, Point3, Rotation3, Translation3, Vector3};
use schemars::JsonSchema;
use serde::Deserialize;
use toml_schema::{Document, FileError};
use urdf_rs::{Collision, Geometry, Joint, JointType, Link, Robot};

use crate::model::{Arm, Cuboid, MAX_PAIRS, MAX_SHAPES, Name, Other, Pair, Shape};

/// Largest length of a shape, and place of one, m; a NaN is none.
const MOST: f64 = 1e3;
/// A shape that is within another one of its link but for this is no shape of its own, m.
const WITHIN: f64 = 1e-9;

/// A box that links keep off: a table, a fixture, the object's surroundings.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct BoxTable {
    /// Name in messages and in `ignore`.
    #[serde(default)]
    #[schemars(extend("x-allowed" = "at most 32 bytes"))]
    name: String,
    /// Lengths of its edges.
    #[schemars(inner(range(min = 1e-3, max = 20)), extend("x-unit" = "m"))]
    size: [f64; 3],
    /// Its middle.
    #[schemars(inner(range(min = -10, max = 10)), extend("x-unit" = "m"))]
    translation: [f64; 3],
    /// Rotation vector from its axes to the base's.
    #[serde(default)]
    #[schemars(inner(range(min = -7, max = 7)), extend("x-unit" = "rad"))]
    rotation: [f64; 3],
}

/// What is read, and from where.
pub(crate) struct Reader<'a> {
    pub robot: &'a Robot,
    /// The joints from the base to the tip.
    pub path: &'a [&'a Joint],
    pub base: &'a str,
    pub boxes: &'a [BoxTable],
    pub ignore: &'a [Vec<String>],
    /// The arm file.
    pub document: &'a Document,
    /// The URDF's path.
    pub urdf: &'a str,
}

/// Where a link is while all joints stand at zero, and how many joints move it.
#[derive(Clone, Copy)]
struct Place {
    at: IsometryMatrix3<f64>,
    joints: usize,
}

impl Reader<'_> {
    /// Reads shapes, boxes and pairs into an arm that has its walls.
    pub fn read(&self, arm: &mut Arm) -> Result<(), FileError> {
        self.check_ignored(arm)?;
        let (places, mut names) = (self.places(), Vec::new());
        for link in &self.robot.links {
            if link.collision.is_empty() || self.is_ignored(&[&link.name]) {
                continue;
            }
            let place = places.get(link.name.as_str()).ok_or_else(|| {
                let what = "a joint beside the way from base to tip moves it";
                self.wrong(link, what, "a link that is fixed to the arm")
            })?;
            let mut shapes: Vec<Shape> = Vec::new();
            for collision in &link.collision {
                let shape = self.shape(link, collision, place)?;
                if !shapes.iter().any(|whole| is_within(&shape, whole)) {
                    shapes.retain(|part| !is_within(part, &shape));
                    shapes.push(shape);
                }
            }
            for shape in shapes {
                names.push(link.name.as_str());
                let name = Name::try_from(link.name.as_str()).unwrap_or_default();
                let is_full = arm.shapes.push(shape).is_err();
                if is_full || arm.shape_links.push(name).is_err() {
                    let allowed = format!("{MAX_SHAPES} of all links");
                    return Err(self.wrong(link, "one more collision shape", &allowed));
                }
            }
        }
        for (i, table) in self.boxes.iter().enumerate() {
            let name = Name::try_from(table.name.as_str()).map_err(|_| {
                let key = format!("box[{i}].name");
                (self.document).refuse(&key, &table.name, "at most 32 bytes")
            })?;
            let rotation = Rotation3::new(Vector3::from(table.rotation));
            // There is room: the schema says how many.
            arm.box_names.extend([name]);
            arm.boxes.extend([Cuboid {
                center: table.translation,
                rotation: rotation.matrix().transpose().into(),
                half: table.size.map(|edge| 0.5 * edge),
            }]);
        }
        self.pair(arm, &names)
    }

    /// What is compared, where the links of the shapes have these names.
    fn pair(&self, arm: &mut Arm, links: &[&str]) -> Result<(), FileError> {
        let about = |names: &[Name], other: fn(u8) -> Other| {
            let names = names.iter().enumerate();
            let all = names.map(|(k, name)| (other(k as u8), name.to_string(), 0));
            all.collect::<Vec<_>>()
        };
        let shapes = arm.shapes.iter().zip(links).enumerate();
        let shapes = shapes.map(|(k, (shape, name))| (k as u8, *name, shape.joints));
        let others: Vec<(Other, String, usize)> = (shapes.clone())
            // Neighbours meet at their joint.
            .map(|(k, name, joints)| (Other::Link(k), name.to_owned(), joints + 1))
            .chain(about(&arm.box_names, Other::Box))
            .chain(about(&arm.wall_names, Other::Wall))
            .collect();
        let mut pairs = Vec::new();
        for (shape, name, joints) in shapes {
            let kept = others
                .iter()
                .filter(|(_, other, most)| joints > *most && !self.is_ignored(&[name, other]));
            pairs.extend(kept.map(|(other, ..)| Pair {
                shape,
                other: *other,
            }));
        }
        let count = pairs.len();
        arm.pairs = heapless::Vec::from_slice(&pairs).map_err(|_| {
            let found = format!("{count} pairs of links, boxes and walls");
            let allowed = format!("at most {MAX_PAIRS}: name those here that never meet");
            self.document.refuse("ignore", found, allowed)
        })?;
        Ok(())
    }

    /// Whether every name in `ignore` is one of a link, box or wall.
    fn check_ignored(&self, arm: &Arm) -> Result<(), FileError> {
        let links = self.robot.links.iter().map(|link| link.name.as_str());
        let boxes = self.boxes.iter().map(|table| table.name.as_str());
        let walls = arm.wall_names.iter().map(|name| name.as_str());
        let known: Vec<&str> = links.chain(boxes).chain(walls).collect();
        for (i, names) in self.ignore.iter().enumerate() {
            if !(1..=2).contains(&names.len()) {
                let found = format!("a list of {}", names.len());
                let key = format!("ignore[{i}]");
                return Err(self
                    .document
                    .refuse(&key, found, "a list of one or two names"));
            }
            if let Some(name) = names.iter().find(|name| !known.contains(&name.as_str())) {
                let allowed = format!("a link, box or wall: {}", known.join(", "));
                let key = format!("ignore[{i}]");
                return Err(self.document.refuse(&key, name, allowed));
            }
        }
        Ok(())
    }

    /// Whether the file leaves these names out: one of them, or both as a pair.
    fn is_ignored(&self, names: &[&str]) -> bool {
        let is_named = |listed: &Vec<String>| listed.iter().all(|name| names.contains(&&**name));
        self.ignore.iter().any(is_named)
    }

    /// Where links are that joints of the arm move, or none; from the base over all fixed joints.
    fn places(&self) -> HashMap<&str, Place> {
        let base = Place {
            at: IsometryMatrix3::identity(),
            joints: 0,
        };
        let (mut places, mut last) = (HashMap::from([(self.base, base)]), base);
        let mut waiting = VecDeque::from([(self.base, base)]);
        for joint in self.path {
            let is_fixed = joint.joint_type == JointType::Fixed;
            last.at *= origin(&joint.origin);
            last.joints += usize::from(!is_fixed);
            places.insert(&joint.child.link, last);
            waiting.push_back((&joint.child.link, last));
        }
        let mut fixed: HashMap<&str, Vec<(&str, IsometryMatrix3<f64>)>> = HashMap::new();
        for joint in &self.robot.joints {
            if joint.joint_type == JointType::Fixed {
                let (above, below) = (joint.parent.link.as_str(), joint.child.link.as_str());
                let at = origin(&joint.origin);
                fixed.entry(above).or_default().push((below, at));
                fixed.entry(below).or_default().push((above, at.inverse()));
            }
        }
        while let Some((link, place)) = waiting.pop_front() {
            for (other, at) in fixed.get(link).into_iter().flatten() {
                if !places.contains_key(other) {
                    let there = Place {
                        at: place.at * at,
                        ..place
                    };
                    places.insert(other, there);
                    waiting.push_back((other, there));
                }
            }
        }
        places
    }

    /// A capsule that encloses a shape.
    fn shape(&self, link: &Link, collision: &Collision, at: &Place) -> Result<Shape, FileError> {
        let (axis, half, radius) = match &collision.geometry {
            Geometry::Sphere { radius } => (2, 0.0, *radius),
            // A capsule's ends stand out from a cylinder's by its radius.
            Geometry::Cylinder { radius, length } | Geometry::Capsule { radius, length } => {
                (2, 0.5 * length, *radius)
            }
            Geometry::Box { size } => {
                let half = Vector3::from(size.0) / 2.0;
                let axis = half.imax();
                let across = half[(axis + 1) % 3].hypot(half[(axis + 2) % 3]);
                (axis, half[axis], across)
            }
            Geometry::Mesh { .. } => {
                let allowed = "a box, capsule, cylinder or sphere";
                return Err(self.wrong(link, "its collision shape is a mesh", allowed));
            }
        };
        let place = at.at * origin(&collision.origin);
        let mut end = Vector3::zeros();
        end[axis] = half;
        let ends: [[f64; 3]; 2] = [-end, end].map(|end| (place * Point3::from(end)).into());
        let mut numbers = ends.iter().flatten().chain([&half, &radius]);
        if !numbers.all(|x: &f64| x.abs() < MOST) || radius <= 0.0 || half < 0.0 {
            let allowed = "lengths above 0, and all numbers below 1000";
            return Err(self.wrong(link, "its collision shape", allowed));
        }
        Ok(Shape {
            ends,
            radius,
            joints: at.joints,
        })
    }

    fn wrong(&self, link: &Link, what: &str, allowed: &str) -> FileError {
        let name = &link.name;
        let message = format!(
            "link {name}: {what}; allowed: {allowed}; or [\"{name}\"] in the arm file's `ignore`: \
             then nothing is kept off this link"
        );
        FileError::Syntax {
            path: self.urdf.to_owned(),
            message,
        }
    }
}

fn origin(pose: &urdf_rs::Pose) -> IsometryMatrix3<f64> {
    let [roll, pitch, yaw] = pose.rpy.0;
    let rotation = Rotation3::from_euler_angles(roll, pitch, yaw);
    IsometryMatrix3::from_parts(Translation3::from(pose.xyz.0), rotation)
}

/// Whether a shape is within another one: both ends' spheres are.
fn is_within(part: &Shape, whole: &Shape) -> bool {
    let [from, to] = whole.ends.map(Vector3::from);
    let along = to - from;
    part.ends.iter().all(|end| {
        let away = Vector3::from(*end) - from;
        let share = along.dot(&away) / along.norm_squared();
        // Of a sphere, which has no length, there is no share.
        let share = if share > 0.0 { share.min(1.0) } else { 0.0 };
        (away - along * share).norm() + part.radius <= whole.radius + WITHIN
    })
}
