//! The robot as version 10 of the interface describes it to clients: a URDF.
//!
//! Frames, ranges and speeds, and how these shrink towards the ends of the ranges; no masses and no
//! shapes, since nothing here has them. Source of the element `position_based_velocity_limits`:
//! libfranka 0.21, `joint_velocity_limits.h`.

use std::fmt::Write;

use panda::kinematics::{FLANGE, LINKS};
use panda::limits::Model;

/// The description of a robot, in XML.
pub fn urdf(model: Model) -> String {
    let mut text = format!("<?xml version=\"1.0\"?>\n<robot name=\"{model}\">\n");
    for link in 0..=LINKS.len() + 1 {
        let _ = writeln!(text, "  <link name=\"link{link}\"/>");
    }
    for (k, (link, bound)) in LINKS.iter().zip(&model.limits().joints).enumerate() {
        // A line of the table turns about the old x axis, then moves along the new z axis.
        let xyz = [link.a, -link.sin * link.d, link.cos * link.d];
        let (lower, upper) = bound.taper.map_or((bound.lower, bound.upper), |taper| {
            (taper.lower, taper.upper)
        });
        let _ = write!(
            text,
            "  <joint name=\"joint{joint}\" type=\"revolute\">\n    \
             <origin xyz=\"{} {} {}\" rpy=\"{} 0 0\"/>\n    \
             <parent link=\"link{k}\"/>\n    <child link=\"link{joint}\"/>\n    \
             <axis xyz=\"0 0 1\"/>\n    \
             <limit lower=\"{lower}\" upper=\"{upper}\" velocity=\"{}\" effort=\"0\"/>\n",
            xyz[0],
            xyz[1],
            xyz[2],
            link.sin.atan2(link.cos),
            bound.velocity,
            joint = k + 1,
        );
        if let Some(taper) = bound.taper {
            let _ = writeln!(
                text,
                "    <position_based_velocity_limits velocity_offset=\"{}\" deceleration_limit=\"{}\"/>",
                taper.offset, taper.deceleration
            );
        }
        text += "  </joint>\n";
    }
    let _ = write!(
        text,
        "  <joint name=\"joint8\" type=\"fixed\">\n    <origin xyz=\"0 0 {FLANGE}\" rpy=\"0 0 0\"/>\n    \
         <parent link=\"link7\"/>\n    <child link=\"link8\"/>\n  </joint>\n</robot>\n"
    );
    text
}
