//! From an image to features: tags are looked for where they are expected, else everywhere.

use markers::Family;
use scene::Scene;

use crate::config::Targets;
use crate::grey::Grey;
use crate::lens::Lens;
use crate::mask_check::Place;
use crate::plane::Point;
use crate::tags::{Tag, TagError, TagFinder, Templates};
use crate::tracker::{Corners, Sighting, Tracker};

/// Frames after which all of the image is looked at again while a tag is missing.
const WHOLE_EVERY: u32 = 10;
/// Sides of windows are multiples of it, px.
const STEP: usize = 32;
/// Largest window, px.
const LARGEST: usize = 320;
/// How much a window is wider than the tag's black square, and how much more, px. The white border
/// is a sixth on each side at most.
const WIDER: f64 = 1.5;
const ROOM_PX: f64 = 10.0;
/// Tags that look at least this large may be looked for in every other pixel, px.
const COARSE_PX: f64 = 70.0;

/// What an image shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// The features, px of the scene's pinhole, in the order of its pattern.
    pub points: Vec<Point>,
    /// Bit i: feature i was measured.
    pub visible: u32,
    /// Whether all of the image was looked at.
    pub is_whole: bool,
    /// A tag that does not lie where the pattern says, and by how much, px.
    pub misplaced: Option<(u32, f64)>,
}

/// Finds the features of a scene in images of its camera.
#[derive(Debug)]
pub struct Finder {
    scene: Scene,
    lens: Lens,
    targets: Targets,
    family: Family,
    templates: Templates,
    everywhere: TagFinder,
    /// By side of the window and step of the search.
    windows: Vec<((usize, usize), TagFinder)>,
    tracker: Tracker,
    /// Number of the last frame.
    last: Option<u64>,
    since_whole: u32,
}

impl Finder {
    /// Finds these targets of a scene, tags of this family, through a lens.
    ///
    /// # Errors
    /// The image is too large for the detector.
    pub fn new(
        scene: &Scene,
        lens: &Lens,
        family: Family,
        targets: &Targets,
    ) -> Result<Self, TagError> {
        let templates = Templates::new(family)?;
        let (width, height) = (scene.camera.width as usize, scene.camera.height as usize);
        let planes = planes(scene, family, targets);
        Ok(Self {
            everywhere: TagFinder::new(&templates, width, height, 2)?,
            windows: Vec::new(),
            family,
            templates,
            tracker: Tracker::new(targets.numbers().iter().copied().zip(planes)),
            scene: scene.clone(),
            lens: lens.clone(),
            targets: targets.clone(),
            last: None,
            since_whole: WHOLE_EVERY,
        })
    }

    /// The features in the frame of this number.
    ///
    /// # Errors
    /// The image has another size than the scene's camera.
    pub fn find(&mut self, image: &Grey, sequence: u64) -> Result<Found, TagError> {
        let frames = self.last.and_then(|last| sequence.checked_sub(last));
        let frames = frames.map_or(1, |frames| frames.clamp(1, 1000) as u32);
        self.last = Some(sequence);
        let (mut tags, refused) = self.look_near(image, frames)?;
        let is_whole = self.is_to_look_everywhere(&tags, &refused, frames);
        if is_whole {
            tags = self.look_everywhere(image, refused)?;
            self.since_whole = 0;
        }
        self.since_whole = self.since_whole.saturating_add(1);
        let sightings: Vec<Sighting> = tags.iter().filter_map(|tag| self.straight(tag)).collect();
        self.tracker.update(&sightings, frames);
        let (points, visible) = self.features();
        Ok(Found {
            points,
            visible,
            is_whole,
            misplaced: self.tracker.misplaced(),
        })
    }

