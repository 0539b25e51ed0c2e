//! What no checksum catches: files that are wrong but hashed as if they were right, cut short, or
//! no memory at all.

mod synthetic;

use std::collections::BTreeMap;
use std::fs::{self, File};

use memory_blob::{MemoryFile, OpenError};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use synthetic::{Random, regression, trajectories};
use tempfile::TempDir;

fn hex(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    digest.iter().map(|b| format!("{b:02x}")).collect()
}

/// A file taken apart, that can be changed and put together again with digests that fit, following
/// FORMAT.md.
struct Forgery {
    metadata: BTreeMap<String, String>,
    tensors: BTreeMap<String, (Value, Vec<f64>)>,
}

impl Forgery {
    fn new() -> Self {
        let mut contents = trajectories(100, 1);
        contents.regression = Some(regression(&contents, 30, true));
        let directory = TempDir::new().unwrap();
        let path = directory.path().join("source");
        contents.write(&path).unwrap();
        let bytes = fs::read(&path).unwrap();
        let begin = 8 + u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
        let Value::Object(mut header) = serde_json::from_slice(&bytes[8..begin]).unwrap() else {
            panic!("the header is no object")
        };
        let metadata = serde_json::from_value(header.remove("__metadata__").unwrap()).unwrap();
        let tensor = |entry: &Value| {
            let at = |i: usize| begin + entry["data_offsets"][i].as_u64().unwrap() as usize;
            let data = bytes[at(0)..at(1)]
                .chunks_exact(8)
                .map(|b| f64::from_le_bytes(b.try_into().unwrap()));
            (entry["shape"].clone(), data.collect())
        };
        let tensors = header.iter().map(|(name, e)| (name.clone(), tensor(e)));
        Self {
            metadata,
            tensors: tensors.collect(),
        }
    }

    fn data(&mut self, name: &str) -> &mut Vec<f64> {
        &mut self.tensors.get_mut(name).unwrap().1
    }

    fn say(&mut self, key: &str, value: &str) {
        self.metadata.insert(key.into(), value.into());
    }

    fn bytes(mut self) -> Vec<u8> {
        let mut header = serde_json::Map::new();
        let (mut body, mut lines) = (Vec::new(), String::new());
        for (name, (shape, data)) in &self.tensors {
            let bytes: Vec<u8> = data.iter().flat_map(|x| x.to_le_bytes()).collect();
            self.metadata.insert(format!("sha256.{name}"), hex(&bytes));
            let offsets = [body.len(), body.len() + bytes.len()];
            body.extend(bytes);
            let entry = json!({"dtype": "F64", "shape": shape, "data_offsets": offsets});
            header.insert(name.clone(), entry);
            lines += &format!("{name}:{shape}\n");
        }
        self.metadata.remove("digest");
        let text: String = (self.metadata.iter().map(|(k, v)| format!("{k}={v}\n"))).collect();
        self.say("digest", &hex((text + &lines).as_bytes()));
        header.insert("__metadata__".into(), json!(self.metadata));
        let header = Value::Object(header).to_string();
        [
            &(header.len() as u64).to_le_bytes(),
            header.as_bytes(),
            &body,
        ]
        .concat()
    }

    /// The file stays mapped when its name is gone.
    fn open(self) -> Result<MemoryFile, OpenError> {
        let directory = TempDir::new().unwrap();
        let path = directory.path().join("forged");
        fs::write(&path, self.bytes()).unwrap();
        MemoryFile::open(&path, None)
    }
}

/// The message of a refusal.
fn refused(change: impl FnOnce(&mut Forgery)) -> String {
    let mut forgery = Forgery::new();
    change(&mut forgery);
    forgery.open().unwrap_err().to_string()
}

#[test]
fn a_file_put_together_by_the_letter_of_the_format_is_accepted() {
    Forgery::new().open().unwrap();
}

#[test]
fn probes_catch_scales_that_changed_places() {
    let message = refused(|f| f.data("scaling").swap(16, 24));
    assert!(message.contains("probe"), "{message}");
}

#[test]
fn probes_catch_weights_in_the_order_of_columns() {
    let message = refused(|f| {
        let lambda = f.data("gpr.lambda");
        let (rows, columns) = (lambda.len() / 16, 16);
        let turned = (0..lambda.len()).map(|i| lambda[i % rows * columns + i / rows]);
        *lambda = turned.collect();
    });
    assert!(message.contains("probe 0 of gpr"), "{message}");
}

#[test]
fn probes_catch_another_signal_variance() {
    let message = refused(|f| f.say("signal_variance", "1.8"));
    assert!(message.contains("of gpr"), "{message}");
}

#[test]
fn numbers_out_of_range_are_named() {
    let nan = refused(|f| f.data("samples.y")[3] = f64::NAN);
    assert!(nan.contains("samples.y: element 3"), "{nan}");
    let scale = refused(|f| f.data("scaling")[16] = 0.0);
    assert!(scale.contains("scale: 0; allowed"), "{scale}");
    let length = refused(|f| f.data("gpr.length_scale")[2] = -1.0);
    assert!(length.contains("gpr.length_scale: -1"), "{length}");
    let output = refused(|f| f.data("gpr.output_scale")[1] = 0.0);
    assert!(output.contains("gpr.output_scale: 0"), "{output}");
    let factor = refused(|f| f.data("gpr.cholesky")[2] = 0.0);
    assert!(factor.contains("gpr.cholesky: diagonal"), "{factor}");
}

