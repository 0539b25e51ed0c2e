//! Which sighting is which tag, over the frames, and where hidden tags are.
//!
//! All tags lie on one plane and do not move on it. So a homography from the plane to the image,
//! fitted to the tags that are seen, says where the hidden ones are, and which of two tags of the
//! same number is ours. The plane is that of the scene's pattern where it tells the size of its
//! markers, else the image in which tags were seen first.

use crate::plane::{Homography, Point};

/// Corners of the black square: upper left, upper right, lower right, lower left.
pub type Corners = [Point; 4];

/// A tag in the image of the scene's pinhole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Its number in the family.
    pub number: u32,
    /// Its corners, px.
    pub corners: Corners,
    /// Where its diagonals meet, px.
    pub centre: Point,
}

/// Frames after which a tag that was not seen may be anywhere.
const FRESH: u32 = 5;
/// How far a tag may be from where it is expected, as a share of its side, and at least, px.
const GATE: f64 = 0.35;
const GATE_PX: f64 = 6.0;

/// A tag that is followed.
#[derive(Clone, Debug)]
struct Track {
    number: u32,
    /// Its corners on the plane.
    plane: Option<Corners>,
    /// Where it is, or is guessed to be, px.
    now: Option<(Corners, Point)>,
    /// Its motion, px a frame.
    velocity: Point,
    /// Frames since it was seen.
    missed: u32,
    /// Whether the tags that are seen tell where it is.
    is_guessed: bool,
}

/// Follows the tags of a pattern.
#[derive(Clone, Debug)]
pub struct Tracker {
    tracks: Vec<Track>,
    misplaced: Option<(u32, f64)>,
}

impl Tracker {
    /// Follows tags of these numbers, with their corners on the pattern's plane (m) where they are
    /// known.
    pub fn new(tags: impl IntoIterator<Item = (u32, Option<Corners>)>) -> Self {
        let track = |(number, plane)| Track {
            number,
            plane,
            now: None,
            velocity: [0.0; 2],
            missed: u32::MAX,
            is_guessed: false,
        };
        Self {
            tracks: tags.into_iter().map(track).collect(),
            misplaced: None,
        }
    }

    /// The numbers of the tags.
    pub fn numbers(&self) -> impl Iterator<Item = u32> {
        self.tracks.iter().map(|track| track.number)
    }

    /// Whether a tag, by its index, was seen in the last frame.
    pub fn is_seen(&self, index: usize) -> bool {
        self.tracks[index].missed == 0
    }

    /// Whether a tag was not seen in the last frame, but others told where it is.
    pub fn is_guessed(&self, index: usize) -> bool {
        self.tracks[index].is_guessed
    }

    /// Corners and centre of a tag in the last frame, px: measured or guessed; `None` before it was
    /// seen or could be guessed.
    pub fn place(&self, index: usize) -> Option<(Corners, Point)> {
        self.tracks[index].now
    }

    /// Where the corners of a tag will be so many frames later, px.
    pub fn expected(&self, index: usize, frames: u32) -> Option<Corners> {
        let track = &self.tracks[index];
        let (corners, _) = track.now?;
        let [u, v] = track.velocity.map(|x| x * f64::from(frames.min(FRESH)));
        Some(corners.map(|p| [p[0] + u, p[1] + v]))
    }

    /// A tag of the last frame that does not lie where the pattern says, and by how much, px.
    pub fn misplaced(&self) -> Option<(u32, f64)> {
        self.misplaced
    }

    /// Takes the tags that are seen in a frame, `frames` after the last one, at least 1.
    pub fn update(&mut self, sightings: &[Sighting], frames: u32) {
        let mut chosen: Vec<Option<Sighting>> = (0..self.tracks.len())
            .map(|index| self.clear(index, sightings, frames))
            .collect();
        let (h, misplaced) = self.agree(&mut chosen, frames);
        self.misplaced = misplaced;
        for (index, chosen) in chosen.iter_mut().enumerate() {
            if let (None, Some(h)) = (&chosen, &h) {
                *chosen = self.near_plane(index, sightings, h);
            }
        }
        self.learn(&chosen, h.as_ref());
        for (track, chosen) in self.tracks.iter_mut().zip(chosen) {
            track.follow(chosen, h.as_ref(), frames);
        }
    }

