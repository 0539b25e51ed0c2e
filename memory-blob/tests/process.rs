//! Regression against scikit-learn: `python/gpr_fixture.py` made the data, the kernel and the
//! answers; the weights and the factor are solved for here, by the textbook.

mod synthetic;

use memory_blob::{Contents, Regression};
use serde_json::{Map, Value};
use synthetic::opened;

struct Fixture(Value);

impl Fixture {
    fn read() -> Self {
        Self(serde_json::from_str(include_str!("../fixtures/gpr.json")).unwrap())
    }

    fn number(&self, key: &str) -> f64 {
        self.0[key].as_f64().unwrap()
    }

    fn row(&self, key: &str) -> Vec<f64> {
        numbers(&self.0[key])
    }

    fn rows(&self, key: &str) -> Vec<Vec<f64>> {
        self.0[key]
            .as_array()
            .unwrap()
            .iter()
            .map(numbers)
            .collect()
    }
}

fn numbers(row: &Value) -> Vec<f64> {
    let row = row.as_array().unwrap();
    row.iter().map(|x| x.as_f64().unwrap()).collect()
}

/// Packed lower rows of the Cholesky factor of a symmetric matrix.
fn cholesky(matrix: &[Vec<f64>]) -> Vec<f64> {
    let at = |i: usize, j: usize| i * (i + 1) / 2 + j;
    let mut factor = vec![0.0; at(matrix.len(), 0)];
    for i in 0..matrix.len() {
        for j in 0..=i {
            let done: f64 = (0..j).map(|k| factor[at(i, k)] * factor[at(j, k)]).sum();
            let rest = matrix[i][j] - done;
            factor[at(i, j)] = if i == j {
                rest.sqrt()
            } else {
                rest / factor[at(j, j)]
            };
        }
    }
    factor
}

/// Solves L L^T x = b for one column.
fn solve(factor: &[f64], mut b: Vec<f64>) -> Vec<f64> {
    let at = |i: usize, j: usize| i * (i + 1) / 2 + j;
    for i in 0..b.len() {
        let done: f64 = (0..i).map(|j| factor[at(i, j)] * b[j]).sum();
        b[i] = (b[i] - done) / factor[at(i, i)];
    }
    for i in (0..b.len()).rev() {
        let done: f64 = (i + 1..b.len()).map(|j| factor[at(j, i)] * b[j]).sum();
        b[i] = (b[i] - done) / factor[at(i, i)];
    }
    b
}

fn contents(fixture: &Fixture) -> Contents {
    let (x, y) = (fixture.rows("inputs"), fixture.rows("outputs"));
    let (offset, scale) = (fixture.row("offset"), fixture.row("scale"));
    let (mean, length_scale) = (fixture.row("output_mean"), fixture.row("length_scale"));
    let (signal, noise) = (
        fixture.number("signal_variance"),
        fixture.number("noise_variance"),
    );
    let kernel = |a: &[f64], b: &[f64]| {
        let square = |k: usize| ((a[k] - b[k]) / scale[k] / length_scale[k]).powi(2);
        signal * (-0.5 * (0..a.len()).map(square).sum::<f64>()).exp()
    };
    let matrix: Vec<Vec<f64>> = (0..x.len())
        .map(|i| {
            let noise = |j| if i == j { noise } else { 0.0 };
            (0..x.len())
                .map(|j| kernel(&x[i], &x[j]) + noise(j))
                .collect()
        })
        .collect();
    let factor = cholesky(&matrix);
    let columns: Vec<Vec<f64>> = (0..mean.len())
        .map(|o| solve(&factor, y.iter().map(|row| row[o] - mean[o]).collect()))
        .collect();
    let lambda = (0..x.len())
        .map(|i| columns.iter().map(|column| column[i]).collect())
        .collect();
    Contents {
        task: [1; 32],
        offset,
        scale,
        trajectory: vec![0; x.len()],
        step: (0..x.len() as u32).collect(),
        cost_to_go: vec![0.0; x.len()],
        regression: Some(Regression {
            x: x.clone(),
            length_scale,
            signal_variance: signal,
            noise_variance: noise,
            mean,
            lambda,
            output_scale: fixture.row("output_size"),
            cholesky: Some(factor),
        }),
        provenance: Map::new(),
        x,
        y,
    }
}

