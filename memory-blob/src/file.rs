//! A memory file: opened, verified, sealed, mapped.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use memmap2::Mmap;
use safetensors::{Dtype, SafeTensors};
use serde_json::{Map, Value};

use crate::contents::{Contents, Regression};
use crate::exp::LANES;
use crate::format::{self, ALIGNMENT, MAX_HEADER, PROBE_TOLERANCE, round_up};
use crate::gpr::OUTPUT_LANES;
use crate::samples::{BLOCK, BLOCKS_PER_GROUP};
use crate::sealed;
use crate::view::{Memory, Scaling};
use crate::{Gpr, MAX_INPUTS, MAX_OUTPUTS, Samples};

/// Why a memory file was refused.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The file could not be read, or no sealed memory was to be had.
    #[error("{path}: cannot read the memory: {source}")]
    Read {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// The file is damaged, or not a memory.
    #[error("{path}: not an intact memory: {what}")]
    Corrupt {
        /// The file.
        path: String,
        /// Which part, what was found, and what is allowed.
        what: String,
    },
    /// The file has another schema.
    #[error("{path}: schema {found}; allowed: {}", format::SCHEMA)]
    Schema {
        /// The file.
        path: String,
        /// Its schema.
        found: String,
    },
    /// The memory was built for another task.
    #[error(
        "{path}: built for another task: its fingerprint is {found}; allowed: {expected}, that of this scene (camera, \
         pattern, goal, limits, occlusions); build a memory for this scene with `vpc-memory build`"
    )]
    Task {
        /// The file.
        path: String,
        /// Fingerprint in the file.
        found: String,
        /// Fingerprint of the scene.
        expected: String,
    },
}

/// A verified memory, copied into sealed memory and mapped read-only.
#[derive(Debug)]
pub struct MemoryFile {
    map: Mmap,
    ranges: BTreeMap<String, Range<usize>>,
    metadata: BTreeMap<String, String>,
    layout: Layout,
    task: [u8; 32],
    bytes: usize,
}

/// The counts that fix all shapes.
#[derive(Clone, Copy, Debug)]
struct Layout {
    inputs: usize,
    outputs: usize,
    samples: usize,
    gpr_samples: usize,
    signal_variance: f64,
    noise_variance: f64,
}

impl MemoryFile {
    /// Opens a file and verifies all of it: structure, digests, ranges, probes, and that it was built for `task`
    /// where one is given.
    ///
    /// # Errors
    /// [`OpenError`] names the file, the part and what is allowed.
    pub fn open(path: &Path, task: Option<&[u8; 32]>) -> Result<Self, OpenError> {
        let name = path.display().to_string();
        let read = |source| OpenError::Read {
            path: name.clone(),
            source,
        };
        let bytes = std::fs::read(path).map_err(read)?;
        let corrupt = |what| OpenError::Corrupt {
            path: name.clone(),
            what,
        };
        let header = Header::parse(&bytes).map_err(corrupt)?;
        let schema = header.text("schema").map_err(corrupt)?;
        if schema != format::SCHEMA {
            return Err(OpenError::Schema {
                path: name,
                found: schema.to_owned(),
            });
        }
        header.verify(&bytes).map_err(corrupt)?;
        let layout = Layout::read(&header).map_err(corrupt)?;
        layout.check_shapes(&header).map_err(corrupt)?;
        let found = header.task().map_err(corrupt)?;
        if let Some(expected) = task
            && *expected != found
        {
            let (found, expected) = (format::hex(&found), format::hex(expected));
            return Err(OpenError::Task {
                path: name,
                found,
                expected,
            });
        }

        let (mut copy, mut ranges) = (Vec::with_capacity(bytes.len()), BTreeMap::new());
        for (tensor, (_, range)) in &header.tensors {
            copy.resize(round_up(copy.len(), ALIGNMENT), 0);
            ranges.insert(tensor.clone(), copy.len()..copy.len() + range.len());
            copy.extend_from_slice(&bytes[range.clone()]);
        }
        let map = sealed::seal(&copy).map_err(read)?;
        let file = Self {
            map,
            ranges,
            metadata: header.metadata,
            layout,
            task: found,
            bytes: bytes.len(),
        };
        file.verify_numbers().map_err(corrupt)?;
        file.verify_probes().map_err(corrupt)?;
        Ok(file)
    }

