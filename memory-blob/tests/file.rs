//! The promises of the file: exact round trips, exact queries, and the refusal of everything that
//! is not intact.

mod synthetic;

use std::path::PathBuf;

use memory_blob::{Contents, MemoryFile, OpenError, Regression};
use serde_json::Map;
use synthetic::{Random, opened};
use tempfile::TempDir;

fn contents(count: usize, regression: bool) -> Contents {
    let mut random = Random(11);
    let x: Vec<Vec<f64>> = (0..count).map(|_| random.row(10, 1000.0)).collect();
    let y: Vec<Vec<f64>> = (0..count).map(|_| random.row(14, 10.0)).collect();
    let regression = regression.then(|| Regression {
        x: x[..37].to_vec(),
        length_scale: (0..10).map(|k| 0.3 + 0.1 * k as f64).collect(),
        signal_variance: 1.7,
        noise_variance: 0.01,
        mean: random.row(14, 5.0),
        lambda: (0..37).map(|_| random.row(14, 2.0)).collect(),
        output_scale: (1..=14).map(f64::from).collect(),
        cholesky: None,
    });
    Contents {
        task: [7; 32],
        offset: vec![5.0; 10],
        scale: (0..10).map(|k| 900.0 + k as f64).collect(),
        trajectory: (0..count as u32).map(|i| i / 10).collect(),
        step: (0..count as u32).map(|i| i % 10).collect(),
        cost_to_go: vec![1.0; count],
        x,
        y,
        regression,
        provenance: Map::new(),
    }
}

/// A file in a directory that goes with it.
struct Written {
    directory: TempDir,
    path: PathBuf,
}

impl Written {
    fn new(contents: &Contents) -> Self {
        let directory = TempDir::new().unwrap();
        let path = directory.path().join("memory");
        contents.write(&path).unwrap();
        Self { directory, path }
    }
}

#[test]
fn a_round_trip_gives_everything_back() {
    let before = contents(500, true);
    let file = MemoryFile::open(&Written::new(&before).path, Some(&[7; 32])).unwrap();
    let after = file.contents();
    let close = |a: &[Vec<f64>], b: &[Vec<f64>]| {
        a.len() == b.len()
            && a.iter()
                .flatten()
                .zip(b.iter().flatten())
                .all(|(a, b)| (a - b).abs() <= 1e-12 * (1.0 + a.abs()))
    };
    assert!(close(&before.x, &after.x));
    assert_eq!(
        (&before.y, &before.trajectory, &before.step),
        (&after.y, &after.trajectory, &after.step)
    );
    let (before, after) = (before.regression.unwrap(), after.regression.unwrap());
    assert!(close(&before.x, &after.x));
    assert_eq!((before.lambda, before.mean), (after.lambda, after.mean));
    assert_eq!(before.output_scale, after.output_scale);
}

#[test]
fn the_same_contents_give_the_same_bytes() {
    let contents = contents(300, true);
    let (a, b) = (Written::new(&contents), Written::new(&contents));
    assert_eq!(
        std::fs::read(a.path).unwrap(),
        std::fs::read(b.path).unwrap()
    );
}

#[test]
fn a_search_finds_what_comparing_with_every_sample_finds() {
    let contents = contents(5000, false);
    let file = opened(&contents);
    let samples = file.view().samples();
    let mut random = Random(5);
    for trial in 0..200 {
        let query = random.row(10, 1200.0);
        let mut order: Vec<(f64, usize)> = contents
            .x
            .iter()
            .enumerate()
            .map(|(i, x)| {
                let square = |k: usize| ((x[k] - query[k]) / contents.scale[k]).powi(2);
                ((0..10).map(square).sum(), i)
            })
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let k = 1 + trial % 64;
        let mut found = vec![0.0; 14];
        let nearest = samples.nearest(&query, k, &mut found).unwrap();
        assert!((nearest.distance() - order[0].0.sqrt()).abs() < 1e-12);
        for (o, found) in found.iter().enumerate() {
            let mean = order[..k]
                .iter()
                .map(|(_, i)| contents.y[*i][o])
                .sum::<f64>()
                / k as f64;
            assert!((mean - found).abs() < 1e-9, "trial {trial}");
        }
    }
}

