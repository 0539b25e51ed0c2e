//! Fits a tag's template to the image, and refuses a tag that is not seen whole.
//!
//! A quad that was found may have shrunk because something hides an edge, or covers a part of the
//! white border. So the borders between black and white modules, those of the bits among them, are
//! measured one by one, a homography is fitted to all of them, and every place must agree with it.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::grey::Grey;
use crate::template::{Blur, Edge, Template};

/// Passes of the fit.
const PASSES: usize = 3;
/// Blurs that are tried where edges are too wide to be measured one by one, modules.
const WIDE: [f64; 4] = [0.35, 0.45, 0.55, 0.65];
/// Below this measured blur, modules, none of them is tried.
const SHARP: f64 = 0.15;
/// Least softness of the edges, as a share of what the tried blur would leave.
const MEASURED: f64 = 0.95;
/// Distance between samples across an edge, px, at most.
const STEP: f64 = 0.5;
/// Farthest sample from an edge, px and modules.
const REACH_PX: f64 = 4.0;
const REACH: f64 = 0.5;
/// Least difference between white and black, levels.
const CONTRAST: f64 = 16.0;
/// Share of the contrast by which the border's modules may miss their level.
const LEVEL: f64 = 0.3;
/// How far an edge may be from the fit, px and modules, and at most.
const OFF_PX: f64 = 0.25;
const OFF: f64 = 0.06;
const OFF_MOST_PX: f64 = 0.5;
/// Places on the outline that may be farther, and which share of all.
const OUTLINE_MISFITS: usize = 1;
const MISFITS: f64 = 0.02;
/// How far a side of the black square may be from the fit on the mean, px.
const SIDE_OFF_PX: f64 = 0.15;
/// Farthest sample in the last pass, in standard deviations of the blur and at least, px: farther
/// off, light that a sensor smears along its columns weighs more than the edge.
const NEAR: f64 = 3.0;
const NEAR_PX: f64 = 1.5;
/// Share of the contrast by which levels about an edge may miss those of the tag and be taken for
/// the light there, not for something that covers it; and the least difference between them, as
/// neighbours leave it.
const LOCAL: f64 = 0.25;
const RESOLVED: f64 = 0.8;

/// Unknowns: the homography with a last entry of 1, and by how far white reaches over black along x
/// and y (px), as saturation, the sensor's curve, sharpening and motion make it.
type Normal = SMatrix<f64, 10, 10>;
type Unknowns = SVector<f64, 10>;

/// Where a point of the tag is in the image, px.
pub(crate) fn project(h: &Matrix3<f64>, [x, y]: [f64; 2]) -> [f64; 2] {
    let p = h * Vector3::new(x, y, 1.0);
    [p.x / p.z, p.y / p.z]
}

/// The homography from tag coordinates to px that fits the image best, near `start`; `None` if the
/// tag is not seen whole.
pub(crate) fn register(
    image: &Grey,
    template: &Template,
    start: &Matrix3<f64>,
) -> Option<Matrix3<f64>> {
    let (first, sigma) = fit(image, template, start, None);
    if first.is_some() || sigma.is_some_and(|sigma| sigma[0].max(sigma[1]) < SHARP) {
        return first;
    }
    let known = |sigma| fit(image, template, start, Some(sigma)).0;
    WIDE.into_iter().find_map(known)
}

