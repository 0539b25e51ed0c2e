//! What is wrong between robot and camera, found from a few small moves: how the image moved,
//! against how it should have by the robot's own poses, the hand-eye calibration and the scene.
//!
//! A Levenberg-Marquardt fit of the mistakes that users make: the camera turned or shifted on the
//! flange, another focal length, a pattern of another size; from every way to name a camera's axes,
//! and with images that are mirrored. The pose of the pattern, which lies still, is fitted with
//! them.

use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

use arm::{Mount, Pose};
use nalgebra::{Point3, Rotation3, SMatrix, SVector, Translation3, Vector2, Vector3};
use scene::{Camera, Scene};

use hand_eye::{Frame, HandEye};

/// A small move of the robot, between two rests.
#[derive(Clone, Debug)]
pub struct Move {
    /// The flange in the base, before and after.
    pub flange: [Pose; 2],
    /// The features, before and after, px.
    pub image: [Vec<[f64; 2]>; 2],
}

impl Move {
    /// The largest motion of a coordinate in the image, px.
    pub fn length_px(&self) -> f64 {
        let [before, after] = &self.image;
        let pairs = before.iter().flatten().zip(after.iter().flatten());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }
}

/// What is to be done.
#[derive(Clone, Debug, PartialEq)]
pub struct Advice {
    /// What explains the moves best.
    pub findings: Findings,
    /// The likely mistakes, each with what to change; none where all is well.
    pub mistakes: Vec<String>,
}

/// Names the likely mistakes. A file that is right, but about the other frame or the other way
/// round, is told from a wrong one; an arm file is about one frame only. `None` where no pose of
/// the pattern fits an image.
pub fn advise(
    scene: &Scene,
    hand_eye: &HandEye,
    flange_from_ee: &Pose,
    moves: &[Move],
) -> Option<Advice> {
    let findings = explain(scene, &hand_eye.mount(flange_from_ee), moves)?;
    let mistakes = findings.mistakes();
    if mistakes.is_empty() || scene.arm.is_some() {
        return Some(Advice { findings, mistakes });
    }
    let HandEye { frame, camera } = *hand_eye;
    let (other, name) = match frame {
        Frame::Flange => (Frame::Ee, "ee"),
        Frame::Ee => (Frame::Flange, "flange"),
    };
    let inverse = camera.inverse();
    for (frame, camera, words) in [
        (
            other,
            camera,
            format!(
                "axes: the hand-eye file is about the other frame: hand_eye_frame = \"{name}\""
            ),
        ),
        (
            frame,
            inverse,
            "axes: the hand-eye file holds the inverse, the robot in the camera".to_owned(),
        ),
        (
            other,
            inverse,
            format!(
                "axes: the hand-eye file holds the inverse, about the other frame: hand_eye_frame = \"{name}\""
            ),
        ),
    ] {
        let is_right = |hand_eye: HandEye| {
            let found = explain(scene, &hand_eye.mount(flange_from_ee), moves);
            found.is_some_and(|found| found.mistakes().is_empty())
        };
        if is_right(HandEye { frame, camera }) {
            let mistakes = vec![words];
            return Some(Advice { findings, mistakes });
        }
    }
    Some(Advice { findings, mistakes })
}

/// How the image differs from a right one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flip {
    /// It does not.
    None,
    /// Mirrored, left and right.
    U,
    /// Mirrored, top and bottom.
    V,
    /// u and v are swapped.
    Swapped,
}

/// What explains the moves best.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Findings {
    /// Root mean square of what the settings as they are leave unexplained, px.
    pub before_px: f64,
    /// The same with what follows, px.
    pub after_px: f64,
    /// The image.
    pub flip: Flip,
    /// By how much the true camera is turned from where the calibration has it: rotation vector in
    /// the camera frame, rad.
    pub turn: Vector3<f64>,
    /// By how much it is shifted, m, in the camera frame.
    pub shift: Vector3<f64>,
    /// True focal lengths, as a multiple of the scene's.
    pub focal: f64,
    /// True size of the pattern, as a multiple of the scene's.
    pub size: f64,
}

/// Turn, shift, and the logarithms of focal length and size; turn and shift of the pattern.
type Parameters = SVector<f64, COUNT>;
const COUNT: usize = MISTAKES + 6;
const MISTAKES: usize = 8;

