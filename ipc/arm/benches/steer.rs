//! Times of what the 1 kHz loop of the arm computes. `cargo bench --bench steer`

use arm::ik::inverse;
use arm::{Arm, Chain, Dampers, Joints, Model, ShaperSettings, Twist, singularity};
use divan::black_box;

fn main() {
    divan::main();
}

/// The reference: joint velocities for a twist.
#[divan::bench]
fn inverse_kinematics(bencher: divan::Bencher) {
    let (chain, q) = (Chain::FRANKA, Joints::from(arm::READY));
    let up = Twist::z() * 0.1;
    bencher.bench_local(|| inverse(&black_box(&chain).jacobian(black_box(&q))) * black_box(up));
}

/// The bounds on the camera's velocity in a posture, as the law asks for them in every cycle and
/// every simulated step.
#[divan::bench]
fn dampers(bencher: divan::Bencher) {
    let (arm, q) = law();
    bencher.bench_local(|| Dampers::at(black_box(&arm), black_box(&q), &[1.0; 6], 0.4));
}

/// The joints after a simulated step.
#[divan::bench]
fn joints_after_a_step(bencher: divan::Bencher) {
    let (arm, q) = law();
    bencher.bench_local(|| black_box(&arm).moved(black_box(&q), black_box(&[0.05; 6]), 0.4));
}

/// An arm as the law knows it.
fn law() -> (Arm, Joints) {
    let arm = Arm {
        chain: Chain::FRANKA,
        shaped: Chain::FRANKA,
        limits: *Model::Panda.limits(),
        margin: 0.2,
        speed: 0.25,
        strain: 0.6,
        walls: Default::default(),
        points: Default::default(),
        shapes: Default::default(),
    };
    (arm, Joints::from(arm::READY))
}

/// The share of a motion that keeps clear of singularities.
#[divan::bench]
fn clear_of_singularities(bencher: divan::Bencher) {
    let (chain, q) = (Chain::FRANKA, Joints::from(arm::READY));
    let (limits, shaper) = (Model::Panda.limits(), ShaperSettings::default());
    let dq = inverse(&chain.jacobian(&q)) * Twist::z() * 0.1;
    bencher.bench_local(|| singularity::share(&chain, limits, &shaper, black_box(&q), &dq));
}
