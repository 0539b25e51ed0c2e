//! What stands still: the image plane with its occlusions, the goal, the camera.

use foxglove::messages::{CameraCalibration, ImageAnnotations, RawImage, points_annotation::Type};
use scene::{Mask, Scene};

use crate::annotation::{CLEAR, GREY, RED, circle, lines, time};

/// Frame of the camera: x right, y down, z forward.
pub(crate) const CAMERA: &str = "camera";
/// Topic of the picture that is annotated.
pub(crate) const IMAGE: &str = "/camera/image";
/// Corners of the outline of an occlusion's part.
const CORNERS: usize = 96;

/// What stands still in the image: the outlines of the occlusions, the image's border, the goal.
pub(crate) fn scenery(scene: &Scene, wall_ns: u64) -> ImageAnnotations {
    let at = time(wall_ns);
    let (right, lower) = (scene.camera.width - 0.5, scene.camera.height - 0.5);
    let frame = [[-0.5, -0.5], [right, -0.5], [right, lower], [-0.5, lower]];
    let parts = scene
        .parts()
        .map(|part| lines(at, Type::LineLoop, part.outline(CORNERS), GREY));
    let masks = scene
        .masks()
        .map(|mask| lines(at, Type::LineList, borders(mask).into_iter(), GREY));
    let frame = lines(at, Type::LineLoop, frame.into_iter(), GREY);
    let goal = scene.goal_px();
    ImageAnnotations {
        circles: goal
            .map(|center| circle(at, center, 14.0, RED, CLEAR))
            .collect(),
        points: parts.chain(masks).chain([frame]).collect(),
        ..ImageAnnotations::default()
    }
}

/// The borders of a mask: both ends of each straight run of pixel edges between forbidden and free.
fn borders(mask: &Mask) -> Vec<[f64; 2]> {
    let mut ends = Vec::new();
    let (width, height) = (mask.width(), mask.height());
    for (is_upright, count, length) in [(false, height, width), (true, width, height)] {
        let turned = |along: usize, across: usize| match is_upright {
            false => [along, across],
            true => [across, along],
        };
        let is_forbidden = |along, across| {
            let [column, row] = turned(along, across);
            mask.is_forbidden(column, row)
        };
        for line in 0..=count {
            let mut was_edge = false;
            for i in 0..=length {
                let is_edge = is_forbidden(i, line) != is_forbidden(i, line.wrapping_sub(1));
                if is_edge != was_edge {
                    // A pixel is the square about its whole-numbered centre.
                    ends.push(turned(i, line).map(|x| x as f64 - 0.5));
                }
                was_edge = is_edge;
            }
        }
    }
    ends
}

/// The image plane as a picture, occlusions grey on white: Foxglove's Image panel needs an image to
/// annotate.
pub(crate) fn image(scene: &Scene, wall_ns: u64) -> RawImage {
    let (width, height) = (scene.camera.width as usize, scene.camera.height as usize);
    let mut pixels = vec![250_u8; width * height];
    for part in scene.parts() {
        let [low, high] = part.bounds();
        for row in span(low[1], high[1], height) {
            for column in span(low[0], high[0], width) {
                if part.covers([column as f64, row as f64]) {
                    pixels[row * width + column] = 185;
                }
            }
        }
    }
    for [columns, rows] in scene.masks().flat_map(Mask::rectangles) {
        for row in rows {
            pixels[row * width..][columns.clone()].fill(185);
        }
    }
    RawImage {
        timestamp: time(wall_ns),
        frame_id: CAMERA.to_owned(),
        width: width as u32,
        height: height as u32,
        encoding: "mono8".to_owned(),
        step: width as u32,
        data: pixels.into(),
    }
}

/// Pixels between two coordinates, inside the image.
fn span(from: f64, to: f64, size: usize) -> std::ops::Range<usize> {
    // Casts saturate: what lies left of the image becomes 0.
    (from.floor() as usize).min(size)..(to.ceil() as usize).min(size)
}