/// Most iterations of a fit.
const ITERATIONS: usize = 40;
/// Least depth of a point, m.
const NEAREST: f64 = 1e-3;
/// Step of the difference quotients; all parameters are of size 1 or less.
const STEP: f64 = 1e-6;
/// Beginnings that are refined, of all ways to name axes.
const REFINED: usize = 4;
/// Part of the error that another image must leave to be believed.
const BELIEVED: f64 = 0.4;
/// Factor by which errors of equal explanations differ, by noise.
const ALIKE: f64 = 1.2;
/// Difference of errors that is none, px.
const ROUNDING_PX: f64 = 0.03;

/// Finds what explains the moves best; `None` where no pose of the pattern fits an image.
pub fn explain(scene: &Scene, mount: &Mount, moves: &[Move]) -> Option<Findings> {
    let judge = |flip| Judge {
        scene,
        mount,
        moves,
        flip,
    };
    let plain = judge(Flip::None);
    let before_px = plain.refine(plain.nothing()?, 0..0)?.rms;
    let mut best = (Flip::None, plain.fit()?);
    let flips = [Flip::U, Flip::V, Flip::Swapped].into_iter();
    let mut others: Vec<_> = flips
        .filter_map(|flip| Some((flip, judge(flip).fit()?)))
        .collect();
    others.retain(|(_, fit)| fit.rms < BELIEVED * best.1.rms);
    // Mirrored one way and turned by half a turn is mirrored the other way: the lesser turn is
    // meant.
    let least = others
        .iter()
        .map(|(_, fit)| fit.rms)
        .fold(f64::INFINITY, f64::min);
    others.retain(|(_, fit)| fit.rms < ALIKE * least);
    let turn = |fit: &Fit| fit.found.turn.angle();
    if let Some(other) = others
        .into_iter()
        .min_by(|(_, a), (_, b)| turn(a).total_cmp(&turn(b)))
    {
        best = other;
    }
    let (
        flip,
        Fit {
            found,
            rms: after_px,
        },
    ) = best;
    Some(Findings {
        before_px,
        after_px,
        flip,
        turn: found.turn.scaled_axis(),
        shift: found.shift,
        focal: found.focal,
        size: found.size,
    })
}

impl Findings {
    /// The likely mistakes, each with what to change; none where all is well.
    pub fn mistakes(&self) -> Vec<String> {
        let mut mistakes = Vec::new();
        // The settings as they are explain the image: what would explain its noise as well is none.
        if self.before_px < EXPLAINED_PX.max(NOISE * self.after_px).min(UNEXPLAINED_PX) {
            return mistakes;
        }
        if self.after_px > UNEXPLAINED_PX {
            mistakes.push(format!(
                "unknown: {:.1} px remain unexplained; do the features belong to this camera, and to an object that lies still?",
                self.after_px
            ));
            return mistakes;
        }
        match self.flip {
            Flip::None => (),
            Flip::U => mistakes.push(
                "sign: the image is mirrored left and right; u must grow to the right".to_owned(),
            ),
            Flip::V => mistakes.push(
                "sign: the image is mirrored top and bottom; v must grow downwards".to_owned(),
            ),
            Flip::Swapped => mistakes.push("axes: u and v are swapped in the features".to_owned()),
        }
        let angle = self.turn.norm();
        let degrees = angle.to_degrees();
        let axis = match angle > 0.0 {
            true => self.turn / angle,
            false => Vector3::z(),
        };
        let words = format!(
            "{degrees:.1} deg about ({:.2} {:.2} {:.2}) of the camera",
            axis.x, axis.y, axis.z
        );
        if angle > FAR_TURN {
            // The rest is told no better than that.
            mistakes.push(format!(
                "axes: the camera is turned by {words} from where the hand-eye file has it. Its frame is x right, y down, z forward"
            ));
            return mistakes;
        } else if angle > TURN {
            mistakes.push(format!(
                "hand-eye: the camera is turned by {words} from where the file has it: calibrate again"
            ));
        }
        if self.shift.norm() > SHIFT {
            let [x, y, z]: [f64; 3] = (self.shift * 100.0).into();
            mistakes.push(format!(
                "hand-eye: the camera is ({x:.1} {y:.1} {z:.1}) cm from where the file has it, along its axes: calibrate again"
            ));
        }
        if self.focal.ln().abs() > FOCAL {
            mistakes.push(format!(
                "focal length: the true one is {:.2} times the scene's (camera.fx, camera.fy); is the image scaled?",
                self.focal
            ));
        }
        if self.size.ln().abs() > SIZE {
            mistakes.push(format!(
                "pattern: it is {:.2} times as large as the scene says (pattern.points); are the units metres?",
                self.size
            ));
        }
        mistakes
    }
}