    /// The sighting of a tag, where there is one candidate: near where the tag was, or at all.
    fn clear(&self, index: usize, sightings: &[Sighting], frames: u32) -> Option<Sighting> {
        let number = self.tracks[index].number;
        let all = sightings.iter().filter(|s| s.number == number);
        let near = all.clone().filter(|s| self.is_near(index, s, frames));
        only(near).or_else(|| only(all))
    }

    /// Whether a sighting is where a tag that was seen lately is expected.
    fn is_near(&self, index: usize, sighting: &Sighting, frames: u32) -> bool {
        let is_fresh = self.tracks[index].missed.saturating_add(frames) <= FRESH;
        let expected = self.expected(index, frames).filter(|_| is_fresh);
        expected.is_some_and(|expected| apart(&expected, &sighting.corners) < gate(&expected))
    }

    /// Takes out what does not lie on one plane with the others; the homography from the plane to
    /// the image, and the tag that lay farthest from it.
    fn agree(
        &self,
        chosen: &mut [Option<Sighting>],
        frames: u32,
    ) -> (Option<Homography>, Option<(u32, f64)>) {
        let mut misplaced = None;
        let is_fresh = |track: &Track| track.missed.saturating_add(frames) <= FRESH;
        loop {
            let pairs = |index: usize| {
                let (plane, sighting) = (self.tracks[index].plane?, chosen[index]?);
                Some(plane.into_iter().zip(sighting.corners))
            };
            let anchors: Vec<usize> = (0..chosen.len()).filter(|i| pairs(*i).is_some()).collect();
            let all: Vec<_> = anchors.iter().filter_map(|i| pairs(*i)).flatten().collect();
            let Some(h) = Homography::fit(&all) else {
                return (None, misplaced);
            };
            let is_near = |index: usize| {
                let near = chosen[index].map(|s| self.is_near(index, &s, frames));
                near.unwrap_or(false)
            };
            if let [only] = anchors[..] {
                // One alone may be somebody else's tag while ours is hidden.
                if is_near(only) || !self.tracks.iter().any(is_fresh) {
                    return (Some(h), misplaced);
                }
                chosen[only] = None;
                continue;
            }
            let off = |index: usize| {
                let corners = chosen[index].map(|s| s.corners)?;
                let expected = self.tracks[index].plane?.map(|p| h.apply(p));
                let [Some(a), Some(b), Some(c), Some(d)] = expected else {
                    return Some((f64::INFINITY, gate(&corners)));
                };
                Some((apart(&[a, b, c, d], &corners), gate(&corners)))
            };
            let far = anchors.iter().filter_map(|i| Some((*i, off(*i)?)));
            let far = far.filter(|(_, (off, gate))| off > gate);
            let Some((worst, (off, _))) = far.max_by(|a, b| a.1.0.total_cmp(&b.1.0)) else {
                return (Some(h), misplaced);
            };
            misplaced = Some((self.tracks[worst].number, off));
            if anchors.len() > 2 {
                chosen[worst] = None;
            } else {
                // Of two that disagree: the one that is where it was.
                let near = anchors.iter().filter(|index| is_near(**index)).count();
                let out: Vec<usize> = anchors
                    .into_iter()
                    .filter(|index| near != 1 || !is_near(*index))
                    .collect();
                out.into_iter().for_each(|index| chosen[index] = None);
            }
        }
    }

    /// The one sighting of a tag where the plane says that it is.
    fn near_plane(&self, index: usize, sightings: &[Sighting], h: &Homography) -> Option<Sighting> {
        let track = &self.tracks[index];
        let expected = mapped(h, &track.plane?)?;
        let is_near = |s: &&Sighting| {
            s.number == track.number && apart(&expected, &s.corners) < gate(&expected)
        };
        only(sightings.iter().filter(is_near))
    }

    /// Learns where tags lie on the plane that nobody told.
    fn learn(&mut self, chosen: &[Option<Sighting>], h: Option<&Homography>) {
        let back = h.and_then(Homography::inverse);
        let is_known = self.tracks.iter().any(|track| track.plane.is_some());
        for (track, chosen) in self.tracks.iter_mut().zip(chosen) {
            if let (None, Some(sighting)) = (track.plane, chosen) {
                track.plane = match &back {
                    Some(back) => mapped(back, &sighting.corners),
                    None if !is_known => Some(sighting.corners),
                    None => None,
                };
            }
        }
    }
}