    /// Locks the mapped pages into memory, so that no query faults.
    ///
    /// # Errors
    /// The operating system's reason, where the limit on locked memory is too small.
    pub fn lock(&self) -> std::io::Result<()> {
        self.map.lock()
    }

    /// The view that queries use.
    pub fn view(&self) -> Memory<'_> {
        let l = &self.layout;
        let (n, blocks) = (l.inputs, l.samples.div_ceil(BLOCK));
        let scaling = self.scaling();
        let samples = Samples {
            scaling,
            count: l.samples,
            outputs: l.outputs,
            x: self.tensor("samples.x"),
            y: self.tensor("samples.y"),
            boxes: &self.tensor("samples.boxes")[..blocks * 2 * n],
            groups: &self.tensor("samples.groups")[..blocks.div_ceil(BLOCKS_PER_GROUP) * 2 * n],
        };
        let gpr = (l.gpr_samples > 0).then(|| Gpr {
            scaling,
            count: l.gpr_samples,
            outputs: l.outputs,
            signal_variance: l.signal_variance,
            length_scale: &self.tensor("gpr.length_scale")[..n],
            x: self.tensor("gpr.x"),
            lambda: self.tensor("gpr.lambda"),
            mean: self.tensor("gpr.mean"),
            cholesky: self.tensor("gpr.cholesky"),
        });
        Memory {
            samples: Some(samples),
            gpr,
        }
    }

    /// Fingerprint of the task that the memory was built for.
    pub fn task(&self) -> &[u8; 32] {
        &self.task
    }

    /// Size of the file, bytes.
    pub fn size(&self) -> usize {
        self.bytes
    }

    /// Where the memory comes from.
    pub fn provenance(&self) -> Map<String, Value> {
        self.metadata
            .get("provenance")
            .and_then(|text| serde_json::from_str(text).ok())
            .unwrap_or_default()
    }

    /// The noise variance phi_s of the Gaussian process.
    pub fn noise_variance(&self) -> f64 {
        self.layout.noise_variance
    }

    /// Everything in the file, as its maker knew it: samples in the order of trajectories and steps. Allocates; not
    /// for the control cycle.
    pub fn contents(&self) -> Contents {
        let l = &self.layout;
        let n = l.inputs;
        let scaling = self.scaling();
        let raw = |k: usize, x: f64| x * scaling.scale[k] + scaling.offset[k];
        let (x, origin) = (self.tensor("samples.x"), self.tensor("samples.origin"));
        let rows = origin.len() / 2;
        let mut order: Vec<usize> = (0..l.samples).collect();
        order.sort_by(|&a, &b| {
            origin[a]
                .total_cmp(&origin[b])
                .then(origin[rows + a].total_cmp(&origin[rows + b]))
        });
        let input = |i: usize| {
            let block = &x[i / BLOCK * n * BLOCK..];
            (0..n)
                .map(|k| raw(k, block[k * BLOCK + i % BLOCK]))
                .collect()
        };
        let regression = self.view().gpr().map(|gpr| Regression {
            x: (0..l.gpr_samples)
                .map(|i| {
                    let block = &gpr.x[i / LANES * n * LANES..];
                    (0..n)
                        .map(|k| raw(k, block[k * LANES + i % LANES] * gpr.length_scale[k]))
                        .collect()
                })
                .collect(),
            length_scale: gpr.length_scale.to_vec(),
            signal_variance: l.signal_variance,
            noise_variance: l.noise_variance,
            mean: gpr.mean[..l.outputs].to_vec(),
            lambda: gpr
                .lambda
                .chunks(gpr.mean.len())
                .take(l.gpr_samples)
                .map(|row| row[..l.outputs].to_vec())
                .collect(),
            cholesky: gpr
                .has_variance()
                .then(|| gpr.cholesky[..l.gpr_samples * (l.gpr_samples + 1) / 2].to_vec()),
        });
        Contents {
            task: self.task,
            offset: scaling.offset.to_vec(),
            scale: scaling.scale.to_vec(),
            x: order.iter().map(|&i| input(i)).collect(),
            y: order
                .iter()
                .map(|&i| self.tensor("samples.y")[i * l.outputs..][..l.outputs].to_vec())
                .collect(),
            trajectory: order.iter().map(|&i| origin[i] as u32).collect(),
            step: order.iter().map(|&i| origin[rows + i] as u32).collect(),
            regression,
            provenance: self.provenance(),
        }
    }

    fn scaling(&self) -> Scaling<'_> {
        let (n, n8) = (self.layout.inputs, round_up(self.layout.inputs, 8));
        let both = self.tensor("scaling");
        Scaling {
            offset: &both[..n],
            scale: &both[n8..n8 + n],
        }
    }

    fn tensor(&self, name: &str) -> &[f64] {
        self.ranges
            .get(name)
            .map_or(&[], |range| bytemuck::cast_slice(&self.map[range.clone()]))
    }

    fn verify_numbers(&self) -> Result<(), String> {
        for name in self.ranges.keys() {
            if let Some(i) = self.tensor(name).iter().position(|x| !x.is_finite()) {
                return Err(format!(
                    "tensor {name}: element {i} is not finite; allowed: finite numbers"
                ));
            }
        }
        let positive = |what: &str, values: &[f64]| match values.iter().find(|x| **x <= 0.0) {
            Some(x) => Err(format!("{what}: {x}; allowed: numbers above 0")),
            None => Ok(()),
        };
        positive("scaling: scale", self.scaling().scale)?;
        let view = self.view();
        if let Some(gpr) = view.gpr() {
            positive("gpr.length_scale", gpr.length_scale)?;
            let diagonal: Vec<f64> = (0..if gpr.has_variance() { gpr.count } else { 0 })
                .map(|i| gpr.cholesky[i * (i + 3) / 2])
                .collect();
            positive("gpr.cholesky: diagonal", &diagonal)?;
        }
        // A box that does not hold its samples would hide them from searches.
        let (l, x) = (&self.layout, self.tensor("samples.x"));
        for i in 0..l.samples {
            for k in 0..l.inputs {
                let value = x[(i / BLOCK * l.inputs + k) * BLOCK + i % BLOCK];
                for (what, rows) in [("boxes", BLOCK), ("groups", BLOCK * BLOCKS_PER_GROUP)] {
                    let limits =
                        &self.tensor(&format!("samples.{what}"))[i / rows * 2 * l.inputs..];
                    if !(limits[k]..=limits[l.inputs + k]).contains(&value) {
                        return Err(format!(
                            "samples.{what}: sample {i} lies outside its box; allowed: inside"
                        ));
                    }
                }
            }
        }
        Ok(())
    }

    fn verify_probes(&self) -> Result<(), String> {
        let l = &self.layout;
        let (n8, p8) = (round_up(l.inputs, 8), round_up(l.outputs, OUTPUT_LANES));
        let view = self.view();
        let mut answer = vec![0.0; l.outputs];
        for (i, x) in self.tensor("probes.x").chunks(n8).enumerate() {
            let x = &x[..l.inputs];
            let compare = |what: &str, asked: Result<(), crate::QueryError>, answer: &[f64]| {
                asked.map_err(|e| format!("probe {i} of {what}: {e}"))?;
                let expected = &self.tensor(&format!("probes.{what}"))[i * p8..];
                for (found, expected) in answer.iter().zip(expected) {
                    let tolerance = PROBE_TOLERANCE * (1.0 + expected.abs());
                    if (found - expected).abs() > tolerance {
                        return Err(format!(
                            "probe {i} of {what}: answer {found}; allowed: {expected}"
                        ));
                    }
                }
                Ok(())
            };
            if let Some(samples) = view.samples() {
                let asked = samples.nearest(x, 1, &mut answer).map(|_| ());
                compare("knn", asked, &answer)?;
            }
            if let Some(gpr) = view.gpr() {
                let asked = gpr.mean(x, &mut answer);
                compare("gpr", asked, &answer)?;
            }
        }
        Ok(())
    }
}