/// From which on something is a mistake: rad, m, logarithms, px. The law stands errors of this
/// size; the moves show them with their noise.
const TURN: f64 = 0.06;
const FAR_TURN: f64 = 0.6;
const SHIFT: f64 = 0.03;
const FOCAL: f64 = 0.05;
const SIZE: f64 = 0.10;
const UNEXPLAINED_PX: f64 = 2.0;
const EXPLAINED_PX: f64 = 0.25;
/// Factor by which noise makes an error larger than the best explanation of it.
const NOISE: f64 = 1.5;

/// The mistakes at which the moves are judged, and the pattern in the camera before the first move.
#[derive(Clone, Copy, Debug)]
struct Turned {
    turn: Rotation3<f64>,
    shift: Vector3<f64>,
    focal: f64,
    size: f64,
    pattern: Pose,
}

impl Turned {
    fn after(&self, by: &Parameters) -> Self {
        let part = |first: usize| Vector3::from(by.fixed_rows::<3>(first));
        let at = self.pattern.translation.vector + part(MISTAKES + 3);
        let turn = Rotation3::new(part(MISTAKES)) * self.pattern.rotation;
        Self {
            turn: self.turn * Rotation3::new(part(0)),
            shift: self.shift + part(3),
            focal: self.focal * by[6].exp(),
            size: self.size * by[7].exp(),
            pattern: Pose::from_parts(Translation3::from(at), turn),
        }
    }
}

struct Fit {
    found: Turned,
    rms: f64,
}

struct Judge<'a> {
    scene: &'a Scene,
    mount: &'a Mount,
    moves: &'a [Move],
    flip: Flip,
}

