//! Finds, identifies and follows the four markers.

use scene::{Camera, MAX_POINTS, Pose, Scene};

use crate::assignment::assign;
use crate::chart::{Chart, Pairs};
use crate::criteria::{DetectorSettings, SizeError};
use crate::disc::Disc;
use crate::homography::{Homography, Point};
use crate::image::Image;
use crate::search::{near, whole_frame};

/// How far a marker may be from its prediction, px.
const GATE_PX: f64 = 25.0;
/// How far the pattern may be turned against the last known arrangement when all markers were lost,
/// rad. A pattern that looks the same after a half turn needs less than pi/2.
const TURN_MAX: f64 = 1.4;
/// Frames without two visible markers after which predictions are given up.
const PATIENCE: u32 = 5;

/// A marker in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// It was measured in this frame, all of it.
    pub visible: bool,
    /// Where its centre is seen, px; where it is not visible, where it is believed to be: finite,
    /// not to be relied upon.
    pub pixel: [f64; 2],
}

/// One sighting for each point of the pattern, in its order.
pub type Sightings = heapless::Vec<Sighting, MAX_POINTS>;

/// Finds the markers in frame after frame. Detection allocates nothing.
#[derive(Clone, Debug)]
pub struct Detector {
    camera: Camera,
    /// Least and greatest mean radius of a disc, px.
    radius_px: [f64; 2],
    chart: Chart,
    /// Predictions may be trusted.
    tracking: bool,
    /// Frames since two markers were seen.
    blind: u32,
    /// Shift of all markers between the last two frames, px.
    drift: Point,
    /// Levels of discs and background, as last seen.
    levels: [f64; 2],
    sightings: Sightings,
}

impl Detector {
    /// A detector of the pattern of a scene. Until [`Detector::expect`] says otherwise it takes the
    /// pattern to be turned as at the scene's goal, give or take 80 deg.
    pub fn new(scene: &Scene, settings: &DetectorSettings) -> Self {
        let camera = scene.camera;
        let center = Sighting {
            visible: false,
            pixel: [camera.cx, camera.cy],
        };
        let mut detector = Self {
            camera,
            sightings: scene.pattern.iter().map(|_| center).collect(),
            radius_px: settings.radius_px,
            chart: Chart::new(scene, settings.marker_radius_m),
            tracking: false,
            blind: 0,
            drift: [0.0; 2],
            levels: [0.0; 2],
        };
        detector.expect(&scene.goal);
        detector
    }

    /// Forgets all markers; the next frame is searched as a whole, for a pattern turned about as at
    /// `pose` (object in the camera frame). Call it at the start of a run, and where the camera may
    /// have been moved meanwhile.
    pub fn expect(&mut self, pose: &Pose) {
        self.tracking = false;
        self.blind = 0;
        self.drift = [0.0; 2];
        self.chart.set(Homography::of_pose(&self.camera, pose));
        self.predict();
    }

    /// Finds the markers in the next frame.
    ///
    /// # Errors
    /// [`SizeError`] where the image is not of the scene's size.
    pub fn detect(&mut self, image: &Image) -> Result<&Sightings, SizeError> {
        let expected = [self.camera.width as usize, self.camera.height as usize];
        let found = [image.width(), image.height()];
        if found != expected {
            return Err(SizeError { found, expected });
        }
        if !(self.tracking && self.track(image)) {
            self.acquire(image);
        }
        self.correct();
        Ok(&self.sightings)
    }

    /// What was found in the last frame.
    pub fn sightings(&self) -> &Sightings {
        &self.sightings
    }

    /// Bit i is set where marker i was visible in the last frame: `Features::visible` of the
    /// contract.
    pub fn visible(&self) -> u32 {
        let bits = self.sightings.iter().enumerate();
        bits.map(|(i, marker)| u32::from(marker.visible) << i).sum()
    }

    /// Follows the markers into this frame; false if they are lost.
    fn track(&mut self, image: &Image) -> bool {
        // First the markers that were seen in the last frame, from where they are going to be.
        let before = self.sightings.clone();
        self.predict();
        let mut drift = [0.0; 2];
        let mut count = 0.0;
        for i in 0..before.len() {
            if !before[i].visible {
                continue;
            }
            let from = before[i].pixel;
            let prediction = [from[0] + self.drift[0], from[1] + self.drift[1]];
            if let Some(disc) = self.find(image, i, prediction) {
                drift = [0, 1].map(|k| drift[k] + disc.center[k] - from[k]);
                count += 1.0;
                self.take(i, &disc);
            }
        }
        if count > 0.0 {
            self.drift = drift.map(|x| x / count);
        }
        if !self.fit() {
            return false;
        }
        // Then the others, from where the ones that were found say that they are.
        let known = self
            .sightings
            .iter()
            .filter(|marker| marker.visible)
            .count();
        self.blind = if known >= 2 { 0 } else { self.blind + 1 };
        if known == 0 {
            self.chart.shift(self.drift);
        }
        if self.blind > PATIENCE {
            return false;
        }
        self.predict_hidden();
        let mut again = false;
        for i in 0..before.len() {
            if !before[i].visible && !self.sightings[i].visible {
                let prediction = self.sightings[i].pixel;
                if let Some(disc) = self.find(image, i, prediction) {
                    self.take(i, &disc);
                    again = true;
                }
            }
        }
        if again && !self.fit() {
            return false;
        }
        self.predict_hidden();
        true
    }

