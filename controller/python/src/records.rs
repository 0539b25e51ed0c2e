//! Recordings: their messages as JSON.

use std::path::PathBuf;

use ::recording::{Recorded, Recording};
use pyo3::prelude::*;

use crate::error;

fn json<T: Recorded>(messages: &[T]) -> Vec<String> {
    messages.iter().map(Recorded::to_json).collect()
}

/// The messages of one kind.
type Kind = fn(&Recording) -> Vec<String>;

const KINDS: [(&str, Kind); 7] = [
    ("cycles", |it| json(&it.cycles)),
    ("desired", |it| json(&it.desired)),
    ("features", |it| json(&it.features)),
    ("replies", |it| json(&it.replies)),
    ("requests", |it| json(&it.requests)),
    ("robot", |it| json(&it.robot)),
    ("twist", |it| json(&it.twist)),
];

/// The messages of one kind in a recording (MCAP), each as JSON text, in their order. A file that
/// was cut short is read as far as it goes.
#[pyfunction]
pub fn records(py: Python<'_>, path: PathBuf, kind: &str) -> PyResult<Vec<String>> {
    let Some((_, messages)) = KINDS.iter().find(|(name, _)| *name == kind) else {
        let allowed = KINDS.map(|(name, _)| name).join(", ");
        return Err(error::value(format!("kind `{kind}`; allowed: {allowed}")));
    };
    py.detach(|| Recording::read(&path).map(|recording| messages(&recording)))
        .map_err(error::read)
}
