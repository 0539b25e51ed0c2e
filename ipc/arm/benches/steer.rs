//! Times of what the 1 kHz loop of the arm computes. `cargo bench --bench steer`

use arm::ik::inverse;
use arm::{Chain, Joints, Model, ShaperSettings, Twist, singularity};
use divan::black_box;

fn main() {
    divan::main();
}

/// The reference: joint velocities for a twist.
#[divan::bench]
fn inverse_kinematics(bencher: divan::Bencher) {
    let (chain, q) = (Chain::default(), Joints::from(arm::READY));
    let up = Twist::z() * 0.1;
    bencher.bench_local(|| inverse(&black_box(&chain).jacobian(black_box(&q))) * black_box(up));
}

/// The share of a motion that keeps clear of singularities.
#[divan::bench]
fn clear_of_singularities(bencher: divan::Bencher) {
    let (chain, q) = (Chain::default(), Joints::from(arm::READY));
    let (limits, shaper) = (Model::Panda.limits(), ShaperSettings::default());
    let dq = inverse(&chain.jacobian(&q)) * Twist::z() * 0.1;
    bencher.bench_local(|| singularity::share(&chain, limits, &shaper, black_box(&q), &dq));
}
