//! Names and sizes of the file; see `FORMAT.md`.

use std::collections::BTreeMap;

use sha2::{Digest, Sha256};

/// Value of the metadata key `format`.
pub(crate) const FORMAT: &str = "vpc-memory";
/// Value of the metadata key `schema`.
pub(crate) const SCHEMA: &str = "3";
/// Largest file, bytes: a hundred times the largest that is shipped. It is read and verified within
/// the 5 s that `vpcd` has for a check of its files.
pub(crate) const MOST_BYTES: u64 = 256 << 20;
/// Largest header, bytes.
pub(crate) const MAX_HEADER: usize = 64 * 1024;
/// Alignment of tensors in our files and in sealed memory, bytes.
pub(crate) const ALIGNMENT: usize = 64;
/// Probes stored in a file.
pub(crate) const PROBES: usize = 8;
/// A probe's answer may differ from the stored one by this much, relative to 1 + its size.
pub(crate) const PROBE_TOLERANCE: f64 = 1e-6;
/// What fills boxes of no block and samples of no row: far from every query, and finite when
/// squared.
pub(crate) const FAR: f64 = 1e150;

/// `count` rounded up to a multiple of `of`.
pub(crate) fn round_up(count: usize, of: usize) -> usize {
    count.div_ceil(of) * of
}

/// Lower-case hexadecimal digits of the SHA-256 of some bytes.
pub(crate) fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// Lower-case hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The digest of a header: SHA-256 of `key=value\n` for every metadata key but `digest`, in the
/// order of their bytes, then `name:[dim,dim]\n` for every tensor, likewise.
pub(crate) fn digest<N: std::fmt::Display>(
    metadata: &BTreeMap<String, String>,
    shapes: impl IntoIterator<Item = (N, Vec<usize>)>,
) -> String {
    let mut text = String::new();
    for (key, value) in metadata.iter().filter(|(key, _)| *key != "digest") {
        text += &format!("{key}={value}\n");
    }
    for (name, shape) in shapes {
        let shape: Vec<String> = shape.iter().map(ToString::to_string).collect();
        text += &format!("{name}:[{}]\n", shape.join(","));
    }
    sha256(text.as_bytes())
}
