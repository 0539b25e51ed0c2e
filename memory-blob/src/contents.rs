//! What a writer fills in, and the writing.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

use serde_json::{Map, Value, json};

use crate::exp::LANES;
use crate::format::{self, ALIGNMENT, FAR, PROBES, round_up};
use crate::gpr::OUTPUT_LANES;
use crate::order::{bounding_box, kd_order};
use crate::samples::{BLOCK, BLOCKS_PER_GROUP};
use crate::view::{Memory, Scaling};
use crate::{Gpr, MAX_INPUTS, MAX_OUTPUTS, Samples};

/// A memory as its maker knows it: rows in their own order, raw units.
#[derive(Clone, Debug, PartialEq)]
pub struct Contents {
    /// Fingerprint of the task that the memory was built for.
    pub task: [u8; 32],
    /// Per input: what is subtracted before scaling.
    pub offset: Vec<f64>,
    /// Per input: what it is divided by, above zero.
    pub scale: Vec<f64>,
    /// Inputs x = (s, area, angle), one row a sample.
    pub x: Vec<Vec<f64>>,
    /// Outputs y = (v, way point), one row a sample.
    pub y: Vec<Vec<f64>>,
    /// Index of the trajectory of each sample.
    pub trajectory: Vec<u32>,
    /// Control period of each sample in its trajectory.
    pub step: Vec<u32>,
    /// The Gaussian process.
    pub regression: Option<Regression>,
    /// Where the memory comes from: seed, counts, settings, date, tool.
    pub provenance: Map<String, Value>,
}

/// A fitted Gaussian process, y = m + k(x, X) Lambda, with k(x, x') = signal_variance exp(-1/2 sum ((x-x')/l)^2) on
/// scaled inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Regression {
    /// Raw inputs that the process is conditioned on, one row each.
    pub x: Vec<Vec<f64>>,
    /// One length scale an input, in scaled units, above zero.
    pub length_scale: Vec<f64>,
    /// phi_o^2.
    pub signal_variance: f64,
    /// phi_s.
    pub noise_variance: f64,
    /// m, one value an output, in its units.
    pub mean: Vec<f64>,
    /// (K + phi_s I)^{-1} (Y - m), one row for each row of `x`.
    pub lambda: Vec<Vec<f64>>,
    /// Packed lower rows of the Cholesky factor of K + phi_s I, for variances.
    pub cholesky: Option<Vec<f64>>,
}

/// Why a memory was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The contents contradict themselves.
    #[error("memory: {what} is {found}; allowed: {allowed}")]
    Contents {
        /// Which part.
        what: &'static str,
        /// What was found.
        found: String,
        /// What is allowed.
        allowed: String,
    },
    /// The file could not be written.
    #[error("{path}: cannot write the memory: {source}")]
    Write {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
}

/// Tensors and metadata, ready to be written.
struct Draft {
    metadata: BTreeMap<String, String>,
    tensors: BTreeMap<String, (Vec<usize>, Vec<f64>)>,
}

impl Contents {
    /// Writes the memory to `path`: beside it first, synchronised, then renamed, so that no reader sees half a file.
    /// The same contents give the same bytes.
    ///
    /// # Errors
    /// [`WriteError`] where the contents contradict themselves or the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), WriteError> {
        self.check()?;
        let bytes = self.draft().bytes();
        let name = path.display().to_string();
        let failed = |source| WriteError::Write {
            path: name.clone(),
            source,
        };
        let directory = path
            .parent()
            .filter(|d| !d.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        fs::create_dir_all(directory).map_err(failed)?;
        let mut beside = path.as_os_str().to_owned();
        beside.push(format!(".{}.tmp", std::process::id()));
        let write = || {
            let mut file = File::create(&beside)?;
            file.write_all(&bytes)?;
            file.sync_all()?;
            fs::rename(&beside, path)
        };
        write().map_err(|source| {
            // The reason is what the user needs; a left-over file beside it is not worth another error.
            let _ = fs::remove_file(&beside);
            failed(source)
        })
    }

