//! The image plane: size, goal, occlusions and limits, from the scene or from the messages.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use scene::{Arm, FileError, Mask, Part, Scene};

use crate::view::View;

/// Image sizes of common cameras, px: without scene and images, the first that holds all features
/// seen.
const SIZES: [[f64; 2]; 5] = [
    [640.0, 480.0],
    [1280.0, 960.0],
    [1600.0, 1200.0],
    [2560.0, 1920.0],
    [5120.0, 3840.0],
];

/// The image plane.
#[derive(Clone, Debug, Default)]
pub struct ImagePlane {
    scene: Option<Scene>,
    path: PathBuf,
    modified: Option<SystemTime>,
}

impl ImagePlane {
    /// Of the scene that is `given`, else of the daemon's in this domain, which may come later.
    ///
    /// # Errors
    /// As [`Scene::read`], of a scene that is given.
    pub fn open(directory: &Path, given: Option<&Path>) -> Result<Self, FileError> {
        if let Some(path) = given {
            return Ok(Self {
                scene: Some(Scene::read(path)?),
                path: path.to_owned(),
                modified: modified(path),
            });
        }
        let mut plane = Self {
            path: directory.join(ipc::SCENE_FILE),
            ..Self::default()
        };
        plane.refresh();
        Ok(plane)
    }

    /// Reads the scene again where its file has changed; one that is being written is left for the
    /// next call.
    pub fn refresh(&mut self) {
        let modified = modified(&self.path);
        if modified != self.modified
            && let Ok(scene) = Scene::read(&self.path)
        {
            (self.scene, self.modified) = (Some(scene), modified);
        }
    }

    /// The arm of the scene.
    pub fn arm(&self) -> Option<&Arm> {
        self.scene.as_ref()?.arm.as_ref()
    }

    /// Whether the scene is known.
    pub fn has_scene(&self) -> bool {
        self.scene.is_some()
    }

    /// Width and height of the image, px.
    pub fn size(&self, view: &View) -> [f64; 2] {
        if let Some(scene) = &self.scene {
            return [scene.camera.width, scene.camera.height];
        }
        if let Some(image) = view.image() {
            return [f64::from(image.width), f64::from(image.height)];
        }
        let points = || view.recent(u64::MAX).flat_map(|record| record.pairs());
        let holds = |size: &&[f64; 2]| points().all(|[u, v]| u <= size[0] && v <= size[1]);
        *SIZES.iter().find(holds).unwrap_or(&SIZES[SIZES.len() - 1])
    }

    /// The goal of each feature (u, v), px; empty without a scene.
    pub fn goal(&self) -> Vec<[f64; 2]> {
        self.scene.iter().flat_map(Scene::goal_px).collect()
    }

    /// The parts of all occlusions that are not painted.
    pub fn parts(&self) -> impl Iterator<Item = &Part> {
        self.scene.iter().flat_map(Scene::parts)
    }

    /// The painted pixels as rectangles [u, v, width, height], px.
    pub fn painted(&self) -> impl Iterator<Item = [f64; 4]> {
        let masks = self.scene.iter().flat_map(Scene::masks);
        masks.flat_map(Mask::rectangles).map(|[columns, rows]| {
            let [u, v] = [columns.start, rows.start].map(|pixel| pixel as f64 - 0.5);
            [u, v, columns.len() as f64, rows.len() as f64]
        })
    }

    /// Whether an occlusion is in this box of the image, px: its middle in a part, or any painted
    /// pixel in it, so that thin lines do not get lost.
    pub fn touches(&self, low: [f64; 2], high: [f64; 2]) -> bool {
        let middle = [0, 1].map(|i| (low[i] + high[i]) / 2.0);
        // A pixel is the square about its whole-numbered centre. The casts stop at 0.
        let pixels = |i: usize| (low[i] + 0.5).floor() as usize..(high[i] + 0.5).ceil() as usize;
        let painted = |mask: &Mask| {
            pixels(1).any(|row| pixels(0).any(|column| mask.is_forbidden(column, row)))
        };
        self.parts().any(|part| part.covers(middle))
            || self.scene.iter().flat_map(Scene::masks).any(painted)
    }

