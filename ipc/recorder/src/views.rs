//! What Foxglove draws of each message: views of its own schemas, beside the message itself.

use foxglove::messages::{
    FrameTransform, ImageAnnotations, Pose, PoseInFrame, Quaternion, Vector3, log::Level,
    points_annotation::Type,
};
use ipc::{
    CycleRecord, Features, Hold, MAX_POINTS, Reply, Request, RobotState, Snapshot, TwistCommand,
    TwistState,
};
use nalgebra::Isometry3;
use recording::{Recorded, Sink, WriteError};

use crate::annotation::{BLUE, CLEAR, GREY, RED, circle, lines, text};
use crate::scenery::CAMERA;
use crate::view_writer::ViewWriter;

/// Frame of the pattern, which stands still.
const OBJECT: &str = "object";

/// A message that Foxglove is to show somehow.
pub trait Viewed: Recorded {
    /// Writes the views of it.
    #[doc(hidden)]
    fn view<S: Sink>(&self, _to: &mut ViewWriter<S>) -> Result<(), WriteError> {
        Ok(())
    }
}

impl Viewed for TwistCommand {}

impl Viewed for Snapshot {}

impl Viewed for Features {
    fn view<S: Sink>(&self, to: &mut ViewWriter<S>) -> Result<(), WriteError> {
        const TOPIC: &str = "/camera/features";
        if !to.is_due(TOPIC, self.stamp.published_ns) {
            return Ok(());
        }
        to.draw(TOPIC, &self.stamp, |at| {
            let circle = |(i, point): (usize, [f64; 2])| {
                let is_visible = self.visible & (1 << i) != 0_u32;
                circle(at, point, 10.0, BLUE, if is_visible { BLUE } else { CLEAR })
            };
            ImageAnnotations {
                circles: self.pairs().enumerate().map(circle).collect(),
                points: vec![lines(at, Type::LineLoop, self.pairs(), BLUE)],
                ..ImageAnnotations::default()
            }
        })
    }
}

impl Viewed for RobotState {
    fn view<S: Sink>(&self, to: &mut ViewWriter<S>) -> Result<(), WriteError> {
        if !to.is_due("/tf", self.stamp.published_ns) {
            return Ok(());
        }
        let (place, turn) = camera_in_object(self.translation, self.rotation);
        to.draw("/tf", &self.stamp, |at| FrameTransform {
            timestamp: at,
            parent_frame_id: OBJECT.to_owned(),
            child_frame_id: CAMERA.to_owned(),
            translation: Some(place),
            rotation: Some(turn),
        })?;
        to.draw("/camera/pose", &self.stamp, |at| PoseInFrame {
            timestamp: at,
            frame_id: OBJECT.to_owned(),
            pose: Some(Pose {
                position: Some(place),
                orientation: Some(turn),
            }),
        })
    }
}

impl Viewed for CycleRecord {
    fn view<S: Sink>(&self, to: &mut ViewWriter<S>) -> Result<(), WriteError> {
        const TOPIC: &str = "/camera/way_point";
        let published_ns = self.stamp.published_ns;
        if to.is_due(TOPIC, published_ns) {
            to.draw(TOPIC, &self.stamp, |at| {
                let count = (self.way_point_count as usize).min(MAX_POINTS);
                let points = self.way_point.chunks_exact(2).take(count);
                let ends = points.flat_map(|p| {
                    [[-7.0, -7.0], [7.0, 7.0], [-7.0, 7.0], [7.0, -7.0]]
                        .map(|[u, v]| [p[0] + u, p[1] + v])
                });
                let ways = self
                    .foreseen()
                    .map(|way| lines(at, Type::LineStrip, way, GREY));
                ImageAnnotations {
                    points: ways.chain([lines(at, Type::LineList, ends, RED)]).collect(),
                    texts: vec![text(at, [8.0, 24.0], caption(self))],
                    ..ImageAnnotations::default()
                }
            })?;
        }
        let situation = [self.state, self.hold];
        if to.situation.replace(situation) == Some(situation) {
            return Ok(());
        }
        let level = match TwistState::from_code(self.state) {
            Some(TwistState::Holding | TwistState::Braking) => Level::Warning,
            _ => Level::Info,
        };
        let text = format!("cycle {}: {}", self.cycle, caption(self));
        to.log(level, "vpcd", text, published_ns)
    }
}

impl Viewed for Request {
    fn view<S: Sink>(&self, to: &mut ViewWriter<S>) -> Result<(), WriteError> {
        let action = self.action().map(|action| action.to_string());
        let text = format!(
            "request {:016x}: {}",
            self.id,
            action.as_deref().unwrap_or("?")
        );
        to.log(Level::Info, "operator", text, self.stamp.published_ns)
    }
}

impl Viewed for Reply {
    fn view<S: Sink>(&self, to: &mut ViewWriter<S>) -> Result<(), WriteError> {
        let outcome = self.outcome().map(|outcome| outcome.to_string());
        let text = format!(
            "reply to {:016x}: {}",
            self.id,
            outcome.as_deref().unwrap_or("?")
        );
        let level = match self.outcome {
            0 => Level::Info,
            _ => Level::Warning,
        };
        to.log(level, "vpcd", text, self.stamp.published_ns)
    }
}

/// State, cause and error in one line.
fn caption(record: &CycleRecord) -> String {
    let state = TwistState::from_code(record.state).map(|state| state.to_string());
    let mut text = state.unwrap_or_else(|| "unknown state".to_owned());
    match Hold::from_code(record.hold) {
        Some(Hold::None) | None => (),
        Some(cause) => text += &format!(": {cause}"),
    }
    if record.error_px.is_finite() {
        text += &format!(", error {:.1} px", record.error_px);
    }
    if record.way_point_count > 0 {
        text += ", way point";
    }
    if record.arrival_s.is_finite() {
        text += &format!(", arrives in {:.1} s", record.arrival_s);
    } else if record.knows_no_way() {
        text += ", no way known";
    }
    text
}

/// The camera in the object frame, from the object in the camera frame (m; rotation vector, rad).
fn camera_in_object(translation: [f64; 3], rotation: [f64; 3]) -> (Vector3, Quaternion) {
    let camera = Isometry3::new(translation.into(), rotation.into()).inverse();
    let (place, turn) = (camera.translation, camera.rotation);
    let place = Vector3 {
        x: place.x,
        y: place.y,
        z: place.z,
    };
    let turn = Quaternion {
        x: turn.i,
        y: turn.j,
        z: turn.k,
        w: turn.w,
    };
    (place, turn)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    #[test]
    fn the_camera_in_the_object_frame_is_the_inverse_pose() {
        let (translation, rotation) = ([0.1, -0.2, 0.7], [0.3, -0.4, 1.1]);
        let (place, turn) = camera_in_object(translation, rotation);
        let object = Isometry3::new(translation.into(), rotation.into());
        let origin = object * Point3::new(place.x, place.y, place.z);
        assert!(origin.coords.norm() < 1e-12, "{origin}");
        let turn = nalgebra::Quaternion::new(turn.w, turn.x, turn.y, turn.z);
        let turn = nalgebra::UnitQuaternion::from_quaternion(turn);
        assert!((turn * object.rotation).angle() < 1e-12);
        // A quarter turn about the optical axis and back.
        let (_, turn) = camera_in_object([0.0; 3], [0.0, 0.0, std::f64::consts::FRAC_PI_2]);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((turn.z + half).abs() < 1e-12 && (turn.w - half).abs() < 1e-12);
    }
}
