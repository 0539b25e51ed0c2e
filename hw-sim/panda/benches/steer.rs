//! Times of what the 1 kHz loop of the arm computes. `cargo bench --bench steer`

use divan::black_box;
use panda::Model;
use panda::ik::joint_velocities;
use panda::kinematics::{Chain, Joints, Twist};
use panda::shaper::ShaperSettings;
use panda::singularity;

fn main() {
    divan::main();
}

/// The reference: joint velocities for a twist.
#[divan::bench]
fn inverse_kinematics(bencher: divan::Bencher) {
    let (chain, q) = (Chain::default(), Joints::from(panda::READY));
    let up = Twist::z() * 0.1;
    bencher.bench_local(|| joint_velocities(black_box(&chain), black_box(&q), black_box(&up)));
}

/// The share of a motion that keeps clear of singularities.
#[divan::bench]
fn clear_of_singularities(bencher: divan::Bencher) {
    let (chain, q) = (Chain::default(), Joints::from(panda::READY));
    let (limits, shaper) = (Model::Panda.limits(), ShaperSettings::default());
    let dq = joint_velocities(&chain, &q, &(Twist::z() * 0.1));
    bencher.bench_local(|| singularity::share(&chain, limits, &shaper, black_box(&q), &dq));
}