/// The header of a container: metadata, and shape and byte range of each tensor.
struct Header {
    metadata: BTreeMap<String, String>,
    tensors: BTreeMap<String, (Vec<usize>, Range<usize>)>,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let length = bytes.first_chunk::<8>().map(|b| u64::from_le_bytes(*b));
        let length = length.ok_or_else(|| format!("{} bytes; allowed: at least 8", bytes.len()))?;
        if length > MAX_HEADER as u64 {
            return Err(format!(
                "header of {length} bytes; allowed: at most {MAX_HEADER}"
            ));
        }
        let (_, metadata) =
            SafeTensors::read_metadata(bytes).map_err(|e| format!("container: {e}"))?;
        let container = SafeTensors::deserialize(bytes).map_err(|e| format!("container: {e}"))?;
        let mut tensors = BTreeMap::new();
        for (name, tensor) in container.tensors() {
            if tensor.dtype() != Dtype::F64 {
                return Err(format!(
                    "tensor {name}: type {:?}; allowed: F64",
                    tensor.dtype()
                ));
            }
            let begin = tensor.data().as_ptr() as usize - bytes.as_ptr() as usize;
            tensors.insert(
                name,
                (tensor.shape().to_vec(), begin..begin + tensor.data().len()),
            );
        }
        let metadata: BTreeMap<String, String> = metadata
            .metadata()
            .clone()
            .unwrap_or_default()
            .into_iter()
            .collect();
        let header = Self { metadata, tensors };
        match header.text("format") {
            Ok(format::FORMAT) => Ok(header),
            _ => Err(format!("metadata `format`; allowed: {}", format::FORMAT)),
        }
    }

    fn text(&self, key: &str) -> Result<&str, String> {
        self.metadata
            .get(key)
            .map(String::as_str)
            .ok_or_else(|| format!("metadata `{key}` is missing"))
    }

    fn number<T: std::str::FromStr>(&self, key: &str, allowed: &str) -> Result<T, String> {
        let text = self.text(key)?;
        text.parse()
            .map_err(|_| format!("metadata `{key}` = {text}; allowed: {allowed}"))
    }

    fn task(&self) -> Result<[u8; 32], String> {
        let text = self.text("task")?;
        let digit = |i: usize| {
            text.get(2 * i..2 * i + 2)
                .and_then(|d| u8::from_str_radix(d, 16).ok())
        };
        let bytes: Option<Vec<u8>> = (0..32).map(digit).collect();
        bytes
            .filter(|_| text.len() == 64)
            .and_then(|bytes| bytes.try_into().ok())
            .ok_or_else(|| format!("metadata `task` = {text}; allowed: 64 hexadecimal digits"))
    }

    /// Compares every digest.
    fn verify(&self, bytes: &[u8]) -> Result<(), String> {
        let shapes = self
            .tensors
            .iter()
            .map(|(name, (shape, _))| (name.clone(), shape.clone()))
            .collect();
        let digest = format::digest(&self.metadata, &shapes);
        if self.text("digest")? != digest {
            return Err("metadata: the digest of the header differs; allowed: as written".into());
        }
        for (name, (_, range)) in &self.tensors {
            if self.text(&format!("sha256.{name}"))? != format::sha256(&bytes[range.clone()]) {
                return Err(format!(
                    "tensor {name}: SHA-256 differs; allowed: as written"
                ));
            }
        }
        Ok(())
    }
}