    fn check(&self) -> Result<(), WriteError> {
        let wrong = |what, found: String, allowed: String| {
            Err(WriteError::Contents {
                what,
                found,
                allowed,
            })
        };
        let (n, p) = (self.scale.len(), self.y.first().map_or(0, Vec::len));
        if n == 0 || n > MAX_INPUTS {
            return wrong(
                "scale",
                format!("{n} entries"),
                format!("1 to {MAX_INPUTS}"),
            );
        }
        if p == 0 || p > MAX_OUTPUTS {
            return wrong(
                "y",
                format!("{} rows of {p}", self.y.len()),
                format!("rows of 1 to {MAX_OUTPUTS}"),
            );
        }
        if self.offset.len() != n {
            return wrong(
                "offset",
                format!("{} entries", self.offset.len()),
                format!("{n}"),
            );
        }
        if self.scale.iter().any(|s| !(s.is_finite() && *s > 0.0)) {
            return wrong(
                "scale",
                format!("{:?}", self.scale),
                "finite numbers above 0".into(),
            );
        }
        let count = self.x.len();
        for (what, found) in [
            ("y", self.y.len()),
            ("trajectory", self.trajectory.len()),
            ("step", self.step.len()),
        ] {
            if found != count {
                return wrong(
                    what,
                    format!("{found} rows"),
                    format!("{count}, as many as x"),
                );
            }
        }
        rows("x", &self.x, n)?;
        rows("y", &self.y, p)?;
        let Some(r) = &self.regression else {
            return Ok(());
        };
        rows("regression.x", &r.x, n)?;
        rows("regression.lambda", &r.lambda, p)?;
        let m = r.x.len();
        if m == 0 || r.lambda.len() != m {
            let found = format!("{} rows for {m} inputs", r.lambda.len());
            return wrong(
                "regression.lambda",
                found,
                "one row an input, at least one".into(),
            );
        }
        if r.length_scale.len() != n || r.length_scale.iter().any(|l| !(l.is_finite() && *l > 0.0))
        {
            return wrong(
                "regression.length_scale",
                format!("{:?}", r.length_scale),
                format!("{n} numbers above 0"),
            );
        }
        if r.mean.len() != p || r.mean.iter().any(|m| !m.is_finite()) {
            return wrong(
                "regression.mean",
                format!("{:?}", r.mean),
                format!("{p} finite numbers"),
            );
        }
        for (what, value) in [
            ("regression.signal_variance", r.signal_variance),
            ("regression.noise_variance", r.noise_variance),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return wrong(what, value.to_string(), "a finite number above 0".into());
            }
        }
        match &r.cholesky {
            Some(c) if c.len() != m * (m + 1) / 2 || c.iter().any(|x| !x.is_finite()) => {
                let allowed = format!("{} finite numbers", m * (m + 1) / 2);
                wrong(
                    "regression.cholesky",
                    format!("{} numbers", c.len()),
                    allowed,
                )
            }
            _ => Ok(()),
        }
    }

    fn scaled(&self, rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let scale = |row: &Vec<f64>| {
            row.iter()
                .zip(self.offset.iter().zip(&self.scale))
                .map(|(x, (o, s))| (x - o) / s)
                .collect()
        };
        rows.iter().map(scale).collect()
    }

    fn draft(&self) -> Draft {
        let (n, p, count) = (self.scale.len(), self.y[0].len(), self.x.len());
        let (n8, p8) = (round_up(n, 8), round_up(p, OUTPUT_LANES));
        let mut tensors = BTreeMap::new();
        let mut put = |name: &str, shape: Vec<usize>, data: Vec<f64>| {
            tensors.insert(name.to_owned(), (shape, data));
        };
        put(
            "scaling",
            vec![2, n8],
            [padded(&self.offset, n8, 0.0), padded(&self.scale, n8, 1.0)].concat(),
        );

        let scaled = self.scaled(&self.x);
        let order = kd_order(&scaled);
        let blocks = count.div_ceil(BLOCK);
        let (mut x, mut boxes, mut groups) = (Vec::new(), Vec::new(), Vec::new());
        for block in order.chunks(BLOCK) {
            let row = |k: usize| block.iter().map(|&i| scaled[i][k]).collect::<Vec<_>>();
            (0..n).for_each(|k| x.extend(padded(&row(k), BLOCK, FAR)));
            boxes.extend(bounding_box(block.iter().map(|&i| &scaled[i]), n));
        }
        for group in order.chunks(BLOCK * BLOCKS_PER_GROUP) {
            groups.extend(bounding_box(group.iter().map(|&i| &scaled[i]), n));
        }
        let (blocks4, groups4) = (
            round_up(blocks, 4),
            round_up(blocks.div_ceil(BLOCKS_PER_GROUP), 4),
        );
        let mut y: Vec<f64> = order
            .iter()
            .flat_map(|&i| self.y[i].iter().copied())
            .collect();
        y.resize(blocks * BLOCK * p, 0.0);
        let origin = |of: &[u32]| {
            let values: Vec<f64> = order.iter().map(|&i| f64::from(of[i])).collect();
            padded(&values, blocks * BLOCK, 0.0)
        };
        put("samples.x", vec![blocks, n, BLOCK], x);
        put("samples.y", vec![blocks * BLOCK, p], y);
        put(
            "samples.boxes",
            vec![blocks4, 2, n],
            padded(&boxes, blocks4 * 2 * n, FAR),
        );
        put(
            "samples.groups",
            vec![groups4, 2, n],
            padded(&groups, groups4 * 2 * n, FAR),
        );
        put(
            "samples.origin",
            vec![2, blocks * BLOCK],
            [origin(&self.trajectory), origin(&self.step)].concat(),
        );

        if let Some(r) = &self.regression {
            let scaled = self.scaled(&r.x);
            let mut x = Vec::new();
            for block in scaled.chunks(LANES) {
                let row = |k: usize| {
                    block
                        .iter()
                        .map(|row| row[k] / r.length_scale[k])
                        .collect::<Vec<_>>()
                };
                (0..n).for_each(|k| x.extend(padded(&row(k), LANES, FAR)));
            }
            let blocks = r.x.len().div_ceil(LANES);
            let lambda: Vec<f64> = r
                .lambda
                .iter()
                .flat_map(|row| padded(row, p8, 0.0))
                .collect();
            put("gpr.x", vec![blocks, n, LANES], x);
            put(
                "gpr.lambda",
                vec![blocks * LANES, p8],
                padded(&lambda, blocks * LANES * p8, 0.0),
            );
            put(
                "gpr.length_scale",
                vec![n8],
                padded(&r.length_scale, n8, 1.0),
            );
            put("gpr.mean", vec![p8], padded(&r.mean, p8, 0.0));
            if let Some(cholesky) = &r.cholesky {
                let length = round_up(cholesky.len(), 8);
                put("gpr.cholesky", vec![length], padded(cholesky, length, 0.0));
            }
        }
        let mut draft = Draft {
            metadata: self.metadata(),
            tensors,
        };
        draft.add_probes(self, n8, p8);
        draft.seal();
        draft
    }

    fn metadata(&self) -> BTreeMap<String, String> {
        let mut metadata: BTreeMap<String, String> = [
            ("format", format::FORMAT.to_owned()),
            ("schema", format::SCHEMA.to_owned()),
            ("task", format::hex(&self.task)),
            ("inputs", self.scale.len().to_string()),
            ("outputs", self.y[0].len().to_string()),
            ("samples", self.x.len().to_string()),
            (
                "gpr_samples",
                self.regression
                    .as_ref()
                    .map_or(0, |r| r.x.len())
                    .to_string(),
            ),
            (
                "provenance",
                Value::Object(self.provenance.clone()).to_string(),
            ),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into();
        if let Some(r) = &self.regression {
            metadata.insert("kernel".into(), "rbf".into());
            metadata.insert("signal_variance".into(), format!("{:?}", r.signal_variance));
            metadata.insert("noise_variance".into(), format!("{:?}", r.noise_variance));
        }
        metadata
    }
}