#[test]
fn a_box_that_hides_a_sample_is_refused() {
    for name in ["samples.boxes", "samples.groups"] {
        let message = refused(|f| f.data(name)[0] += 0.01);
        assert!(message.contains("outside its box"), "{message}");
    }
}

#[test]
fn counts_that_do_not_fit_the_tensors_are_refused() {
    for (key, value) in [
        ("samples", "99999"),
        ("samples", "0"),
        ("samples", "18446744073709551615"),
        ("samples", "-1"),
        ("inputs", "19"),
        ("inputs", "0"),
        ("outputs", "30"),
        ("gpr_samples", "400"),
        ("gpr_samples", "1000000"),
        ("signal_variance", "NaN"),
        ("noise_variance", "0"),
        ("kernel", "matern"),
        ("task", "07"),
        ("format", "other"),
    ] {
        let message = refused(|f| f.say(key, value));
        assert!(message.contains("allowed"), "{key} = {value}: {message}");
    }
}

#[test]
fn another_schema_and_a_missing_file_are_errors_of_their_own() {
    let mut forgery = Forgery::new();
    forgery.say("schema", "1");
    let error = forgery.open().unwrap_err();
    assert!(matches!(error, OpenError::Schema { .. }), "{error}");
    let message = error.to_string();
    assert!(
        message.contains("schema 1; allowed: 3; build the memory again"),
        "{message}"
    );
    let error = MemoryFile::open("/nowhere/missing.vpcmem".as_ref(), None).unwrap_err();
    assert!(matches!(error, OpenError::Read { .. }), "{error}");
    assert!(
        error.to_string().contains("/nowhere/missing.vpcmem"),
        "{error}"
    );
}

#[test]
fn missing_and_unknown_tensors_are_named() {
    let missing = refused(|f| {
        f.tensors.remove("samples.origin");
    });
    assert!(missing.contains("samples.origin is missing"), "{missing}");
    let scales = refused(|f| {
        f.tensors.remove("gpr.output_scale");
    });
    assert!(scales.contains("gpr.output_scale is missing"), "{scales}");
    let unknown = refused(|f| {
        f.tensors.insert("extra".into(), (json!([8]), vec![0.0; 8]));
    });
    assert!(unknown.contains("tensor extra"), "{unknown}");
}

#[test]
fn a_file_cut_short_anywhere_is_refused() {
    let directory = TempDir::new().unwrap();
    let path = directory.path().join("cut");
    trajectories(40, 2).write(&path).unwrap();
    let file = File::options().write(true).open(&path).unwrap();
    let length = file.metadata().unwrap().len();
    MemoryFile::open(&path, None).unwrap();
    for shorter in (0..length).rev() {
        file.set_len(shorter).unwrap();
        assert!(MemoryFile::open(&path, None).is_err(), "{shorter} bytes");
    }
}

#[test]
fn a_file_that_is_too_large_is_refused_without_reading_it() {
    let file = tempfile::NamedTempFile::new().unwrap();
    file.as_file().set_len(3 << 40).unwrap();
    let message = MemoryFile::open(file.path(), None).unwrap_err().to_string();
    assert!(
        message.contains("3298534883328 bytes; allowed: up to 268435456"),
        "{message}"
    );
}

#[test]
fn junk_is_refused_without_a_panic() {
    let directory = TempDir::new().unwrap();
    let path = directory.path().join("junk");
    let mut random = Random(6);
    for trial in 0..2000 {
        let length = (random.next() * 300.0) as usize;
        let mut junk: Vec<u8> = (0..length).map(|_| (random.next() * 256.0) as u8).collect();
        // Every other one gets a header length that could be true, so that more than its size is
        // looked at.
        if trial % 2 == 0 && length > 10 {
            junk[..8].copy_from_slice(&(length as u64 - 9).to_le_bytes());
            junk[8] = b'{';
        }
        fs::write(&path, &junk).unwrap();
        assert!(MemoryFile::open(&path, None).is_err());
    }
    let mut forgery = Forgery::new();
    for name in forgery.tensors.keys().cloned().collect::<Vec<_>>() {
        let data = forgery.data(&name);
        data.iter_mut()
            .for_each(|x| *x = 1e308 * (random.next() - 0.5));
    }
    assert!(forgery.open().is_err());
}

#[test]
fn another_kind_of_file_is_told_from_a_damaged_memory() {
    let directory = TempDir::new().unwrap();
    let path = directory.path().join("other");
    for (bytes, begin) in [
        (b"# A scene of mine\n".as_slice(), "# A scene"),
        (b"\x89PNG\r\n\x1a\n\0\0", "\\x89PNG\\r\\n\\x1a\\n\\x00"),
        (b"VPCFLT1\n", "VPCFLT1\\n"),
    ] {
        fs::write(&path, bytes).unwrap();
        let refused = MemoryFile::open(&path, None).unwrap_err().to_string();
        let expected = format!("begins with `{begin}`; allowed: a safetensors container");
        assert!(refused.contains(&expected), "{refused}");
    }
}
