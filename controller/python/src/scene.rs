//! The scene: camera, pattern, goal, limits, occlusions.

use std::path::PathBuf;

use ::scene as files;
use hw_sim::Referee;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use vpc::Task;

use crate::{array, error};

/// The scenes of this repository, by name.
const BUILT_IN: [(&str, &str); 3] = [
    ("paper-sim", files::PAPER_SIM),
    ("paper-robot", files::PAPER_ROBOT),
    ("tags-robot", files::TAGS_ROBOT),
];

/// What law, memory and referee agree on: camera, pattern, goal, limits, occlusions, what counts as
/// success, and the region of random starts. A scene never changes.
#[pyclass(frozen, module = "vpc")]
pub struct Scene {
    /// As the crates have it.
    pub scene: files::Scene,
    name: String,
}

/// An occlusion of the image.
#[derive(IntoPyObject)]
pub struct Occlusion {
    name: String,
    crossable: bool,
    /// Center u, v and half axes u, v, px, and the exponent p of each part.
    parts: Vec<(f64, f64, f64, f64, f64)>,
}

impl Scene {
    fn of(scene: Result<files::Scene, files::FileError>, name: String) -> PyResult<Self> {
        let scene = scene.map_err(error::file)?;
        // Every scene gives a task, or an error that says why it does not.
        Task::new(&scene).map_err(error::value)?;
        Ok(Self { scene, name })
    }

    /// Joints of its arm; 0 without.
    pub fn joints(&self) -> usize {
        self.scene.arm.as_ref().map_or(0, |arm| arm.joints.len())
    }

    /// The task of the law.
    ///
    /// # Errors
    /// `ValueError`, which no scene that was read gives.
    pub fn task(&self) -> PyResult<Task> {
        Task::new(&self.scene).map_err(error::value)
    }

    /// A start pose from an array-like of shape (6,).
    ///
    /// # Errors
    /// `ValueError` if a number is not finite, or the object is behind the camera.
    pub fn pose(name: &str, pose: [f64; 6]) -> PyResult<files::Pose> {
        let [tx, ty, tz, rx, ry, rz] = pose;
        if !pose.iter().all(|x| x.is_finite()) || tz <= 0.0 {
            let allowed = "six finite numbers tx, ty, tz (m), rx, ry, rz (rad), tz > 0";
            return Err(error::value(format!(
                "{name} = {pose:?}; allowed: {allowed}"
            )));
        }
        Ok(files::Pose {
            translation: [tx, ty, tz],
            rotation: [rx, ry, rz],
        })
    }
}

/// A pose as (tx, ty, tz, rx, ry, rz): m and rad.
pub fn numbers(pose: &files::Pose) -> [f64; 6] {
    let ([tx, ty, tz], [rx, ry, rz]) = (pose.translation, pose.rotation);
    [tx, ty, tz, rx, ry, rz]
}

