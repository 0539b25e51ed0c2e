//! The search is exact: what comparing with every sample finds, for any number of neighbours, on
//! trajectories, where samples lie close and way points repeat, and without any structure.

mod synthetic;

use memory_blob::{Contents, MAX_NEIGHBOURS, MemoryFile};
use synthetic::{INPUTS, OUTPUTS, Random, compare_with_all, opened};

/// Compares distances, not rows: where samples are equally near, either may count.
fn compare(contents: &Contents, file: &MemoryFile, query: &[f64], k: usize) {
    let all = compare_with_all(contents, query);
    let samples = file.view().samples();
    let mut mean = [0.0; OUTPUTS];
    let nearest = samples.nearest(query, k, &mut mean).unwrap();
    assert_eq!(nearest.indices().len(), k);
    assert!((nearest.distance() - all[0].0.sqrt()).abs() < 1e-9);
    // The k-th distance is clear of the next, so that rounding cannot decide who is in.
    if all.get(k).is_none_or(|next| next.0 - all[k - 1].0 > 1e-9) {
        for (o, found) in mean.iter().enumerate() {
            let sum: f64 = all[..k].iter().map(|(_, row)| contents.y[*row][o]).sum();
            assert!((found - sum / k as f64).abs() < 1e-9, "k = {k}");
        }
    }
}

#[test]
fn on_trajectories_the_search_is_exact() {
    let contents = synthetic::trajectories(3000, 3);
    let file = opened(&contents);
    let mut random = Random(4);
    for trial in 0..300 {
        let x = &contents.x[(random.next() * 3000.0) as usize];
        let away = random.row(INPUTS, 0.2);
        let query: Vec<f64> = (0..INPUTS)
            .map(|k| x[k] + away[k] * contents.scale[k])
            .collect();
        compare(&contents, &file, &query, 1 + trial % MAX_NEIGHBOURS);
        compare(&contents, &file, x, 1);
    }
}

#[test]
fn every_count_of_samples_round_a_block_is_searched_to_the_end() {
    for count in [1, 2, 31, 32, 33, 511, 512, 513, 1025] {
        let contents = synthetic::noise(count, count as u64);
        let file = opened(&contents);
        let mut random = Random(8);
        for _ in 0..20 {
            let query = synthetic::noisy_input(&mut random);
            for k in [1, count.min(MAX_NEIGHBOURS)] {
                compare(&contents, &file, &query, k);
            }
        }
    }
}

#[test]
fn equally_near_samples_give_the_first_of_the_file() {
    let mut contents = synthetic::noise(200, 2);
    contents.x.iter_mut().for_each(|x| *x = vec![1.0; INPUTS]);
    let file = opened(&contents);
    let samples = file.view().samples();
    let nearest = samples.search(&[3.0; INPUTS], 5).unwrap();
    assert_eq!(nearest.indices(), [0, 1, 2, 3, 4]);
    assert_eq!(nearest, samples.search(&[3.0; INPUTS], 5).unwrap());
}

#[test]
fn the_largest_finite_inputs_are_answered_with_a_sample() {
    let contents = synthetic::trajectories(100, 5);
    let file = opened(&contents);
    let samples = file.view().samples();
    for x in [f64::MAX, f64::MIN, 1e200, f64::MIN_POSITIVE] {
        let nearest = samples.search(&[x; INPUTS], 3).unwrap();
        assert!(nearest.indices().iter().all(|&i| i < 100), "{x}");
    }
}