    /// Looks for all markers in the whole frame.
    fn acquire(&mut self, image: &Image) {
        self.predict();
        self.tracking = false;
        let discs = whole_frame(image, self.radius_px);
        let (pattern, turn) = (self.chart.pattern(), self.chart.turn());
        let Some(assignment) = assign(&discs, pattern, turn, TURN_MAX) else {
            return;
        };
        for (i, disc) in assignment.iter().enumerate() {
            if let Some(disc) = disc {
                self.take(i, &discs[*disc]);
            }
        }
        let radii = assignment.iter().map(|disc| Some(discs[(*disc)?].radius));
        match self.chart.anew(&self.pairs(), radii) {
            Some(map) => {
                self.chart.set(map);
                self.drift = [0.0; 2];
                self.blind = 0;
                self.tracking = true;
                self.predict_hidden();
            }
            None => self.predict(),
        }
    }

    /// The disc of a marker near a prediction.
    fn find(&self, image: &Image, marker: usize, prediction: Point) -> Option<Disc> {
        // Never as far as the next marker.
        let gate = GATE_PX.min(0.4 * self.chart.spacing(marker)?);
        let radius = self.chart.radius(marker)?;
        let disc = near(image, prediction, gate, self.levels, radius, self.radius_px)?;
        self.chart.fits(marker, disc.radius).then_some(disc)
    }

    fn take(&mut self, marker: usize, disc: &Disc) {
        self.sightings[marker] = Sighting {
            visible: true,
            pixel: disc.center,
        };
        self.levels = disc.levels;
    }

    /// Brings the chart into line with the markers that are visible; false if they do not look
    /// like the pattern.
    fn fit(&mut self) -> bool {
        let pairs = self.pairs();
        self.chart.follow(&pairs)
    }

    /// Every marker where the map says, none of them visible.
    fn predict(&mut self) {
        self.sightings
            .iter_mut()
            .for_each(|marker| marker.visible = false);
        self.predict_hidden();
    }

    /// Markers that are not visible where the map says.
    fn predict_hidden(&mut self) {
        for (i, marker) in self.sightings.iter_mut().enumerate() {
            if let (false, Some(pixel)) = (marker.visible, self.chart.place(i)) {
                marker.pixel = pixel;
            }
        }
    }

    /// The markers that are visible.
    fn pairs(&self) -> Pairs {
        let all = self.chart.pattern().iter().zip(&self.sightings);
        all.filter(|(_, marker)| marker.visible)
            .map(|(point, marker)| (*point, marker.pixel))
            .collect()
    }

    /// From centroids of ellipses to the images of the discs' centres.
    fn correct(&mut self) {
        for (i, marker) in self.sightings.iter_mut().enumerate() {
            if let (true, Some(slant)) = (marker.visible, self.chart.slant(i)) {
                marker.pixel = [0, 1].map(|k| marker.pixel[k] + slant[k]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::homography::distance;
    use crate::{Look, Renderer, truth};

    fn robot() -> (Scene, Renderer, Detector) {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let renderer = Renderer::new(&scene, &Look::default());
        let detector = Detector::new(&scene, &DetectorSettings::default());
        (scene, renderer, detector)
    }

    /// Largest error of the visible markers, px, and their bits.
    fn seen(scene: &Scene, pose: &Pose, detector: &Detector) -> (f64, u32) {
        let truths = truth(scene, pose, 0.006, |_| true);
        let both = truths.iter().zip(detector.sightings());
        let errors = both
            .filter(|(_, marker)| marker.visible)
            .map(|(truth, marker)| distance(truth.pixel, marker.pixel));
        (errors.fold(0.0, f64::max), detector.visible())
    }

    #[test]
    fn a_marker_that_comes_back_from_behind_the_object_is_itself_again() {
        let (scene, mut renderer, mut detector) = robot();
        let mut bits = Vec::new();
        for k in 0..120 {
            let mut pose = scene.goal;
            // Down until the lower two are behind the object, and up again.
            pose.translation[1] += 0.07 * (std::f64::consts::PI * f64::from(k) / 119.0).sin();
            detector.detect(renderer.render(&pose)).unwrap();
            let (error, visible) = seen(&scene, &pose, &detector);
            assert!(error < 0.3, "frame {k}: {error}");
            bits.push(visible);
        }
        assert_eq!((bits[0], bits[119]), (0b1111, 0b1111));
        assert!(bits[50..70].iter().all(|bits| *bits == 0b0011), "{bits:?}");
    }

    #[test]
    fn a_pattern_turned_by_more_than_may_be_is_not_named() {
        let (scene, mut renderer, mut detector) = robot();
        let mut pose = scene.goal;
        pose.translation[1] = -0.05;
        pose.rotation[2] = 3.0;
        detector.detect(renderer.render(&pose)).unwrap();
        // It looks the same as one turned by 3.0 - pi, and is taken for it: the caller has to say
        // what to expect.
        assert!(seen(&scene, &pose, &detector).0 > 100.0);
        detector.expect(&pose);
        detector.detect(renderer.render(&pose)).unwrap();
        let (error, bits) = seen(&scene, &pose, &detector);
        assert!(error < 0.3 && bits == 0b1111);
    }

    #[test]
    fn discs_of_another_size_are_not_the_patterns() {
        let (scene, _, mut detector) = robot();
        let look = Look {
            marker_radius_m: 0.009,
            ..Look::default()
        };
        let mut renderer = Renderer::new(&scene, &look);
        detector.detect(renderer.render(&scene.goal)).unwrap();
        assert_eq!(detector.visible(), 0);
    }

    #[test]
    fn an_image_of_another_size_is_refused() {
        let (_, _, mut detector) = robot();
        let message = detector
            .detect(&Image::new(320, 240))
            .unwrap_err()
            .to_string();
        assert_eq!(
            message,
            "image of 320 x 240 px; allowed: 640 x 480, the scene's"
        );
    }
}
