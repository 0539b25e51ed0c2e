//! From rendered images to calibrations: the finder of tags is part of it.

use scene::Scene;
use tag_board::Board;
use vision::{Look, Renderer, Tag};
use vision_calibration_core::Iso3;
use vpc_calib::camera::Camera;
use vpc_calib::detector::Detector;
use vpc_calib::hand_eye::{self, Mounting, Pair};
use vpc_calib::intrinsics;
use vpc_calib::picture::Picture;
use vpc_calib::target::Target;
use vpc_calib::view::View;

use crate::station::{PANDA, mount, place};
use crate::synthetic::{Chance, PINHOLE};

/// A camera before a board.
pub struct Studio {
    renderer: Renderer,
    detector: Detector,
}

impl Studio {
    pub fn new(board: &Board, seed: u64) -> Self {
        let mut scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        scene.occlusions.clear();
        let Camera {
            focal: [fx, fy],
            center: [cx, cy],
            ..
        } = PINHOLE;
        (scene.camera.fx, scene.camera.fy) = (fx, fy);
        (scene.camera.cx, scene.camera.cy) = (cx, cy);
        let look = Look {
            seed,
            ..Look::default()
        };
        let [columns, rows] = [board.columns, board.rows].map(|count| count as usize);
        let tags = Tag::board(columns, rows, board.tag_size, board.pitch());
        Self {
            renderer: Renderer::with_tags(&scene, &look, &tags),
            detector: Detector::new(board).unwrap(),
        }
    }

    pub fn picture(&mut self, pose: &Iso3) -> Picture {
        let pose = scene::Pose {
            translation: pose.translation.vector.into(),
            rotation: pose.rotation.scaled_axis().into(),
        };
        let image = self.renderer.render(&pose);
        Picture {
            size: [image.width(), image.height()].map(|side| side as u32),
            pixels: image.pixels().to_vec(),
        }
    }

    fn view(&mut self, name: &str, pose: &Iso3) -> View {
        let picture = self.picture(pose);
        let mut view = self.detector.view(name, &picture.grey().unwrap()).unwrap();
        view.keep_known(&Target::from(&Board::default()));
        view
    }
}

#[test]
fn corners_of_a_board_are_found_to_a_tenth_of_a_pixel() {
    let board = Board::default();
    let target = Target::from(&board);
    let (mut studio, mut chance) = (Studio::new(&board, 1), Chance::new(1));
    let (mut sum, mut count, mut worst, mut tags) = (0.0, 0, 0.0f64, [0; 2]);
    for _ in 0..20 {
        let pose = chance.pose(35.0);
        let view = studio.view("a.png", &pose);
        let whole = chance.view(&PINHOLE, &board, &pose, 0.0).tags().count();
        tags = [tags[0] + view.tags().count(), tags[1] + whole];
        for (place, [u, v]) in view.pairs(&target) {
            let [a, b] = PINHOLE.project(&pose, place).unwrap();
            let off = (u - a).hypot(v - b);
            (sum, count, worst) = (sum + off * off, count + 1, worst.max(off));
        }
    }
    let rms = (sum / f64::from(count)).sqrt();
    testkit::tell(format_args!(
        "{} of {} tags; corners off by {rms:.3} px RMS, {worst:.2} px at most",
        tags[0], tags[1]
    ));
    assert!(rms < 0.1 && tags[0] as f64 > 0.9 * tags[1] as f64);
}

#[test]
#[ignore = "long: the optimizer is others' code, which a dev build does not optimize"]
fn rendered_images_give_focal_length_and_mounting() {
    let board = Board::default();
    let target = Target::from(&board);
    let mut worst = [0.0f64; 3];
    for seed in 0..testkit::repeats("rendered images", 1, 20) as u64 {
        let (mut studio, mut chance) = (Studio::new(&board, seed), Chance::new(seed));
        let mut pairs = Vec::new();
        while pairs.len() < 14 {
            let pose = chance.pose(35.0);
            let view = studio.view(&format!("{:02}.png", pairs.len()), &pose);
            if view.points.len() >= 40 {
                let miss = Iso3::new(
                    chance.vector(PANDA[0]),
                    chance.vector(PANDA[1].to_radians()),
                );
                let flange = place() * pose.inverse() * mount().inverse() * miss;
                pairs.push(Pair { flange, view });
            }
        }
        let views: Vec<View> = pairs.iter().map(|pair| pair.view.clone()).collect();
        let lens = intrinsics::calibrate(&views, &target, PINHOLE.size, false).unwrap();
        assert!(
            lens.verdict().is_good(),
            "{seed}: {}\n{lens}",
            lens.verdict()
        );
        let focal = [0, 1].map(|k| (lens.camera.focal[k] / PINHOLE.focal[k] - 1.0).abs());
        let found =
            hand_eye::calibrate(&pairs, Mounting::EyeInHand, &lens.camera, &target).unwrap();
        assert!(
            found.verdict().is_good(),
            "{seed}: {}\n{found}",
            found.verdict()
        );
        let off = mount().inverse() * found.camera;
        let off = [
            off.translation.vector.norm(),
            off.rotation.angle().to_degrees(),
        ];
        worst = [
            worst[0].max(focal[0]).max(focal[1]),
            worst[1].max(off[0]),
            worst[2].max(off[1]),
        ];
    }
    let [focal, place, turn] = [100.0 * worst[0], 1e3 * worst[1], worst[2]];
    testkit::tell(format_args!(
        "off at most: focal lengths {focal:.3} %, mounting {place:.2} mm and {turn:.3} deg"
    ));
    assert!(focal < 0.3 && place < 1.0 && turn < 0.1);
}