impl Draft {
    fn tensor(&self, name: &str) -> &[f64] {
        self.tensors.get(name).map_or(&[], |(_, data)| data)
    }

    /// A few inputs and what the queries answer to them, which a reader evaluates again: they catch a wrong layout
    /// or scaling that no checksum can see.
    fn add_probes(&mut self, contents: &Contents, n8: usize, p8: usize) {
        let (n, p) = (contents.scale.len(), contents.y[0].len());
        let count = contents.x.len();
        let scaling = Scaling {
            offset: &contents.offset,
            scale: &contents.scale,
        };
        let blocks = count.div_ceil(BLOCK);
        let samples = Samples {
            scaling,
            count,
            outputs: p,
            x: self.tensor("samples.x"),
            y: self.tensor("samples.y"),
            boxes: &self.tensor("samples.boxes")[..blocks * 2 * n],
            groups: &self.tensor("samples.groups")[..blocks.div_ceil(BLOCKS_PER_GROUP) * 2 * n],
        };
        let gpr = contents.regression.as_ref().map(|r| Gpr {
            scaling,
            count: r.x.len(),
            outputs: p,
            signal_variance: r.signal_variance,
            length_scale: &r.length_scale,
            x: self.tensor("gpr.x"),
            lambda: self.tensor("gpr.lambda"),
            mean: self.tensor("gpr.mean"),
            cholesky: &[],
        });
        let memory = Memory {
            samples: Some(samples),
            gpr,
        };
        let (mut inputs, mut knn, mut means) = (Vec::new(), Vec::new(), Vec::new());
        for probe in 0..PROBES {
            // Two thirds of the way from one sample to another: inside the data, on no sample.
            let (a, b) = (
                &contents.x[probe * count / PROBES],
                &contents.x[(probe * 7 + 3) % count],
            );
            let x: Vec<f64> = a.iter().zip(b).map(|(a, b)| a + (b - a) / 3.0).collect();
            let mut answer = vec![0.0; p];
            if let Some(samples) = memory.samples()
                && samples.nearest(&x, 1, &mut answer).is_ok()
            {
                knn.extend(padded(&answer, p8, 0.0));
            }
            if let Some(gpr) = memory.gpr()
                && gpr.mean(&x, &mut answer).is_ok()
            {
                means.extend(padded(&answer, p8, 0.0));
            }
            inputs.extend(padded(&x, n8, 0.0));
        }
        self.tensors
            .insert("probes.x".into(), (vec![PROBES, n8], inputs));
        self.tensors
            .insert("probes.knn".into(), (vec![PROBES, p8], knn));
        if !means.is_empty() {
            self.tensors
                .insert("probes.gpr".into(), (vec![PROBES, p8], means));
        }
    }

