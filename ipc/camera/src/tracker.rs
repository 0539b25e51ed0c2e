//! Follows the tags of a pattern from frame to frame: each is looked for where it is expected, and
//! all in the whole image when they are lost.

use crate::grey::Grey;
use crate::tags::{Tag, TagError, TagFinder, Templates};

/// Sides of the windows that are searched, px.
const WINDOWS: [usize; 5] = [64, 96, 128, 192, 256];
/// A window is larger than the tag that is expected by this share of its side, and by at least so
/// many px, on each side.
const ROOM: f64 = 0.5;
const ROOM_PX: f64 = 12.0;
/// Frames without a tag after which it is expected nowhere.
const PATIENCE: u64 = 8;
/// While a tag is missing, the whole image is searched in each frame of so many.
const WHOLE_EVERY: u64 = 5;

/// What is to be found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pattern {
    /// The centres of these tags, in the order of the scene's points.
    Centres(Vec<u32>),
    /// The corners of this one: upper left, upper right, lower right, lower left.
    Corners(u32),
}

impl Pattern {
    fn numbers(&self) -> &[u32] {
        match self {
            Self::Centres(numbers) => numbers,
            Self::Corners(number) => std::slice::from_ref(number),
        }
    }

    /// Points that it gives.
    pub fn points(&self) -> usize {
        match self {
            Self::Centres(numbers) => numbers.len(),
            Self::Corners(_) => 4,
        }
    }
}

/// What a frame shows of the pattern.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sighting {
    /// The points, px; those of hidden tags are where they are expected.
    pub points: Vec<[f64; 2]>,
    /// Bit i: point i was measured in this frame.
    pub visible: u32,
    /// The tags that were seen, of the pattern and others.
    pub tags: Vec<Tag>,
    /// Whether the whole image was searched.
    pub is_whole: bool,
}

/// Where a tag is, or is expected.
#[derive(Clone, Copy, Debug)]
struct Known {
    corners: [[f64; 2]; 4],
    /// From one frame to the next, px.
    shift: [f64; 2],
    /// Frames since it was seen.
    unseen: u64,
}

impl Known {
    fn centre(&self) -> [f64; 2] {
        [0, 1].map(|k| self.corners.iter().map(|corner| corner[k]).sum::<f64>() / 4.0)
    }

    /// The longest side of its box, px.
    fn side(&self) -> f64 {
        let [low, high] = self.bounds();
        (high[0] - low[0]).max(high[1] - low[1])
    }

    fn bounds(&self) -> [[f64; 2]; 2] {
        let of = |pick: fn(f64, f64) -> f64, k: usize| {
            let corners = self.corners.iter().map(|corner| corner[k]);
            corners.reduce(pick).unwrap_or_default()
        };
        [
            [0, 1].map(|k| of(f64::min, k)),
            [0, 1].map(|k| of(f64::max, k)),
        ]
    }

    fn moved(mut self, map: impl Fn([f64; 2]) -> [f64; 2]) -> Self {
        self.corners = self.corners.map(map);
        self
    }
}

/// Finds the tags of a pattern in images of one size.
#[derive(Debug)]
pub struct Tracker {
    pattern: Pattern,
    templates: Templates,
    size: [usize; 2],
    /// Finders by the side of their windows; each is made when it is first needed.
    windows: [Option<TagFinder>; WINDOWS.len()],
    whole: TagFinder,
    known: Vec<Option<Known>>,
    /// Number of the last frame.
    frame: u64,
}

impl Tracker {
    /// A tracker that has seen nothing.
    ///
    /// # Errors
    /// [`TagError`]: the size is no image's.
    pub fn new(pattern: Pattern, width: usize, height: usize) -> Result<Self, TagError> {
        let templates = Templates::new()?;
        Ok(Self {
            whole: TagFinder::new(&templates, width, height, 1)?,
            known: vec![None; pattern.numbers().len()],
            pattern,
            templates,
            size: [width, height],
            windows: [const { None }; WINDOWS.len()],
            frame: 0,
        })
    }

    /// Forgets where tags are: the source began anew.
    pub fn forget(&mut self) {
        self.known.fill(None);
        self.frame = 0;
    }

    /// What the frame of this number shows.
    ///
    /// # Errors
    /// [`TagError`]: the image has another size.
    pub fn see(&mut self, image: &Grey, number: u64) -> Result<Sighting, TagError> {
        let frames = number.saturating_sub(self.frame).clamp(1, PATIENCE);
        self.frame = number;
        for known in &mut self.known {
            // A tag that is not seen for long may have gone anywhere.
            *known = known.filter(|known| known.unseen <= PATIENCE);
            if let Some(known) = known {
                let step = known.shift.map(|shift| shift * frames as f64);
                *known = known.moved(|[u, v]| [u + step[0], v + step[1]]);
            }
        }
        let is_missing = self
            .known
            .iter()
            .any(|known| known.is_none_or(|k| k.unseen > 0));
        let is_lost = self.known.iter().all(Option::is_none);
        let is_whole = is_lost || is_missing && number.is_multiple_of(WHOLE_EVERY);
        let tags = match is_whole {
            true => self.whole.find(image)?,
            false => self.search(image)?,
        };
        self.follow(&tags, frames);
        Ok(self.sighting(tags, is_whole))
    }

