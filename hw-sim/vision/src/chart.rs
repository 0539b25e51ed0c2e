//! Where each marker is to be seen: the pattern, and the map from its plane to the image.

use nalgebra::{Matrix3, Vector2};
use scene::{MAX_POINTS, Scene};

use crate::assignment::{SQUEEZE_TRACKED, view};
use crate::homography::{Homography, Point, distance};

/// Points of the pattern's plane (m) with where they are seen (px).
pub(crate) type Pairs = heapless::Vec<(Point, Point), MAX_POINTS>;

/// The pattern under a map.
#[derive(Clone, Debug)]
pub(crate) struct Chart {
    pattern: heapless::Vec<Point, MAX_POINTS>,
    /// Size of the pattern, m.
    unit: f64,
    /// Radius of the discs, m.
    radius: f64,
    /// How the plane of the pattern was last seen, or is expected to be.
    map: Homography,
    /// Turn of the last known arrangement, rad.
    turn: f64,
}

impl Chart {
    /// The pattern of a scene with discs of `radius` (m), as at its goal.
    pub fn new(scene: &Scene, radius: f64) -> Self {
        let pattern: heapless::Vec<Point, MAX_POINTS> =
            scene.pattern.iter().map(|p| [p[0], p[1]]).collect();
        let size = pattern.iter().map(|p| p[0].hypot(p[1]));
        Self {
            unit: size.fold(1e-9, f64::max),
            pattern,
            radius,
            map: Homography::of_pose(&scene.camera, &scene.goal),
            turn: 0.0,
        }
    }

    /// The points of the pattern, m.
    pub fn pattern(&self) -> &[Point] {
        &self.pattern
    }

    /// Turn of the last known arrangement, rad.
    pub fn turn(&self) -> f64 {
        self.turn
    }

    /// Takes another map, and the turn of the pattern under it.
    pub fn set(&mut self, map: Homography) {
        self.map = map;
        let images: Pairs = self
            .pattern
            .iter()
            .filter_map(|point| Some((*point, self.map.apply(*point)?)))
            .collect();
        if let Some((turn, _)) = Homography::affine(&images).and_then(|map| view(&map)) {
            self.turn = turn;
        }
    }

    /// Shifts all markers in the image, px.
    pub fn shift(&mut self, [u, v]: Point) {
        let shift = Homography(Matrix3::new_translation(&Vector2::new(u, v)));
        self.map = self.map.then(&shift);
    }

    /// Where a marker is to be seen, px.
    pub fn place(&self, marker: usize) -> Option<Point> {
        self.map.apply(self.pattern[marker])
    }

    /// From there to the next marker, px.
    pub fn spacing(&self, marker: usize) -> Option<f64> {
        let at = self.place(marker)?;
        let others = (0..self.pattern.len()).filter(|i| *i != marker);
        let gaps = others.filter_map(|i| Some(distance(self.place(i)?, at)));
        Some(gaps.fold(f64::INFINITY, f64::min))
    }

    /// Mean radius with which a marker is seen, px.
    pub fn radius(&self, marker: usize) -> Option<f64> {
        self.radius_under(&self.map, marker)
    }

    /// Whether a radius (px) fits a marker.
    pub fn fits(&self, marker: usize, radius: f64) -> bool {
        self.fits_under(&self.map, marker, radius)
    }

    /// The map through pairs that were found anew; none if the radii of the discs (px; none
    /// where a marker was not found) do not fit it.
    pub fn anew(
        &self,
        pairs: &Pairs,
        mut radii: impl Iterator<Item = Option<f64>>,
    ) -> Option<Homography> {
        let map = Homography::through(pairs, self.unit).or_else(|| Homography::affine(pairs))?;
        (0..self.pattern.len())
            .zip(&mut radii)
            .all(|(marker, radius)| radius.is_none_or(|r| self.fits_under(&map, marker, r)))
            .then_some(map)
    }

    /// Brings the map into line with the markers that are visible; false if they do not look
    /// like the pattern.
    pub fn follow(&mut self, pairs: &Pairs) -> bool {
        if pairs.len() >= 3 {
            let seen = Homography::affine(pairs).map(|map| view(&map));
            if seen.is_some_and(|view| view.is_none_or(|(_, ratio)| ratio < SQUEEZE_TRACKED)) {
                return false;
            }
        }
        let moved: Pairs = pairs
            .iter()
            .filter_map(|(point, pixel)| Some((self.map.apply(*point)?, *pixel)))
            .collect();
        let map = Homography::through(pairs, self.unit).or_else(|| {
            let change = Homography::affine(&moved).or_else(|| Homography::similarity(&moved))?;
            Some(self.map.then(&change))
        });
        if let Some(map) = map {
            self.set(map);
        }
        true
    }

    /// From the centroid of a marker's ellipse to the image of the disc's centre, px: seen at a
    /// slant, the near half of a disc is larger.
    pub fn slant(&self, marker: usize) -> Option<Point> {
        let point = self.pattern[marker];
        let (center, ellipse) = (self.map.apply(point)?, self.map.disc(point, self.radius)?);
        Some([0, 1].map(|k| center[k] - ellipse.center[k]))
    }

    fn radius_under(&self, map: &Homography, marker: usize) -> Option<f64> {
        let [[a, b], [c, d]] = map.jacobian(self.pattern[marker])?;
        Some(self.radius * (a * d - b * c).abs().sqrt())
    }

    fn fits_under(&self, map: &Homography, marker: usize, radius: f64) -> bool {
        self.radius_under(map, marker)
            .is_some_and(|expected| (radius / expected - 1.0).abs() < 0.3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn goal() -> Chart {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        Chart::new(&scene, 0.006)
    }

    #[test]
    fn places_and_sizes_at_the_goal_are_those_of_the_pinhole() {
        let chart = goal();
        // (-0.06, -0.045 - 0.01) m at 0.35 m and 615 px.
        let expected = [320.0 - 615.0 * 0.06 / 0.35, 240.0 - 615.0 * 0.055 / 0.35];
        assert!(distance(chart.place(0).unwrap(), expected) < 1e-9);
        assert!((chart.spacing(0).unwrap() - 615.0 * 0.09 / 0.35).abs() < 1e-9);
        assert!((chart.radius(0).unwrap() - 615.0 * 0.006 / 0.35).abs() < 1e-9);
        assert!(chart.fits(0, 10.0) && !chart.fits(0, 15.0));
    }

    #[test]
    fn a_chart_follows_markers_that_moved_and_refuses_a_line() {
        let mut chart = goal();
        let pairs = |chart: &Chart, squeeze: f64| -> Pairs {
            let all = chart.pattern().iter().enumerate();
            let places = all.map(|(i, point)| (*point, chart.place(i).unwrap()));
            places
                .map(|(point, [u, v])| (point, [u + 7.0, squeeze * v - 3.0]))
                .collect()
        };
        let before = chart.place(2).unwrap();
        assert!(!chart.clone().follow(&pairs(&chart, 0.0)));
        let moved = pairs(&chart, 1.0);
        assert!(chart.follow(&moved));
        let after = chart.place(2).unwrap();
        assert!(distance(after, [before[0] + 7.0, before[1] - 3.0]) < 1e-6);
    }
}
