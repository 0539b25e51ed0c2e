//! A scene before a memory is built for it.

use scene::Scene;

use crate::Points;
use crate::canvas::{Canvas, colour};
use crate::frame::{Frame, GOAL};

/// Style of what a refusal is about.
const OFFENDER: &str =
    "fill=\"#d81f1f\" fill-opacity=\"0.6\" stroke=\"#d81f1f\" stroke-width=\"2\"";

/// The pattern as the camera sees it, px.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// Its points.
    pub points: Points,
    /// Corners of the marker round each point; none where markers are points.
    pub markers: Vec<Points>,
}

/// A point that a scene is refused for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offender {
    /// Which point of the pattern, from 0.
    pub point: usize,
    /// The radius about it that has to be clear, px; 0 where it has to be in sight itself.
    pub radius: f64,
}

/// A scene: occlusions and the zone round them in which the memory is asked, the goal, some starts.
#[derive(Clone, Debug)]
pub struct Preview<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Rectangles (left, top, right, bottom, px) that together are the zone round the occlusions.
    pub zone: Vec<[f64; 4]>,
    /// The goal.
    pub goal: Seen,
    /// What is wrong with the goal.
    pub offender: Option<Offender>,
    /// Starts.
    pub starts: Vec<Seen>,
    /// Title.
    pub title: String,
}

impl Preview<'_> {
    /// The drawing: the pattern of each start as a polygon with a dot in each feature's colour,
    /// that of the goal in red, with the number of each point; markers in their size. Of a goal
    /// that is refused, only the offender is red.
    pub fn canvas(&self) -> Canvas {
        let mut frame = Frame::new(self.scene, &self.title);
        let orange = "fill=\"#e69f00\" opacity=\"0.25\" shape-rendering=\"crispEdges\"";
        frame.rectangles(self.zone.iter().copied(), orange);
        for start in &self.starts {
            let thin = "stroke=\"#777777\" stroke-width=\"0.5\" opacity=\"0.6\"";
            frame.polyline(round(&start.points), thin);
            for (i, marker) in start.markers.iter().enumerate() {
                let style = format!(
                    "stroke=\"{}\" stroke-width=\"0.5\" opacity=\"0.6\"",
                    colour(i)
                );
                frame.polyline(round(marker), &style);
            }
            for (i, point) in start.points.iter().enumerate() {
                frame.circle(*point, 1.8, &format!("fill=\"{}\"", colour(i)));
            }
        }
        let edge = match self.offender {
            None => GOAL,
            Some(_) => "stroke=\"#222222\" stroke-width=\"1.5\"",
        };
        frame.polyline(round(&self.goal.points), edge);
        for marker in &self.goal.markers {
            frame.polyline(round(marker), "stroke=\"#222222\" stroke-width=\"1\"");
        }
        for (i, point) in self.goal.points.iter().enumerate() {
            let is_refused = self.offender.is_some_and(|offender| offender.point == i);
            let style = match is_refused {
                true => OFFENDER.to_owned(),
                false => format!("fill=\"{}\" {edge}", colour(i)),
            };
            frame.circle(*point, 5.0, &style);
            frame.number(*point, i);
        }
        if let Some((offender, point)) = self.refused() {
            let style =
                "fill=\"none\" stroke=\"#d81f1f\" stroke-width=\"1.5\" stroke-dasharray=\"4 3\"";
            frame.circle_in_image(point, offender.radius, style);
            if let Some(marker) = self.goal.markers.get(offender.point) {
                frame.polyline(round(marker), "stroke=\"#d81f1f\" stroke-width=\"2\"");
            }
        }
        frame.explained(match self.offender {
            None => "red: goal; thin: starts; grey: occlusions; orange: the memory is asked",
            Some(_) => "red: refused, dashed: has to be clear; black: goal; grey: occlusions",
        })
    }

    /// The offender and where it is.
    fn refused(&self) -> Option<(Offender, [f64; 2])> {
        let offender = self.offender?;
        Some((offender, *self.goal.points.get(offender.point)?))
    }
}

/// A closed polygon.
fn round(corners: &[[f64; 2]]) -> impl Iterator<Item = [f64; 2]> {
    corners.iter().chain(corners.first()).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_offender_alone_is_red() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let drawn = |offender: Option<Offender>| {
            let goal = Seen {
                points: vec![[50.0, 50.0], [90.0, 50.0]],
                markers: vec![vec![[45.0, 45.0], [55.0, 55.0]]],
            };
            let preview = Preview {
                scene: &scene,
                zone: Vec::new(),
                goal,
                offender,
                starts: Vec::new(),
                title: String::new(),
            };
            preview.canvas().svg()
        };
        let (point, radius) = (0, 30.0);
        let refused = drawn(Some(Offender { point, radius }));
        assert_eq!(refused.matches(OFFENDER).count(), 1);
        // 30 px of an image of 640, drawn 360 wide.
        assert!(refused.contains("r=\"16.875\""), "{refused}");
        // The polygon and the rings of a goal; of one that is refused, they are black.
        let black = "stroke=\"#222222\" stroke-width=\"1.5\"";
        assert_eq!(refused.matches(black).count(), 2);
        assert_eq!(drawn(None).matches(GOAL).count(), 3);
    }
}