/// The same for a blur of this deviation, modules, or for one that is measured; and what
/// is measured along x and y, modules.
fn fit(
    image: &Grey,
    template: &Template,
    start: &Matrix3<f64>,
    known: Option<f64>,
) -> (Option<Matrix3<f64>>, Option<[f64; 2]>) {
    let mut h = start / start[(2, 2)];
    let mut blur = Blur::new([known.unwrap_or(0.15); 2]);
    for pass in 1.. {
        let Some(light) = Light::of(image, template, &blur, &h) else {
            break;
        };
        let (mut a, mut b) = (Normal::zeros(), Unknowns::zeros());
        let mut softness = [[0.0_f64; 3]; 2];
        let mut places = Vec::with_capacity(template.edges.len());
        for edge in &template.edges {
            let place = Place::of(&h, edge, template.module);
            let mut reach = REACH_PX.min(REACH * place.module_px);
            if pass == PASSES {
                let sigma = blur.sigma()[edge.axis()] * place.module_px;
                reach = reach.min((NEAR * sigma).max(NEAR_PX));
            }
            let Some(profile) = place.profile(image, &light, edge.at, reach) else {
                places.push(None);
                continue;
            };
            let off = place.slant * profile.off(&place, &blur, template, edge);
            let row = place.row(&h, edge);
            a.ger(1.0, &row, &row, 1.0);
            b.axpy(off, &row, 1.0);
            if edge.side.is_some() {
                let [sum, expected, count] = &mut softness[edge.axis()];
                *sum += profile.soft / place.module_px;
                *expected += blur.softness(edge, reach / place.module_px);
                *count += 1.0;
            }
            places.push(Some((row, off, place.slant * place.module_px)));
        }
        let Some(normal) = a.cholesky() else {
            break;
        };
        let mut step = normal.solve(&b);
        for k in 0..8 {
            h[(k / 3, k % 3)] += step[k];
        }
        // The integral of p (1 - p) over a Gaussian's distribution p is sigma / sqrt(pi).
        let sigma = |[sum, _, count]: [f64; 3]| std::f64::consts::PI.sqrt() * sum / count;
        let sigma = softness.map(sigma);
        // An edge sharper than possible: what should be white is darker than the bits. One sharper
        // than by the tried blur: that would hide what covers a part of it.
        let least = if known.is_some() { MEASURED } else { 0.0 };
        let is_soft = |[sum, expected, count]: [f64; 3]| count > 0.0 && sum > least * expected;
        if !softness.into_iter().all(is_soft) {
            break;
        }
        if known.is_none() {
            blur = Blur::new(sigma);
        }
        if pass < PASSES {
            continue;
        }
        let mut seen = Seen::of(&places, template, &step);
        if seen.misfits > 0 && seen.is_whole(template) {
            // They are few, and something covers them: the fit is better without.
            for (row, off, module_px) in places.iter().flatten() {
                if is_misfit(off - row.dot(&step), *module_px) {
                    a.ger(-1.0, row, row, 1.0);
                    b.axpy(-off, row, 1.0);
                }
            }
            let Some(normal) = a.cholesky() else {
                break;
            };
            let without = normal.solve(&b);
            for k in 0..8 {
                h[(k / 3, k % 3)] += without[k] - step[k];
            }
            step = without;
            seen = Seen::of(&places, template, &step);
        }
        let is_whole = seen.is_whole(template) && light.is_whole(image, template, &blur, &h);
        return (is_whole.then_some(h), Some(sigma));
    }
    (None, None)
}

/// How well the places of a tag agree with the fit.
#[derive(Debug, Default)]
struct Seen {
    /// Places that were measured, those of them that are far off, and those of these on the outline.
    places: usize,
    misfits: usize,
    misfits_of_outline: usize,
    /// By the side of the black square: sum of the distances from the fit, px, and their number.
    sides: [(f64, f64); 4],
    /// Places outside the image: by side, and between the bits.
    outside: [usize; 5],
}

/// What was measured at a place: its row of the normal equations, how far off it was before the
/// last step, and the side of a module there, px.
type Measured = (Unknowns, f64, f64);

/// Whether a place is this far from the fit (px) that it is not an edge of the tag.
fn is_misfit(off: f64, module_px: f64) -> bool {
    off.abs() > (OFF_PX + OFF * module_px).min(OFF_MOST_PX)
}

impl Seen {
    /// What the places of a template's edges say of a step.
    fn of(places: &[Option<Measured>], template: &Template, step: &Unknowns) -> Self {
        let mut seen = Self::default();
        for (place, edge) in places.iter().zip(&template.edges) {
            match place {
                Some((row, off, module_px)) => {
                    seen.add(off - row.dot(step), *module_px, edge.side);
                }
                None => seen.outside[edge.side.unwrap_or(4)] += 1,
            }
        }
        seen
    }

