//! Times of what the 1 kHz loop of the arm computes. `cargo bench --bench steer`

use arm::ik::inverse;
use arm::{
    Arm, Capsule, Chain, Cuboid, Dampers, Joints, Model, Other, Pair, ShaperSettings, Shapes,
    Twist, singularity,
};
use divan::black_box;
use nalgebra::{Rotation3, Vector3};

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

/// The same with as many shapes as the shipped Panda has, about a box on a table: 35 pairs.
#[divan::bench]
fn dampers_of_links(bencher: divan::Bencher) {
    let (mut arm, q) = law();
    let heights = [0.05, 0.25, 0.45, 0.6, 0.8, 0.95, 1.03, 1.0, 0.9, 0.85];
    let joints = [0, 1, 2, 3, 4, 5, 6, 7, 7, 7];
    let capsules = heights.into_iter().zip(joints).map(|(height, joints)| {
        let ends = [-0.05, 0.05].map(|x| Vector3::new(x, 0.0, height));
        let radius = 0.06;
        Capsule {
            ends,
            radius,
            joints,
        }
    });
    let below = (0..3).flat_map(|k| (5..10).map(move |shape| (shape, Other::Link(k))));
    let all = below.chain((0..10).flat_map(|k| [(k, Other::Box(0)), (k, Other::Wall(0))]));
    arm.walls.extend([arm::Wall {
        normal: [0.0, 0.0, 1.0],
        offset: 0.0,
    }]);
    arm.shapes = Shapes {
        capsules: capsules.collect(),
        boxes: std::iter::once(Cuboid {
            center: Vector3::new(0.5, 0.0, 0.1),
            rotation: Rotation3::identity(),
            half: Vector3::new(0.1, 0.2, 0.1),
        })
        .collect(),
        pairs: all.map(|(shape, other)| Pair { shape, other }).collect(),
        clearance: 0.02,
    };
    bencher.bench_local(|| Dampers::at(black_box(&arm), black_box(&q), &[1.0; 6], 0.4));
}

/// The joints after a simulated step.
#[divan::bench]
fn joints_after_a_step(bencher: divan::Bencher) {
    let (arm, q) = law();
    bencher.bench_local(|| black_box(&arm).moved(black_box(&q), black_box(&[0.05; 6]), 0.0, 0.4));
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
        is_elbow_free: true,
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
