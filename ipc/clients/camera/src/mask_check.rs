//! Does the mask agree with what the camera sees? Tags that vanish where nothing hides them, and
//! tags that are seen where the mask says that they cannot be.

mod shape;

use std::collections::BTreeMap;
use std::fmt;

use scene::Scene;
use shape::Shape;

/// Points along a side of a tag that are measured.
const ALONG: usize = 8;

/// A tag in the image: where it is seen, or where it should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Its number.
    pub number: u32,
    /// Its centre (u, v), px.
    pub center: [f64; 2],
    /// Its corners in their order round it, px, with the white border where that must be seen too.
    pub corners: [[f64; 2]; 4],
}

impl Place {
    /// Whether every coordinate is a number.
    fn is_finite(&self) -> bool {
        self.points().flatten().all(f64::is_finite)
    }

    /// Centre, corners and points of the sides.
    fn points(&self) -> impl Iterator<Item = [f64; 2]> {
        let corners = self.corners;
        let corner = move |k: usize| corners[k % 4];
        let along = move |k: usize| {
            let share = (k % ALONG) as f64 / ALONG as f64;
            let (from, to) = (corner(k / ALONG), corner(k / ALONG + 1));
            [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]))
        };
        (0..4 * ALONG).map(along).chain([self.center])
    }
}

/// When the mask is doubted.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Distance from an occlusion, outwards or inwards, and from the image's border, that is not
    /// doubted, px.
    pub clear_px: f64,
    /// Frames in a row.
    pub frames: u32,
    /// Tags that must be seen for another one to have vanished: else the light may be out.
    pub others: usize,
    /// Least time between two warnings, ns.
    pub quiet_ns: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            clear_px: 8.0,
            frames: 5,
            others: 2,
            quiet_ns: 10_000_000_000,
        }
    }
}

/// How often the mask was contradicted: tags, each counted once until it behaves again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Not seen though nothing hides them.
    pub vanished: u64,
    /// Seen though the mask covers their centres.
    pub seen_through: u64,
}

/// What is wrong with an occlusion.
#[derive(Clone, Debug, PartialEq)]
pub struct Warning {
    /// The occlusion; `None` in a scene without any.
    pub occlusion: Option<String>,
    /// Farthest from it that a tag vanished, px.
    pub vanished_px: Option<f64>,
    /// Deepest in it that a tag was seen, px.
    pub seen_px: Option<f64>,
    /// The last tag that said so, and where, px.
    pub tag: (u32, [f64; 2]),
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (number, [u, v]) = self.tag;
        let name = match &self.occlusion {
            Some(name) => format!("occlusion \"{name}\""),
            None => "the scene, which has no occlusion,".to_owned(),
        };
        let (verdict, px) = match (self.vanished_px, self.seen_px) {
            (Some(small), Some(large)) => ("is shifted", small.max(large)),
            (Some(small), None) => ("is too small or shifted", small),
            (None, large) => ("is too large or shifted", large.unwrap_or(0.0)),
        };
        let doing = match self.vanished_px {
            Some(_) => "vanished though nothing hides it",
            None => "is seen though it is covered",
        };
        if px.is_finite() {
            write!(f, "{name} {verdict}, by about {px:.0} px or more: ")?;
        } else {
            write!(f, "{name} hides nothing: ")?;
        }
        write!(
            f,
            "tag {number} at ({u:.0}, {v:.0}) {doing}; learn the mask again (vpc-camera mask)"
        )
    }
}

/// What was found against an occlusion since the last warning.
#[derive(Clone, Copy, Debug, Default)]
struct Evidence {
    vanished_px: Option<f64>,
    seen_px: Option<f64>,
    tag: (u32, [f64; 2]),
}

impl Evidence {
    fn worst(&self) -> f64 {
        let [small, large] = [self.vanished_px, self.seen_px].map(|px| px.unwrap_or(0.0));
        small.max(large)
    }
}

/// Watches the tags of a running camera.
pub struct MaskCheck {
    settings: Settings,
    size: [usize; 2],
    shapes: Vec<Shape>,
    /// By tag: whether it was seen, and in how many frames in a row it contradicted the mask.
    streaks: BTreeMap<u32, (bool, u32)>,
    /// By occlusion; the last is for a scene without any.
    evidence: Vec<Evidence>,
    counts: Counts,
    warned_ns: Option<u64>,
}

impl MaskCheck {
    /// A check of a scene's occlusions. Takes some bytes for each pixel and occlusion.
    pub fn new(scene: &Scene, settings: Settings) -> Self {
        let size = [scene.camera.width, scene.camera.height].map(|side| side as usize);
        let shapes = scene.occlusions.iter();
        let shapes: Vec<Shape> = shapes.map(|o| Shape::of(o, size[0], size[1])).collect();
        Self {
            settings,
            size,
            evidence: vec![Evidence::default(); shapes.len() + 1],
            shapes,
            streaks: BTreeMap::new(),
            counts: Counts::default(),
            warned_ns: None,
        }
    }