impl Track {
    fn follow(&mut self, chosen: Option<Sighting>, h: Option<&Homography>, frames: u32) {
        let Some(sighting) = chosen else {
            self.missed = self.missed.saturating_add(frames);
            let guess = h.zip(self.plane).and_then(|(h, plane)| mapped(h, &plane));
            self.velocity = match guess.zip(self.now) {
                Some((guess, (_, before))) => moved(before, middle(&guess), frames),
                None => [0.0; 2],
            };
            self.is_guessed = guess.is_some();
            if let Some(guess) = guess {
                self.now = Some((guess, middle(&guess)));
            }
            return;
        };
        let before = self.now.filter(|_| self.missed <= FRESH);
        let before = before.map(|(_, centre)| moved(centre, sighting.centre, frames));
        self.velocity = before.unwrap_or_default();
        self.now = Some((sighting.corners, sighting.centre));
        (self.missed, self.is_guessed) = (0, false);
    }
}

/// Returns the sighting if there is just one.
fn only<'a>(mut of: impl Iterator<Item = &'a Sighting>) -> Option<Sighting> {
    let first = of.next().copied();
    first.filter(|_| of.next().is_none())
}

fn moved(from: Point, to: Point, frames: u32) -> Point {
    [0, 1].map(|k| (to[k] - from[k]) / f64::from(frames.max(1)))
}

fn mapped(h: &Homography, corners: &Corners) -> Option<Corners> {
    let [a, b, c, d] = corners.map(|p| h.apply(p));
    Some([a?, b?, c?, d?])
}

/// Where the diagonals meet.
fn middle(corners: &Corners) -> Point {
    let [a, b, c, d] = *corners;
    let (e, f) = ([c[0] - a[0], c[1] - a[1]], [d[0] - b[0], d[1] - b[1]]);
    let cross = e[0] * f[1] - e[1] * f[0];
    let share = ((b[0] - a[0]) * f[1] - (b[1] - a[1]) * f[0]) / cross;
    if share.is_finite() {
        [a[0] + share * e[0], a[1] + share * e[1]]
    } else {
        [0, 1].map(|k| corners.iter().map(|p| p[k]).sum::<f64>() / 4.0)
    }
}

/// The largest distance between corners.
fn apart(a: &Corners, b: &Corners) -> f64 {
    let far = a
        .iter()
        .zip(b)
        .map(|(p, q)| (p[0] - q[0]).hypot(p[1] - q[1]));
    far.fold(0.0, f64::max)
}

