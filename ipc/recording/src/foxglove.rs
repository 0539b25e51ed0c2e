//! Messages of the schemas that Foxglove knows by name, so that its panels draw them without our code.
//!
//! Only the fields that are written stand in the schemas; Foxglove takes what is missing as empty. Checked against
//! Foxglove's own descriptions by `tests/python/check.py`.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use scene::{Mask, Part, Scene};
use serde_json::{Value, json};

use crate::geometry;
use crate::outline::outlines;

/// A colour: red, green, blue, opacity, each 0 to 1.
pub(crate) type Color = [f64; 4];

pub(crate) const BLUE: Color = [0.12, 0.31, 0.85, 1.0];
pub(crate) const RED: Color = [0.85, 0.12, 0.12, 1.0];
const GREY: Color = [0.45, 0.47, 0.5, 1.0];
const CLEAR: Color = [0.0; 4];
/// Frame of the camera: x right, y down, z forward.
const CAMERA: &str = "camera";
/// Frame of the pattern, which stands still.
const OBJECT: &str = "object";
/// Corners of the outline of an occlusion's part.
const CORNERS: usize = 96;

/// Levels of log entries, as Foxglove numbers them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Level {
    Info = 2,
    Warning = 3,
    Error = 4,
}

/// A well-known schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Known {
    ImageAnnotations,
    RawImage,
    CameraCalibration,
    FrameTransform,
    PoseInFrame,
    Log,
}

impl Known {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::ImageAnnotations => "foxglove.ImageAnnotations",
            Self::RawImage => "foxglove.RawImage",
            Self::CameraCalibration => "foxglove.CameraCalibration",
            Self::FrameTransform => "foxglove.FrameTransform",
            Self::PoseInFrame => "foxglove.PoseInFrame",
            Self::Log => "foxglove.Log",
        }
    }

    pub(crate) fn schema(self) -> Value {
        let number = || json!({ "type": "number" });
        let integer = || json!({ "type": "integer", "minimum": 0 });
        let text = || json!({ "type": "string" });
        let bytes = || json!({ "type": "string", "contentEncoding": "base64" });
        let list = |items: Value| json!({ "type": "array", "items": items });
        let numbers =
            |n: usize| json!({ "type": "array", "items": number(), "minItems": n, "maxItems": n });
        let object = |title: &str, fields: Value| json!({ "title": title, "type": "object", "properties": fields });
        let choice = |title: &str, choices: &[(&str, u32)]| {
            let choices: Vec<Value> = choices
                .iter()
                .map(|(name, code)| json!({ "title": name, "const": code }))
                .collect();
            json!({ "title": title, "oneOf": choices })
        };
        let time = || {
            let nanoseconds = json!({ "type": "integer", "minimum": 0, "maximum": 999_999_999 });
            object("time", json!({ "sec": integer(), "nsec": nanoseconds }))
        };
        let point = || object("foxglove.Point2", json!({ "x": number(), "y": number() }));
        let vector = || {
            let fields = json!({ "x": number(), "y": number(), "z": number() });
            object("foxglove.Vector3", fields)
        };
        let quaternion = || {
            let fields = json!({ "x": number(), "y": number(), "z": number(), "w": number() });
            object("foxglove.Quaternion", fields)
        };
        let color = || {
            let fields = json!({ "r": number(), "g": number(), "b": number(), "a": number() });
            object("foxglove.Color", fields)
        };
        let fields = match self {
            Self::ImageAnnotations => json!({
                "circles": list(object("foxglove.CircleAnnotation", json!({
                    "timestamp": time(),
                    "position": point(),
                    "diameter": number(),
                    "thickness": number(),
                    "fill_color": color(),
                    "outline_color": color(),
                }))),
                "points": list(object("foxglove.PointsAnnotation", json!({
                    "timestamp": time(),
                    "type": choice("foxglove.PointsAnnotationType", &[
                        ("UNKNOWN", 0),
                        ("POINTS", 1),
                        ("LINE_LOOP", 2),
                        ("LINE_STRIP", 3),
                        ("LINE_LIST", 4),
                    ]),
                    "points": list(point()),
                    "outline_color": color(),
                    "outline_colors": list(color()),
                    "fill_color": color(),
                    "thickness": number(),
                }))),
                "texts": list(object("foxglove.TextAnnotation", json!({
                    "timestamp": time(),
                    "position": point(),
                    "text": text(),
                    "font_size": number(),
                    "text_color": color(),
                    "background_color": color(),
                }))),
            }),
            Self::RawImage => json!({
                "timestamp": time(),
                "frame_id": text(),
                "width": integer(),
                "height": integer(),
                "encoding": text(),
                "step": integer(),
                "data": bytes(),
            }),
            Self::CameraCalibration => json!({
                "timestamp": time(),
                "frame_id": text(),
                "width": integer(),
                "height": integer(),
                "distortion_model": text(),
                "D": list(number()),
                "K": numbers(9),
                "R": numbers(9),
                "P": numbers(12),
            }),
            Self::FrameTransform => json!({
                "timestamp": time(),
                "parent_frame_id": text(),
                "child_frame_id": text(),
                "translation": vector(),
                "rotation": quaternion(),
            }),
            Self::PoseInFrame => json!({
                "timestamp": time(),
                "frame_id": text(),
                "pose": object("foxglove.Pose", json!({
                    "position": vector(),
                    "orientation": quaternion(),
                })),
            }),
            Self::Log => json!({
                "timestamp": time(),
                "level": choice("foxglove.LogLevel", &[
                    ("UNKNOWN", 0),
                    ("DEBUG", 1),
                    ("INFO", 2),
                    ("WARNING", 3),
                    ("ERROR", 4),
                    ("FATAL", 5),
                ]),
                "message": text(),
                "name": text(),
                "file": text(),
                "line": integer(),
            }),
        };
        object(self.name(), fields)
    }
}

