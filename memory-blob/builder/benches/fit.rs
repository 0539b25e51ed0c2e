//! How long the off-line fits take: `cargo bench -p memory-builder --bench fit`.
//!
//! Sizes are the paper's: about 800 samples, 10 inputs, 14 outputs. Everything runs on one thread.

use std::hint::black_box;

use divan::Bencher;
use memory_builder::mixture::{Mixture, MixtureSettings};
use memory_builder::regression::likelihood::Likelihood;
use memory_builder::regression::{FitSettings, Kernel, Matrix, fit};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const INPUTS: usize = 10;
const OUTPUTS: usize = 14;

fn main() {
    divan::main();
}

/// Waves of random directions with 1 % of noise.
fn samples(count: usize) -> (Matrix, Matrix) {
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
    let outputs = (0..count).flat_map(|row| (0..OUTPUTS).map(move |column| (row, column)));
    let outputs = outputs.map(|(row, column)| value(row, column)).collect();
    let matrix = |name, columns, data| Matrix::new(name, columns, data).expect("finite samples");
    (
        matrix("inputs", INPUTS, inputs.clone()),
        matrix("outputs", OUTPUTS, outputs),
    )
}

#[divan::bench(args = [400, 800], sample_count = 20)]
fn likelihood_and_gradient(bencher: Bencher<'_, '_>, count: usize) {
    let (inputs, outputs) = samples(count);
    let likelihood = Likelihood::new(&inputs, &outputs).expect("equal rows");
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

#[divan::bench(args = [50, 300], sample_count = 10)]
fn mixture_of_failures(bencher: Bencher<'_, '_>, count: usize) {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut point = |centre: f64| -> [f64; 6] {
        std::array::from_fn(|_| centre + 0.1 * rng.sample::<f64, _>(StandardNormal))
    };
    let points: Vec<[f64; 6]> = (0..count).map(|at| point((at % 3) as f64)).collect();
    bencher.bench_local(|| Mixture::fit(black_box(&points), &MixtureSettings::default(), 1));
}