#[test]
fn regression_is_the_formula() {
    let contents = contents(100, true);
    let file = opened(&contents);
    let r = contents.regression.unwrap();
    let query = Random(9).row(10, 800.0);
    let mut found = vec![0.0; 14];
    file.view().gpr().unwrap().mean(&query, &mut found).unwrap();
    for (o, found) in found.iter().enumerate() {
        let weighted: f64 = r
            .x
            .iter()
            .zip(&r.lambda)
            .map(|(x, lambda)| {
                let square =
                    |k: usize| ((x[k] - query[k]) / contents.scale[k] / r.length_scale[k]).powi(2);
                r.signal_variance * (-0.5 * (0..10).map(square).sum::<f64>()).exp() * lambda[o]
            })
            .sum();
        assert!((r.mean[o] + weighted - found).abs() < 1e-12);
    }
}

#[test]
fn every_truncation_and_flipped_header_byte_is_refused() {
    let Written { directory, path } = Written::new(&contents(40, true));
    let bytes = std::fs::read(&path).unwrap();
    let header = 8 + u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let broken = directory.path().join("broken");
    let refused = |bytes: &[u8]| {
        std::fs::write(&broken, bytes).unwrap();
        MemoryFile::open(&broken, None).is_err()
    };
    for at in 0..header {
        let mut bytes = bytes.clone();
        bytes[at] ^= 1 << (at % 8);
        assert!(refused(&bytes), "header byte {at}");
    }
    let mut random = Random(3);
    for _ in 0..300 {
        let at = header + (random.next() * (bytes.len() - header) as f64) as usize;
        let mut bytes = bytes.clone();
        bytes[at] ^= 1 << (at % 8);
        assert!(refused(&bytes), "body byte {at}");
        assert!(refused(&bytes[..at]), "truncated to {at}");
    }
    for length in [0, 1, 7, 8, 9, header - 1, header, bytes.len() - 1] {
        assert!(refused(&bytes[..length]), "truncated to {length}");
    }
}

#[test]
fn a_memory_of_another_task_is_refused_with_both_fingerprints() {
    let error =
        MemoryFile::open(&Written::new(&contents(40, false)).path, Some(&[9; 32])).unwrap_err();
    assert!(matches!(error, OpenError::Task { .. }));
    let message = error.to_string();
    assert!(
        message.contains(&"07".repeat(32)) && message.contains(&"09".repeat(32)),
        "{message}"
    );
}

#[test]
fn a_file_changed_after_opening_changes_nothing() {
    let written = Written::new(&contents(100, false));
    let file = MemoryFile::open(&written.path, None).unwrap();
    let query = Random(2).row(10, 500.0);
    let (mut before, mut after) = (vec![0.0; 14], vec![0.0; 14]);
    file.view()
        .samples()
        .nearest(&query, 3, &mut before)
        .unwrap();
    std::fs::write(&written.path, b"").unwrap();
    file.view()
        .samples()
        .nearest(&query, 3, &mut after)
        .unwrap();
    assert_eq!(before, after);
}

#[test]
fn bad_queries_are_errors() {
    let file = opened(&contents(40, true));
    let (samples, gpr) = (file.view().samples(), file.view().gpr().unwrap());
    let (good, mut y) = (vec![0.0; 10], vec![0.0; 14]);
    let mut nan = good.clone();
    nan[4] = f64::NAN;
    assert!(
        samples
            .nearest(&good[..9], 1, &mut y)
            .unwrap_err()
            .to_string()
            .contains("9 entries; allowed")
    );
    assert!(
        samples
            .nearest(&nan, 1, &mut y)
            .unwrap_err()
            .to_string()
            .contains("entry 4")
    );
    assert!(
        samples
            .nearest(&good, 0, &mut y)
            .unwrap_err()
            .to_string()
            .contains("1 to 40")
    );
    assert!(samples.nearest(&good, 41, &mut y).is_err());
    assert!(gpr.mean(&nan, &mut y).is_err());
    assert!(
        gpr.variance(&good, &mut [0.0; 37], &mut y)
            .unwrap_err()
            .to_string()
            .contains("no Cholesky factor")
    );
}