fn gate(corners: &Corners) -> f64 {
    let [a, _, c, _] = corners;
    let side = (a[0] - c[0]).hypot(a[1] - c[1]) * std::f64::consts::FRAC_1_SQRT_2;
    (GATE * side).max(GATE_PX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of 24 mm about a point.
    fn square([x, y]: Point) -> Corners {
        [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
            .map(|[a, b]| [x + 0.012 * a, y + 0.012 * b])
    }

    const POINTS: [Point; 4] = [
        [-0.06, -0.045],
        [0.06, -0.045],
        [0.06, 0.045],
        [-0.06, 0.045],
    ];

    /// The pattern seen from 0.4 m, shifted and tilted.
    fn seen(number: u32, shift: Point, tilt: f64) -> Sighting {
        let project = |[x, y]: Point| {
            let z = 0.4 + tilt * x;
            [
                320.0 + 615.0 * x / z + shift[0],
                240.0 + 615.0 * y / z + shift[1],
            ]
        };
        let point = POINTS[number as usize];
        Sighting {
            number,
            corners: square(point).map(project),
            centre: project(point),
        }
    }

    fn tracker(knows_size: bool) -> Tracker {
        Tracker::new((0..4).map(|i| (i, knows_size.then(|| square(POINTS[i as usize])))))
    }

    fn seen_bits(tracker: &Tracker) -> u32 {
        (0..4).map(|i| u32::from(tracker.is_seen(i)) << i).sum()
    }

    fn off(tracker: &Tracker, index: usize, expected: &Sighting) -> f64 {
        let (corners, centre) = tracker.place(index).unwrap();
        let gap = (centre[0] - expected.centre[0]).hypot(centre[1] - expected.centre[1]);
        gap.max(apart(&corners, &expected.corners))
    }

    #[test]
    fn hidden_tags_are_guessed_by_the_plane_of_the_others() {
        for knows_size in [true, false] {
            let mut tracker = tracker(knows_size);
            let all = [0, 1, 2, 3].map(|i| seen(i, [0.0; 2], 0.1));
            tracker.update(&all, 1);
            assert_eq!(seen_bits(&tracker), 0b1111);
            // The camera moves on; one tag is seen.
            let later = [0, 1, 2, 3].map(|i| seen(i, [11.0, -5.0], 0.4));
            tracker.update(&later[2..3], 1);
            assert_eq!(seen_bits(&tracker), 0b0100);
            for (i, expected) in later.iter().enumerate() {
                assert!(off(&tracker, i, expected) < 1e-6, "{knows_size} {i}");
            }
            // None is seen: they stay.
            tracker.update(&[], 1);
            assert_eq!(seen_bits(&tracker), 0);
            assert!(off(&tracker, 0, &later[0]) < 1e-6);
        }
    }

    #[test]
    fn an_unseen_tag_is_guessed_where_the_scene_tells_the_size() {
        let mut tracker = tracker(true);
        tracker.update(&[seen(1, [0.0; 2], 0.2)], 1);
        assert!(off(&tracker, 3, &seen(3, [0.0; 2], 0.2)) < 1e-6);
        let mut other = super::tests::tracker(false);
        other.update(&[seen(1, [0.0; 2], 0.2)], 1);
        assert_eq!(other.place(3), None);
    }

    #[test]
    fn a_moving_tag_is_expected_further_on() {
        let mut tracker = tracker(true);
        for n in 0..3 {
            tracker.update(&[seen(0, [4.0 * f64::from(n), 0.0], 0.0)], 1);
        }
        let expected = tracker.expected(0, 2).unwrap();
        assert!(apart(&expected, &seen(0, [16.0, 0.0], 0.0).corners) < 1e-6);
    }

    #[test]
    fn of_two_tags_with_one_number_ours_is_taken() {
        let clutter = Sighting {
            number: 1,
            ..seen(3, [90.0, 60.0], 0.0)
        };
        let all = [0, 1, 2, 3].map(|i| seen(i, [0.0; 2], 0.0));
        // From the start, by the plane.
        let mut both = vec![clutter];
        both.extend(all);
        for order in [both.clone(), both.iter().rev().copied().collect()] {
            let mut tracker = tracker(true);
            tracker.update(&order, 1);
            assert_eq!(seen_bits(&tracker), 0b1111);
            assert!(off(&tracker, 1, &all[1]) < 1e-6);
        }
        // Later, by where it was.
        let mut later = tracker(false);
        later.update(&all, 1);
        later.update(&both, 1);
        assert!(off(&later, 1, &all[1]) < 1e-6 && later.is_seen(1));
        // Where nothing tells which is ours neither is.
        let mut alone = tracker(true);
        alone.update(&[clutter, all[1]], 1);
        assert_eq!(seen_bits(&alone), 0);
    }

    #[test]
    fn somebody_elses_tag_does_not_stand_in_for_a_hidden_one() {
        let clutter = Sighting {
            number: 1,
            ..seen(3, [90.0, 60.0], 0.0)
        };
        let all = [0, 1, 2, 3].map(|i| seen(i, [0.0; 2], 0.0));
        let mut tracker = tracker(true);
        tracker.update(&[all[0], all[2], all[3], clutter], 1);
        assert_eq!(seen_bits(&tracker), 0b1101);
        assert!(off(&tracker, 1, &all[1]) < 1e-6);
        assert_eq!(tracker.misplaced().unwrap().0, 1);
        // All of ours are hidden.
        tracker.update(&[clutter], 1);
        assert_eq!(seen_bits(&tracker), 0);
    }

    #[test]
    fn a_pattern_that_jumps_is_taken_up_at_once() {
        let mut tracker = tracker(true);
        tracker.update(&[0, 1, 2, 3].map(|i| seen(i, [0.0; 2], 0.0)), 1);
        let far = [0, 1, 2, 3].map(|i| seen(i, [-90.0, 70.0], 0.2));
        tracker.update(&far, 1);
        assert_eq!(seen_bits(&tracker), 0b1111);
        assert!(off(&tracker, 2, &far[2]) < 1e-6);
    }

    #[test]
    fn a_pattern_that_is_not_the_scenes_is_told_by_its_tag() {
        let mut tracker = tracker(true);
        let mut all = [0, 1, 2, 3].map(|i| seen(i, [0.0; 2], 0.0));
        // Tags 1 and 2 were mixed up.
        (all[1].number, all[2].number) = (2, 1);
        tracker.update(&all, 1);
        let (_, off) = tracker.misplaced().unwrap();
        assert!(off > 10.0, "{off}");
    }
}
