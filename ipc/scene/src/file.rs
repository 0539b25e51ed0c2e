//! Reading a scene file: TOML into raw numbers, then checked into a [`Scene`].

use std::path::Path;

use crate::error::SceneError;
use crate::mask::picture::{self, MaskError};
use crate::mask::{MAX_AREAS, Mask};
use crate::model::*;
use crate::raw::*;

impl Scene {
    /// Reads and checks a scene file.
    ///
    /// # Errors
    /// [`SceneError`] names the file, the key, the value and what is allowed.
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|source| SceneError::Read {
            path: name.clone(),
            source,
        })?;
        Self::parse(&text, &name)
    }

    /// Checks the text of a scene file; `path` is for messages, and masks are looked for beside it.
    ///
    /// # Errors
    /// As [`Scene::read`].
    pub fn parse(text: &str, path: &str) -> Result<Self, SceneError> {
        let directory = Path::new(path).parent().unwrap_or(Path::new(""));
        Self::parse_with(text, path, &|mask| std::fs::read(directory.join(mask)))
    }

    /// As [`Scene::parse`], with masks from elsewhere: `masks` gives the bytes of the PNG file of each name in the text.
    ///
    /// # Errors
    /// As [`Scene::read`].
    pub fn parse_with(
        text: &str,
        path: &str,
        masks: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
    ) -> Result<Self, SceneError> {
        let raw: RawScene = toml::from_str(text).map_err(|e| SceneError::Syntax {
            path: path.to_owned(),
            message: e.to_string().trim_end().to_owned(),
        })?;
        Checker { path, masks }.scene(raw)
    }
}

/// Turns raw tables into checked ones; every refusal carries the file's name.
struct Checker<'a> {
    path: &'a str,
    masks: &'a dyn Fn(&str) -> std::io::Result<Vec<u8>>,
}