    fn seal(&mut self) {
        for (name, (_, data)) in &self.tensors {
            self.metadata.insert(
                format!("sha256.{name}"),
                format::sha256(bytemuck::cast_slice(data)),
            );
        }
        let shapes = self
            .tensors
            .iter()
            .map(|(name, (shape, _))| (name.clone(), shape.clone()))
            .collect();
        let digest = format::digest(&self.metadata, &shapes);
        self.metadata.insert("digest".into(), digest);
    }

    /// The safetensors container: header length, header padded with spaces to the alignment, tensors in the order of
    /// their names.
    fn bytes(&self) -> Vec<u8> {
        let mut header = Map::new();
        header.insert("__metadata__".into(), json!(self.metadata));
        let mut offset = 0;
        for (name, (shape, data)) in &self.tensors {
            let end = offset + 8 * data.len();
            header.insert(
                name.clone(),
                json!({"dtype": "F64", "shape": shape, "data_offsets": [offset, end]}),
            );
            offset = end;
        }
        let mut text = Value::Object(header).to_string().into_bytes();
        text.resize(round_up(8 + text.len(), ALIGNMENT) - 8, b' ');
        let mut bytes = (text.len() as u64).to_le_bytes().to_vec();
        bytes.append(&mut text);
        for (_, data) in self.tensors.values() {
            bytes.extend_from_slice(bytemuck::cast_slice(data));
        }
        bytes
    }
}

fn padded(data: &[f64], length: usize, with: f64) -> Vec<f64> {
    let mut data = data.to_vec();
    data.resize(length, with);
    data
}

fn rows(what: &'static str, rows: &[Vec<f64>], length: usize) -> Result<(), WriteError> {
    let wrong = |found: String, allowed: String| {
        Err(WriteError::Contents {
            what,
            found,
            allowed,
        })
    };
    if rows.is_empty() {
        return wrong("empty".into(), "at least one row".into());
    }
    for (i, row) in rows.iter().enumerate() {
        if row.len() != length {
            return wrong(
                format!("{} entries in row {i}", row.len()),
                format!("{length}"),
            );
        }
        if let Some(x) = row.iter().find(|x| !x.is_finite()) {
            return wrong(format!("{x} in row {i}"), "finite numbers".into());
        }
    }
    Ok(())
}
