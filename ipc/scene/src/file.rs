//! Reading a scene file: TOML into tables, then checked into a [`Scene`].

use std::path::Path;

use mask::{MAX_AREAS, Mask, MaskError};
use schemars::JsonSchema;
use serde::Deserialize;
use toml_schema::{Document, FileError};

use crate::model::*;

/// Controller, builder and emulator must agree on the scene. A memory fits only the scene it was
/// built for, but `success`, `starts`, `cost`, the limits of acceleration, `arm`, `marker_size` and
/// the keys `name`, `grasped`, `on_lens` and `crossable` of occlusions may change.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Scene")]
struct Tables {
    /// File of the arm that carries the camera, relative to the scene file. Without one the camera
    /// flies freely.
    #[serde(default)]
    #[schemars(extend("x-allowed" = "a TOML file, see arm.schema.json"))]
    arm: Option<String>,
    camera: Camera,
    pattern: Pattern,
    /// Pose of the object in the camera frame (x right, y down, z forward) at the goal; it shows
    /// every point in the image and outside the occlusions.
    goal: Pose,
    limits: Limits,
    cost: Cost,
    success: Success,
    starts: StartRegion,
    /// Areas of the image that features must not enter.
    #[serde(default)]
    #[schemars(length(max = MAX_OCCLUSIONS))]
    occlusion: Vec<Painted>,
}

/// The pattern that the camera looks at.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Pattern {
    /// Points `[X, Y, 0.0]` in the object frame, in the order of the features; four of them without
    /// three on a line.
    #[schemars(length(min = MIN_POINTS, max = MAX_POINTS), inner(inner(range(min = -10, max = 10))))]
    #[schemars(extend("x-unit" = "m"))]
    points: Vec<[f64; 3]>,
    /// Side of the square around each point that must stay in sight: a tag with its white border. 0
    /// or none: only the points.
    #[serde(default)]
    #[schemars(range(min = 0, max = 1), extend("x-unit" = "m"))]
    marker_size: Option<f64>,
}

/// An occlusion is the union of its parts and its mask.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Painted {
    /// Name in messages and for `vpc-memory build --grow`.
    #[schemars(extend("x-allowed" = "at most 32 bytes"))]
    name: String,
    /// Shapes of the occlusion.
    #[serde(default)]
    #[schemars(length(max = MAX_PARTS), extend("x-allowed" = "1 to 8 parts, or a mask"))]
    parts: Vec<Part>,
    /// PNG file, relative to the scene file; white (at least half gray) is forbidden, black free.
    #[schemars(extend("x-allowed" = "an opaque gray PNG of the image's size, up to 4096x4096 px, at most 32 white areas"))]
    mask: Option<String>,
    /// Whether this is the object in the emulated robot's gripper, which leaves the view when it
    /// is released; at most one.
    #[serde(default)]
    grasped: bool,
    /// Whether the emulated camera shows this as a blurred spot on its lens instead of an object.
    #[serde(default)]
    on_lens: bool,
    /// Whether foresight may take points behind this, for `safety.blind_s` at most.
    #[serde(default)]
    crossable: bool,
}

/// Returns the JSON Schema of a scene file.
pub fn schema() -> serde_json::Value {
    toml_schema::schema::<Tables>()
}

impl Scene {
    /// Reads and checks a scene file.
    ///
    /// # Errors
    /// [`FileError`] names the file, the key, the value and what is allowed.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        Self::parse(&toml_schema::read_text(path)?, &path.display().to_string())
    }

    /// Checks the text of a scene file; `path` is for messages, and the files that it names are
    /// looked for beside it.
    ///
    /// # Errors
    /// As [`Scene::read`].
    pub fn parse(text: &str, path: &str) -> Result<Self, FileError> {
        Self::parse_with(text, path, &|name| read_beside(&beside(path, name)))
    }

    /// As [`Scene::parse`], with the files that it names from elsewhere: `beside` returns the one
    /// of a name in the text.
    ///
    /// # Errors
    /// As [`Scene::read`].
    pub fn parse_with(
        text: &str,
        path: &str,
        beside: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
    ) -> Result<Self, FileError> {
        let document = Document::parse(text, path)?;
        let tables: Tables = document.check()?;
        Checker {
            document,
            path,
            beside,
        }
        .scene(tables)
    }
}

impl Arm {
    /// Reads an arm file, for a scene that names none.
    ///
    /// # Errors
    /// [`FileError`] names the file, the key, the value and what is allowed.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let name = path.display().to_string();
        crate::arm::parse(&name, Path::new(""), &|name| read_beside(Path::new(name)))
    }
}

/// Reads a file that a scene names.
pub(crate) fn read_beside(path: &Path) -> std::io::Result<Vec<u8>> {
    toml_schema::read_bytes(path, MOST_BESIDE)
}

