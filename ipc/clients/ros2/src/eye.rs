//! From tags, or points in order, to features. Pure.

use messages::Features;
use scene::Scene;

use crate::camera_info;
use crate::config::{Config, Targets};
use crate::message::{AprilTagDetectionArray, CameraInfo, Header, ImagePoint, PolygonStamped};
use crate::refusal::{Refusal, check_frame, finite};
use crate::stamp::{Clocks, Order};

/// Corners of a tag as the AprilTag library has them, in the order of a scene: upper left, upper
/// right, lower right, lower left.
const CORNERS: [usize; 4] = [3, 2, 1, 0];

/// Makes features.
#[derive(Clone, Debug)]
pub struct Eye {
    scene: Scene,
    targets: Targets,
    frame: String,
    is_rectified: bool,
    tolerance_px: f64,
    /// Added to coordinates, px.
    shift_px: f64,
    stamp_offset_ns: i64,
    order: Order,
    /// Whether the camera is that of the scene: the last CameraInfo.
    camera: Result<(), Refusal>,
    /// Where each point was seen last.
    last: Vec<Option<[f64; 2]>>,
    /// Tags that are none of ours.
    pub foreign: u64,
}

impl Eye {
    /// That has seen nothing yet.
    pub fn new(config: &Config) -> Self {
        let points = config.scene.pattern.len();
        Self {
            scene: config.scene.clone(),
            targets: config.targets.clone(),
            frame: config.camera.frame.clone(),
            is_rectified: config.camera.rectified,
            tolerance_px: config.camera.tolerance_px,
            shift_px: -config.pixel_centre,
            stamp_offset_ns: config.stamp_offset_ns,
            order: Order::default(),
            camera: match config.camera.info.as_str() {
                "" => Ok(()),
                topic => Err(Refusal::NoInfo(topic.to_owned())),
            },
            last: vec![None; points],
            foreign: 0,
        }
    }

    /// Takes a CameraInfo, which decides whether features are published from now on.
    ///
    /// # Errors
    /// [`Refusal`]: it is about another camera.
    pub fn info(&mut self, info: &CameraInfo) -> Result<(), Refusal> {
        self.camera = check_frame(&info.header.frame_id, &self.frame).and_then(|()| {
            let (camera, tolerance) = (&self.scene.camera, self.tolerance_px);
            Ok(camera_info::check(
                info,
                camera,
                self.is_rectified,
                tolerance,
            )?)
        });
        self.camera.clone()
    }

    /// Features of tags. A tag that is not in sight is where it was seen last, and its bit in
    /// `visible` is 0. Tags of other numbers are passed over, and counted.
    ///
    /// # Errors
    /// [`Refusal`]; what was seen before stays.
    pub fn tags(
        &mut self,
        message: &AprilTagDetectionArray,
        clocks: &Clocks,
        now_ns: u64,
    ) -> Result<Features, Refusal> {
        let data_ns = self.judge(&message.header, clocks, now_ns)?;
        let mut seen = vec![None; self.last.len()];
        let mut foreign = 0;
        for tag in &message.detections {
            let number = u32::try_from(tag.id).ok();
            let index = match &self.targets {
                Targets::Corners(ours) => (number == Some(*ours)).then_some(0),
                Targets::Centres(ours) => ours.iter().position(|ours| number == Some(*ours)),
            };
            let Some(index) = index else {
                foreign += 1;
                continue;
            };
            if seen[index].is_some() {
                return Err(Refusal::TwiceTag(tag.id));
            }
            match &self.targets {
                Targets::Centres(_) => seen[index] = Some(self.point(&tag.centre)?),
                Targets::Corners(_) => {
                    for (place, corner) in seen.iter_mut().zip(CORNERS) {
                        *place = Some(self.point(&tag.corners[corner])?);
                    }
                }
            }
        }
        let points: Option<Vec<_>> = (0..seen.len()).map(|k| seen[k].or(self.last[k])).collect();
        let Some(points) = points else {
            let missing = (0..seen.len()).find(|k| seen[*k].or(self.last[*k]).is_none());
            return Err(Refusal::NeverSeen(match &self.targets {
                Targets::Corners(number) => *number,
                Targets::Centres(numbers) => numbers[missing.unwrap_or_default()],
            }));
        };
        self.foreign += foreign;
        self.order.after(data_ns)?;
        self.last = points.iter().copied().map(Some).collect();
        let mut features = Features::new(&points, data_ns);
        for (bit, place) in seen.iter().enumerate() {
            if place.is_none() {
                features.visible &= !(1 << bit);
            }
        }
        Ok(features)
    }

