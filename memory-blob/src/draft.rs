//! A file to be written: tensors, metadata, digests, and the container's bytes.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::format::{self, ALIGNMENT, PROBES, round_up};
use crate::layout::Layout;
use crate::tensors::{self, Tensors};
use crate::{Contents, Memory, WriteError};

/// Tensors and metadata, ready to be written.
pub struct Draft {
    pub(crate) layout: Layout,
    pub(crate) metadata: BTreeMap<String, String>,
    pub(crate) tensors: Tensors,
}

impl Draft {
    /// The contents laid out as FORMAT.md says.
    ///
    /// # Errors
    /// [`WriteError`] if they contradict themselves.
    pub fn of(contents: &Contents) -> Result<Self, WriteError> {
        contents.check()?;
        let layout = Layout::of(contents, PROBES);
        let mut draft = Self {
            layout,
            metadata: metadata(contents, &layout),
            tensors: tensors::of_samples(contents, &layout),
        };
        if let Some(regression) = &contents.regression {
            draft
                .tensors
                .extend(tensors::of_process(contents, &layout, regression));
        }
        draft.add_probes(contents);
        draft.add_digests();
        Ok(draft)
    }

    /// The view that queries use.
    pub fn view(&self) -> Memory<'_> {
        self.layout
            .view(|name| self.tensors.get(name).map_or(&[], Vec::as_slice))
    }

    /// Adds the digests; nothing may change afterwards.
    fn add_digests(&mut self) {
        for (name, data) in &self.tensors {
            let digest = format::sha256(bytemuck::cast_slice(data));
            self.metadata.insert(format!("sha256.{name}"), digest);
        }
        let digest = format::digest(&self.metadata, self.layout.shapes());
        self.metadata.insert("digest".into(), digest);
    }

    /// The safetensors container: header length, header padded with spaces to the alignment,
    /// tensors in the order of their names.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        let mut header = Map::new();
        header.insert("__metadata__".into(), json!(self.metadata));
        let (shapes, mut offset) = (self.layout.shapes(), 0);
        for (name, data) in &self.tensors {
            let offsets = [offset, offset + 8 * data.len()];
            let tensor = json!({"dtype": "F64", "shape": shapes[name], "data_offsets": offsets});
            header.insert((*name).to_owned(), tensor);
            offset = offsets[1];
        }
        let mut text = Value::Object(header).to_string().into_bytes();
        text.resize(round_up(8 + text.len(), ALIGNMENT) - 8, b' ');
        let mut bytes = (text.len() as u64).to_le_bytes().to_vec();
        bytes.append(&mut text);
        for data in self.tensors.values() {
            bytes.extend_from_slice(bytemuck::cast_slice(data));
        }
        bytes
    }
}

fn metadata(contents: &Contents, layout: &Layout) -> BTreeMap<String, String> {
    let mut metadata = BTreeMap::from([
        ("format", format::FORMAT.to_owned()),
        ("schema", format::SCHEMA.to_owned()),
        ("task", format::hex(&contents.task)),
        ("inputs", layout.inputs.to_string()),
        ("outputs", layout.outputs.to_string()),
        ("samples", layout.samples.to_string()),
        ("gpr_samples", layout.gpr_samples.to_string()),
        (
            "provenance",
            Value::Object(contents.provenance.clone()).to_string(),
        ),
    ]);
    if layout.gpr_samples > 0 {
        metadata.insert("kernel", "rbf".to_owned());
        metadata.insert("signal_variance", format!("{:?}", layout.signal_variance));
        metadata.insert("noise_variance", format!("{:?}", layout.noise_variance));
    }
    metadata
        .into_iter()
        .map(|(key, value)| (key.to_owned(), value))
        .collect()
}