    /// Searches a window about each expected tag.
    fn search(&mut self, image: &Grey) -> Result<Vec<Tag>, TagError> {
        let mut tags: Vec<Tag> = Vec::new();
        for known in self.known.iter().flatten() {
            let side = known.side() * (1.0 + 2.0 * ROOM) + 2.0 * ROOM_PX;
            let index = WINDOWS.iter().position(|&window| window as f64 >= side);
            let index = index.filter(|&index| WINDOWS[index] <= self.size[0].min(self.size[1]));
            let Some(index) = index else {
                return self.whole.find(image);
            };
            let window = WINDOWS[index];
            let finder = match &mut self.windows[index] {
                Some(finder) => finder,
                none => none.insert(TagFinder::new(&self.templates, window, window, 1)?),
            };
            let centre = known.centre();
            let first = [0, 1].map(|k| {
                let first = (centre[k] - 0.5 * window as f64).max(0.0) as usize;
                first.min(self.size[k] - window)
            });
            let [columns, rows] = first.map(|first| first..first + window);
            let offset = first.map(|first| first as f64);
            let shifted = |p: [f64; 2]| [p[0] + offset[0], p[1] + offset[1]];
            for tag in finder.find(&image.part(columns, rows))? {
                let tag = Tag {
                    corners: tag.corners.map(shifted),
                    centre: shifted(tag.centre),
                    ..tag
                };
                // Windows may overlap.
                let is_same = |other: &Tag| {
                    other.number == tag.number && distance(other.centre, tag.centre) < 2.0
                };
                if !tags.iter().any(is_same) {
                    tags.push(tag);
                }
            }
        }
        Ok(tags)
    }

    /// Takes in what was found, and moves what was not as the others moved.
    fn follow(&mut self, tags: &[Tag], frames: u64) {
        let mut pairs = Vec::new();
        let found: Vec<Option<Tag>> = (self.pattern.numbers().iter())
            .zip(&self.known)
            .map(|(&number, known)| the_one(tags, number, known.as_ref()))
            .collect();
        for (known, tag) in self.known.iter().zip(&found) {
            if let (Some(known), Some(tag)) = (known, tag) {
                pairs.extend(known.corners.into_iter().zip(tag.corners));
            }
        }
        let map = similarity(&pairs);
        for (known, tag) in self.known.iter_mut().zip(found) {
            match (tag, &mut *known) {
                (Some(tag), _) => {
                    // Where it was is where it is expected now less the step.
                    let step = known.map_or([0.0; 2], |known| {
                        [0, 1].map(|k| {
                            known.shift[k] + (tag.centre[k] - known.centre()[k]) / frames as f64
                        })
                    });
                    *known = Some(Known {
                        corners: tag.corners,
                        shift: step,
                        unseen: 0,
                    });
                }
                (None, Some(hidden)) => {
                    *hidden = hidden.moved(&map);
                    hidden.unseen += frames;
                }
                (None, None) => (),
            }
        }
    }

    fn sighting(&self, tags: Vec<Tag>, is_whole: bool) -> Sighting {
        let middle = self.size.map(|size| 0.5 * (size as f64 - 1.0));
        let mut sighting = Sighting {
            tags,
            is_whole,
            ..Sighting::default()
        };
        let mut add = |point: [f64; 2], is_seen: bool| {
            sighting.visible |= u32::from(is_seen) << sighting.points.len();
            sighting.points.push(point);
        };
        for known in &self.known {
            let is_seen = known.is_some_and(|known| known.unseen == 0);
            match (&self.pattern, known) {
                (Pattern::Centres(_), Some(known)) => add(diagonals(known.corners), is_seen),
                (Pattern::Centres(_), None) => add(middle, false),
                (Pattern::Corners(_), Some(known)) => {
                    known
                        .corners
                        .into_iter()
                        .for_each(|corner| add(corner, is_seen));
                }
                (Pattern::Corners(_), None) => (0..4).for_each(|_| add(middle, false)),
            }
        }
        sighting
    }
}