/// The pinhole camera of the scene.
pub(crate) fn calibration(scene: &Scene, wall_ns: u64) -> CameraCalibration {
    let camera = &scene.camera;
    let (fx, fy, cx, cy) = (camera.fx, camera.fy, camera.cx, camera.cy);
    CameraCalibration {
        timestamp: time(wall_ns),
        frame_id: CAMERA.to_owned(),
        width: camera.width as u32,
        height: camera.height as u32,
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..CameraCalibration::default()
    }
}

#[cfg(test)]
mod tests {
    use foxglove::messages::{Point2, Timestamp};

    use super::*;

    /// The paper's simulated scene with a painted mask instead of its occlusions.
    fn painted(is_white: impl Fn(u32, u32) -> bool) -> Scene {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("mask.png");
        scene::write_mask(&path, 1024, 1024, is_white).unwrap();
        let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
        let text = format!("{head}[[occlusion]]\nname = \"painted\"\nmask = \"mask.png\"\n");
        let png = std::fs::read(path).unwrap();
        Scene::parse_with(&text, "painted.toml", &|_| Ok(png.clone())).unwrap()
    }

    #[test]
    fn the_picture_is_grey_inside_occlusions_and_light_outside() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let image = image(&scene, 1_500_000_000);
        assert_eq!(image.timestamp, Some(Timestamp::new(1, 500_000_000)));
        assert_eq!(image.data.len(), 1024 * 1024);
        let at = |u: usize, v: usize| image.data[v * 1024 + u];
        assert_eq!((at(850, 560), at(850, 650)), (185, 250));
        assert_eq!((at(200, 420), at(0, 0)), (185, 250));
    }

    #[test]
    fn a_mask_is_grey_in_the_picture_and_has_its_outline() {
        let scene = painted(|i, j| (700..900).contains(&i) && (100..200).contains(&j));
        for (n, grey) in image(&scene, 0).data.into_iter().enumerate() {
            let inside = (700..900).contains(&(n % 1024)) && (100..200).contains(&(n / 1024));
            assert_eq!(grey, if inside { 185 } else { 250 });
        }
        // Two ends for each of four sides, a corner twice.
        let outline = &scenery(&scene, 0).points[0];
        assert_eq!(
            (outline.r#type, outline.points.len()),
            (Type::LineList as i32, 8)
        );
        for (x, y) in [
            (700.0, 100.0),
            (900.0, 100.0),
            (900.0, 200.0),
            (700.0, 200.0),
        ] {
            let corners = outline.points.iter().filter(|p| **p == Point2 { x, y });
            assert_eq!(corners.count(), 2, "{outline:?}");
        }
    }

    #[test]
    fn borders_of_a_mask_go_round_holes_and_along_edges() {
        let inside =
            |i: u32, j: u32, from: u32, to: u32| (from..to).contains(&i) && (from..to).contains(&j);
        let length = |is_white: &dyn Fn(u32, u32) -> bool| -> f64 {
            let scene = painted(is_white);
            let ends = borders(scene.masks().next().unwrap());
            let pairs = ends.chunks_exact(2);
            pairs
                .map(|p| (p[0][0] - p[1][0]).hypot(p[0][1] - p[1][1]))
                .sum()
        };
        let ring = length(&|i, j| inside(i, j, 100, 200) && !inside(i, j, 140, 150));
        assert_eq!(ring, 4.0 * 100.0 + 4.0 * 10.0);
        assert_eq!(length(&|i, j| inside(i, j, 1000, 1024)), 4.0 * 24.0);
        assert_eq!(length(&|i, j| inside(i, j, 0, 30)), 4.0 * 30.0);
        // Pixels that meet at a corner.
        let two = length(&|i, j| inside(i, j, 100, 140) || inside(i, j, 140, 180));
        assert_eq!(two, 8.0 * 40.0);
    }

    #[test]
    fn an_occlusion_across_the_border_is_drawn_as_far_as_it_is_seen() {
        assert_eq!(span(-10.5, 3.2, 100), 0..4);
        assert_eq!(span(98.0, 130.0, 100), 98..100);
        assert_eq!(span(-9.0, -2.0, 100), 0..0);
        assert_eq!(span(200.0, 300.0, 100), 100..100);
    }
}
