//! The arm's kinematics against Pinocchio and a URDF: `fixtures/kinematics.py` made the numbers.

use nalgebra::{Matrix3, Vector3};
use panda::{Chain, Jacobian, Joints};
use serde::Deserialize;

#[derive(Deserialize)]
struct Fixture {
    samples: Vec<Sample>,
}

#[derive(Deserialize)]
struct Sample {
    q: [f64; 7],
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
    jacobian: [[f64; 7]; 6],
}

fn samples() -> Vec<Sample> {
    let fixture: Fixture =
        serde_json::from_str(include_str!("../fixtures/kinematics.json")).expect("the fixture");
    assert!(fixture.samples.len() >= 100);
    fixture.samples
}

#[test]
fn flange_poses_agree_with_pinocchio_to_a_nanometre() {
    for sample in samples() {
        let flange = Chain::default().flange(&Joints::from(sample.q));
        let expected = Vector3::from(sample.translation);
        assert!((flange.translation.vector - expected).norm() < 1e-9);
        let expected = Matrix3::from_fn(|i, j| sample.rotation[i][j]);
        assert!((flange.rotation.matrix() - expected).norm() < 1e-9);
    }
}

#[test]
fn jacobians_agree_with_pinocchio() {
    for sample in samples() {
        let jacobian = Chain::default().posture(&Joints::from(sample.q)).jacobian;
        let expected = Jacobian::from_fn(|i, j| sample.jacobian[i][j]);
        assert!((jacobian - expected).norm() < 1e-9);
    }
}
