//! The header of a file: the container's metadata, names, shapes and digests.

use std::collections::BTreeMap;
use std::ops::Range;

use safetensors::{Dtype, SafeTensors};

use crate::format::{self, MAX_HEADER};

/// The header of a container: metadata, and shape and byte range of each tensor.
pub(crate) struct Header {
    pub(crate) metadata: BTreeMap<String, String>,
    pub(crate) tensors: BTreeMap<String, (Vec<usize>, Range<usize>)>,
}

impl Header {
    /// Parses the header of a file, without checking digests and shapes.
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, String> {
        let length = bytes.first_chunk::<8>().map(|b| u64::from_le_bytes(*b));
        let length = length.ok_or_else(|| format!("{} bytes; allowed: at least 8", bytes.len()))?;
        // Where the header's JSON begins.
        if bytes.get(8) != Some(&b'{') {
            let begin = bytes[..bytes.len().min(9)].escape_ascii();
            return Err(format!(
                "begins with `{begin}`; allowed: a safetensors container, eight bytes of length and `{{` (is it a \
                 memory? `vpc-memory build` writes one)"
            ));
        }
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

    /// The metadata of a key.
    pub(crate) fn text(&self, key: &str) -> Result<&str, String> {
        self.metadata
            .get(key)
            .map(String::as_str)
            .ok_or_else(|| format!("metadata `{key}` is missing"))
    }

    /// The metadata of a key, as a number that is `allowed`.
    pub(crate) fn number<T: std::str::FromStr>(
        &self,
        key: &str,
        allowed: &str,
        is_allowed: impl Fn(&T) -> bool,
    ) -> Result<T, String> {
        let text = self.text(key)?;
        let number = text.parse().ok().filter(is_allowed);
        number.ok_or_else(|| format!("metadata `{key}` = {text}; allowed: {allowed}"))
    }

    /// Fingerprint of the task.
    pub(crate) fn task(&self) -> Result<[u8; 32], String> {
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
    pub(crate) fn verify(&self, bytes: &[u8]) -> Result<(), String> {
        let shapes = self
            .tensors
            .iter()
            .map(|(name, (shape, _))| (name, shape.clone()));
        if self.text("digest")? != format::digest(&self.metadata, shapes) {
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