    /// Tags of the last frame with their white borders, in the image of the scene's camera: those
    /// that were seen, and those that others say should be.
    pub fn places(&self) -> [Vec<Place>; 2] {
        let mut places = [Vec::new(), Vec::new()];
        for (index, number) in self.tracker.numbers().enumerate() {
            let list = match (self.tracker.is_seen(index), self.tracker.is_guessed(index)) {
                (true, _) => &mut places[0],
                (_, true) => &mut places[1],
                _ => continue,
            };
            let Some((corners, center)) = self.tracker.place(index) else {
                continue;
            };
            let black = self.family.black_share();
            let rim = |corner: Point| [0, 1].map(|k| center[k] + (corner[k] - center[k]) / black);
            list.push(Place {
                number,
                center,
                corners: corners.map(rim),
            });
        }
        places
    }

    /// Looks for each tag in a window about where it is expected: those that are seen whole, and
    /// the numbers of those that are there, but not seen whole.
    fn look_near(&mut self, image: &Grey, frames: u32) -> Result<(Vec<Tag>, Vec<u32>), TagError> {
        let (mut tags, mut refused) = (Vec::new(), Vec::new());
        for index in 0..self.targets.numbers().len() {
            let Some(expected) = self.tracker.expected(index, frames) else {
                continue;
            };
            let [a, b, c, d] = expected.map(|p| self.lens.distort(p, &self.scene.camera));
            let (Some(a), Some(b), Some(c), Some(d)) = (a, b, c, d) else {
                continue;
            };
            let Some((place, side, coarse)) = window(image, &[a, b, c, d], frames) else {
                continue;
            };
            let [u, v] = place;
            let number = self.targets.numbers()[index];
            let finder = self.window_finder(side, coarse)?;
            let part = image.part(u..u + side, v..v + side);
            let is_ours = |found: u32| found == number;
            let mut found = finder.find_those(&part, is_ours)?;
            // One that is read and refused would be again.
            if found.is_empty() && finder.refused().is_empty() {
                found = finder.find_missing(&part, is_ours)?;
            }
            if found.is_empty() {
                refused.extend(finder.refused().first());
            }
            tags.extend(found.iter().map(|tag| tag.shifted([u as f64, v as f64])));
        }
        Ok((tags, refused))
    }

    /// Looks for all tags in the whole image, and once more for missing ones; not for tags that were
    /// read and refused.
    fn look_everywhere(
        &mut self,
        image: &Grey,
        mut refused: Vec<u32>,
    ) -> Result<Vec<Tag>, TagError> {
        let is_ours = |number: u32| self.targets.numbers().contains(&number);
        let mut tags = self.everywhere.find_those(image, is_ours)?;
        refused.extend(self.everywhere.refused());
        let is_missing = |number: &u32| {
            !refused.contains(number) && tags.iter().all(|tag| tag.number != *number)
        };
        let missing: Vec<u32> = self.tracker.numbers().filter(is_missing).collect();
        if !missing.is_empty() {
            let is_missing = |number: u32| missing.contains(&number);
            tags.extend(self.everywhere.find_missing(image, is_missing)?);
        }
        Ok(tags)
    }

    fn window_finder(&mut self, side: usize, coarse: usize) -> Result<&mut TagFinder, TagError> {
        let key = (side, coarse);
        let known = self.windows.iter().position(|(known, _)| *known == key);
        let known = match known {
            Some(known) => known,
            None => {
                let finder = TagFinder::new(&self.templates, side, side, coarse)?;
                self.windows.push((key, finder));
                self.windows.len() - 1
            }
        };
        Ok(&mut self.windows[known].1)
    }

    /// Where a tag is lost that was seen a frame ago, and is not where it should be; every so often
    /// while one is missing; all the time while all are.
    fn is_to_look_everywhere(&self, tags: &[Tag], refused: &[u32], frames: u32) -> bool {
        let is_here = |number: u32| tags.iter().any(|tag| tag.number == number);
        let mut missing = self
            .tracker
            .numbers()
            .enumerate()
            .filter(|(_, number)| !is_here(*number))
            .peekable();
        if missing.peek().is_none() {
            return false;
        }
        let is_due = self.since_whole.saturating_add(frames - 1) >= WHOLE_EVERY;
        let mut lost = missing.filter(|(_, number)| !refused.contains(number));
        tags.is_empty() || is_due || lost.any(|(index, _)| self.tracker.is_seen(index))
    }

