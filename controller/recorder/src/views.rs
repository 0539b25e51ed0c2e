//! What Foxglove draws of each message: views of its own schemas, beside the message itself.

use arm::Mount;
use foxglove::messages::{
    FrameTransform, ImageAnnotations, Pose, PoseInFrame, log::Level, points_annotation::Type,
};
use messages::{
    CycleRecord, DesiredTwist, Features, MAX_POINTS, Reply, Request, RobotState, Snapshot, Stamp,
    TwistCommand, TwistState,
};
use nalgebra::Isometry3;
use recording::{Recorded, Sink, WriteError};
use scene::Arm;

use crate::annotation::{AMBER, BLUE, CLEAR, GREY, RED, circle, lines, text};
use crate::joint_bars::bars;
use crate::scenery::CAMERA;
use crate::view_writer::ViewWriter;
use crate::world::{
    BASE, FLANGE, OBJECT, arm, base_from_flange, foreseen, isometry, known_arm, pose,
};

/// A message that Foxglove is to show somehow.
pub trait Viewed: Recorded {
    /// Writes the views of it.
    #[doc(hidden)]
    fn view<S: Sink>(&self, _to: &mut ViewWriter<S>) -> Result<(), WriteError> {
        Ok(())
    }
}

impl Viewed for TwistCommand {}

impl Viewed for DesiredTwist {}

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
        // A bridge that does not know where the object is leaves zeros.
        if self.translation != [0.0; 3] {
            let object = Isometry3::new(self.translation.into(), self.rotation.into());
            let camera = object.inverse();
            transform(to, &self.stamp, [OBJECT, CAMERA], &camera)?;
            to.draw("/camera/pose", &self.stamp, |at| PoseInFrame {
                timestamp: at,
                frame_id: OBJECT.to_owned(),
                pose: Some(pose(&camera)),
            })?;
        }
        if let Some(scene) = to.scene.clone()
            && let Some(known) = &scene.arm
            && known.joints.len() == self.joints as usize
        {
            let base = isometry(&arm::Arm::from(known).chain.pose(&self.q.into())).inverse();
            transform(to, &self.stamp, [CAMERA, BASE], &base)?;
            to.draw("/world/arm", &self.stamp, |at| known_arm(known, self.q, at))?;
            let bound = to.bound;
            return to.draw("/camera/joints", &self.stamp, |at| {
                bars(known, self.q, bound, at)
            });
        }
        if self.joints as usize != arm::JOINTS {
            return Ok(());
        }
        // From the object over the camera to the base, so that each frame has one parent.
        if let Some(Mount { flange_from_camera }) = to.mount {
            let flange = isometry(&flange_from_camera).inverse();
            transform(to, &self.stamp, [CAMERA, FLANGE], &flange)?;
        }
        transform(
            to,
            &self.stamp,
            [FLANGE, BASE],
            &base_from_flange(self.q).inverse(),
        )?;
        to.draw("/world/arm", &self.stamp, |at| arm(self.q, at))
    }
}

impl Viewed for CycleRecord {
    fn view<S: Sink>(&self, to: &mut ViewWriter<S>) -> Result<(), WriteError> {
        const TOPIC: &str = "/camera/way_point";
        if self.count > 0 {
            to.bound = self.bound();
        }
        let scene = to.scene.clone();
        let arm = scene.as_ref().and_then(|scene| scene.arm.as_ref());
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
                let ellipses = self
                    .ellipses()
                    .map(|(_, outline)| lines(at, Type::LineLoop, outline, AMBER));
                let points = ways.chain([lines(at, Type::LineList, ends, RED)]);
                ImageAnnotations {
                    points: points.chain(ellipses).collect(),
                    texts: vec![text(at, [8.0, 24.0], caption(self, arm))],
                    ..ImageAnnotations::default()
                }
            })?;
        }
        const FORESEEN: &str = "/world/foreseen";
        if let Some(scene) = to.scene.clone()
            && to.is_due(FORESEEN, published_ns)
        {
            to.draw(FORESEEN, &self.stamp, |at| foreseen(&scene, self, at))?;
        }
        let situation = [self.state, self.hold];
        if to.situation.replace(situation) == Some(situation) {
            return Ok(());
        }
        let level = match TwistState::from_code(self.state) {
            Some(TwistState::Holding | TwistState::Braking) => Level::Warning,
            _ => Level::Info,
        };
        let text = format!("cycle {}: {}", self.cycle, caption(self, arm));
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

/// Writes where a frame is in another.
fn transform<S: Sink>(
    to: &mut ViewWriter<S>,
    stamp: &Stamp,
    [parent, child]: [&str; 2],
    found: &Isometry3<f64>,
) -> Result<(), WriteError> {
    to.draw("/tf", stamp, |at| {
        let Pose {
            position,
            orientation,
        } = pose(found);
        FrameTransform {
            timestamp: at,
            parent_frame_id: parent.to_owned(),
            child_frame_id: child.to_owned(),
            translation: position,
            rotation: orientation,
        }
    })
}

/// State, cause and error in one line, with the names of this arm.
fn caption(record: &CycleRecord, arm: Option<&Arm>) -> String {
    let state = TwistState::from_code(record.state).map(|state| state.to_string());
    let mut text = state.unwrap_or_else(|| "unknown state".to_owned());
    if let Some(hold) = record.hold() {
        text += &format!(": {hold}");
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
    if let Some(bound) = record.bound() {
        text += ", ";
        text += &match arm {
            Some(arm) => bound.named(arm.names()).to_string(),
            None => bound.to_string(),
        };
    }
    let [metres, radians] = record.drift_speed();
    if metres + radians > 0.0 {
        text += &format!(
            ", pattern moves {:.1} cm/s, {radians:.2} rad/s",
            100.0 * metres
        );
    }
    match record.ellipses().count() {
        0 => (),
        hidden => text += &format!(", {hidden} hidden"),
    }
    text
}