    /// How often the mask was contradicted so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Takes a frame: the tags that are seen, and where those should be that are not; a tag in
    /// neither list is not judged. Returns a warning where the mask is contradicted, at most one
    /// every `quiet_ns`.
    pub fn frame(&mut self, now_ns: u64, seen: &[Place], hidden: &[Place]) -> Option<Warning> {
        let is_known = |number: &u32| {
            let mut places = seen.iter().chain(hidden);
            places.any(|place| place.number == *number)
        };
        self.streaks.retain(|number, _| is_known(number));
        for place in seen {
            self.judge(place, true, self.depth(place));
        }
        let is_lit = seen.len() >= self.settings.others;
        for place in hidden {
            let clear = self.clearance(place).filter(|_| is_lit);
            self.judge(place, false, clear);
        }
        self.warning(now_ns)
    }

    /// Counts a frame in which a tag contradicts an occlusion, by so many px, or none.
    fn judge(&mut self, place: &Place, is_seen: bool, against: Option<(usize, f64)>) {
        let (was_seen, count) = self.streaks.get(&place.number).copied().unwrap_or_default();
        let before = if was_seen == is_seen { count } else { 0 };
        let count = against.map_or(0, |_| before.saturating_add(1));
        self.streaks.insert(place.number, (is_seen, count));
        let Some((shape, px)) = against.filter(|_| count >= self.settings.frames) else {
            return;
        };
        let evidence = &mut self.evidence[shape];
        let (times, most) = match is_seen {
            true => (&mut self.counts.seen_through, &mut evidence.seen_px),
            false => (&mut self.counts.vanished, &mut evidence.vanished_px),
        };
        *times += u64::from(count == self.settings.frames);
        *most = Some(most.map_or(px, |most| most.max(px)));
        evidence.tag = (place.number, place.center);
    }

