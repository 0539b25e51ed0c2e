//! Drawings over the camera's image: seen points, goal, foreseen path. visualization_msgs/
//! ImageMarker, one topic each, which Foxglove draws.

use messages::CycleRecord;
use ros2_client::Publisher;
use scene::Scene;

use crate::config::Reliability;
use crate::message::{ColorRGBA, Header, ImageMarker, Point, Time};
use crate::ros::{Ros, RosError};

/// Types of a drawing.
const LINE_LIST: i32 = 2;
const POINTS: i32 = 4;
/// Size of a point, and width of a line, px.
const POINT_PX: f32 = 8.0;
const LINE_PX: f32 = 2.0;
/// Foxglove counts from the corner of the first pixel, we from its centre.
const CORNER_PX: f64 = 0.5;

/// The topics.
pub struct Overlay {
    publishers: [Publisher<ImageMarker>; 3],
    goal: Vec<[f64; 2]>,
    frame: String,
}

impl Overlay {
    /// Offers them below the node's name.
    ///
    /// # Errors
    /// [`RosError`].
    pub fn open(ros: &mut Ros, scene: &Scene, frame: &str) -> Result<Self, RosError> {
        let name = ros.name().to_owned();
        let mut open = |topic: &str| {
            let topic = format!("{name}/overlay/{topic}");
            ros.publisher(&topic, Reliability::Reliable)
        };
        Ok(Self {
            publishers: [open("seen")?, open("goal")?, open("foreseen")?],
            goal: scene.goal_px().collect(),
            frame: frame.to_owned(),
        })
    }

    /// Draws what a cycle saw and foresaw, at the time of its features.
    ///
    /// # Errors
    /// Why a drawing could not be sent.
    pub fn draw(&self, cycle: &CycleRecord, stamp: Time) -> Result<(), String> {
        let is_finite = |pair: &[f64; 2]| pair.iter().all(|x| x.is_finite());
        let seen = cycle.pairs().filter(is_finite).collect();
        let foreseen = cycle.foreseen().flat_map(|way| {
            let way: Vec<_> = way.collect();
            let lines = way.windows(2).filter(|ends| ends.iter().all(is_finite));
            lines.flatten().copied().collect::<Vec<_>>()
        });
        let drawings = [
            (POINTS, POINT_PX, [0.1, 0.9, 0.2], seen),
            (POINTS, POINT_PX, [1.0, 0.6, 0.0], self.goal.clone()),
            (LINE_LIST, LINE_PX, [0.2, 0.6, 1.0], foreseen.collect()),
        ];
        for (publisher, (kind, scale, colour, pairs)) in self.publishers.iter().zip(drawings) {
            let sent = publisher.publish(self.marker(&stamp, kind, scale, colour, pairs));
            sent.map_err(|why| format!("{why:?}"))?;
        }
        Ok(())
    }

    fn marker(
        &self,
        stamp: &Time,
        r#type: i32,
        scale: f32,
        [r, g, b]: [f32; 3],
        pairs: Vec<[f64; 2]>,
    ) -> ImageMarker {
        let points = pairs.iter().map(|[u, v]| Point {
            x: u + CORNER_PX,
            y: v + CORNER_PX,
            z: 0.0,
        });
        ImageMarker {
            header: Header {
                stamp: stamp.clone(),
                frame_id: self.frame.clone(),
            },
            ns: "vpcd".to_owned(),
            r#type,
            scale,
            outline_color: ColorRGBA { r, g, b, a: 1.0 },
            points: points.collect(),
            ..ImageMarker::default()
        }
    }
}
