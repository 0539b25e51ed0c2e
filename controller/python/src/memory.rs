//! The memory of motion: built, loaded, asked.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use ::vpc::{DOF, MAX_POINTS, Task};
use memory_blob::{MemoryFile, OpenError, hex};
use memory_builder::build;
use memory_builder::memory;
use memory_builder::progress::Progress;
use memory_builder::settings::{BuildSettings, RegressionSettings};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::scene::Scene;
use crate::{array, error};

/// A memory of motion: trajectories of one scene, solved off line. It never changes.
#[pyclass(frozen, module = "vpc")]
pub struct Memory {
    /// As the crates have it.
    pub file: Arc<MemoryFile>,
    name: String,
    bytes: Vec<u8>,
    task: Task,
}

/// The answer of a memory to some image points.
#[pyclass(frozen, module = "vpc")]
pub struct Recall {
    answer: Vec<f64>,
    variance: Option<Vec<f64>>,
    /// Indices of the samples that k-NN averaged, nearest first; empty for the Gaussian process.
    #[pyo3(get)]
    samples: Vec<usize>,
    /// Distance of the nearest sample, in scaled inputs; None for the Gaussian process.
    #[pyo3(get)]
    distance: Option<f64>,
    /// Greatest correlation of the points with a sample, 0 to 1: near 0 the process knows nothing
    /// there, and its mean is no motion and the goal. None for k-NN.
    #[pyo3(get)]
    correlation: Option<f64>,
}

impl Memory {
    /// Opens a file that was built for the task of this scene.
    fn open(path: &Path, name: String, scene: &Scene) -> PyResult<Self> {
        let unread = |source| {
            error::open(OpenError::Read {
                path: name.clone(),
                source,
            })
        };
        let fingerprint = scene.scene.fingerprint();
        let file = MemoryFile::open(path, Some(fingerprint.bytes())).map_err(error::open)?;
        Ok(Self {
            file: Arc::new(file),
            bytes: std::fs::read(path).map_err(unread)?,
            task: scene.task()?,
            name,
        })
    }

    /// Refuses a memory of another scene.
    ///
    /// # Errors
    /// `ValueError` with both fingerprints.
    pub fn belongs_to(&self, scene: &Scene) -> PyResult<()> {
        let (found, fingerprint) = (self.file.task(), scene.scene.fingerprint());
        let expected = fingerprint.bytes();
        if found == expected {
            return Ok(());
        }
        Err(error::open(OpenError::Task {
            path: self.name.clone(),
            found: hex(found),
            expected: hex(expected),
        }))
    }

    /// The input x = (s, area, angle) of these points.
    fn input(&self, points: &Bound<'_, PyAny>) -> PyResult<impl AsRef<[f64]>> {
        let points = array::rows("points", points, Some(self.task.goal.len()))?;
        Ok(self.task.recall_input(&points))
    }

    /// Room for an output y = (v, way point).
    fn output(&self) -> Vec<f64> {
        vec![0.0; DOF + 2 * self.task.goal.len().min(MAX_POINTS)]
    }
}

/// Collects trajectories; Ctrl-C, or an exception of `report`, ends it after the batch of starts
/// that is being tried.
fn collect(
    py: Python<'_>,
    scene: &::scene::Scene,
    settings: &BuildSettings,
    report: Option<&Py<PyAny>>,
) -> PyResult<Progress> {
    let (stop, mut raised) = (AtomicBool::new(false), None);
    let tell = |progress: &Progress| {
        Python::attach(|py| {
            py.check_signals()?;
            let told = (progress.trajectories.len(), progress.tried);
            report.map_or(Ok(()), |report| report.call1(py, told).map(|_| ()))
        })
    };
    let progress = py.detach(|| {
        build::collect(
            scene,
            settings,
            Progress::default(),
            &stop,
            &mut |progress| {
                raised = tell(progress).err();
                stop.store(raised.is_some(), Ordering::Relaxed);
            },
        )
    });
    match raised {
        Some(exception) => Err(exception),
        None => progress.map_err(error::value),
    }
}