fn time(wall_ns: u64) -> Value {
    json!({ "sec": wall_ns / 1_000_000_000, "nsec": wall_ns % 1_000_000_000 })
}

fn color([r, g, b, a]: Color) -> Value {
    json!({ "r": r, "g": g, "b": b, "a": a })
}

fn point([x, y]: [f64; 2]) -> Value {
    json!({ "x": x, "y": y })
}

/// An annotation of the image under construction.
#[derive(Debug)]
pub(crate) struct Annotations {
    time: Value,
    circles: Vec<Value>,
    points: Vec<Value>,
    texts: Vec<Value>,
}

impl Annotations {
    pub(crate) fn at(wall_ns: u64) -> Self {
        Self {
            time: time(wall_ns),
            circles: Vec::new(),
            points: Vec::new(),
            texts: Vec::new(),
        }
    }

    /// A circle: filled or not.
    pub(crate) fn circle(&mut self, at: [f64; 2], diameter: f64, line: Color, fill: Color) {
        self.circles.push(json!({
            "timestamp": self.time,
            "position": point(at),
            "diameter": diameter,
            "thickness": 2.0,
            "fill_color": color(fill),
            "outline_color": color(line),
        }));
    }

    /// A closed outline (2) or separate lines (4) through these points.
    fn lines(&mut self, kind: u32, corners: impl Iterator<Item = [f64; 2]>, line: Color) {
        self.points.push(json!({
            "timestamp": self.time,
            "type": kind,
            "points": corners.map(point).collect::<Vec<_>>(),
            "outline_color": color(line),
            "outline_colors": [],
            "fill_color": color(CLEAR),
            "thickness": 2.0,
        }));
    }

    /// A closed outline.
    pub(crate) fn outline(&mut self, corners: impl Iterator<Item = [f64; 2]>, line: Color) {
        self.lines(2, corners, line);
    }

    /// A diagonal cross for each point.
    pub(crate) fn crosses(&mut self, points: &[[f64; 2]], arm: f64, line: Color) {
        let ends = points.iter().flat_map(|[x, y]| {
            [[-arm, -arm], [arm, arm], [-arm, arm], [arm, -arm]].map(|[u, v]| [x + u, y + v])
        });
        self.lines(4, ends, line);
    }

    pub(crate) fn text(&mut self, at: [f64; 2], text: &str) {
        self.texts.push(json!({
            "timestamp": self.time,
            "position": point(at),
            "text": text,
            "font_size": 16.0,
            "text_color": color([0.1, 0.1, 0.1, 1.0]),
            "background_color": color([1.0, 1.0, 1.0, 0.8]),
        }));
    }

    pub(crate) fn finish(self) -> Value {
        json!({ "circles": self.circles, "points": self.points, "texts": self.texts })
    }
}

/// What stands still in the image: the outlines of the occlusions, the image's border, the goal.
pub(crate) fn scenery(scene: &Scene, wall_ns: u64) -> Value {
    let mut annotations = Annotations::at(wall_ns);
    for part in scene.parts() {
        annotations.outline(outline(part), GREY);
    }
    for border in scene.masks().flat_map(outlines) {
        annotations.outline(border.into_iter(), GREY);
    }
    let (w, h) = (scene.camera.width, scene.camera.height);
    let corners = [[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]];
    annotations.outline(corners.into_iter(), GREY);
    for at in geometry::goal(scene) {
        annotations.circle(at, 14.0, RED, CLEAR);
    }
    annotations.finish()
}

/// The border of a part: |x|^p + |y|^p = 1, by its direction from the centre.
fn outline(part: &Part) -> impl Iterator<Item = [f64; 2]> {
    let part = *part;
    (0..CORNERS).map(move |i| {
        let (s, c) = (std::f64::consts::TAU * i as f64 / CORNERS as f64).sin_cos();
        let radius = (c.abs().powf(part.p) + s.abs().powf(part.p)).powf(-1.0 / part.p);
        [
            part.center[0] + part.half[0] * radius * c,
            part.center[1] + part.half[1] * radius * s,
        ]
    })
}