impl Judge<'_> {
    /// No mistake, and a pattern that faces the camera, its size and turn as in the first image;
    /// `None` where its points coincide.
    fn nothing(&self) -> Option<Turned> {
        let Camera { fx, fy, cx, cy, .. } = self.scene.camera;
        let image = self.moves.first()?.image[0].iter();
        let image: Vec<_> = image
            .map(|p| self.seen(*p))
            .map(|[u, v]| Vector2::new((u - cx) / fx, (v - cy) / fy))
            .collect();
        let pattern = self.scene.pattern.iter();
        let pattern: Vec<_> = pattern.map(|[x, y, _]| Vector2::new(*x, *y)).collect();
        let middle = |all: &[Vector2<f64>]| all.iter().sum::<Vector2<f64>>() / all.len() as f64;
        let (from, to) = (middle(&pattern), middle(&image));
        // Of the best turn the cosine and the sine, and of both the squared sizes.
        let (mut turn, mut sizes) = (Vector2::zeros(), Vector2::zeros());
        for (p, m) in pattern.iter().zip(&image) {
            let (p, m) = (p - from, m - to);
            turn += Vector2::new(p.dot(&m), p.perp(&m));
            sizes += Vector2::new(p.norm_squared(), m.norm_squared());
        }
        let turn = Rotation3::new(Vector3::z() * turn.y.atan2(turn.x));
        let depth = (sizes.x / sizes.y).sqrt();
        let at = to.push(1.0) * depth - turn * from.push(0.0);
        (depth > 0.0 && depth.is_finite()).then(|| Turned {
            turn: Rotation3::identity(),
            shift: Vector3::zeros(),
            focal: 1.0,
            size: 1.0,
            pattern: Pose::from_parts(Translation3::from(at), turn),
        })
    }

    /// Predicted less seen, px; `None` where the pattern is behind the camera.
    fn residuals(&self, at: &Turned) -> Option<Vec<f64>> {
        let Camera { fx, fy, cx, cy, .. } = self.scene.camera;
        let error = Pose::from_parts(Translation3::from(at.shift), at.turn);
        let mount = self.mount.flange_from_camera * error;
        let base_from_pattern = self.moves.first()?.flange[0] * mount * at.pattern;
        let mut residuals = Vec::new();
        for Move { flange, image } in self.moves {
            for (flange, image) in flange.iter().zip(image) {
                let camera_from_pattern = (flange * mount).inverse() * base_from_pattern;
                for (point, seen) in self.scene.pattern.iter().zip(image) {
                    let point = camera_from_pattern * (Point3::from(*point) * at.size);
                    let [u, v] = self.seen(*seen);
                    if point.z < NEAREST {
                        return None;
                    }
                    residuals.push(at.focal * fx * point.x / point.z + cx - u);
                    residuals.push(at.focal * fy * point.y / point.z + cy - v);
                }
            }
        }
        Some(residuals)
    }

    /// A point as the camera would have seen it without the flip.
    fn seen(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let Camera { width, height, .. } = self.scene.camera;
        match self.flip {
            Flip::None => [u, v],
            Flip::U => [width - 1.0 - u, v],
            Flip::V => [u, height - 1.0 - v],
            Flip::Swapped => [v, u],
        }
    }

    /// Root mean square of the error by which a move is explained, px: the images before the moves
    /// tell where the pattern is.
    fn rms(&self, at: &Turned) -> Option<f64> {
        let residuals = self.residuals(at)?;
        let squares: f64 = residuals.iter().map(|x| x * x).sum();
        Some((2.0 * squares / residuals.len().max(1) as f64).sqrt())
    }

    /// The best fit from all ways to name axes.
    fn fit(&self) -> Option<Fit> {
        let nothing = self.nothing()?;
        let turned = axes().into_iter().map(|turn| Turned { turn, ..nothing });
        let mut beginnings: Vec<Fit> = turned
            .filter_map(|turned| self.refine(turned, 0..0))
            .collect();
        beginnings.sort_by(|a, b| a.rms.total_cmp(&b.rms));
        let least = |fits: Vec<Fit>| fits.into_iter().min_by(|a, b| a.rms.total_cmp(&b.rms));
        let refined = beginnings.into_iter().take(REFINED);
        let all = least(
            refined
                .filter_map(|fit| self.refine(fit.found, 0..MISTAKES))
                .collect(),
        )?;
        // A few small moves hardly tell focal length from distance: one cause, where it is enough.
        let causes = [0..3, 3..6, 6..7, 7..8].into_iter();
        let one = least(
            causes
                .filter_map(|cause| self.refine(nothing, cause))
                .collect(),
        );
        let is_enough = |one: &Fit| one.rms < (ALIKE * all.rms).max(all.rms + ROUNDING_PX);
        Some(one.filter(is_enough).unwrap_or(all))
    }

    /// The best fit near `at` by some of the mistakes.
    fn refine(&self, mut at: Turned, by: Range<usize>) -> Option<Fit> {
        let mut rms = self.rms(&at)?;
        let mut damping = 1e-3;
        for _ in 0..ITERATIONS {
            let here = self.residuals(&at)?;
            let mut columns = Vec::new();
            for k in 0..COUNT {
                let mut step = Parameters::zeros();
                step[k] = STEP;
                let there = self.residuals(&at.after(&step))?;
                let slope = there.iter().zip(&here).map(|(a, b)| (a - b) / STEP);
                columns.push(slope.collect::<Vec<_>>());
            }
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let mut square =
                SMatrix::<f64, COUNT, COUNT>::from_fn(|i, j| dot(&columns[i], &columns[j]));
            let mut right = Parameters::from_fn(|i, _| -dot(&columns[i], &here));
            for k in 0..COUNT {
                square[(k, k)] *= 1.0 + damping;
                square[(k, k)] += 1e-9;
            }
            for k in (0..MISTAKES).filter(|k| !by.contains(k)) {
                square.row_mut(k).fill(0.0);
                square.column_mut(k).fill(0.0);
                square[(k, k)] = 1.0;
                right[k] = 0.0;
            }
            let step = square.cholesky()?.solve(&right);
            let next = at.after(&step);
            match self.rms(&next) {
                Some(better) if better < rms => {
                    let is_done = rms - better < 1e-9;
                    (at, rms) = (next, better);
                    damping = (damping * 0.2).max(1e-9);
                    if is_done {
                        break;
                    }
                }
                _ if damping > 1e6 => break,
                _ => damping *= 10.0,
            }
        }
        Some(Fit { found: at, rms })
    }
}

/// The 24 ways to turn a frame onto its own axes.
fn axes() -> Vec<Rotation3<f64>> {
    let quarters =
        |axis: Vector3<f64>, count: u8| Rotation3::new(axis * (f64::from(count) * FRAC_PI_2));
    let faces = [
        Rotation3::identity(),
        quarters(Vector3::x(), 1),
        quarters(Vector3::x(), 2),
        quarters(Vector3::x(), 3),
        quarters(Vector3::y(), 1),
        quarters(Vector3::y(), 3),
    ];
    let mut axes = Vec::new();
    for face in faces {
        axes.extend((0..4).map(|count| face * quarters(Vector3::z(), count)));
    }
    axes
}

#[cfg(test)]
mod tests;
