//! The joints of the scene's arm: where each is in its range, and which one binds the command.

use messages::ArmBound;
use serde::Serialize;

use crate::view::View;

/// A joint as views show it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Joint {
    /// Its name, or its number from 1.
    pub name: String,
    /// Its position, rad, or m where it slides.
    pub q: f64,
    /// The ends of its range, rad or m; null in JSON where it has none.
    pub range: [f64; 2],
    /// What the law keeps of the range at each end, rad or m.
    pub margin: f64,
    /// `rad` or `m`.
    pub unit: &'static str,
    /// Whether it is what binds the law's command.
    pub binds: bool,
}

impl Joint {
    /// Where a position is in the range, 0 at its lower end and 1 at the upper; `None` of a joint
    /// that turns without end.
    pub fn place(&self, q: f64) -> Option<f64> {
        let [least, most] = self.range;
        let place = (q - least) / (most - least);
        (most - least).is_finite().then(|| place.clamp(0.0, 1.0))
    }

    /// What is left to the nearer end of the range, rad or m.
    pub fn left(&self) -> f64 {
        let [least, most] = self.range;
        (self.q - least).min(most - self.q)
    }

    /// The range as a line of `width` characters: dots where the law does not go, and where it is.
    pub fn track(&self, width: usize) -> String {
        let [least, most] = self.range;
        let cell = |place: f64| (place * width.saturating_sub(1) as f64).round() as usize;
        let [from, to] = [least + self.margin, most - self.margin].map(|q| self.place(q));
        // A margin is seen, however short the line.
        let mark = usize::from(self.margin > 0.0);
        let from = from.map_or(0, |place| cell(place).max(mark));
        let to = to.map_or(width, |place| {
            cell(place).min(width.saturating_sub(1 + mark))
        });
        let at = self.place(self.q).map(cell);
        let cells = (0..width).map(|k| match k {
            _ if at == Some(k) => '●',
            _ if (from..=to).contains(&k) => '─',
            _ => '·',
        });
        cells.collect()
    }
}

/// The joints; empty where the scene names no arm, or the robot does not tell as many.
pub fn joints(view: &View, now_ns: u64) -> Vec<Joint> {
    let (Some(arm), Some(robot)) = (&view.arm, view.robot_at(now_ns)) else {
        return Vec::new();
    };
    if robot.joints as usize != arm.joints.len() {
        return Vec::new();
    }
    let bound = view.bound();
    let binding = bound.filter(|bound| matches!(bound.kind, ArmBound::Range | ArmBound::Speed));
    let joints = arm.joints.iter().zip(robot.q).enumerate();
    let joints = joints.map(|(k, (joint, q))| Joint {
        name: match arm.joint_names.get(k) {
            Some(name) if !name.is_empty() => name.to_string(),
            _ => (k + 1).to_string(),
        },
        q,
        range: joint.range,
        margin: arm.margin,
        unit: if joint.slides { "m" } else { "rad" },
        binds: binding.is_some_and(|bound| bound.index == k),
    });
    joints.collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use messages::{CycleRecord, Order, Received, RobotState, TwistState};
    use scene::Scene;

    use super::*;
    use crate::view::tests::record;

    /// A run with the shipped Panda, of which the fourth joint binds.
    pub fn with_arm(mut view: View, at_ns: u64) -> View {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../ipc/scene/scenes/s.toml");
        let text = format!("arm = 'panda.toml'\n{}", scene::PAPER_ROBOT);
        view.arm = Scene::parse(&text, path).unwrap().arm;
        let mut robot = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], 0);
        (robot.joints, robot.mode) = (7, 1);
        robot.q = [0.0, -0.8, 0.0, -2.87, 0.0, 1.6, 2.2];
        robot.stamp.published_ns = at_ns;
        view.robot = Some(robot);
        let last = view.latest().copied().unwrap_or_default();
        let message = CycleRecord {
            arm_bound: ArmBound::Range.code(),
            arm_bound_index: 3,
            count: 4,
            ..last
        };
        let order = Order::Next;
        view.cycle(&Received { message, order });
        view
    }

    #[test]
    fn each_joint_has_its_place_and_the_one_that_binds_is_told() {
        let mut view = View::default();
        let message = record(1, TwistState::Moving, None);
        let order = Order::Next;
        view.cycle(&Received { message, order });
        let mut view = with_arm(view, 0);
        let all = joints(&view, 0);
        assert_eq!((all.len(), &*all[3].name), (7, "panda_joint4"));
        let binding: Vec<_> = all.iter().map(|joint| joint.binds).collect();
        assert_eq!(binding.iter().filter(|binds| **binds).count(), 1);
        assert!(binding[3] && (all[3].left() - 0.2018).abs() < 1e-9);
        let half = "─".repeat(14);
        assert_eq!(all[0].track(31), format!("·{half}●{half}·"));
        assert_eq!(all[0].track(5), "·─●─·");
        assert_eq!(all[3].track(15), "·●────────────·");
        // Of another robot, or of one that is silent.
        assert_eq!(joints(&view, 2_000_000_000), []);
        view.robot.as_mut().unwrap().joints = 6;
        assert_eq!(joints(&view, 0), []);
    }

    #[test]
    fn a_joint_without_ends_has_no_place() {
        let joint = Joint {
            name: "1".to_owned(),
            q: 9.0,
            range: [f64::NEG_INFINITY, f64::INFINITY],
            margin: 0.2,
            unit: "rad",
            binds: false,
        };
        assert_eq!((joint.place(9.0), joint.left()), (None, f64::INFINITY));
        assert_eq!(joint.track(3), "───");
    }
}