    /// The occlusion that covers the centre of a tag by more than allowed, and how deep the
    /// deepest point of the tag is in it, px.
    fn depth(&self, place: &Place) -> Option<(usize, f64)> {
        let deep = |shape: &Shape| {
            let distance = |point| shape.distance(point, self.size);
            let is_deep = place.is_finite() && distance(place.center) < -self.settings.clear_px;
            is_deep.then(|| -place.points().map(distance).fold(f64::INFINITY, f64::min))
        };
        let depths = self.shapes.iter().enumerate();
        depths
            .filter_map(|(k, shape)| Some((k, deep(shape)?)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The nearest occlusion and how far it is from a tag, px, where that and the border of the
    /// image are further than allowed.
    fn clearance(&self, place: &Place) -> Option<(usize, f64)> {
        let [right, bottom] = self.size.map(|side| side as f64 - 1.0);
        let inside = |[u, v]: [f64; 2]| u.min(v).min(right - u).min(bottom - v);
        let in_image = place.points().map(inside).fold(f64::INFINITY, f64::min);
        if in_image <= self.settings.clear_px || !place.is_finite() {
            return None;
        }
        let distances = self.shapes.iter().enumerate().map(|(k, shape)| {
            let distances = place.points().map(|point| shape.distance(point, self.size));
            (k, distances.fold(f64::INFINITY, f64::min))
        });
        let none = (self.shapes.len(), f64::INFINITY);
        let nearest = distances.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or(none);
        (nearest.1 > self.settings.clear_px).then_some(nearest)
    }

    /// The worst occlusion, where it may be told.
    fn warning(&mut self, now_ns: u64) -> Option<Warning> {
        let quiet = |last: u64| now_ns.saturating_sub(last) < self.settings.quiet_ns;
        if self.warned_ns.is_some_and(quiet) {
            return None;
        }
        let worst = self.evidence.iter().enumerate();
        let (shape, evidence) = worst.max_by(|a, b| a.1.worst().total_cmp(&b.1.worst()))?;
        if evidence.vanished_px.is_none() && evidence.seen_px.is_none() {
            return None;
        }
        let warning = Warning {
            occlusion: self.shapes.get(shape).map(|shape| shape.name.clone()),
            vanished_px: evidence.vanished_px,
            seen_px: evidence.seen_px,
            tag: evidence.tag,
        };
        self.evidence.fill(Evidence::default());
        self.warned_ns = Some(now_ns);
        Some(warning)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The robot scene: a spot of radius 38 px at (320, 222), an object of 240 px by 140 px at
    /// (320, 455).
    fn check() -> MaskCheck {
        let scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        MaskCheck::new(&scene, Settings::default())
    }

    /// An upright tag of 40 px.
    fn tag(number: u32, u: f64, v: f64) -> Place {
        let corners = [[-20.0, -20.0], [20.0, -20.0], [20.0, 20.0], [-20.0, 20.0]];
        Place {
            number,
            center: [u, v],
            corners: corners.map(|[x, y]| [u + x, v + y]),
        }
    }

    fn others() -> [Place; 2] {
        [tag(7, 100.0, 100.0), tag(8, 540.0, 100.0)]
    }

    const FRAME_NS: u64 = 33_000_000;

    /// Warnings of so many frames.
    fn watch(check: &mut MaskCheck, frames: u64, seen: &[Place], hidden: &[Place]) -> Vec<Warning> {
        let warnings = (0..frames).map(|k| check.frame(k * FRAME_NS, seen, hidden));
        warnings.flatten().collect()
    }

    #[test]
    fn a_mask_that_is_right_is_not_doubted() {
        let mut check = check();
        // Hidden by the spot in part, by the object, by the border; seen beside the spot.
        let hidden = [
            tag(0, 270.0, 222.0),
            tag(1, 300.0, 440.0),
            tag(2, 630.0, 240.0),
        ];
        let seen = [tag(3, 320.0, 150.0), others()[0], others()[1]];
        assert_eq!(watch(&mut check, 100, &seen, &hidden), []);
        assert_eq!(check.counts(), Counts::default());
    }

    #[test]
    fn a_tag_that_vanishes_beside_a_spot_says_how_much_is_missing() {
        let mut check = check();
        // Its right side is 320 - 38 - 14 px from the left.
        let hidden = [tag(0, 320.0 - 38.0 - 14.0 - 20.0, 222.0)];
        assert_eq!(watch(&mut check, 4, &others(), &hidden), []);
        let warnings = watch(&mut check, 1, &others(), &hidden);
        let words = warnings[0].to_string();
        assert!(
            words.starts_with("occlusion \"spot on the lens\" is too small or shifted, by about 14 px or more: tag 0 at"),
            "{words}"
        );
        assert_eq!(check.counts().vanished, 1);
    }

    #[test]
    fn a_tag_that_is_seen_in_the_mask_says_how_much_is_too_much() {
        let mut check = check();
        // The upper border of the object is at 385: centre 10 px, lower side 30 px inside.
        let seen = [tag(0, 320.0, 395.0), others()[0]];
        let warnings = watch(&mut check, 5, &seen, &[]);
        let words = warnings[0].to_string();
        assert!(
            words.starts_with(
                "occlusion \"grasped object\" is too large or shifted, by about 30 px or more"
            ),
            "{words}"
        );
        assert_eq!(
            check.counts(),
            Counts {
                vanished: 0,
                seen_through: 1
            }
        );
    }

    #[test]
    fn on_both_sides_it_is_shifted() {
        let mut check = check();
        let seen = [tag(0, 300.0, 222.0), others()[0], others()[1]];
        let hidden = [tag(1, 320.0 + 38.0 + 20.0 + 12.0, 222.0)];
        let warnings = watch(&mut check, 5, &seen, &hidden);
        assert!(
            warnings[0]
                .to_string()
                .contains("\"spot on the lens\" is shifted, by about 3")
        );
    }

    #[test]
    fn warnings_are_ten_seconds_apart_and_a_tag_counts_once() {
        let mut check = check();
        let hidden = [tag(0, 200.0, 222.0)];
        let warnings = watch(&mut check, 900, &others(), &hidden);
        // 29.7 s, from the fifth frame on.
        assert_eq!((warnings.len(), check.counts().vanished), (3, 1));
    }

    #[test]
    fn a_streak_ends_when_the_tag_is_seen() {
        let mut check = check();
        let vanishing = tag(0, 200.0, 222.0);
        for _ in 0..10 {
            watch(&mut check, 4, &others(), &[vanishing]);
            watch(&mut check, 1, &[vanishing, others()[0]], &[]);
        }
        watch(&mut check, 50, &others()[..1], &[vanishing]);
        watch(&mut check, 50, &[], &[vanishing]);
        // Nor does a place that nobody knows.
        watch(&mut check, 50, &others(), &[tag(0, f64::NAN, 222.0)]);
        assert_eq!(check.counts(), Counts::default());
    }

    #[test]
    fn a_scene_without_occlusions_may_lack_one() {
        let mut scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        scene.occlusions.clear();
        let mut check = MaskCheck::new(&scene, Settings::default());
        let warnings = watch(&mut check, 5, &others(), &[tag(0, 200.0, 222.0)]);
        let words = warnings[0].to_string();
        assert!(words.starts_with(
            "the scene, which has no occlusion, hides nothing: tag 0 at (200, 222) vanished"
        ));
    }
}