impl Checker<'_> {
    fn refuse(&self, key: &str, value: impl ToString, allowed: &'static str) -> SceneError {
        let (path, key, value) = (self.path.to_owned(), key.to_owned(), value.to_string());
        SceneError::Value {
            path,
            key,
            value,
            allowed,
        }
    }

    fn number(
        &self,
        key: &str,
        value: f64,
        range: std::ops::RangeInclusive<f64>,
        allowed: &'static str,
    ) -> Result<f64, SceneError> {
        if range.contains(&value) {
            Ok(value)
        } else {
            Err(self.refuse(key, value, allowed))
        }
    }

    fn numbers<const N: usize>(
        &self,
        key: &str,
        values: [f64; N],
        range: std::ops::RangeInclusive<f64>,
        allowed: &'static str,
    ) -> Result<[f64; N], SceneError> {
        if values.iter().all(|x| range.contains(x)) {
            Ok(values)
        } else {
            Err(self.refuse(key, format!("{values:?}"), allowed))
        }
    }

    fn list<T, const N: usize>(
        &self,
        key: &str,
        items: Vec<T>,
        least: usize,
        allowed: &'static str,
    ) -> Result<heapless::Vec<T, N>, SceneError> {
        let count = items.len();
        if count < least || count > N {
            return Err(self.refuse(key, format!("a list of {count}"), allowed));
        }
        Ok(items.into_iter().collect())
    }

    fn scene(&self, raw: RawScene) -> Result<Scene, SceneError> {
        let scene = Scene {
            camera: self.camera(&raw.camera)?,
            pattern: self.pattern(raw.pattern)?,
            goal: self.goal(&raw.goal)?,
            limits: Limits {
                linear: self.number(
                    "limits.linear",
                    raw.limits.linear,
                    1e-6..=10.0,
                    "1e-6 to 10 m/s",
                )?,
                angular: self.number(
                    "limits.angular",
                    raw.limits.angular,
                    1e-6..=30.0,
                    "1e-6 to 30 rad/s",
                )?,
            },
            cost: Cost {
                k_q: self.number(
                    "cost.k_q",
                    raw.cost.k_q,
                    1e-12..=1e6,
                    "1e-12 to 1e6 (1/px^2)",
                )?,
                r: self.numbers("cost.r", raw.cost.r, 0.0..=1e9, "six numbers, 0 to 1e9")?,
            },
            success: self.success(&raw.success)?,
            starts: self.starts(&raw.starts)?,
            occlusions: self.occlusions(raw.occlusion, &raw.camera)?,
        };
        self.goal_in_view(&scene)?;
        Ok(scene)
    }

    fn camera(&self, raw: &RawCamera) -> Result<Camera, SceneError> {
        let pixels = "16 to 16384 px";
        let focal = "10 to 1e5 px";
        let centre = "inside the image";
        let (width, height) = (f64::from(raw.width), f64::from(raw.height));
        Ok(Camera {
            width: self.number("camera.width", width, 16.0..=16384.0, pixels)?,
            height: self.number("camera.height", height, 16.0..=16384.0, pixels)?,
            fx: self.number("camera.fx", raw.fx, 10.0..=1e5, focal)?,
            fy: self.number("camera.fy", raw.fy, 10.0..=1e5, focal)?,
            cx: self.number("camera.cx", raw.cx, 0.0..=width, centre)?,
            cy: self.number("camera.cy", raw.cy, 0.0..=height, centre)?,
            rate_hz: self.number("camera.rate_hz", raw.rate_hz, 1.0..=1000.0, "1 to 1000 Hz")?,
        })
    }

    fn pattern(&self, raw: RawPattern) -> Result<heapless::Vec<[f64; 3], MAX_POINTS>, SceneError> {
        for (i, point) in raw.points.iter().enumerate() {
            let key = format!("pattern.points[{i}]");
            self.numbers(&key, *point, -10.0..=10.0, "three numbers, -10 to 10 m")?;
            self.number(
                &format!("{key}[2]"),
                point[2],
                0.0..=0.0,
                "0: the pattern is planar",
            )?;
        }
        let points: heapless::Vec<[f64; 3], MAX_POINTS> =
            self.list("pattern.points", raw.points, MIN_POINTS, "4 to 8 points")?;
        // Four points no three of which lie on a line are what a homography needs.
        let crosses_over = |a: usize, b: usize, c: usize| {
            let (p, q, r) = (points[a], points[b], points[c]);
            ((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])).abs() > 1e-9
        };
        let n = points.len();
        let general = (0..n).any(|a| {
            (a + 1..n).any(|b| {
                (b + 1..n).any(|c| {
                    crosses_over(a, b, c)
                        && (0..n).any(|d| {
                            ![a, b, c].contains(&d)
                                && crosses_over(a, b, d)
                                && crosses_over(a, c, d)
                                && crosses_over(b, c, d)
                        })
                })
            })
        });
        if !general {
            let allowed = "four points among them, no three of which lie on a line";
            return Err(self.refuse("pattern.points", format!("{points:?}"), allowed));
        }
        Ok(points)
    }

    fn goal(&self, raw: &RawPose) -> Result<Pose, SceneError> {
        let pi = std::f64::consts::PI;
        let metres = "three numbers, -100 to 100 m";
        self.number(
            "goal.translation[2]",
            raw.translation[2],
            1e-3..=100.0,
            "0.001 to 100 m",
        )?;
        Ok(Pose {
            translation: self.numbers(
                "goal.translation",
                raw.translation,
                -100.0..=100.0,
                metres,
            )?,
            rotation: self.numbers(
                "goal.rotation",
                raw.rotation,
                -pi..=pi,
                "three numbers, -pi to pi rad",
            )?,
        })
    }

    fn success(&self, raw: &RawSuccess) -> Result<Success, SceneError> {
        let violation = self.number(
            "success.violation_px",
            raw.violation_px,
            0.0..=1e4,
            "0 to 1e4 px",
        )?;
        let convergence = self.number(
            "success.convergence_px",
            raw.convergence_px,
            1e-6..=1e4,
            "1e-6 to 1e4 px",
        )?;
        let time = self.number("success.time_s", raw.time_s, 0.1..=3600.0, "0.1 to 3600 s")?;
        Ok(Success {
            violation_px: violation,
            convergence_px: convergence,
            time_s: time,
        })
    }

    fn starts(&self, raw: &RawStarts) -> Result<StartRegion, SceneError> {
        let metres = "three numbers, -100 to 100 m";
        let min = self.numbers(
            "starts.translation_min",
            raw.translation_min,
            -100.0..=100.0,
            metres,
        )?;
        let max = self.numbers(
            "starts.translation_max",
            raw.translation_max,
            -100.0..=100.0,
            metres,
        )?;
        if min.iter().zip(&max).any(|(a, b)| a > b) {
            let value = format!("{max:?}");
            return Err(self.refuse(
                "starts.translation_max",
                value,
                "at least starts.translation_min",
            ));
        }
        self.number(
            "starts.translation_min[2]",
            min[2],
            1e-3..=100.0,
            "0.001 to 100 m",
        )?;
        Ok(StartRegion {
            translation_min: min,
            translation_max: max,
            tilt_max: self.number("starts.tilt_max", raw.tilt_max, 0.0..=1.5, "0 to 1.5 rad")?,
            roll_max: self.number(
                "starts.roll_max",
                raw.roll_max,
                0.0..=std::f64::consts::PI,
                "0 to pi rad",
            )?,
            clearance_px: self.number(
                "starts.clearance_px",
                raw.clearance_px,
                0.0..=1e4,
                "0 to 1e4 px",
            )?,
            min_error_px: self.number(
                "starts.min_error_px",
                raw.min_error_px,
                0.0..=1e4,
                "0 to 1e4 px",
            )?,
        })
    }

    fn occlusions(
        &self,
        raw: Vec<RawOcclusion>,
        camera: &RawCamera,
    ) -> Result<heapless::Vec<Occlusion, MAX_OCCLUSIONS>, SceneError> {
        let mut occlusions = Vec::with_capacity(raw.len());
        let mut areas = 0;
        for (i, occlusion) in raw.into_iter().enumerate() {
            let key = format!("occlusion[{i}]");
            let name = Name::try_from(occlusion.name.as_str()).map_err(|_| {
                self.refuse(&format!("{key}.name"), &occlusion.name, "at most 32 bytes")
            })?;
            for (j, part) in occlusion.parts.iter().enumerate() {
                let key = format!("{key}.parts[{j}]");
                let pixels = "two numbers, -1e5 to 1e5 px";
                self.numbers(&format!("{key}.center"), part.center, -1e5..=1e5, pixels)?;
                self.numbers(
                    &format!("{key}.half"),
                    part.half,
                    1e-3..=1e5,
                    "two numbers, 0.001 to 1e5 px",
                )?;
                self.number(&format!("{key}.p"), part.p, 1.0..=64.0, "1 to 64")?;
            }
            let parts: Vec<Part> = occlusion
                .parts
                .iter()
                .map(|part| Part {
                    center: part.center,
                    half: part.half,
                    p: part.p,
                })
                .collect();
            let (least, allowed) = match occlusion.mask {
                Some(_) => (0, "0 to 8 parts beside a mask"),
                None => (1, "1 to 8 parts, or a mask"),
            };
            let parts = self.list(&format!("{key}.parts"), parts, least, allowed)?;
            let mask = occlusion
                .mask
                .map(|mask| self.mask(&format!("{key}.mask"), &mask, camera))
                .transpose()?;
            areas += mask.map_or(0, |mask| mask.areas().len());
            if areas > MAX_AREAS {
                let allowed = "at most 32 areas in all masks together";
                return Err(self.refuse(&format!("{key}.mask"), areas, allowed));
            }
            occlusions.push(Occlusion { name, parts, mask });
        }
        self.list("occlusion", occlusions, 0, "0 to 12 occlusions")
    }

    fn mask(&self, key: &str, mask: &str, camera: &RawCamera) -> Result<Mask, SceneError> {
        let directory = Path::new(self.path).parent().unwrap_or(Path::new(""));
        let bytes = (self.masks)(mask).map_err(MaskError::Read);
        let read = bytes.and_then(|bytes| picture::decode(&bytes, camera.width, camera.height));
        read.map_err(|reason| SceneError::Mask {
            path: self.path.to_owned(),
            key: key.to_owned(),
            mask: directory.join(mask).display().to_string(),
            reason: reason.to_string(),
        })
    }

    /// A goal whose points lie behind the camera cannot be seen; where they fall on the image is for the
    /// mathematics of each side.
    fn goal_in_view(&self, scene: &Scene) -> Result<(), SceneError> {
        let reach = scene
            .pattern
            .iter()
            .map(|p| p[0].hypot(p[1]))
            .fold(0.0, f64::max);
        let tilt = scene.goal.rotation[0]
            .hypot(scene.goal.rotation[1])
            .min(1.6)
            .sin();
        let nearest = scene.goal.translation[2] - reach * tilt;
        if nearest <= 0.0 {
            let value = scene.goal.translation[2];
            return Err(self.refuse(
                "goal.translation[2]",
                value,
                "far enough that every point of the pattern is in front of the camera",
            ));
        }
        Ok(())
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
        assert!(edited("fy = 800.0", "fy = \"far\"").contains("line 10"));
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
    }
}