impl Layout {
    fn read(header: &Header) -> Result<Self, String> {
        let count = |key, most: usize| {
            let allowed = format!("0 to {most}");
            let value: usize = header.number(key, &allowed)?;
            if value <= most {
                Ok(value)
            } else {
                Err(format!("metadata `{key}` = {value}; allowed: {allowed}"))
            }
        };
        let gpr_samples = count("gpr_samples", 1_000_000)?;
        let variance = |key| {
            if gpr_samples == 0 {
                return Ok(1.0);
            }
            let value: f64 = header.number(key, "a finite number above 0")?;
            if value.is_finite() && value > 0.0 {
                Ok(value)
            } else {
                Err(format!(
                    "metadata `{key}` = {value}; allowed: a finite number above 0"
                ))
            }
        };
        if gpr_samples > 0 && header.text("kernel")? != "rbf" {
            return Err(format!(
                "metadata `kernel` = {}; allowed: rbf",
                header.text("kernel")?
            ));
        }
        let layout = Self {
            inputs: count("inputs", MAX_INPUTS)?,
            outputs: count("outputs", MAX_OUTPUTS)?,
            samples: count("samples", 10_000_000)?,
            gpr_samples,
            signal_variance: variance("signal_variance")?,
            noise_variance: variance("noise_variance")?,
        };
        if layout.inputs == 0 || layout.outputs == 0 || layout.samples == 0 {
            return Err(
                "metadata `inputs`, `outputs` or `samples` = 0; allowed: at least 1".into(),
            );
        }
        Ok(layout)
    }