    /// Adds a place, `off` px from the fit.
    fn add(&mut self, off: f64, module_px: f64, side: Option<usize>) {
        let is_off = is_misfit(off, module_px);
        self.places += 1;
        self.misfits += usize::from(is_off);
        if let Some(side) = side {
            self.misfits_of_outline += usize::from(is_off);
            let (sum, count) = &mut self.sides[side];
            (*sum, *count) = (*sum + off, *count + 1.0);
        }
    }

    fn is_whole(&self, template: &Template) -> bool {
        // Half the places of a side may lie outside the image; as many of each must be inside.
        let half = template.black;
        let is_there = |(sum, count): &(f64, f64)| (sum / count).abs() < SIDE_OFF_PX;
        let outside = self.outside.iter().sum::<usize>();
        let side = self.sides.iter().map(|(_, count)| *count as usize).min();
        self.misfits_of_outline <= OUTLINE_MISFITS
            && self.misfits as f64 <= MISFITS * self.places as f64
            && self.sides.iter().all(is_there)
            && outside <= half
            && side.is_some_and(|least| least >= half)
    }
}

/// Levels of black and white over the tag: planes.
struct Light(SVector<f64, 6>);

impl Light {
    fn of(image: &Grey, template: &Template, blur: &Blur, h: &Matrix3<f64>) -> Option<Self> {
        let (mut a, mut b) = (SMatrix::<f64, 6, 6>::zeros(), SVector::<f64, 6>::zeros());
        for cell in &template.border {
            let Some(level) = image.level(project(h, cell.at)) else {
                continue;
            };
            let row: SVector<f64, 6> = Self::row(blur.level(template, cell), cell.at);
            a.ger(1.0, &row, &row, 1.0);
            b.axpy(level, &row, 1.0);
        }
        let light = Self(a.cholesky()?.solve(&b));
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let is_clear = |at: [f64; 2]| light.levels(at).1 > CONTRAST;
        corners.into_iter().all(is_clear).then_some(light)
    }

    fn row(white: f64, [x, y]: [f64; 2]) -> SVector<f64, 6> {
        let black = 1.0 - white;
        SVector::from([black * x, black * y, black, white * x, white * y, white])
    }

    /// Black, and the contrast to white.
    fn levels(&self, at: [f64; 2]) -> (f64, f64) {
        let [black, white] = [0.0, 1.0].map(|white| self.0.dot(&Self::row(white, at)));
        (black, white - black)
    }

    /// Whether all of the white border is white, and of the black one black, as far as they are in
    /// the image.
    fn is_whole(&self, image: &Grey, template: &Template, blur: &Blur, h: &Matrix3<f64>) -> bool {
        let mut outside = 0;
        let all = template.border.iter().all(|cell| {
            let Some(level) = image.level(project(h, cell.at)) else {
                outside += 1;
                return true;
            };
            let (black, contrast) = self.levels(cell.at);
            ((level - black) / contrast - blur.level(template, cell)).abs() < LEVEL
        });
        // A side of the border.
        all && outside <= template.side
    }
}

/// A place on an edge, in the image.
struct Place {
    pixel: [f64; 2],
    /// Unit vector to white, at a right angle to the edge, px.
    normal: [f64; 2],
    /// Unit vector to white along the tag's axis, px: a line along it stays within a row of modules
    /// however the tag is tilted.
    to_white: [f64; 2],
    /// Cosine of the angle between both.
    slant: f64,
    /// Side of a module along the axis, px.
    module_px: f64,
}

/// What samples across an edge tell.
struct Profile {
    /// How far they reach to each side, and where `ends` are, px.
    reach: f64,
    at: f64,
    /// The area under the levels p from black (0) to white (1), and that under p (1 - p), px.
    area: f64,
    soft: f64,
    /// The level near the end on the black side, and near that on the white one.
    ends: [f64; 2],
}