    /// A tag in the image of the scene's pinhole.
    fn straight(&self, tag: &Tag) -> Option<Sighting> {
        let straight = |p: Point| self.lens.undistort(p, &self.scene.camera);
        let [a, b, c, d] = tag.corners.map(straight);
        Some(Sighting {
            number: tag.number,
            corners: [a?, b?, c?, d?],
            centre: straight(tag.centre)?,
        })
    }

    fn features(&self) -> (Vec<Point>, u32) {
        let camera = &self.scene.camera;
        // Nobody knows where it is.
        let nowhere = [camera.cx, camera.cy];
        match &self.targets {
            Targets::Centres(numbers) => {
                let place = |index: usize| self.tracker.place(index);
                let points = (0..numbers.len()).map(|i| place(i).map_or(nowhere, |(_, c)| c));
                let bits = (0..numbers.len()).map(|i| u32::from(self.tracker.is_seen(i)) << i);
                (points.collect(), bits.sum())
            }
            Targets::Corners(_) => {
                let corners = self.tracker.place(0).map(|(corners, _)| corners);
                let visible = if self.tracker.is_seen(0) { 0b1111 } else { 0 };
                (corners.unwrap_or([nowhere; 4]).to_vec(), visible)
            }
        }
    }
}

/// Corners of the tags on the plane of the pattern, m, where the scene tells their size.
fn planes(scene: &Scene, family: Family, targets: &Targets) -> Vec<Option<Corners>> {
    let flat = |p: &[f64; 3]| [p[0], p[1]];
    match targets {
        Targets::Centres(_) => {
            let square = |[x, y]: Point| {
                let half = 0.5 * family.black_share() * scene.marker_size;
                let corners = [[-half, -half], [half, -half], [half, half], [-half, half]];
                (half > 0.0).then(|| corners.map(|[a, b]| [x + a, y + b]))
            };
            scene.pattern.iter().map(|p| square(flat(p))).collect()
        }
        Targets::Corners(_) => {
            let corners: Vec<Point> = scene.pattern.iter().map(flat).collect();
            vec![corners.try_into().ok()]
        }
    }
}

/// The window about a tag's corners: its column and row, its side, and in every how many pixels to
/// look; `None` where all of the image is no larger, or the tag is outside.
fn window(image: &Grey, corners: &Corners, frames: u32) -> Option<([usize; 2], usize, usize)> {
    let range = |k: usize| {
        let values = corners.iter().map(|p| p[k]);
        let least = values.clone().fold(f64::INFINITY, f64::min);
        (least, values.fold(f64::NEG_INFINITY, f64::max))
    };
    let ((left, right), (top, bottom)) = (range(0), range(1));
    let extent = (right - left).max(bottom - top);
    let room = ROOM_PX * f64::from(frames.min(4));
    let needed = WIDER * extent + 2.0 * room;
    if needed.is_nan() || needed >= LARGEST as f64 {
        return None;
    }
    let side = (needed.ceil() as usize).next_multiple_of(STEP);
    let place = |low: f64, high: f64, size: usize| {
        let middle = 0.5 * (low + high);
        let is_inside = (0.0..size as f64).contains(&middle);
        let first = (middle - 0.5 * side as f64).round().max(0.0) as usize;
        (is_inside && side < size).then(|| first.min(size - side))
    };
    let (u, v) = (
        place(left, right, image.width())?,
        place(top, bottom, image.height())?,
    );
    let coarse = if extent >= COARSE_PX { 2 } else { 1 };
    Some(([u, v], side, coarse))
}