    /// Features of points in order.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn points(
        &mut self,
        message: &PolygonStamped,
        clocks: &Clocks,
        now_ns: u64,
    ) -> Result<Features, Refusal> {
        let data_ns = self.judge(&message.header, clocks, now_ns)?;
        let points = &message.polygon.points;
        let (found, allowed) = (points.len(), self.last.len());
        if found != allowed {
            return Err(Refusal::Points { found, allowed });
        }
        let mut pairs = Vec::with_capacity(found);
        for point in points {
            if point.z != 0.0 {
                return Err(Refusal::Depth(point.z));
            }
            let [x, y] = [point.x, point.y].map(f64::from);
            pairs.push(self.point(&ImagePoint { x, y })?);
        }
        self.order.after(data_ns)?;
        Ok(Features::new(&pairs, data_ns))
    }

    /// The instant of a message of the right camera.
    fn judge(&self, header: &Header, clocks: &Clocks, now_ns: u64) -> Result<u64, Refusal> {
        check_frame(&header.frame_id, &self.frame)?;
        self.camera.clone()?;
        Ok(clocks.instant(&header.stamp, self.stamp_offset_ns, now_ns)?)
    }

    fn point(&self, point: &ImagePoint) -> Result<[f64; 2], Refusal> {
        let pair = [point.x + self.shift_px, point.y + self.shift_px];
        finite("a coordinate", &pair)?;
        Ok(pair)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::of_keys;
    use crate::message::{AprilTagDetection, Point32, Polygon};
    use crate::stamp::wall;

    const NOW: u64 = 10_000_000_000;
    const OFFSET: i64 = -1_700_000_000_000_000_000;

    fn header(at_ns: u64) -> Header {
        Header {
            stamp: wall(at_ns, OFFSET),
            frame_id: "camera_optical_frame".to_owned(),
        }
    }

    fn clocks() -> Clocks {
        Clocks::new(OFFSET, 200_000_000)
    }

    /// An eye that needs no CameraInfo.
    fn eye(keys: &str) -> Eye {
        Eye::new(&of_keys(&format!("[camera]\ninfo = \"\"\n{keys}")))
    }

    fn tag(id: i32) -> AprilTagDetection {
        let at = |x: f64, y: f64| ImagePoint {
            x: 100.5 + 10.0 * f64::from(id) + x,
            y: 200.5 + y,
        };
        AprilTagDetection {
            id,
            centre: at(0.0, 0.0),
            // As the library has them: lower left first, against the clock.
            corners: [at(-5.0, 5.0), at(5.0, 5.0), at(5.0, -5.0), at(-5.0, -5.0)],
            ..AprilTagDetection::default()
        }
    }

    fn see(eye: &mut Eye, at_ns: u64, ids: &[i32]) -> Result<Features, Refusal> {
        let message = AprilTagDetectionArray {
            header: header(at_ns),
            detections: ids.iter().copied().map(tag).collect(),
        };
        eye.tags(&message, &clocks(), NOW)
    }

    #[test]
    fn centers_are_in_the_patterns_order_from_pixel_centers() {
        let mut eye = eye("tags = [3, 0, 1, 2]");
        let features = see(&mut eye, NOW - 1000, &[0, 1, 17, 2, 3]).unwrap();
        let seen: Vec<_> = features.pairs().map(|[u, _]| u).collect();
        assert_eq!(seen, [130.0, 100.0, 110.0, 120.0]);
        assert!(features.pairs().all(|[_, v]| v == 200.0));
        assert_eq!((features.stamp.data_ns, eye.foreign), (NOW - 1000, 1));
    }

    #[test]
    fn the_corners_of_a_tag_are_in_the_documented_order() {
        let mut eye = eye("corners_of = 2");
        let features = see(&mut eye, NOW - 1000, &[1, 2]).unwrap();
        let corners = [
            [115.0, 195.0],
            [125.0, 195.0],
            [125.0, 205.0],
            [115.0, 205.0],
        ];
        assert!(features.pairs().eq(corners));
    }

    #[test]
    fn a_tag_out_of_sight_is_where_it_was_and_not_visible() {
        let mut eye = eye("");
        let never = see(&mut eye, NOW - 3000, &[0, 1, 2]);
        assert_eq!(never, Err(Refusal::NeverSeen(3)));
        let all = see(&mut eye, NOW - 2000, &[0, 1, 2, 3]).unwrap();
        let some = see(&mut eye, NOW - 1000, &[0, 2]).unwrap();
        assert_eq!((all.visible, some.visible), (0b1111, 0b0101));
        assert_eq!(all.points, some.points);
        // What is refused changes nothing.
        assert_eq!(see(&mut eye, NOW, &[2, 2]), Err(Refusal::TwiceTag(2)));
        let again = see(&mut eye, NOW - 1000, &[0, 1, 2, 3]).unwrap_err();
        assert_eq!(again.kind(), "out of order");
    }

    #[test]
    fn without_the_scenes_camera_nothing_is_seen() {
        let mut eye = Eye::new(&of_keys(""));
        let refused = see(&mut eye, NOW, &[0, 1, 2, 3]).unwrap_err();
        assert_eq!(refused.kind(), "no CameraInfo");
        let mut info = CameraInfo {
            header: header(NOW),
            width: 1024,
            height: 1024,
            p: [
                800.0, 0.0, 512.0, 0.0, 0.0, 800.0, 512.0, 0.0, 0.0, 0.0, 1.0, 0.0,
            ],
            ..CameraInfo::default()
        };
        assert_eq!(eye.info(&info), Ok(()));
        assert!(see(&mut eye, NOW - 1, &[0, 1, 2, 3]).is_ok());
        info.p[0] = 600.0;
        assert!(eye.info(&info).is_err());
        let refused = see(&mut eye, NOW, &[0, 1, 2, 3]).unwrap_err();
        assert_eq!(refused.kind(), "other camera");
    }

    #[test]
    fn points_are_counted_flat_and_finite() {
        let point = |x: f32| Point32 { x, y: 7.0, z: 0.0 };
        let see = |points: Vec<Point32>| {
            let header = header(NOW);
            let polygon = Polygon { points };
            let message = PolygonStamped { header, polygon };
            eye("features = \"points\"").points(&message, &clocks(), NOW)
        };
        let features = see((1..=4).map(|x| point(x as f32)).collect()).unwrap();
        assert!(features.pairs().eq((1..=4).map(|x| [f64::from(x), 7.0])));
        let (found, allowed) = (3, 4);
        assert_eq!(
            see(vec![point(1.0); 3]),
            Err(Refusal::Points { found, allowed })
        );
        let mut points = vec![point(1.0); 4];
        points[2].x = f32::INFINITY;
        assert_eq!(see(points.clone()), Err(Refusal::NotFinite("a coordinate")));
        points[1].z = 0.5;
        assert_eq!(see(points), Err(Refusal::Depth(0.5)));
    }
}
