//! A file on its way out: tensors, metadata, digests, and the container's bytes.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::Contents;
use crate::format::{self, ALIGNMENT, round_up};
use crate::tensors::{self, Tensors};

/// Tensors and metadata, ready to be written.
pub(crate) struct Draft {
    pub(crate) metadata: BTreeMap<String, String>,
    pub(crate) tensors: Tensors,
}

impl Draft {
    /// The contents laid out as FORMAT.md says; they were checked.
    pub(crate) fn of(contents: &Contents) -> Self {
        let mut draft = Self {
            metadata: metadata(contents),
            tensors: tensors::of_samples(contents),
        };
        if let Some(regression) = &contents.regression {
            let process = tensors::of_process(contents, regression);
            draft.tensors.extend(process);
        }
        draft.add_probes(contents);
        draft.seal();
        draft
    }

    /// Adds the digests; nothing may change afterwards.
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
    pub(crate) fn bytes(&self) -> Vec<u8> {
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

fn metadata(contents: &Contents) -> BTreeMap<String, String> {
    let mut metadata: BTreeMap<String, String> = [
        ("format", format::FORMAT.to_owned()),
        ("schema", format::SCHEMA.to_owned()),
        ("task", format::hex(&contents.task)),
        ("inputs", contents.scale.len().to_string()),
        ("outputs", contents.y[0].len().to_string()),
        ("samples", contents.x.len().to_string()),
        (
            "gpr_samples",
            contents
                .regression
                .as_ref()
                .map_or(0, |r| r.x.len())
                .to_string(),
        ),
        (
            "provenance",
            Value::Object(contents.provenance.clone()).to_string(),
        ),
    ]
    .map(|(key, value)| (key.to_owned(), value))
    .into();
    if let Some(r) = &contents.regression {
        metadata.insert("kernel".into(), "rbf".into());
        metadata.insert("signal_variance".into(), format!("{:?}", r.signal_variance));
        metadata.insert("noise_variance".into(), format!("{:?}", r.noise_variance));
    }
    metadata
}
