//! Memories made of numbers, for tests, benches and examples: their shapes are real, their advice
//! is not.
#![allow(dead_code)] // each user takes what it needs

use memory_blob::{Contents, MemoryFile, Regression};
use serde_json::{Map, Value, json};

/// Entries of an input with four points.
pub const INPUTS: usize = 10;
/// Entries of an output with four points.
pub const OUTPUTS: usize = 14;
/// Steps of a trajectory.
const STEPS: usize = 20;

/// A small generator, so that the tests need no crate.
pub struct Random(pub u64);

impl Random {
    /// A number in [0, 1).
    pub fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Numbers in [-size / 2, size / 2).
    pub fn row(&mut self, length: usize, size: f64) -> Vec<f64> {
        (0..length).map(|_| size * (self.next() - 0.5)).collect()
    }
}

/// Inputs of a square with this centre (px), half a side (px) and angle (rad).
pub fn input(centre: [f64; 2], half: f64, angle: f64) -> Vec<f64> {
    let (sin, cos) = angle.sin_cos();
    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
        .iter()
        .flat_map(|[x, y]: &[f64; 2]| {
            [
                centre[0] + half * (cos * x - sin * y),
                centre[1] + half * (sin * x + cos * y),
            ]
        })
        .chain([4.0 * half * half, angle])
        .collect()
}

/// Samples on smooth trajectories of a square that comes to rest in the middle of a 640 x 480
/// image.
pub fn trajectories(count: usize, seed: u64) -> Contents {
    let mut random = Random(seed);
    let (mut x, mut y) = (Vec::new(), Vec::new());
    let goal = input([320.0, 240.0], 60.0, 0.0);
    while x.len() < count {
        let start = [
            80.0 + 480.0 * random.next(),
            80.0 + 320.0 * random.next(),
            20.0 + 50.0 * random.next(),
            3.0 * (random.next() - 0.5),
        ];
        let bow = 80.0 * (random.next() - 0.5);
        for step in 0..STEPS.min(count - x.len()) {
            let t = step as f64 / (STEPS - 1) as f64;
            let blend = |a: f64, b: f64| a + (b - a) * t * t * (3.0 - 2.0 * t);
            let aside = bow * (std::f64::consts::PI * t).sin();
            let centre = [
                blend(start[0], 320.0) + aside,
                blend(start[1], 240.0) - aside,
            ];
            x.push(input(centre, blend(start[2], 60.0), blend(start[3], 0.0)));
            let twist = [
                (320.0 - centre[0]) / 1000.0,
                (240.0 - centre[1]) / 1000.0,
                0.1 * (1.0 - t),
                0.0,
                0.0,
                -start[3] * t * (1.0 - t),
            ];
            y.push([&twist[..], &goal[..8]].concat());
        }
    }
    contents(x, y)
}

/// Inputs without any structure, one unit wide in every scaled coordinate, so that none decides
/// distances alone.
pub fn noisy_input(random: &mut Random) -> Vec<f64> {
    (0..INPUTS)
        .map(|k| scale(k) * (random.next() - 0.5))
        .collect()
}

/// Samples at such inputs: the hardest case for a search.
pub fn noise(count: usize, seed: u64) -> Contents {
    let mut random = Random(seed);
    let x = (0..count).map(|_| noisy_input(&mut random)).collect();
    let y = (0..count).map(|_| random.row(OUTPUTS, 10.0)).collect();
    contents(x, y)
}

/// Scale of an input: of an image coordinate, the area or the angle.
fn scale(k: usize) -> f64 {
    match k {
        8 => 10_000.0,
        9 => 1.0,
        _ => 300.0,
    }
}

fn contents(x: Vec<Vec<f64>>, y: Vec<Vec<f64>>) -> Contents {
    let count = x.len() as u32;
    let provenance: Map<String, Value> = [("tool".to_owned(), json!("synthetic numbers"))]
        .into_iter()
        .collect();
    Contents {
        task: [7; 32],
        offset: (0..INPUTS).map(|k| k as f64).collect(),
        scale: (0..INPUTS).map(scale).collect(),
        trajectory: (0..count).map(|i| i / STEPS as u32).collect(),
        step: (0..count).map(|i| i % STEPS as u32).collect(),
        cost_to_go: (0..count).map(|i| f64::from(count - i)).collect(),
        x,
        y,
        regression: None,
        provenance,
    }
}

/// The same, as a file that was written, opened and has lost its name.
pub fn opened(contents: &Contents) -> MemoryFile {
    let directory = tempfile::TempDir::new().unwrap();
    let path = directory.path().join("synthetic.vpcmem");
    contents.write(&path).unwrap();
    MemoryFile::open(&path, None).unwrap()
}

/// A process over `count` of the samples with random weights and, where asked for, a
/// well-conditioned factor: right in its shapes, not fitted to anything.
pub fn regression(contents: &Contents, count: usize, factor: bool) -> Regression {
    let mut random = Random(23);
    let total = contents.x.len();
    let row = |random: &mut Random, i: usize| {
        let mut row = random.row(i + 1, 0.02);
        row[i] = 1.0 + random.next();
        row
    };
    Regression {
        x: (0..count)
            .map(|i| contents.x[i * total / count].clone())
            .collect(),
        length_scale: (0..INPUTS).map(|k| 0.5 + 0.1 * k as f64).collect(),
        signal_variance: 1.7,
        noise_variance: 0.01,
        mean: random.row(OUTPUTS, 5.0),
        lambda: (0..count).map(|_| random.row(OUTPUTS, 2.0)).collect(),
        output_scale: (0..OUTPUTS).map(|o| 0.5 + o as f64).collect(),
        cholesky: factor.then(|| (0..count).flat_map(|i| row(&mut random, i)).collect()),
    }
}

/// The naive search: squared distances of all samples in scaled inputs, least first, ties by row.
pub fn compare_with_all(contents: &Contents, query: &[f64]) -> Vec<(f64, usize)> {
    let square = |x: &[f64]| {
        (0..query.len())
            .map(|k| ((x[k] - query[k]) / contents.scale[k]).powi(2))
            .sum()
    };
    let mut all: Vec<(f64, usize)> = contents.x.iter().map(|x| square(x)).zip(0..).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    all
}