#[pymethods]
impl Scene {
    /// Reads a scene file (TOML) and what it names.
    ///
    /// Raises OSError if a file cannot be read, and ValueError, which names file, key, value and
    /// what is allowed.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        Self::of(files::Scene::read(&path), path.display().to_string())
    }

    /// Reads the text of a scene file; `path` is for messages, and the files that it names are
    /// looked for beside it. Raises as `load`.
    #[staticmethod]
    #[pyo3(signature = (text, path="scene.toml"))]
    fn parse(text: &str, path: &str) -> PyResult<Self> {
        Self::of(files::Scene::parse(text, path), path.to_owned())
    }

    /// A scene of the repository: "paper-sim", "paper-robot" or "tags-robot". Raises ValueError for
    /// another name.
    #[staticmethod]
    fn built_in(name: &str) -> PyResult<Self> {
        let Some((_, text)) = BUILT_IN.iter().find(|(known, _)| *known == name) else {
            let known = BUILT_IN.map(|(known, _)| known).join(", ");
            return Err(error::value(format!("scene `{name}`; allowed: {known}")));
        };
        Self::of(files::Scene::parse(text, name), name.to_owned())
    }

    /// The same scene with the arm of another file (TOML, such as `ipc/scene/scenes/panda.toml`);
    /// None: without an arm. A memory of one is a memory of the other. Raises as `load`.
    fn with_arm(&self, path: Option<PathBuf>) -> PyResult<Self> {
        let arm = path.map(|path| files::Arm::read(&path)).transpose();
        let mut scene = self.scene.clone();
        scene.arm = arm.map_err(error::file)?;
        Self::of(Ok(scene), self.name.clone())
    }

    /// Least and greatest position (rad), speed (rad/s) and acceleration (rad/s^2) of each joint of
    /// its arm, base to camera, shape (J, 4), with m in place of rad where one slides; None without
    /// an arm.
    #[getter]
    fn joint_limits<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let limits = self.scene.arm.as_ref().map(|arm| {
            let joints = arm.joints.iter();
            let each = joints.map(|it| [it.range[0], it.range[1], it.velocity, it.acceleration]);
            each.collect::<Vec<_>>()
        });
        limits.map(|limits| array::of_rows(py, &limits)).transpose()
    }

    /// Its path, or the name of a built-in one.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// Width and height of the image, px.
    #[getter]
    fn size(&self) -> (f64, f64) {
        let camera = &self.scene.camera;
        (camera.width, camera.height)
    }

    /// Focal lengths fx and fy, px.
    #[getter]
    fn focal(&self) -> (f64, f64) {
        let camera = &self.scene.camera;
        (camera.fx, camera.fy)
    }

    /// Principal point cx and cy, px.
    #[getter]
    fn center(&self) -> (f64, f64) {
        let camera = &self.scene.camera;
        (camera.cx, camera.cy)
    }

    /// Rate of the camera, Hz.
    #[getter]
    fn rate_hz(&self) -> f64 {
        self.scene.camera.rate_hz
    }

    /// Points of the pattern in the object's frame, m, shape (N, 3).
    #[getter]
    fn pattern<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        array::of_rows(py, &self.scene.pattern)
    }

    /// Image points of the pattern at the goal (u right, v down), px, shape (N, 2).
    #[getter]
    fn goal<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        array::of_rows(py, Referee::new(&self.scene).goal())
    }

    /// Pose of the object in the camera frame at the goal: tx, ty, tz (m), rx, ry, rz (rotation
    /// vector, rad), shape (6,).
    #[getter]
    fn goal_pose<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        array::of_vector(py, &numbers(&self.scene.goal))
    }

    /// Largest magnitude of each component of a twist, m/s and rad/s, shape (6,).
    #[getter]
    fn velocity_limits<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        array::of_vector(py, &self.scene.limits.velocity())
    }

    /// Largest change of each component of a twist in a second, m/s^2 and rad/s^2, shape (6,);
    /// infinite without such a limit.
    #[getter]
    fn acceleration_limits<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        array::of_vector(py, &self.scene.limits.acceleration())
    }

    /// Time in which a run must arrive, s.
    #[getter]
    fn time_s(&self) -> f64 {
        self.scene.success.time_s
    }

    /// Largest component of the distance from the goal at which a run has arrived, px.
    #[getter]
    fn convergence_px(&self) -> f64 {
        self.scene.success.convergence_px
    }

    /// Regions that points must not enter, each with the parts |u/hu|^p + |v/hv|^p <= 1 about their
    /// centers. Painted areas are not among them.
    #[getter]
    fn occlusions(&self) -> Vec<Occlusion> {
        let occlusions = self.scene.occlusions.iter().map(|one| Occlusion {
            name: one.name.to_string(),
            crossable: one.crossable,
            parts: one
                .parts
                .iter()
                .map(|part| {
                    let ([u, v], [hu, hv]) = (part.center, part.half);
                    (u, v, hu, hv, part.p)
                })
                .collect(),
        });
        occlusions.collect()
    }

    /// Draws valid start poses from the scene's region: those of `vpc-memory starts`, shape
    /// (count, 6): tx, ty, tz (m), rx, ry, rz (rad), the object in the camera frame. Raises
    /// ValueError if the region holds none.
    #[pyo3(signature = (count=100, seed=1000))]
    fn starts<'py>(
        &self,
        py: Python<'py>,
        count: usize,
        seed: u64,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let task = self.task()?;
        let drawn = py.detach(|| memory_builder::start::drawn(&self.scene, &task, count, seed));
        let starts: Vec<_> = drawn.map_err(error::value)?.iter().map(numbers).collect();
        array::of_rows(py, &starts)
    }

    fn __repr__(&self) -> String {
        format!("Scene({:?})", self.name)
    }
}

/// Reads a file of start poses (CSV: tx,ty,tz,rx,ry,rz; m and rad), shape (count, 6). Raises
/// OSError if it cannot be read, and ValueError, which names file, line and what is allowed.
#[pyfunction]
pub fn read_starts(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let starts = files::read_starts(&path).map_err(error::file)?;
    let starts: Vec<_> = starts.iter().map(numbers).collect();
    array::of_rows(py, &starts)
}