    /// Limits of the twist, linear (m/s) and angular (rad/s); without a scene the largest seen.
    pub fn limits(&self, view: &View) -> [f64; 2] {
        if let Some(scene) = &self.scene {
            return [scene.limits.linear, scene.limits.angular];
        }
        [0..3, 3..6].map(|axes| {
            let values = view.recent(u64::MAX).flat_map(|r| &r.twist[axes.clone()]);
            values.fold(1e-3, |most: f64, value| most.max(value.abs()))
        })
    }
}

fn modified(path: &Path) -> Option<SystemTime> {
    std::fs::metadata(path).ok()?.modified().ok()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn paper() -> ImagePlane {
        ImagePlane {
            scene: Some(Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap()),
            ..ImagePlane::default()
        }
    }

    /// The paper's simulated scene with a mask instead of its occlusions.
    pub(crate) fn painted(is_white: impl Fn(u32, u32) -> bool) -> ImagePlane {
        let directory = tempfile::tempdir().unwrap();
        scene::write_mask(&directory.path().join("mask.png"), 1024, 1024, is_white).unwrap();
        let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
        let text = format!("{head}[[occlusion]]\nname = \"painted\"\nmask = \"mask.png\"\n");
        let path = directory.path().join("scene.toml");
        std::fs::write(&path, text).unwrap();
        ImagePlane::open(directory.path(), Some(&path)).unwrap()
    }

    #[test]
    fn the_scene_that_the_daemon_writes_is_taken_up() {
        let domain = tempfile::tempdir().unwrap();
        let mut plane = ImagePlane::open(domain.path(), None).unwrap();
        assert!(!plane.has_scene() && plane.goal().is_empty());
        let path = domain.path().join(ipc::SCENE_FILE);
        std::fs::create_dir(path.parent().unwrap()).unwrap();
        let write = |text: &str, second| {
            let file = std::fs::File::create(&path).unwrap();
            std::io::Write::write_all(&mut &file, text.as_bytes()).unwrap();
            let instant = SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(second);
            file.set_modified(instant).unwrap();
        };
        write("[camera]", 1);
        plane.refresh();
        assert!(!plane.has_scene());
        write(scene::PAPER_SIM, 2);
        plane.refresh();
        assert_eq!(plane.limits(&View::default()), [0.5, 1.0]);
        let other = scene::PAPER_SIM.replace("linear = 0.5", "linear = 0.25");
        write(&other, 3);
        plane.refresh();
        assert_eq!(plane.limits(&View::default()), [0.25, 1.0]);
    }

    #[test]
    fn a_line_one_pixel_wide_is_touched_and_only_where_it_is() {
        let plane = painted(|i, j| i == 77 && (100..200).contains(&j));
        assert!(plane.touches([70.0, 150.0], [80.0, 160.0]));
        assert!(plane.touches([77.0, 199.4], [77.4, 210.0]));
        for (low, high) in [
            ([78.0, 150.0], [90.0, 160.0]),
            ([60.0, 150.0], [76.5, 160.0]),
            ([70.0, 200.0], [80.0, 210.0]),
        ] {
            assert!(!plane.touches(low, high), "{low:?}");
        }
        let rectangles: Vec<_> = plane.painted().collect();
        assert_eq!(rectangles, [[76.5, 99.5, 1.0, 100.0]]);
        assert_eq!(plane.parts().count(), 0);
    }

    #[test]
    fn the_goal_of_the_paper_is_a_square_in_the_middle_and_free() {
        let plane = paper();
        let goal = plane.goal();
        let [width, height] = plane.size(&View::default());
        assert_eq!(goal.len(), 4);
        for axis in [0, 1] {
            let middle = goal.iter().map(|point| point[axis]).sum::<f64>() / 4.0;
            let expected = [width, height][axis] / 2.0;
            assert!((middle - expected).abs() < 1.0, "{goal:?}");
        }
        assert!(goal.iter().all(|&point| !plane.touches(point, point)));
    }

    #[test]
    fn the_centre_of_every_part_is_covered() {
        let plane = paper();
        assert!(plane.parts().count() > 0);
        assert!(plane.parts().all(|part| part.covers(part.center)));
        let bare = ImagePlane::default();
        assert!(!bare.touches([10.0, 10.0], [10.0, 10.0]));
    }
}
