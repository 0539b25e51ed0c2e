//! The joints of the scene's arm as bars in the image: range, margins, position, and which one
//! binds.

use foxglove::messages::{ImageAnnotations, Timestamp, points_annotation::Type};
use messages::{ArmBound, Bound};
use scene::Arm;

use crate::annotation::{AMBER, BLUE, GREY, circle, lines, text};

/// Left end, top and width of the bars, and from one to the next, px.
const LEFT: f64 = 24.0;
const TOP: f64 = 48.0;
const WIDTH: f64 = 120.0;
const APART: f64 = 18.0;
/// Half the height of an end, and of a margin's mark, px.
const TICK: f64 = 5.0;

/// A bar for each joint at these positions, rad or m; one that turns without end has no dot.
pub(crate) fn bars(
    arm: &Arm,
    q: [f64; arm::JOINTS],
    bound: Option<Bound<'_>>,
    at: Option<Timestamp>,
) -> ImageAnnotations {
    let binding = bound.filter(|bound| matches!(bound.kind, ArmBound::Range | ArmBound::Speed));
    let mut annotations = ImageAnnotations::default();
    for (k, (joint, q)) in arm.joints.iter().zip(q).enumerate() {
        let binds = binding.is_some_and(|bound| bound.index == k);
        let (color, dot) = if binds { (AMBER, AMBER) } else { (GREY, BLUE) };
        let [least, most] = joint.range;
        let has_ends = (most - least).is_finite();
        let v = TOP + APART * k as f64;
        let u = |q: f64| LEFT + WIDTH * ((q - least) / (most - least)).clamp(0.0, 1.0);
        let track = [[LEFT, v], [LEFT + WIDTH, v]].into_iter();
        annotations
            .points
            .push(lines(at, Type::LineList, track, color));
        let name = (k + 1).to_string();
        annotations.texts.push(text(at, [4.0, v + TICK], name));
        if !has_ends {
            continue;
        }
        let ends = [least, least + arm.margin, most - arm.margin, most];
        let ticks = ends
            .into_iter()
            .flat_map(|q| [[u(q), v - TICK], [u(q), v + TICK]]);
        annotations
            .points
            .push(lines(at, Type::LineList, ticks, color));
        annotations
            .circles
            .push(circle(at, [u(q), v], 8.0, dot, dot));
    }
    annotations
}

#[cfg(test)]
mod tests {
    use scene::Scene;

    use super::*;

    #[test]
    fn each_joint_has_a_dot_in_its_range_and_the_one_that_binds_another_colour() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../ipc/scene/scenes/s.toml");
        let text = format!("arm = 'panda.toml'\n{}", scene::PAPER_ROBOT);
        let mut arm = Scene::parse(&text, path).unwrap().arm.unwrap();
        let q = [0.0, -0.8, 0.0, -3.0718, 0.0, 1.6, 9.0];
        let bound = |kind| {
            Some(Bound {
                kind,
                index: 3,
                name: "",
                link: None,
                link_name: "",
            })
        };
        let drawn = bars(&arm, q, bound(ArmBound::Range), None);
        assert_eq!(
            (drawn.circles.len(), drawn.texts.len(), drawn.points.len()),
            (7, 7, 14)
        );
        let place = |k: usize| drawn.circles[k].position.unwrap().x - 0.5;
        let [middle, lower, upper] = [0, 3, 6].map(place);
        assert!((middle - LEFT - WIDTH / 2.0).abs() < 1e-9, "{middle}");
        assert_eq!((lower, upper), (LEFT, LEFT + WIDTH));
        let amber = |drawn: &ImageAnnotations| {
            let colors = drawn.circles.iter().map(|circle| circle.fill_color);
            colors.map(|color| color == Some(AMBER)).collect::<Vec<_>>()
        };
        assert!(
            amber(&drawn)
                .iter()
                .enumerate()
                .all(|(k, is)| *is == (k == 3))
        );
        assert!(!amber(&bars(&arm, q, bound(ArmBound::Wall), None)).contains(&true));
        arm.joints[0].range = [f64::NEG_INFINITY, f64::INFINITY];
        assert_eq!(bars(&arm, q, None, None).circles.len(), 6);
    }
}
