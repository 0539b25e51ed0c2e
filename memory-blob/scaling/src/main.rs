//! What the nearest neighbour costs in memories of different sizes, by the search of `memory-blob` and
//! by indices, as a Markdown table: `cargo run --release -p memory-scaling -- --queries OTHER MEMORY...`.

mod tree;

use std::hint::black_box;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, ensure};
use clap::Parser;
use kiddo::ImmutableKdTree;
use kiddo::SquaredEuclidean;
use memory_blob::MemoryFile;
use tree::Tree;

/// Entries of an input with four points.
const N: usize = 10;
/// Queries that are compared with every sample: it takes long.
const EXHAUSTIVE: usize = 256;

/// Measures queries of memories of motion, of patterns with four points.
#[derive(Parser)]
struct Cli {
    /// The memories to ask.
    #[arg(required = true)]
    memories: Vec<PathBuf>,
    /// The memory whose samples are the queries: of the same scene, by another seed.
    #[arg(long)]
    queries: PathBuf,
    /// How many queries, evenly over that memory.
    #[arg(long, default_value_t = 4096)]
    count: usize,
}

/// Squared distances that a method found, and its times, us.
struct Measured {
    squares: Vec<f64>,
    times: Vec<f64>,
}

fn main() -> anyhow::Result<()> {
    let cli = Cli::parse();
    let asked = open(&cli.queries)?.contents();
    ensure!(cli.count > 0, "--count = 0; allowed: at least 1");
    let step = (asked.x.len() / cli.count).max(1);
    let queries: Vec<&Vec<f64>> = asked.x.iter().step_by(step).take(cli.count).collect();
    println!(
        "| samples | search | median (us) | p99 (us) | times the crate's median | nearest found | worst distance |\n\
         |--:|---|--:|--:|--:|--:|--:|"
    );
    for path in &cli.memories {
        ask(path, &queries)?;
    }
    Ok(())
}

fn open(path: &Path) -> anyhow::Result<MemoryFile> {
    let file = MemoryFile::open(path, None)?;
    let inputs = file.view().samples().inputs();
    ensure!(
        inputs == N,
        "{}: {inputs} inputs; allowed: {N}",
        path.display()
    );
    Ok(file)
}

/// All methods on one memory.
fn ask(path: &Path, queries: &[&Vec<f64>]) -> anyhow::Result<()> {
    let clock = Instant::now();
    let file = open(path)?;
    let opened = clock.elapsed().as_secs_f64();
    let samples = file.view().samples();
    let scaling = samples.scaling();
    let scale = |x: &[f64]| -> [f64; N] {
        std::array::from_fn(|k| (x[k] - scaling.offset[k]) / scaling.scale[k])
    };
    // In the order of the file, which is that of a k-d tree.
    let count = samples.len();
    let mut rows: Vec<[f64; N]> = Vec::with_capacity(count);
    let mut row = [0.0; N];
    for index in 0..count {
        samples.input(index, &mut row)?;
        rows.push(scale(&row));
    }
    let scaled: Vec<[f64; N]> = queries.iter().map(|x| scale(x)).collect();

    let ours = |k: usize| {
        let found = measure(queries, |x| {
            samples
                .search(x, k)
                .map_or(f64::NAN, |n| n.distance().powi(2))
        });
        (format!("memory-blob, {k} nearest"), found)
    };
    let mut all = vec![ours(1), ours(5)];
    let few = &scaled[..EXHAUSTIVE.min(scaled.len())];
    let exhaustive = measure(few, |query| {
        let square = |row: &[f64; N]| row.iter().zip(query).map(|(x, q)| (x - q) * (x - q)).sum();
        rows.iter().map(square).fold(f64::INFINITY, f64::min)
    });
    all.push((format!("every sample ({} queries)", few.len()), exhaustive));

    let clock = Instant::now();
    let kiddo: ImmutableKdTree<f64, N> = ImmutableKdTree::new_from_slice(&rows);
    let built = clock.elapsed().as_secs_f64();
    let five = NonZero::new(5).context("five")?;
    let nearest = |query: &[f64; N]| kiddo.nearest_one::<SquaredEuclidean>(query).distance;
    all.push(("kiddo, exact".to_owned(), measure(&scaled, nearest)));
    let nearest = |query: &[f64; N]| kiddo.nearest_n::<SquaredEuclidean>(query, five)[0].distance;
    all.push(("kiddo, 5 nearest".to_owned(), measure(&scaled, nearest)));
    let nearest = |query: &[f64; N]| kiddo.approx_nearest_one::<SquaredEuclidean>(query).distance;
    all.push(("kiddo, one leaf".to_owned(), measure(&scaled, nearest)));
    drop(kiddo);

    let clock = Instant::now();
    let tree = Tree::over(rows);
    let boxed = clock.elapsed().as_secs_f64();
    for slack in [0.0, 0.2, 0.5, 1.0] {
        let found = measure(&scaled, |query| tree.nearest(query, slack).1);
        all.push((
            format!("tree of boxes, within {:.0} %", 100.0 * slack),
            found,
        ));
    }

    let truth = all[0].1.squares.clone();
    let base = quantile(&all[0].1.times, 0.5);
    for (name, found) in &all {
        let pairs = found.squares.iter().zip(&truth);
        // Rounding differs with the order of sums.
        let is_nearest = |(square, least): &(&f64, &f64)| square.sqrt() <= least.sqrt() + 1e-9;
        let hits = pairs.clone().filter(is_nearest).count();
        let excess = pairs.map(|(square, least)| (square / least.max(1e-18)).sqrt());
        let worst = excess.fold(0.0, f64::max);
        let (p50, p99) = (quantile(&found.times, 0.5), quantile(&found.times, 0.99));
        println!(
            "| {count} | {name} | {p50:.1} | {p99:.1} | {:.2} | {:.1} % | {worst:.2} |",
            p50 / base,
            100.0 * hits as f64 / found.squares.len() as f64,
        );
    }
    eprintln!(
        "{}: {count} samples, {} bytes, opened in {opened:.2} s; kiddo's tree in {built:.2} s, the tree of boxes in {boxed:.2} s",
        path.display(),
        file.size()
    );
    Ok(())
}

/// Asks every query once; each differs from the one before, so that caches know only the neighbourhood.
fn measure<Q>(queries: &[Q], nearest: impl Fn(&Q) -> f64) -> Measured {
    let mut found = Measured {
        squares: Vec::with_capacity(queries.len()),
        times: Vec::with_capacity(queries.len()),
    };
    for query in queries {
        let begin = Instant::now();
        let square = black_box(nearest(black_box(query)));
        found.times.push(begin.elapsed().as_nanos() as f64 / 1e3);
        found.squares.push(square);
    }
    found
}

fn quantile(times: &[f64], share: f64) -> f64 {
    let mut times = times.to_vec();
    times.sort_by(f64::total_cmp);
    let at = (share * times.len() as f64) as usize;
    times
        .get(at.min(times.len().saturating_sub(1)))
        .copied()
        .unwrap_or(0.0)
}
