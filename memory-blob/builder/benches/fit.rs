//! How long the off-line fits take: `cargo bench -p memory-builder --bench fit`.
//!
//! Sizes are the paper's: about 800 samples, 10 inputs, 14 outputs. Everything runs on one thread.

use std::hint::black_box;

use divan::Bencher;
use memory_builder::regression::likelihood::{Inputs, Likelihood};
use memory_builder::regression::{FitSettings, Kernel, fit};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const INPUTS: usize = 10;
const OUTPUTS: usize = 14;

fn main() {
    divan::main();
}

/// Waves of random directions with 1 % of noise.
fn samples(count: usize) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut normal = |size: usize| -> Vec<f64> {
        (0..size)
            .map(|_| rng.sample::<f64, _>(StandardNormal))
            .collect()
    };
    let (inputs, directions) = (normal(count * INPUTS), normal(INPUTS * OUTPUTS));
    let noise = normal(count * OUTPUTS);
    let value = |row: usize, column: usize| {
        let x = &inputs[row * INPUTS..(row + 1) * INPUTS];
        let phase: f64 = x
            .iter()
            .zip(&directions[column * INPUTS..])
            .map(|(x, w)| 0.4 * x * w)
            .sum();
        phase.sin() + 0.01 * noise[row * OUTPUTS + column]
    };
    let output = |row| (0..OUTPUTS).map(|column| value(row, column)).collect();
    let rows = inputs.chunks(INPUTS).map(<[f64]>::to_vec).collect();
    (rows, (0..count).map(output).collect())
}

#[divan::bench(args = [400, 800], sample_count = 20)]
fn likelihood_and_gradient(bencher: Bencher<'_, '_>, count: usize) {
    let (inputs, outputs) = samples(count);
    let y = faer::Mat::from_fn(count, OUTPUTS, |row, column| outputs[row][column]);
    let likelihood = Likelihood::new(Inputs::of(&inputs), y);
    let kernel = Kernel {
        length_scales: vec![3.0; INPUTS],
        signal_variance: 1.0,
        noise_variance: 1e-3,
    };
    bencher.bench_local(|| likelihood.value_and_gradient(black_box(&kernel)));
}

#[divan::bench(args = [400, 800], sample_count = 3, sample_size = 1)]
fn whole_fit_of_800_searched_on(bencher: Bencher<'_, '_>, subset: usize) {
    let (inputs, outputs) = samples(800);
    let settings = FitSettings {
        subset,
        ..FitSettings::default()
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("one thread");
    bencher.bench_local(|| {
        pool.install(|| fit(&inputs, &outputs, &[0.0; OUTPUTS], black_box(&settings)))
    });
}
