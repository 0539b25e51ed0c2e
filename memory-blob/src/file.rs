//! A memory file: opened, verified, sealed, mapped.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use memmap2::Mmap;
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

use crate::format::{self, ALIGNMENT, MOST_BYTES, round_up};
use crate::header::Header;
use crate::layout::Layout;
use crate::sealed;
use crate::view::Memory;

/// Why a memory file was refused.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The file could not be read, or no sealed memory was to be had.
    #[error("{path}: cannot read the memory: {source}")]
    Read {
        /// Path of the file, as given.
        path: String,
        /// The operating system's reason.
        r#source: std::io::Error,
    },
    /// The file is damaged, or not a memory.
    #[error("{path}: not an intact memory: {what}")]
    Corrupt {
        /// Path of the file, as given.
        path: String,
        /// Which part, what was found, and what is allowed.
        what: String,
    },
    /// The file has another schema.
    #[error(
        "{path}: schema {found}; allowed: {}; build the memory again with `vpc-memory build`",
        format::SCHEMA
    )]
    Schema {
        /// Path of the file, as given.
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
        /// Path of the file, as given.
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
    digest: [u8; 32],
    bytes: usize,
}

impl MemoryFile {
    /// Opens a file and verifies all of it: structure, digests, ranges, probes, and that it was
    /// built for `task` where one is given.
    ///
    /// # Errors
    /// [`OpenError`] names the file, the part and what is allowed.
    pub fn open(path: &Path, task: Option<&[u8; 32]>) -> Result<Self, OpenError> {
        Self::parse(&Self::read(path)?, path, task)
    }

    /// Reads the bytes of a file, which are not verified yet.
    ///
    /// # Errors
    /// [`OpenError::Read`]: also if it is no plain file, or larger than `MOST_BYTES`.
    pub fn read(path: &Path) -> Result<Vec<u8>, OpenError> {
        toml_schema::read_bytes(path, MOST_BYTES).map_err(|source| OpenError::Read {
            path: path.display().to_string(),
            source,
        })
    }

    /// As [`MemoryFile::open`], of the bytes of a file that was read before; `path` is for
    /// messages.
    ///
    /// # Errors
    /// As [`MemoryFile::open`].
    pub fn parse(bytes: &[u8], path: &Path, task: Option<&[u8; 32]>) -> Result<Self, OpenError> {
        let name = path.display().to_string();
        let read = |source| OpenError::Read {
            path: name.clone(),
            source,
        };
        let corrupt = |what| OpenError::Corrupt {
            path: name.clone(),
            what,
        };
        let header = Header::parse(bytes).map_err(corrupt)?;
        let schema = header.text("schema").map_err(corrupt)?;
        if schema != format::SCHEMA {
            return Err(OpenError::Schema {
                path: name,
                found: schema.to_owned(),
            });
        }
        header.verify(bytes).map_err(corrupt)?;
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
            digest: Sha256::digest(bytes).into(),
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
        self.layout.view(|name| self.tensor(name))
    }

    /// Fingerprint of the task that the memory was built for.
    pub fn task(&self) -> &[u8; 32] {
        &self.task
    }

    /// SHA-256 of the whole file, as it was when it was opened.
    pub fn digest(&self) -> &[u8; 32] {
        &self.digest
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

    /// The counts that fix all shapes.
    pub(crate) fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Names of the tensors.
    pub(crate) fn tensor_names(&self) -> impl Iterator<Item = &str> {
        self.ranges.keys().map(String::as_str)
    }

    /// The numbers of a tensor; none if the file has no such tensor.
    pub(crate) fn tensor(&self, name: &str) -> &[f64] {
        self.ranges
            .get(name)
            .map_or(&[], |range| bytemuck::cast_slice(&self.map[range.clone()]))
    }
}