impl Profile {
    /// How far the edge is from where it should be, towards white, px.
    fn off(&self, place: &Place, blur: &Blur, template: &Template, edge: &Edge) -> f64 {
        let [reach, at] = [self.reach, self.at].map(|x| x / place.module_px);
        let expected = blur.across(template, edge, reach, at);
        let [black, white] = expected.ends;
        let is_near = |k: usize| (self.ends[k] - expected.ends[k]).abs() < LOCAL;
        let mut area = self.area;
        if white - black > RESOLVED && is_near(0) && is_near(1) {
            // In the light about this edge.
            let [dark, bright] = self.ends;
            let base = 2.0 * self.reach;
            area = base * black + (area - base * dark) * (white - black) / (bright - dark);
        }
        place.module_px * expected.area - area
    }
}

impl Place {
    fn of(h: &Matrix3<f64>, edge: &Edge, module: f64) -> Self {
        let pixel = project(h, edge.at);
        let w = h[(2, 0)] * edge.at[0] + h[(2, 1)] * edge.at[1] + h[(2, 2)];
        // Derivatives of the projection along the edge and towards white.
        let along = |[x, y]: [f64; 2]| {
            [0, 1].map(|k| {
                let top = h[(k, 0)] * x + h[(k, 1)] * y;
                (top - pixel[k] * (h[(2, 0)] * x + h[(2, 1)] * y)) / w
            })
        };
        let [x, y] = edge.to_white;
        let (to_white, tangent) = (along([x, y]), along([y, x]));
        let length = tangent[0].hypot(tangent[1]);
        let normal = [tangent[1] / length, -tangent[0] / length];
        let across = normal[0] * to_white[0] + normal[1] * to_white[1];
        let far = to_white[0].hypot(to_white[1]);
        Self {
            pixel,
            normal: normal.map(|x| across.signum() * x),
            to_white: to_white.map(|x| x / far),
            slant: across.abs() / far,
            module_px: module * far,
        }
    }

    /// Samples across the edge that reach so far to each side, px; `None` if some are outside the
    /// image.
    fn profile(&self, image: &Grey, light: &Light, at: [f64; 2], reach: f64) -> Option<Profile> {
        let steps = (reach / STEP).ceil().max(2.0);
        let step = reach / steps;
        let (black, contrast) = light.levels(at);
        let (mut area, mut soft) = (0.0, 0.0);
        let mut ends = [0.0; 2];
        let count = 2 * steps as usize;
        for k in 0..=count {
            let s = k as f64 * step - reach;
            let pixel = [0, 1].map(|i| self.pixel[i] + s * self.to_white[i]);
            let share = (image.level(pixel)? - black) / contrast;
            let share = share.clamp(-0.3, 1.3);
            let weight = if k == 0 || k == count { 0.5 } else { 1.0 };
            area += weight * step * share;
            soft += weight * step * share * (1.0 - share);
            if k < 2 {
                ends[0] += 0.5 * share;
            }
            if k + 2 > count {
                ends[1] += 0.5 * share;
            }
        }
        Some(Profile {
            reach,
            at: reach - 0.5 * step,
            area,
            soft: soft.max(0.0),
            ends,
        })
    }

    /// The derivative of the edge's offset by the unknowns.
    fn row(&self, h: &Matrix3<f64>, edge: &Edge) -> Unknowns {
        let [x, y] = edge.at;
        let w = h[(2, 0)] * x + h[(2, 1)] * y + h[(2, 2)];
        let [nu, nv] = self.normal.map(|n| n / w);
        let along = nu * self.pixel[0] + nv * self.pixel[1];
        let reach = [0, 1].map(|axis| if axis == edge.axis() { -1.0 } else { 0.0 });
        Unknowns::from([
            nu * x,
            nu * y,
            nu,
            nv * x,
            nv * y,
            nv,
            -along * x,
            -along * y,
            reach[0],
            reach[1],
        ])
    }
}