/// The image plane as a picture: occlusions grey on white. Foxglove's Image panel needs an image to annotate.
pub(crate) fn image(scene: &Scene, wall_ns: u64) -> Value {
    let (width, height) = (scene.camera.width as usize, scene.camera.height as usize);
    let mut pixels = vec![250_u8; width * height];
    for part in scene.parts() {
        let [u, v] = part.center;
        let [hu, hv] = part.half;
        let columns = span(u - hu, u + hu, width);
        for y in span(v - hv, v + hv, height) {
            for x in columns.clone() {
                // Pixel centres lie at whole numbers.
                let (du, dv) = ((x as f64 - u) / hu, (y as f64 - v) / hv);
                if du.abs().powf(part.p) + dv.abs().powf(part.p) < 1.0 {
                    pixels[y * width + x] = 185;
                }
            }
        }
    }
    for [columns, rows] in scene.masks().flat_map(Mask::rectangles) {
        for y in rows {
            pixels[y * width..][columns.clone()].fill(185);
        }
    }
    json!({
        "timestamp": time(wall_ns),
        "frame_id": CAMERA,
        "width": width,
        "height": height,
        "encoding": "mono8",
        "step": width,
        "data": STANDARD.encode(pixels),
    })
}

/// Pixels between two coordinates, inside the image.
fn span(from: f64, to: f64, size: usize) -> std::ops::Range<usize> {
    // Casts saturate: what lies left of the image becomes 0.
    (from.floor() as usize).min(size)..(to.ceil() as usize).min(size)
}

/// The pinhole camera of the scene.
pub(crate) fn calibration(scene: &Scene, wall_ns: u64) -> Value {
    let camera = &scene.camera;
    let (fx, fy, cx, cy) = (camera.fx, camera.fy, camera.cx, camera.cy);
    json!({
        "timestamp": time(wall_ns),
        "frame_id": CAMERA,
        "width": camera.width as u64,
        "height": camera.height as u64,
        "distortion_model": "",
        "D": [],
        "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    })
}

/// The camera in the object's frame: a transform and a pose of the same numbers.
pub(crate) fn camera_pose(
    translation: [f64; 3],
    rotation: [f64; 3],
    wall_ns: u64,
) -> (Value, Value) {
    let ([x, y, z], [qx, qy, qz, qw]) = geometry::camera_in_object(translation, rotation);
    let (place, turn) = (
        json!({ "x": x, "y": y, "z": z }),
        json!({ "x": qx, "y": qy, "z": qz, "w": qw }),
    );
    let transform = json!({
        "timestamp": time(wall_ns),
        "parent_frame_id": OBJECT,
        "child_frame_id": CAMERA,
        "translation": place,
        "rotation": turn,
    });
    let pose = json!({
        "timestamp": time(wall_ns),
        "frame_id": OBJECT,
        "pose": { "position": place, "orientation": turn },
    });
    (transform, pose)
}

/// An entry of the log.
pub(crate) fn log(level: Level, name: &str, message: &str, wall_ns: u64) -> Value {
    json!({
        "timestamp": time(wall_ns),
        "level": level as u32,
        "message": message,
        "name": name,
        "file": "",
        "line": 0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_is_grey_inside_occlusions_and_light_outside() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let image = image(&scene, 1_500_000_000);
        assert_eq!(image["timestamp"], json!({ "sec": 1, "nsec": 500_000_000 }));
        let pixels = STANDARD.decode(image["data"].as_str().unwrap()).unwrap();
        assert_eq!(pixels.len(), 1024 * 1024);
        let at = |u: usize, v: usize| pixels[v * 1024 + u];
        assert_eq!((at(850, 560), at(850, 650)), (185, 250));
        assert_eq!((at(200, 420), at(0, 0)), (185, 250));
    }

    #[test]
    fn a_mask_is_grey_in_the_picture_and_has_its_outline() {
        let (scene, _) = crate::outline::tests::painted(|i, j| {
            (700..900).contains(&i) && (100..200).contains(&j)
        });
        let image = image(&scene, 0);
        let pixels = STANDARD.decode(image["data"].as_str().unwrap()).unwrap();
        for (n, grey) in pixels.into_iter().enumerate() {
            let inside = (700..900).contains(&(n % 1024)) && (100..200).contains(&(n / 1024));
            assert_eq!(grey, if inside { 185 } else { 250 });
        }
        let scenery = scenery(&scene, 0);
        let outline = scenery["points"][0]["points"].as_array().unwrap();
        assert_eq!(outline.len(), 4);
        for corner in [[699.5, 99.5], [899.5, 99.5], [899.5, 199.5], [699.5, 199.5]] {
            assert!(outline.contains(&point(corner)), "{outline:?}");
        }
    }

    #[test]
    fn an_occlusion_across_the_border_is_drawn_as_far_as_it_is_seen() {
        assert_eq!(span(-10.5, 3.2, 100), 0..4);
        assert_eq!(span(98.0, 130.0, 100), 98..100);
        assert_eq!(span(-9.0, -2.0, 100), 0..0);
        assert_eq!(span(200.0, 300.0, 100), 100..100);
    }
}
