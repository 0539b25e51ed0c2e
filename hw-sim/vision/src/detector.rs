//! The four markers of a frame: found, told apart, followed.

use scene::{Camera, MAX_POINTS, Pose, Scene};

use crate::assignment::{SQUEEZE_TRACKED, assign, view};
use crate::disc::{Disc, Rules};
use crate::homography::{Homography, Point, distance};
use crate::image::Image;
use crate::search::{near, whole_frame};

/// Whether markers are brighter or darker than what they lie on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Polarity {
    /// Bright discs.
    #[default]
    Bright,
    /// Dark discs.
    Dark,
}

/// How markers look and how far they move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectorSettings {
    /// Bright or dark discs.
    pub polarity: Polarity,
    /// Radius of the discs on the plane of the pattern, m; above 0, at most 1.
    pub marker_radius_m: f64,
    /// Least and greatest mean radius in the image, px; 3 to 200.
    pub radius_px: [f64; 2],
    /// Least contrast to the background, levels; 5 to 250.
    pub contrast: f64,
    /// How far the rim of a whole disc may be from an ellipse, px; 0.1 to 5. Smaller rejects discs that are barely
    /// touched by an occlusion, larger bears more noise.
    pub rim_px: f64,
    /// How far a marker may be from its prediction, px; 1 to 500. Never more than 0.4 of the distance to the next one.
    pub gate_px: f64,
    /// How far the pattern may be turned against the last known arrangement when all markers were lost, rad; 0 to pi. A
    /// pattern that looks the same after a half turn needs less than pi/2, a square less than pi/4.
    pub turn_max: f64,
    /// Frames without two visible markers after which predictions are given up, 0 to 1000.
    pub patience: u32,
}

impl Default for DetectorSettings {
    fn default() -> Self {
        Self {
            polarity: Polarity::Bright,
            marker_radius_m: crate::Look::default().marker_radius_m,
            radius_px: [4.0, 24.0],
            contrast: 50.0,
            rim_px: 0.3,
            gate_px: 25.0,
            turn_max: 1.4,
            patience: 5,
        }
    }
}

/// Why a detector cannot be made, or an image not be searched.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DetectorError {
    /// A setting is out of its range.
    #[error("detector: {key} = {value}; allowed: {allowed}")]
    Value {
        /// The field.
        key: &'static str,
        /// What was found.
        value: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The image has another size than the scene's camera.
    #[error("image of {} x {} px; allowed: {} x {}, the scene's", found[0], found[1], expected[0], expected[1])]
    Size {
        /// Width and height of the image, px.
        found: [usize; 2],
        /// Width and height in the scene, px.
        expected: [usize; 2],
    },
}

/// A marker in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// It was measured in this frame, all of it.
    pub visible: bool,
    /// Where its centre is seen, px; where it is not visible, where it is believed to be: finite, not to be relied upon.
    pub pixel: [f64; 2],
}

/// One sighting for each point of the pattern, in its order.
pub type Sightings = heapless::Vec<Sighting, MAX_POINTS>;

/// Finds the markers in frame after frame. Detection allocates nothing.
#[derive(Clone, Debug)]
pub struct Detector {
    settings: DetectorSettings,
    camera: Camera,
    pattern: heapless::Vec<Point, MAX_POINTS>,
    /// Size of the pattern, m.
    unit: f64,
    rules: Rules,
    /// How the plane of the pattern was last seen, or is expected to be.
    map: Homography,
    /// Predictions may be trusted.
    tracking: bool,
    /// Frames since two markers were seen.
    blind: u32,
    /// Turn of the last known arrangement, rad.
    turn: f64,
    /// Shift of all markers between the last two frames, px.
    drift: Point,
    /// Signed levels of discs and background, as last seen.
    levels: [f64; 2],
    sightings: Sightings,
}

impl Detector {
    /// A detector of the pattern of a scene. Until [`Detector::expect`] says otherwise it takes the pattern to be turned
    /// as at the scene's goal, give or take `turn_max`.
    ///
    /// # Errors
    /// [`DetectorError::Value`] where a setting is out of its range.
    pub fn new(scene: &Scene, settings: &DetectorSettings) -> Result<Self, DetectorError> {
        settings.check()?;
        let pattern: heapless::Vec<Point, MAX_POINTS> =
            scene.pattern.iter().map(|p| [p[0], p[1]]).collect();
        let unit = pattern
            .iter()
            .map(|p| p[0].hypot(p[1]))
            .fold(1e-9, f64::max);
        let sign = match settings.polarity {
            Polarity::Bright => 1.0,
            Polarity::Dark => -1.0,
        };
        let rules = Rules {
            sign,
            radius: settings.radius_px,
            contrast: settings.contrast,
            rim: settings.rim_px,
        };
        let camera = scene.camera;
        let center = Sighting {
            visible: false,
            pixel: [camera.cx, camera.cy],
        };
        let mut detector = Self {
            settings: *settings,
            camera,
            sightings: pattern.iter().map(|_| center).collect(),
            pattern,
            unit,
            rules,
            map: Homography::of_pose(&camera, &scene.goal),
            tracking: false,
            blind: 0,
            turn: 0.0,
            drift: [0.0; 2],
            levels: [0.0; 2],
        };
        detector.expect(&scene.goal);
        Ok(detector)
    }

