//! What a query costs: `cargo bench -p memory-blob --bench query`.
//!
//! Sizes of a large memory: 16,000 samples of 10 inputs and 14 outputs, 800 of them in the process.
//! Each iteration takes the next of 1,024 queries, so that neither caches nor branches know it. The
//! naive search stands beside ours.

#[path = "../tests/synthetic/mod.rs"]
mod synthetic;

use std::hint::black_box;

use divan::Bencher;
use memory_blob::{Contents, MemoryFile};
use synthetic::{INPUTS, OUTPUTS, Random, opened};

const SAMPLES: usize = 16_000;
const PROCESS: usize = 800;
const QUERIES: usize = 1024;

fn main() {
    divan::main();
}

fn on_trajectories() -> Contents {
    synthetic::trajectories(SAMPLES, 1)
}

/// Inputs near samples, as a camera on its way meets them: some px away.
fn queries(contents: &Contents) -> Vec<Vec<f64>> {
    let mut random = Random(77);
    (0..QUERIES)
        .map(|_| {
            let x = &contents.x[(random.next() * contents.x.len() as f64) as usize];
            let away = random.row(INPUTS, 0.05);
            (0..INPUTS)
                .map(|k| x[k] + away[k] * contents.scale[k])
                .collect()
        })
        .collect()
}

fn each<R>(bencher: Bencher, queries: &[Vec<f64>], mut ask: impl FnMut(&[f64]) -> R) {
    let mut next = 0;
    bencher.bench_local(|| {
        next = (next + 1) % queries.len();
        ask(black_box(&queries[next]))
    });
}

#[divan::bench(args = [1, 5, 64], sample_count = 1000)]
fn neighbours_on_trajectories(bencher: Bencher, k: usize) {
    let contents = on_trajectories();
    let file = opened(&contents);
    let (samples, mut y) = (file.view().samples(), [0.0; OUTPUTS]);
    each(bencher, &queries(&contents), |x| {
        samples.nearest(x, k, &mut y).unwrap().distance()
    });
}

/// Samples and queries without structure, far from each other: boxes exclude little.
#[divan::bench(args = [1, 5, 64], sample_count = 1000)]
fn neighbours_without_structure(bencher: Bencher, k: usize) {
    let contents = synthetic::noise(SAMPLES, 1);
    let file = opened(&contents);
    let (samples, mut y) = (file.view().samples(), [0.0; OUTPUTS]);
    let mut random = Random(78);
    let queries: Vec<_> = (0..QUERIES)
        .map(|_| synthetic::noisy_input(&mut random))
        .collect();
    each(bencher, &queries, |x| {
        samples.nearest(x, k, &mut y).unwrap().distance()
    });
}

/// One neighbour by comparing with every row of a flat table, already scaled: what there is to
/// beat.
#[divan::bench(sample_count = 1000)]
fn one_neighbour_naively(bencher: Bencher) {
    let contents = on_trajectories();
    let scaled = |row: &[f64]| -> Vec<f64> {
        (0..INPUTS)
            .map(|k| (row[k] - contents.offset[k]) / contents.scale[k])
            .collect()
    };
    let table: Vec<f64> = contents.x.iter().flat_map(|row| scaled(row)).collect();
    let queries: Vec<_> = queries(&contents).iter().map(|x| scaled(x)).collect();
    each(bencher, &queries, |query| {
        let mut best = (f64::INFINITY, 0);
        for (i, row) in table.chunks_exact(INPUTS).enumerate() {
            let square: f64 = row.iter().zip(query).map(|(x, q)| (x - q) * (x - q)).sum();
            if square < best.0 {
                best = (square, i);
            }
        }
        best
    });
}

fn with_process() -> (Contents, MemoryFile) {
    let mut contents = synthetic::trajectories(4000, 1);
    contents.regression = Some(synthetic::regression(&contents, PROCESS, true));
    let file = opened(&contents);
    (contents, file)
}

#[divan::bench(sample_count = 1000)]
fn mean_of_the_process(bencher: Bencher) {
    let (contents, file) = with_process();
    let (gpr, mut y) = (file.view().gpr().unwrap(), [0.0; OUTPUTS]);
    each(bencher, &queries(&contents), |x| {
        gpr.mean(x, &mut y).unwrap();
        y[0]
    });
}

#[divan::bench(sample_count = 1000)]
fn variance_of_the_process(bencher: Bencher) {
    let (contents, file) = with_process();
    let (gpr, mut scratch) = (file.view().gpr().unwrap(), vec![0.0; PROCESS]);
    let mut y = [0.0; OUTPUTS];
    each(bencher, &queries(&contents), |x| {
        gpr.variance(x, &mut scratch, &mut y).unwrap();
        y[0]
    });
}