#[pymethods]
impl Memory {
    /// Opens a memory file, verifies all of it, and that it was built for this scene. Raises
    /// OSError if it cannot be read, and ValueError if it is not intact or of another scene.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf, scene: &Scene) -> PyResult<Self> {
        py.detach(|| Self::open(&path, path.display().to_string(), scene))
    }

    /// Builds a memory: solves the scene from random starts until so many `trajectories` arrive,
    /// and fits the Gaussian process; with `variance`, its factor is kept for variances. The same
    /// arguments give the same memory, that of `vpc-memory build`. All cores work, and other
    /// threads of Python go on.
    ///
    /// `progress(found, tried)` is called after each batch of 32 starts: trajectories found, starts
    /// tried. Ctrl-C, or an exception of `progress`, ends the build after such a batch.
    ///
    /// Raises ValueError if a number is out of range, or the scene leaves nothing to build.
    #[staticmethod]
    #[pyo3(signature = (scene, trajectories=50, seed=1, *, variance=false, progress=None))]
    fn build(
        py: Python<'_>,
        scene: &Scene,
        trajectories: usize,
        seed: u64,
        variance: bool,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let settings = BuildSettings {
            trajectories,
            seed,
            regression: RegressionSettings {
                variance,
                ..RegressionSettings::default()
            },
            ..BuildSettings::default()
        };
        toml_schema::check(&settings).map_err(error::value)?;
        let task = scene.task()?;
        let found = collect(py, &scene.scene, &settings, progress.as_ref())?;
        let memory = py.detach(|| {
            let contents = memory::contents(&scene.scene, &task, &settings, &found);
            // A memory is a file: it is sealed and verified as it is opened.
            let place = tempfile::tempdir().map_err(|source| error::os(&source, &source))?;
            let path = place.path().join("memory");
            contents
                .map_err(error::value)?
                .write(&path)
                .map_err(error::write)?;
            Self::open(&path, format!("{trajectories}@{seed}"), scene)
        })?;
        py.check_signals()?;
        Ok(memory)
    }

    /// Writes the memory to a file, which `vpcd` takes; one of this name is replaced, a folder that
    /// is missing is made. Raises OSError.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| program::replace(&path, &self.bytes))
            .map_err(|source| {
                let path = path.display().to_string();
                error::os(
                    format!("{path}: cannot write the memory: {source}"),
                    &source,
                )
            })
    }

    /// Number of samples.
    fn __len__(&self) -> usize {
        self.file.view().samples().len()
    }

    /// The mean of the `k` nearest samples of some image points (px, shape (N, 2)): the paper's
    /// k-NN, as the memory has it. The law clamps it to limits and image before it uses it. Raises
    /// ValueError for another shape, a number that is not finite, or a `k` out of range.
    #[pyo3(signature = (points, k=1))]
    fn neighbours(&self, points: &Bound<'_, PyAny>, k: usize) -> PyResult<Recall> {
        let (input, mut answer) = (self.input(points)?, self.output());
        let samples = self.file.view().samples();
        let nearest = samples.nearest(input.as_ref(), k, &mut answer);
        let nearest = nearest.map_err(error::value)?;
        Ok(Recall {
            answer,
            variance: None,
            samples: nearest.indices().to_vec(),
            distance: Some(nearest.distance()),
            correlation: None,
        })
    }

    /// The mean of the Gaussian process at some image points (px, shape (N, 2)), and its variance
    /// if the memory has its factor. Raises ValueError for another shape, a number that is not
    /// finite, or a memory without a process.
    fn gaussian_process(&self, points: &Bound<'_, PyAny>) -> PyResult<Recall> {
        let (input, mut answer) = (self.input(points)?, self.output());
        let Some(process) = self.file.view().gpr() else {
            let message = format!(
                "{}: no Gaussian process; allowed: a memory with one",
                self.name
            );
            return Err(error::value(message));
        };
        let correlation = process.mean(input.as_ref(), &mut answer);
        let correlation = correlation.map_err(error::value)?;
        let variance = process.has_variance().then(|| {
            let (mut scratch, mut variance) = (vec![0.0; process.len()], self.output());
            let done = process.variance(input.as_ref(), &mut scratch, &mut variance);
            done.map(|()| variance)
        });
        Ok(Recall {
            answer,
            variance: variance.transpose().map_err(error::value)?,
            samples: Vec::new(),
            distance: None,
            correlation: Some(correlation),
        })
    }

    fn __repr__(&self) -> String {
        format!("Memory({:?}, {} samples)", self.name, self.__len__())
    }
}

/// The second part of y = (v, way point), shape (N, 2).
fn points_of<'py>(py: Python<'py>, output: &[f64]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    array::of_rows(py, output[DOF..].as_chunks::<2>().0)
}

#[pymethods]
impl Recall {
    /// Camera twist: linear m/s, angular rad/s, camera frame, shape (6,).
    #[getter]
    fn twist<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        array::of_vector(py, &self.answer[..DOF])
    }

    /// Image points to track first, px, shape (N, 2).
    #[getter]
    fn way_point<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        points_of(py, &self.answer)
    }

    /// Variance of each component of the twist without the noise, (m/s)^2 and (rad/s)^2, shape
    /// (6,); None for k-NN, and where the memory has no factor.
    #[getter]
    fn twist_variance<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        let variance = self.variance.as_ref()?;
        Some(array::of_vector(py, &variance[..DOF]))
    }

    /// Variance of the way point without the noise, px^2, shape (N, 2); None as `twist_variance`.
    #[getter]
    fn way_point_variance<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let variance = self.variance.as_ref();
        variance.map(|variance| points_of(py, variance)).transpose()
    }
}
