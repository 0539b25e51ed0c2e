//! The arm file of the scene against the robot that is there.

use arm::Joints;
use messages::RobotState;
use nalgebra::Vector3;
use scene::Arm;

use super::Finding;
use crate::joints::joints;
use crate::view::View;

/// Slowest camera whose velocity is compared, m/s.
const MOVES: f64 = 0.005;
/// Greatest difference between its velocity and that by the joints, of the greater.
const APART: f64 = 0.2;
const WHAT: &str = "arm";

/// Whether the robot has the joints of the scene's arm, within their ranges, and moves the camera
/// as these would; empty where the scene names no arm, or no robot is heard.
pub(super) fn examine(view: &View, now_ns: u64) -> Vec<Finding> {
    let (Some(arm), Some(robot)) = (&view.arm, view.robot_at(now_ns)) else {
        return Vec::new();
    };
    let (told, count) = (robot.joints as usize, arm.joints.len());
    if told != count {
        let words = format!("the robot tells {told} joints, the scene's arm has {count}");
        let remedy = "its client must tell the positions of all joints, base to flange, in vpc/robot; or name another \
                      arm file in the scene";
        return vec![Finding::fail(WHAT, words, remedy)];
    }
    let mut findings = Vec::new();
    for joint in joints(view, now_ns) {
        let ([least, most], unit) = (joint.range, joint.unit);
        let words = |what| {
            let (name, q) = (&joint.name, joint.q);
            format!("{name} at {q:.3} {unit} is {what} its range, {least:.3} to {most:.3} {unit}")
        };
        if joint.left() < 0.0 {
            let remedy = "the arm file is of another robot, or its client tells joints in another order or unit";
            findings.push(Finding::fail(WHAT, words("outside"), remedy));
        } else if joint.left() < joint.margin {
            let words = words("in the margin of");
            findings.push(Finding::warn(
                WHAT,
                words,
                "move it by hand, or reduce the arm file's `margin`",
            ));
        }
    }
    findings.extend(velocity(arm, robot));
    if findings.is_empty() {
        findings.push(Finding::ok(
            WHAT,
            format!("{count} joints, all within their ranges"),
        ));
    }
    findings
}

/// The camera's velocity as the robot tells it, against that of its joints by the arm file.
fn velocity(arm: &Arm, robot: &RobotState) -> Option<Finding> {
    let (q, dq) = (Joints::from(robot.q), Joints::from(robot.dq));
    let by_joints = arm::Arm::from(arm).camera_twist(&q, &dq);
    let [told, by_joints] = [robot.twist, by_joints].map(|[x, y, z, ..]| Vector3::new(x, y, z));
    let most = told.norm().max(by_joints.norm());
    let apart = (told - by_joints).norm();
    if most < MOVES || apart < APART * most {
        return None;
    }
    let [told, by_joints, apart] = [told.norm(), by_joints.norm(), apart].map(|v| 100.0 * v);
    let words = format!(
        "the camera moves at {told:.1} cm/s as the robot tells it, at {by_joints:.1} cm/s by its joints and the arm file: \
         {apart:.1} cm/s apart"
    );
    let remedy = "see the arm file's urdf, tip and camera, and the frame of vpc/robot's twist";
    Some(Finding::fail(WHAT, words, remedy))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joints::tests::with_arm;
    use crate::output::Tone;

    fn examined(change: impl FnOnce(&mut RobotState)) -> Vec<Finding> {
        let mut view = with_arm(View::default(), 0);
        change(view.robot.as_mut().unwrap());
        examine(&view, 0)
    }

    #[test]
    fn a_robot_with_the_arms_joints_in_their_ranges_is_fine() {
        let findings = examined(|_| ());
        assert_eq!(findings.len(), 1);
        assert_eq!(
            (findings[0].verdict, &*findings[0].found),
            (Tone::Good, "7 joints, all within their ranges")
        );
        let mut view = with_arm(View::default(), 0);
        view.arm = None;
        assert_eq!(examine(&view, 0), []);
    }

    #[test]
    fn another_number_of_joints_is_told_with_both() {
        let findings = examined(|robot| robot.joints = 6);
        assert_eq!((findings.len(), findings[0].verdict), (1, Tone::Bad));
        assert_eq!(
            findings[0].found,
            "the robot tells 6 joints, the scene's arm has 7"
        );
    }

    #[test]
    fn a_joint_outside_its_range_or_in_its_margin_is_told_with_the_range() {
        let findings = examined(|robot| (robot.q[3], robot.q[1]) = (0.2, 1.7));
        let verdicts = findings.iter().map(|finding| finding.verdict);
        assert!(verdicts.eq([Tone::Warning, Tone::Bad]), "{findings:?}");
        let margin = "panda_joint2 at 1.700 rad is in the margin of its range, -1.763 to 1.763 rad";
        assert_eq!(findings[0].found, margin);
        let outside = "panda_joint4 at 0.200 rad is outside its range, -3.072 to -0.070 rad";
        assert_eq!(findings[1].found, outside);
    }

    #[test]
    fn a_camera_that_moves_otherwise_than_its_joints_is_told() {
        // The last joint turns the camera, 7 cm aside, about the flange's axis.
        let turning = |twist: [f64; 3]| {
            examined(|robot| {
                robot.dq[6] = 0.5;
                robot.twist[..3].copy_from_slice(&twist);
            })
        };
        let found = |findings: &[Finding]| findings[0].found.clone();
        let still = found(&turning([0.0; 3]));
        assert!(
            still.contains("at 0.0 cm/s as the robot tells it, at 3.5 cm/s by its joints"),
            "{still}"
        );
        // The camera's x axis points away from the flange's.
        let right = [[0.035, 0.0], [-0.035, 0.0], [0.0, 0.035], [0.0, -0.035]];
        let right = right.map(|[x, y]| turning([x, y, 0.0])[0].verdict);
        let good = right.iter().filter(|verdict| **verdict == Tone::Good);
        assert_eq!(good.count(), 1, "{right:?}");
    }
}