fn beside(path: &str, name: &str) -> std::path::PathBuf {
    Path::new(path).parent().unwrap_or(Path::new("")).join(name)
}

/// Largest file that a scene names, bytes: four for each pixel that a mask may have, not
/// compressed.
const MOST_BESIDE: u64 = 4 * mask::MOST_PIXELS as u64;
/// Longest time that a stop from the velocity limits may take, s.
const MAX_STOP_S: f64 = 5.0;

/// The checks that concern several keys.
struct Checker<'a> {
    document: Document,
    path: &'a str,
    /// Reads a file that the scene, or its arm, names.
    beside: &'a dyn Fn(&str) -> std::io::Result<Vec<u8>>,
}

impl Checker<'_> {
    fn scene(&self, tables: Tables) -> Result<Scene, FileError> {
        let camera = tables.camera;
        for (key, value, most) in [
            ("cx", camera.cx, camera.width),
            ("cy", camera.cy, camera.height),
        ] {
            let key = format!("camera.{key}");
            self.hold(value <= most, &key, value, "inside the image")?;
        }
        self.starts(&tables.starts)?;
        self.limits(&tables.limits)?;
        let scene = Scene {
            camera,
            marker_size: tables.pattern.marker_size.unwrap_or(0.0),
            has_marker_size: tables.pattern.marker_size.is_some(),
            pattern: self.pattern(tables.pattern.points)?,
            goal: tables.goal,
            limits: tables.limits,
            cost: tables.cost,
            success: tables.success,
            starts: tables.starts,
            occlusions: self.occlusions(tables.occlusion, &camera)?,
            arm: self.arm(tables.arm.as_deref())?,
        };
        self.goal(&scene)?;
        Ok(scene)
    }

    fn hold(
        &self,
        holds: bool,
        key: &str,
        value: impl ToString,
        allowed: &str,
    ) -> Result<(), FileError> {
        if holds {
            Ok(())
        } else {
            Err(self.document.refuse(key, value, allowed))
        }
    }

    fn limits(&self, limits: &Limits) -> Result<(), FileError> {
        for (key, speed, acceleration) in [
            ("linear", limits.linear, limits.linear_acceleration),
            ("angular", limits.angular, limits.angular_acceleration),
        ] {
            if let Some(acceleration) = acceleration {
                let least = speed / MAX_STOP_S;
                self.hold(
                    acceleration >= least,
                    &format!("limits.{key}_acceleration"),
                    acceleration,
                    &format!("at least {least}, with which a stop takes {MAX_STOP_S} s"),
                )?;
            }
        }
        Ok(())
    }

    fn pattern(
        &self,
        points: Vec<[f64; 3]>,
    ) -> Result<heapless::Vec<[f64; 3], MAX_POINTS>, FileError> {
        for (i, point) in points.iter().enumerate() {
            let key = format!("pattern.points[{i}][2]");
            self.hold(point[2] == 0.0, &key, point[2], "0: the pattern is planar")?;
        }
        // Four points no three of which lie on a line are what a homography needs.
        let is_line = |[a, b, c]: [usize; 3]| {
            let (p, q, r) = (points[a], points[b], points[c]);
            ((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])).abs() <= 1e-9
        };
        let n = points.len();
        let fours = (0..n).flat_map(|a| {
            (0..a).flat_map(move |b| (0..b).flat_map(move |c| (0..c).map(move |d| [a, b, c, d])))
        });
        let is_general = |[a, b, c, d]: [usize; 4]| {
            ![[a, b, c], [a, b, d], [a, c, d], [b, c, d]]
                .into_iter()
                .any(is_line)
        };
        let (holds, found) = (fours.into_iter().any(is_general), format!("{points:?}"));
        let allowed = "four points among them, no three of which lie on a line";
        self.hold(holds, "pattern.points", found, allowed)?;
        Ok(points.into_iter().collect())
    }

    /// A goal whose points lie behind the camera cannot be seen; where they fall on the image is
    /// for the mathematics of each side.
    fn goal(&self, scene: &Scene) -> Result<(), FileError> {
        let [.., depth] = scene.goal.translation;
        let key = "goal.translation[2]";
        self.hold(depth >= 1e-3, key, depth, "0.001 to 100 m")?;
        let reach = scene
            .pattern
            .iter()
            .map(|p| p[0].hypot(p[1]))
            .fold(0.0, f64::max);
        let [x, y, _] = scene.goal.rotation;
        let nearest = depth - reach * x.hypot(y).min(1.6).sin();
        let allowed = "far enough that every point of the pattern is in front of the camera";
        self.hold(nearest > 0.0, key, depth, allowed)
    }

    fn starts(&self, starts: &StartRegion) -> Result<(), FileError> {
        let (min, max) = (starts.translation_min, starts.translation_max);
        let ordered = min.iter().zip(&max).all(|(min, max)| min <= max);
        let (key, allowed) = ("starts.translation_max", "at least starts.translation_min");
        self.hold(ordered, key, format!("{max:?}"), allowed)?;
        let key = "starts.translation_min[2]";
        self.hold(min[2] >= 1e-3, key, min[2], "0.001 to 100 m")
    }

    fn occlusions(
        &self,
        tables: Vec<Painted>,
        camera: &Camera,
    ) -> Result<heapless::Vec<Occlusion, MAX_OCCLUSIONS>, FileError> {
        let mut occlusions = heapless::Vec::new();
        let mut areas = 0;
        for (i, table) in tables.into_iter().enumerate() {
            let key = |name: &str| format!("occlusion[{i}].{name}");
            let name = Name::try_from(table.name.as_str());
            let name = name.map_err(|_| {
                self.document
                    .refuse(&key("name"), &table.name, "at most 32 bytes")
            })?;
            let is_empty = table.parts.is_empty() && table.mask.is_none();
            let (found, allowed) = ("a list of 0", "1 to 8 parts, or a mask");
            self.hold(!is_empty, &key("parts"), found, allowed)?;
            let mask = table
                .mask
                .map(|mask| self.mask(&key("mask"), &mask, camera));
            let mask = mask.transpose()?;
            areas += mask.map_or(0, |mask| mask.areas().len());
            let allowed = "at most 32 areas in all masks together";
            self.hold(areas <= MAX_AREAS, &key("mask"), areas, allowed)?;
            let parts = table.parts.into_iter().collect();
            // The schema allows no more than there is room for.
            let _ = occlusions.push(Occlusion {
                name,
                parts,
                mask,
                grasped: table.grasped,
                on_lens: table.on_lens,
                crossable: table.crossable,
            });
            let grasped = occlusions.iter().filter(|one| one.grasped).count();
            let allowed = "true in one occlusion, the one in the gripper";
            self.hold(grasped <= 1, &key("grasped"), true, allowed)?;
        }
        Ok(occlusions)
    }

    fn arm(&self, name: Option<&str>) -> Result<Option<Arm>, FileError> {
        let directory = Path::new(self.path).parent().unwrap_or(Path::new(""));
        let read = |name: &str| crate::arm::parse(name, directory, self.beside);
        name.map(read).transpose()
    }

    fn mask(&self, key: &str, mask: &str, camera: &Camera) -> Result<Mask, FileError> {
        let bytes = (self.beside)(mask).map_err(MaskError::Read);
        let (width, height) = (camera.width as u32, camera.height as u32);
        let read = bytes.and_then(|bytes| Mask::decode(&bytes, width, height));
        read.map_err(|reason| FileError::Syntax {
            path: self.path.to_owned(),
            message: format!(
                "{key} = \"{}\": {reason}",
                beside(self.path, mask).display()
            ),
        })
    }
}
#[cfg(test)]
mod tests {
    use super::*;