    fn check_shapes(&self, header: &Header) -> Result<(), String> {
        let (n, p) = (self.inputs, self.outputs);
        let (n8, p8) = (round_up(n, 8), round_up(p, OUTPUT_LANES));
        let blocks = self.samples.div_ceil(BLOCK);
        let probes = header
            .tensors
            .get("probes.x")
            .and_then(|(shape, _)| shape.first())
            .copied()
            .unwrap_or(0);
        if probes == 0 {
            return Err("tensor probes.x is missing or empty; allowed: at least one probe".into());
        }
        let mut expected: BTreeMap<&str, Vec<usize>> = [
            ("scaling", vec![2, n8]),
            ("samples.x", vec![blocks, n, BLOCK]),
            ("samples.y", vec![blocks * BLOCK, p]),
            ("samples.boxes", vec![round_up(blocks, 4), 2, n]),
            (
                "samples.groups",
                vec![round_up(blocks.div_ceil(BLOCKS_PER_GROUP), 4), 2, n],
            ),
            ("samples.origin", vec![2, blocks * BLOCK]),
            ("probes.x", vec![probes, n8]),
            ("probes.knn", vec![probes, p8]),
        ]
        .into();
        if self.gpr_samples > 0 {
            let m = self.gpr_samples;
            let blocks = m.div_ceil(LANES);
            expected.insert("gpr.x", vec![blocks, n, LANES]);
            expected.insert("gpr.lambda", vec![blocks * LANES, p8]);
            expected.insert("gpr.length_scale", vec![n8]);
            expected.insert("gpr.mean", vec![p8]);
            expected.insert("probes.gpr", vec![probes, p8]);
            if header.tensors.contains_key("gpr.cholesky") {
                expected.insert("gpr.cholesky", vec![round_up(m * (m + 1) / 2, 8)]);
            }
        }
        for (name, shape) in &expected {
            match header.tensors.get(*name) {
                None => {
                    return Err(format!(
                        "tensor {name} is missing; allowed: shape {shape:?}"
                    ));
                }
                Some((found, _)) if found != shape => {
                    return Err(format!(
                        "tensor {name}: shape {found:?}; allowed: {shape:?}"
                    ));
                }
                Some(_) => {}
            }
        }
        match header
            .tensors
            .keys()
            .find(|name| !expected.contains_key(name.as_str()))
        {
            Some(name) => Err(format!("tensor {name}; allowed: only the documented ones")),
            None => Ok(()),
        }
    }
}