/// The tag of a number that is meant: the only one, or the one near the place that is expected.
/// Two that nothing tells apart are none.
fn the_one(tags: &[Tag], number: u32, known: Option<&Known>) -> Option<Tag> {
    let mut named = tags.iter().filter(|tag| tag.number == number);
    if let Some(known) = known {
        let (at, gate) = (known.centre(), known.side().max(2.0 * ROOM_PX));
        let near = named.filter(|tag| distance(tag.centre, at) < gate);
        let by_distance =
            |a: &&Tag, b: &&Tag| distance(a.centre, at).total_cmp(&distance(b.centre, at));
        return near.min_by(by_distance).copied();
    }
    match (named.next(), named.next()) {
        (Some(tag), None) => Some(*tag),
        _ => None,
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Where the diagonals of a quadrangle meet: the image of a square's centre.
fn diagonals([a, b, c, d]: [[f64; 2]; 4]) -> [f64; 2] {
    let (ac, bd) = ([c[0] - a[0], c[1] - a[1]], [d[0] - b[0], d[1] - b[1]]);
    let cross = ac[0] * bd[1] - ac[1] * bd[0];
    let share = ((b[0] - a[0]) * bd[1] - (b[1] - a[1]) * bd[0]) / cross;
    [0, 1].map(|k| a[k] + share * ac[k])
}

/// The turn, scale and shift that best takes the first points of pairs to the second; the identity
/// without pairs.
fn similarity(pairs: &[([f64; 2], [f64; 2])]) -> impl Fn([f64; 2]) -> [f64; 2] {
    let count = pairs.len().max(1) as f64;
    let (mut from, mut to) = ([0.0; 2], [0.0; 2]);
    for (p, q) in pairs {
        from = [0, 1].map(|k| from[k] + p[k] / count);
        to = [0, 1].map(|k| to[k] + q[k] / count);
    }
    let (mut dot, mut cross, mut square) = (0.0, 0.0, 0.0);
    for (p, q) in pairs {
        let (x, y) = (p[0] - from[0], p[1] - from[1]);
        let (u, v) = (q[0] - to[0], q[1] - to[1]);
        dot += x * u + y * v;
        cross += x * v - y * u;
        square += x * x + y * y;
    }
    let (a, b) = match square > 0.0 {
        true => (dot / square, cross / square),
        false => (1.0, 0.0),
    };
    move |[u, v]| {
        let (x, y) = (u - from[0], v - from[1]);
        [to[0] + a * x - b * y, to[1] + b * x + a * y]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tag(number: u32, at: [f64; 2]) -> Tag {
        let corner = |x: f64, y: f64| [at[0] + 10.0 * x, at[1] + 10.0 * y];
        Tag {
            number,
            corners: [
                corner(-1.0, -1.0),
                corner(1.0, -1.0),
                corner(1.0, 1.0),
                corner(-1.0, 1.0),
            ],
            centre: at,
        }
    }

    fn tracker() -> Tracker {
        Tracker::new(Pattern::Centres(vec![4, 7]), 320, 240).unwrap()
    }

    #[test]
    fn a_hidden_tag_is_expected_where_the_other_takes_it() {
        let mut tracker = tracker();
        tracker.follow(&[tag(4, [100.0, 100.0]), tag(7, [200.0, 100.0])], 1);
        tracker.follow(&[tag(4, [105.0, 97.0])], 1);
        let seen = tracker.sighting(Vec::new(), false);
        assert_eq!(seen.visible, 0b01);
        assert!(distance(seen.points[0], [105.0, 97.0]) < 1e-9);
        assert!(distance(seen.points[1], [205.0, 97.0]) < 1e-9);
    }

    #[test]
    fn a_second_tag_of_a_number_is_told_apart_only_by_where_the_first_was() {
        let two = [tag(4, [100.0, 100.0]), tag(4, [200.0, 100.0])];
        assert_eq!(the_one(&two, 4, None), None);
        let mut tracker = tracker();
        tracker.follow(&[tag(4, [103.0, 100.0])], 1);
        let known = tracker.known[0];
        assert_eq!(the_one(&two, 4, known.as_ref()), Some(two[0]));
        assert_eq!(the_one(&two[1..], 4, known.as_ref()), None);
    }

    #[test]
    fn what_was_never_seen_is_in_the_middle_and_not_visible() {
        let seen = tracker().sighting(Vec::new(), true);
        assert_eq!((seen.points, seen.visible), (vec![[159.5, 119.5]; 2], 0));
    }

    #[test]
    fn the_corners_of_one_tag_are_four_points() {
        let mut tracker = Tracker::new(Pattern::Corners(7), 320, 240).unwrap();
        tracker.follow(&[tag(7, [50.0, 60.0])], 1);
        let seen = tracker.sighting(Vec::new(), false);
        assert_eq!(seen.visible, 0b1111);
        assert_eq!(seen.points[2], [60.0, 70.0]);
    }

    #[test]
    fn diagonals_meet_in_the_image_of_the_centre_not_in_the_mean_of_the_corners() {
        // A square seen at a slant: the far side is half as long.
        let at = diagonals([[-1.0, 0.0], [1.0, 0.0], [2.0, 3.0], [-2.0, 3.0]]);
        assert!(distance(at, [0.0, 1.0]) < 1e-12);
    }
}