    fn edited(from: &str, to: &str) -> String {
        assert!(crate::PAPER_SIM.contains(from), "{from}");
        let text = crate::PAPER_SIM.replacen(from, to, 1);
        Scene::parse(&text, "s.toml").unwrap_err().to_string()
    }

    #[test]
    fn the_papers_scenes_are_valid() {
        let sim = Scene::parse(crate::PAPER_SIM, "sim").unwrap();
        assert_eq!((sim.camera.width, sim.parts().count()), (1024.0, 6));
        let robot = Scene::parse(crate::PAPER_ROBOT, "robot").unwrap();
        assert_eq!((robot.camera.height, robot.limits.linear), (480.0, 0.01));
        let sizes = [sim, robot].map(|scene| (scene.marker_size, scene.has_marker_size));
        assert_eq!(sizes, [(0.0, true); 2]);
    }

    #[test]
    fn the_scene_of_the_tags_is_the_papers_with_markers() {
        let tags = Scene::parse(crate::TAGS_ROBOT, "tags").unwrap();
        assert_eq!(tags.marker_size, 0.03);
        let mut points = tags.clone();
        points.marker_size = 0.0;
        assert_eq!(points, Scene::parse(crate::PAPER_ROBOT, "robot").unwrap());
        assert_eq!(tags.fingerprint(), points.fingerprint());
    }