#[test]
fn mean_and_variance_are_those_of_scikit_learn() {
    let fixture = Fixture::read();
    let file = opened(&contents(&fixture));
    let gpr = file.view().gpr().unwrap();
    let (means, deviations) = (fixture.rows("mean"), fixture.rows("deviation"));
    let (mut y, mut scratch) = (vec![0.0; gpr.outputs()], vec![0.0; gpr.len()]);
    let queries = fixture.rows("queries");
    assert_eq!(queries.len(), 20);
    for (query, (mean, deviation)) in queries.iter().zip(means.iter().zip(&deviations)) {
        gpr.mean(query, &mut y).unwrap();
        for (found, expected) in y.iter().zip(mean) {
            assert!((found - expected).abs() < 1e-8, "{found} {expected}");
        }
        gpr.variance(query, &mut scratch, &mut y).unwrap();
        for (found, expected) in y.iter().zip(deviation) {
            let found = found.sqrt();
            assert!((found - expected).abs() < 1e-8, "{found} {expected}");
        }
    }
}

#[test]
fn far_from_all_samples_the_prior_remains() {
    let fixture = Fixture::read();
    let contents = contents(&fixture);
    let file = opened(&contents);
    let gpr = file.view().gpr().unwrap();
    let (mut y, mut scratch) = (vec![0.0; gpr.outputs()], vec![0.0; gpr.len()]);
    let r = contents.regression.unwrap();
    for x in [1e9, f64::MAX] {
        gpr.mean(&[x; 10], &mut y).unwrap();
        // The exponential ends at that of -700, 1e-304.
        assert!(y.iter().zip(&r.mean).all(|(y, m)| (y - m).abs() < 1e-300));
        gpr.variance(&[x; 10], &mut scratch, &mut y).unwrap();
        for (variance, scale) in y.iter().zip(&r.output_scale) {
            assert_eq!(*variance, r.signal_variance * scale * scale);
        }
    }
}

#[test]
fn every_width_and_count_matches_the_formula() {
    for points in 1..=8 {
        for count in [1, 7, 8, 9] {
            let mut random = synthetic::Random(points as u64 * 10 + count as u64);
            let (n, p) = (2 * points + 2, 2 * points + 6);
            let x: Vec<Vec<f64>> = (0..count).map(|_| random.row(n, 2.0)).collect();
            let regression = Regression {
                x: x.clone(),
                length_scale: vec![1.5; n],
                signal_variance: 0.7,
                noise_variance: 0.1,
                mean: random.row(p, 3.0),
                lambda: (0..count).map(|_| random.row(p, 3.0)).collect(),
                output_scale: vec![1.0; p],
                cholesky: None,
            };
            let file = opened(&Contents {
                task: [1; 32],
                offset: vec![0.0; n],
                scale: vec![1.0; n],
                y: x.iter().map(|_| vec![0.0; p]).collect(),
                trajectory: vec![0; count],
                step: vec![0; count],
                cost_to_go: vec![0.0; count],
                regression: Some(regression.clone()),
                provenance: Map::new(),
                x,
            });
            let (query, mut y) = (random.row(n, 2.0), vec![0.0; p]);
            file.view().gpr().unwrap().mean(&query, &mut y).unwrap();
            for o in 0..p {
                let weighted = |(x, lambda): (&Vec<f64>, &Vec<f64>)| {
                    let square: f64 = x.iter().zip(&query).map(|(x, q)| (x - q).powi(2)).sum();
                    0.7 * (-0.5 * square / 2.25).exp() * lambda[o]
                };
                let sum: f64 = regression
                    .x
                    .iter()
                    .zip(&regression.lambda)
                    .map(weighted)
                    .sum();
                assert!((y[o] - regression.mean[o] - sum).abs() < 1e-12);
            }
        }
    }
}
