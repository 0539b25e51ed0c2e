//! Twists of the camera, of the tool, and along the base's axes.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::config::{CommandFrame, Config};
use crate::message::{Pose, TwistStamped};
use crate::refusal::{Refusal, finite};

/// Least length of a quaternion that is taken as one.
const UNIT: f64 = 1e-3;

/// The frames of camera, tool and base, and the camera on the tool.
#[derive(Clone, Debug, PartialEq)]
pub struct Frames {
    /// `frame_id` of each.
    camera: String,
    tool: String,
    base: String,
    /// Topic of the tool's pose in the base.
    pose: String,
    tool_from_camera: Isometry3<f64>,
}

impl Frames {
    /// From the configuration.
    pub fn new(config: &Config) -> Self {
        let rotation = Vector3::from(config.mount.rotation_deg).map(f64::to_radians);
        Self {
            camera: config.camera.frame.clone(),
            tool: config.robot.tool.clone(),
            base: config.robot.base.clone(),
            pose: config.robot.pose.clone(),
            tool_from_camera: Isometry3::new(Vector3::from(config.mount.translation), rotation),
        }
    }

    /// The twist of a message, in whichever of the frames, as one of the camera.
    ///
    /// # Errors
    /// [`Refusal`]: of another frame, not finite, or in the base's frame while `base_from_tool` is
    /// not known.
    pub fn told(
        &self,
        message: &TwistStamped,
        base_from_tool: Option<&UnitQuaternion<f64>>,
    ) -> Result<[f64; 6], Refusal> {
        let Self {
            camera, tool, base, ..
        } = self;
        let found = &message.header.frame_id;
        let frame = match found {
            _ if found == camera => CommandFrame::Camera,
            _ if found == tool => CommandFrame::Tool,
            _ if found == base => CommandFrame::Base,
            _ => {
                return Err(Refusal::Frame {
                    found: found.clone(),
                    allowed: format!("{camera}, {tool} or {base}"),
                });
            }
        };
        let twist = message.twist.array();
        finite("the twist", &twist)?;
        let of_camera = self.camera(&twist, frame, base_from_tool);
        let of_camera = of_camera.ok_or_else(|| Refusal::NoPose(self.pose.clone()))?;
        // Numbers that are too large for the change of frames.
        finite("the camera's twist", &of_camera)?;
        Ok(of_camera)
    }

    /// A twist of the camera in another frame, vx vy vz wx wy wz in m/s and rad/s. `base_from_tool`
    /// is the tool's rotation, which only the base's frame needs; `None` where it is needed and not
    /// known.
    pub fn out(
        &self,
        camera: &[f64; 6],
        frame: CommandFrame,
        base_from_tool: Option<&UnitQuaternion<f64>>,
    ) -> Option<[f64; 6]> {
        if frame == CommandFrame::Camera {
            return Some(*camera);
        }
        let tool = moved(&self.tool_from_camera, camera);
        match frame {
            CommandFrame::Base => base_from_tool.map(|rotation| turned(rotation, &tool)),
            _ => Some(tool),
        }
    }

    /// A twist of such a frame as one of the camera.
    pub fn camera(
        &self,
        twist: &[f64; 6],
        frame: CommandFrame,
        base_from_tool: Option<&UnitQuaternion<f64>>,
    ) -> Option<[f64; 6]> {
        let camera_from_tool = self.tool_from_camera.inverse();
        match frame {
            CommandFrame::Camera => Some(*twist),
            CommandFrame::Tool => Some(moved(&camera_from_tool, twist)),
            CommandFrame::Base => base_from_tool
                .map(|rotation| moved(&camera_from_tool, &turned(&rotation.inverse(), twist))),
        }
    }
}

fn halves(twist: &[f64; 6]) -> [Vector3<f64>; 2] {
    let [vx, vy, vz, wx, wy, wz] = *twist;
    [Vector3::new(vx, vy, vz), Vector3::new(wx, wy, wz)]
}

fn whole(v: Vector3<f64>, w: Vector3<f64>) -> [f64; 6] {
    [v.x, v.y, v.z, w.x, w.y, w.z]
}

fn turned(rotation: &UnitQuaternion<f64>, twist: &[f64; 6]) -> [f64; 6] {
    let [v, w] = halves(twist);
    whole(rotation * v, rotation * w)
}