    /// Forgets all markers; the next frame is searched as a whole, for a pattern turned about as at `pose` (object in the
    /// camera frame). Call it at the start of a run, and where the camera may have been moved meanwhile.
    pub fn expect(&mut self, pose: &Pose) {
        self.tracking = false;
        self.blind = 0;
        self.drift = [0.0; 2];
        self.map = Homography::of_pose(&self.camera, pose);
        self.predict();
        let pairs = self.pairs(|_| true);
        if let Some((turn, _)) = Homography::affine(&pairs).and_then(|map| view(&map)) {
            self.turn = turn;
        }
    }

    /// Finds the markers in the next frame.
    ///
    /// # Errors
    /// [`DetectorError::Size`] where the image is not of the scene's size.
    pub fn detect(&mut self, image: &Image) -> Result<&Sightings, DetectorError> {
        let expected = [self.camera.width as usize, self.camera.height as usize];
        let found = [image.width(), image.height()];
        if found != expected {
            return Err(DetectorError::Size { found, expected });
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

    /// Bit i is set where marker i was visible in the last frame: `Features::visible` of the contract.
    pub fn visible(&self) -> u32 {
        let bits = self.sightings.iter().enumerate();
        bits.map(|(i, marker)| u32::from(marker.visible) << i).sum()
    }

    /// Follows the markers into this frame; false where they are lost.
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
            let shift = Homography([
                [1.0, 0.0, self.drift[0]],
                [0.0, 1.0, self.drift[1]],
                [0.0, 0.0, 1.0],
            ]);
            self.map = self.map.then(&shift);
        }
        if self.blind > self.settings.patience {
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
        let discs = whole_frame(image, &self.rules);
        let Some(assignment) = assign(&discs, &self.pattern, self.turn, self.settings.turn_max)
        else {
            return;
        };
        for (i, disc) in assignment.iter().enumerate() {
            if let Some(disc) = disc {
                self.take(i, &discs[*disc]);
            }
        }
        let pairs = self.pairs(|marker| marker.visible);
        let map = Homography::through(&pairs, self.unit).or_else(|| Homography::affine(&pairs));
        let sizes = |map: &Homography| {
            assignment
                .iter()
                .enumerate()
                .all(|(i, disc)| disc.is_none_or(|k| self.fits(map, i, discs[k].radius)))
        };
        match map.filter(sizes) {
            Some(map) => {
                self.map = map;
                self.drift = [0.0; 2];
                self.blind = 0;
                self.tracking = true;
                self.remember_turn();
                self.predict_hidden();
            }
            None => self.predict(),
        }
    }

    /// The disc of a marker near a prediction.
    fn find(&self, image: &Image, marker: usize, prediction: Point) -> Option<Disc> {
        // Never as far as the next marker.
        let at = self.map.apply(self.pattern[marker])?;
        let others = (0..self.pattern.len()).filter(|i| *i != marker);
        let spacing = others
            .filter_map(|i| self.map.apply(self.pattern[i]))
            .map(|other| distance(other, at))
            .fold(f64::INFINITY, f64::min);
        let gate = self.settings.gate_px.min(0.4 * spacing);
        let radius = self.expected_radius(&self.map, marker)?;
        let disc = near(image, prediction, gate, self.levels, radius, &self.rules)?;
        self.fits(&self.map, marker, disc.radius).then_some(disc)
    }

    fn take(&mut self, marker: usize, disc: &Disc) {
        self.sightings[marker] = Sighting {
            visible: true,
            pixel: disc.center,
        };
        self.levels = disc.levels;
    }

    /// Brings the map into line with the markers that are visible; false where they do not look like the pattern.
    fn fit(&mut self) -> bool {
        let pairs = self.pairs(|marker| marker.visible);
        if pairs.len() >= 3 {
            let seen = Homography::affine(&pairs).map(|map| view(&map));
            if seen.is_some_and(|view| view.is_none_or(|(_, ratio)| ratio < SQUEEZE_TRACKED)) {
                return false;
            }
        }
        let moved: heapless::Vec<(Point, Point), MAX_POINTS> = pairs
            .iter()
            .filter_map(|(point, pixel)| Some((self.map.apply(*point)?, *pixel)))
            .collect();
        let map = Homography::through(&pairs, self.unit).or_else(|| {
            let change = Homography::affine(&moved).or_else(|| Homography::similarity(&moved))?;
            Some(self.map.then(&change))
        });
        if let Some(map) = map {
            self.map = map;
            self.remember_turn();
        }
        true
    }

    fn remember_turn(&mut self) {
        let images: heapless::Vec<(Point, Point), MAX_POINTS> = self
            .pattern
            .iter()
            .filter_map(|point| Some((*point, self.map.apply(*point)?)))
            .collect();
        if let Some((turn, _)) = Homography::affine(&images).and_then(|map| view(&map)) {
            self.turn = turn;
        }
    }

    /// Mean radius with which a marker is seen, px.
    fn expected_radius(&self, map: &Homography, marker: usize) -> Option<f64> {
        let [[a, b], [c, d]] = map.jacobian(self.pattern[marker])?;
        Some(self.settings.marker_radius_m * (a * d - b * c).abs().sqrt())
    }

    /// Whether a radius fits a marker under a map.
    fn fits(&self, map: &Homography, marker: usize, radius: f64) -> bool {
        self.expected_radius(map, marker)
            .is_some_and(|expected| (radius / expected - 1.0).abs() < 0.3)
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
        for (marker, point) in self.sightings.iter_mut().zip(&self.pattern) {
            if let (false, Some(pixel)) = (marker.visible, self.map.apply(*point)) {
                marker.pixel = pixel;
            }
        }
    }

    fn pairs(&self, of: impl Fn(&Sighting) -> bool) -> heapless::Vec<(Point, Point), MAX_POINTS> {
        let all = self.pattern.iter().zip(&self.sightings);
        all.filter(|(_, marker)| of(marker))
            .map(|(point, marker)| (*point, marker.pixel))
            .collect()
    }

    /// From centroids of ellipses to the images of the discs' centres: seen at a slant, the near half of a disc is larger.
    fn correct(&mut self) {
        let radius = self.settings.marker_radius_m;
        for (marker, point) in self.sightings.iter_mut().zip(&self.pattern) {
            if !marker.visible {
                continue;
            }
            if let (Some(center), Some(ellipse)) =
                (self.map.apply(*point), self.map.disc(*point, radius))
            {
                for k in 0..2 {
                    marker.pixel[k] += center[k] - ellipse.center[k];
                }
            }
        }
    }
}

impl DetectorSettings {
    fn check(&self) -> Result<(), DetectorError> {
        let pi = std::f64::consts::PI;
        let refuse = |key, value: String, allowed| {
            Err(DetectorError::Value {
                key,
                value,
                allowed,
            })
        };
        for (key, value, least, most, allowed) in [
            (
                "marker_radius_m",
                self.marker_radius_m,
                1e-6,
                1.0,
                "above 0, at most 1 m",
            ),
            ("contrast", self.contrast, 5.0, 250.0, "5 to 250 levels"),
            ("rim_px", self.rim_px, 0.1, 5.0, "0.1 to 5 px"),
            ("gate_px", self.gate_px, 1.0, 500.0, "1 to 500 px"),
            ("turn_max", self.turn_max, 0.0, pi, "0 to pi rad"),
        ] {
            if !(least..=most).contains(&value) {
                return refuse(key, value.to_string(), allowed);
            }
        }
        let [least, most] = self.radius_px;
        if !(least >= 3.0 && most <= 200.0 && least < most) {
            let value = format!("{:?}", self.radius_px);
            return refuse(
                "radius_px",
                value,
                "two numbers, 3 to 200 px, the first below the second",
            );
        }
        if self.patience > 1000 {
            return refuse("patience", self.patience.to_string(), "0 to 1000 frames");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Look, Renderer, truth};

    fn robot() -> (Scene, Renderer, Detector) {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let renderer = Renderer::new(&scene, &Look::default()).unwrap();
        let detector = Detector::new(&scene, &DetectorSettings::default()).unwrap();
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
        // It looks the same as one turned by 3.0 - pi, and is taken for it: the caller has to say what to expect.
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
        let mut renderer = Renderer::new(&scene, &look).unwrap();
        detector.detect(renderer.render(&scene.goal)).unwrap();
        assert_eq!(detector.visible(), 0);
    }

    #[test]
    fn dark_markers_are_found_where_dark_ones_are_wanted() {
        let (scene, ..) = robot();
        let look = Look {
            marker_level: 20.0,
            box_level: 200.0,
            table_level: 150.0,
            ..Look::default()
        };
        let settings = DetectorSettings {
            polarity: Polarity::Dark,
            ..DetectorSettings::default()
        };
        let mut detector = Detector::new(&scene, &settings).unwrap();
        let mut renderer = Renderer::new(&scene, &look).unwrap();
        detector.detect(renderer.render(&scene.goal)).unwrap();
        let (error, bits) = seen(&scene, &scene.goal, &detector);
        assert!(error < 0.1 && bits == 0b1111, "{error} {bits:b}");
    }

    #[test]
    fn an_image_of_another_size_and_settings_out_of_range_are_refused() {
        let (scene, _, mut detector) = robot();
        let message = detector
            .detect(&Image::new(320, 240).unwrap())
            .unwrap_err()
            .to_string();
        assert_eq!(
            message,
            "image of 320 x 240 px; allowed: 640 x 480, the scene's"
        );
        let settings = DetectorSettings {
            gate_px: 0.0,
            ..DetectorSettings::default()
        };
        let message = Detector::new(&scene, &settings).unwrap_err().to_string();
        assert_eq!(message, "detector: gate_px = 0; allowed: 1 to 500 px");
    }
}