    #[test]
    fn the_key_grasped_changes_no_fingerprint() {
        let robot = Scene::parse(crate::PAPER_ROBOT, "robot").unwrap();
        assert_eq!(
            robot
                .occlusions
                .iter()
                .map(|one| one.grasped)
                .collect::<Vec<_>>(),
            [false, true]
        );
        assert!(robot.occlusions[0].on_lens && !robot.occlusions[1].on_lens);
        let (head, tail) = crate::PAPER_ROBOT.split_once("grasped = true").unwrap();
        let without = Scene::parse(&format!("{head}{tail}"), "robot").unwrap();
        assert!(without.occlusions.iter().all(|one| !one.grasped));
        assert_eq!(robot.fingerprint(), without.fingerprint());
        let spot = "name = \"spot on the lens\"";
        let two = crate::PAPER_ROBOT.replace(spot, &format!("{spot}\ngrasped = true"));
        assert_eq!(
            Scene::parse(&two, "r.toml").unwrap_err().to_string(),
            "r.toml: occlusion[1].grasped = true; allowed: true in one occlusion, the one in the gripper"
        );
    }

    #[test]
    fn a_refusal_names_file_key_value_and_range() {
        for (from, to, words) in [
            ("fx = 800.0", "fx = nan", ["camera.fx", "NaN", "10 to 1e5"]),
            (
                "linear = 0.5",
                "linear = -0.5",
                ["limits.linear", "-0.5", "1e-6 to 10"],
            ),
            (
                "linear = 0.5",
                "linear = 0.5\nlinear_acceleration = 0.09",
                ["limits.linear_acceleration", "0.09", "at least 0.1,"],
            ),
            (
                "linear = 0.5",
                "linear = 0.5\nangular_acceleration = inf",
                ["limits.angular_acceleration", "inf", "1e-6 to 1e4"],
            ),
            (
                "time_s = 15.0",
                "time_s = inf",
                ["success.time_s", "inf", "0.1 to 3600"],
            ),
            (
                "p = 8.0",
                "p = 0.5",
                ["occlusion[0].parts[0].p", "0.5", "1 to 64"],
            ),
            (
                "width = 1024",
                "width = 3",
                ["camera.width", "3", "16 to 16384"],
            ),
            (
                "[0.15, -0.15, 0.0]",
                "[0.15, -0.15, 0.1]",
                ["pattern.points[1][2]", "0.1", "planar"],
            ),
            (
                "marker_size = 0.0",
                "marker_size = 30",
                ["pattern.marker_size", "30", "0 to 1 m"],
            ),
        ] {
            let message = edited(from, to);
            assert!(message.starts_with("s.toml: "), "{message}");
            assert!(words.iter().all(|word| message.contains(word)), "{message}");
        }
    }

    #[test]
    fn unknown_missing_and_mistyped_keys_are_refused() {
        assert!(edited("fx = 800.0", "fx = 800.0\nskew = 0.0").contains("skew"));
        assert!(edited("fy = 800.0\n", "").contains("fy"));
        assert!(edited("fy = 800.0", "fy = \"far\"").contains("line 11"));
        let (head, tail) = crate::PAPER_SIM.split_once("[cost]").unwrap();
        let (_, tail) = tail.split_once("\n[").unwrap();
        let message = Scene::parse(&format!("{head}[{tail}"), "s.toml").unwrap_err();
        assert_eq!(
            message.to_string(),
            "s.toml: cost is missing; allowed: a table with k_q, r"
        );
    }

    #[test]
    fn markers_of_unknown_size_are_points_and_not_said_to_be() {
        let text = crate::PAPER_SIM.replacen("marker_size = 0.0", "", 1);
        let scene = Scene::parse(&text, "s").unwrap();
        assert_eq!((scene.marker_size, scene.has_marker_size), (0.0, false));
    }

    #[test]
    fn three_points_on_a_line_are_no_pattern() {
        let message = edited("[-0.15, 0.15, 0.0]]", "[0.15, 0.0, 0.0]]");
        assert!(
            message.contains("no three of which lie on a line"),
            "{message}"
        );
    }

    #[test]
    fn the_fingerprint_sees_the_task_and_only_the_task() {
        let base = Scene::parse(crate::PAPER_SIM, "s").unwrap().fingerprint();
        let with = |from: &str, to: &str| {
            assert!(crate::PAPER_SIM.contains(from));
            Scene::parse(&crate::PAPER_SIM.replacen(from, to, 1), "s")
                .unwrap()
                .fingerprint()
        };
        assert_ne!(base, with("linear = 0.5", "linear = 0.4"));
        assert_ne!(base, with("half = [75.0, 75.0]", "half = [75.0, 76.0]"));
        assert_eq!(base, with("L, left", "left L"));
        assert_eq!(base, with("time_s = 15.0", "time_s = 20.0"));
        assert_eq!(
            base,
            with("[limits]", "[limits]\nlinear_acceleration = 1.0")
        );
        assert_eq!(base, with("marker_size = 0.0", "marker_size = 0.03"));
        assert_eq!(base, with("marker_size = 0.0", ""));
    }
}