/// The twist of a rigidly connected frame: the velocity of its own origin, along its own axes.
/// `pose` is the old frame in the new one.
fn moved(pose: &Isometry3<f64>, twist: &[f64; 6]) -> [f64; 6] {
    let [v, w] = halves(twist);
    let w = pose.rotation * w;
    whole(pose.rotation * v + pose.translation.vector.cross(&w), w)
}

/// A pose of a message; `None` if it is not finite, or its quaternion has no length.
pub fn isometry(pose: &Pose) -> Option<Isometry3<f64>> {
    let (p, q) = (&pose.position, &pose.orientation);
    let rotation = Quaternion::new(q.w, q.x, q.y, q.z);
    let rotation = UnitQuaternion::try_new(rotation, UNIT)?;
    let whole = Isometry3::from_parts(Translation3::new(p.x, p.y, p.z), rotation);
    let is_finite = whole.to_homogeneous().iter().all(|x| x.is_finite());
    is_finite.then_some(whole)
}

/// The mean velocity of a frame between two of its poses, `seconds` apart, along its own axes.
pub fn velocity(from: &Isometry3<f64>, to: &Isometry3<f64>, seconds: f64) -> [f64; 6] {
    let turn = from.rotation.inverse() * to.rotation;
    // Along the axes half way.
    let middle = from.rotation * turn.powf(0.5);
    let way = to.translation.vector - from.translation.vector;
    let v = middle.inverse() * way / seconds;
    whole(v, turn.scaled_axis() / seconds)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::of_keys;

    fn frames() -> Frames {
        let mount = "[mount]\ntranslation = [0.05, -0.02, 0.08]\nrotation_deg = [5, -40, 90]";
        Frames::new(&of_keys(mount))
    }

    const TWIST: [f64; 6] = [0.03, -0.02, 0.05, 0.2, -0.1, 0.3];

    fn near(a: &[f64; 6], b: &[f64; 6], tolerance: f64) {
        let error = (0..6).map(|k| (a[k] - b[k]).abs()).fold(0.0, f64::max);
        assert!(error < tolerance, "{a:?} {b:?}");
    }

    #[test]
    fn out_and_back_is_the_same_twist_in_every_frame() {
        let frames = frames();
        let turn = UnitQuaternion::from_euler_angles(0.4, -1.1, 2.0);
        for frame in [CommandFrame::Camera, CommandFrame::Tool, CommandFrame::Base] {
            let out = frames.out(&TWIST, frame, Some(&turn)).unwrap();
            let back = frames.camera(&out, frame, Some(&turn)).unwrap();
            near(&back, &TWIST, 1e-12);
            assert_eq!(out == TWIST, frame == CommandFrame::Camera);
        }
        assert_eq!(frames.out(&TWIST, CommandFrame::Base, None), None);
    }

    #[test]
    fn the_camera_moves_as_told_when_the_tool_moves_as_told() {
        let frames = frames();
        let start = Isometry3::new(Vector3::new(0.4, 0.1, 0.3), Vector3::new(0.3, -2.0, 0.5));
        let seconds = 1e-4;
        // The tool's velocity along base axes moves the tool; the camera is carried along.
        let told = frames.out(&TWIST, CommandFrame::Base, Some(&start.rotation));
        let [v, w] = halves(&told.unwrap());
        let end = Isometry3::from_parts(
            Translation3::from(start.translation.vector + v * seconds),
            UnitQuaternion::from_scaled_axis(w * seconds) * start.rotation,
        );
        let camera = |tool: &Isometry3<f64>| tool * frames.tool_from_camera;
        near(
            &velocity(&camera(&start), &camera(&end), seconds),
            &TWIST,
            1e-5,
        );
        // And so told by the tool's pose.
        let tool = velocity(&start, &end, seconds);
        near(
            &frames.camera(&tool, CommandFrame::Tool, None).unwrap(),
            &TWIST,
            1e-5,
        );
    }

    #[test]
    fn a_pose_without_rotation_or_with_nan_is_none() {
        let mut pose = Pose::default();
        assert_eq!(isometry(&pose), None);
        pose.orientation.w = 2.0;
        assert!(isometry(&pose).is_some());
        pose.position.y = f64::NAN;
        assert_eq!(isometry(&pose), None);
        pose.position.y = 0.0;
        pose.orientation.x = f64::NAN;
        assert_eq!(isometry(&pose), None);
    }
}
