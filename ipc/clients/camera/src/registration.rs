//! Fits a tag's template to the image, and refuses a tag that is not seen whole.
//!
//! A quad that was found may have shrunk because something hides an edge, or covers a part of the
//! white border. So the borders between black and white modules, those of the bits among them, are
//! measured one by one, a homography is fitted to all of them, and every place must agree with it.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::grey::Grey;
use crate::template::{Blur, Cell, Edge, MODULE, Template};

/// Passes of the fit.
const PASSES: usize = 3;
/// Blurs that are tried where edges are too wide to be measured one by one, modules.
const WIDE: [f64; 4] = [0.35, 0.45, 0.55, 0.65];
/// Least measured blur, as a share of the tried one.
const MEASURED: f64 = 0.5;
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

/// Unknowns: the homography with a last entry of 1, and by how far white reaches over black (px),
/// as saturation and the sensor's curve make it.
type Normal = SMatrix<f64, 9, 9>;
type Unknowns = SVector<f64, 9>;

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
    let known = |sigma| fit(image, template, start, Some(sigma));
    fit(image, template, start, None).or_else(|| WIDE.into_iter().find_map(known))
}

/// The same for a blur of this deviation, modules, or for one that is measured.
fn fit(
    image: &Grey,
    template: &Template,
    start: &Matrix3<f64>,
    known: Option<f64>,
) -> Option<Matrix3<f64>> {
    let mut h = start / start[(2, 2)];
    let mut blur = Blur::new([known.unwrap_or(0.15); 2]);
    for pass in 1.. {
        let light = Light::of(image, template, &blur, &h)?;
        let (mut a, mut b) = (Normal::zeros(), Unknowns::zeros());
        let mut softness = [[0.0_f64; 2]; 2];
        let mut places = Vec::with_capacity(template.edges.len());
        for edge in &template.edges {
            let place = Place::of(&h, edge);
            let profile = place.profile(image, &light, edge.at)?;
            let [reach, area, soft] = profile.map(|x| x / place.module_px);
            let off = place.module_px * (blur.area(template, edge, reach) - area);
            let row = place.row(&h, edge.at);
            a.ger(1.0, &row, &row, 1.0);
            b.axpy(off, &row, 1.0);
            if edge.side.is_some() {
                let [sum, count] = &mut softness[edge.axis()];
                (*sum, *count) = (*sum + soft, *count + 1.0);
            }
            places.push((row, off, place.module_px));
        }
        let step = a.cholesky()?.solve(&b);
        for k in 0..8 {
            h[(k / 3, k % 3)] += step[k];
        }
        // The integral of p (1 - p) over a Gaussian's distribution p is sigma / sqrt(pi).
        let sigma = |[sum, count]: [f64; 2]| std::f64::consts::PI.sqrt() * sum / count;
        let sigma = softness.map(sigma);
        // An edge sharper than possible: what should be white is darker than the bits.
        let least = MEASURED * known.unwrap_or(0.0);
        if sigma.iter().any(|&sigma| sigma <= least) {
            return None;
        }
        if known.is_none() {
            blur = Blur::new(sigma);
        }
        if pass < PASSES {
            continue;
        }
        let off = |(row, off, _): &(Unknowns, f64, f64)| off - row.dot(&step);
        let seen = Seen::default();
        let seen = places
            .iter()
            .zip(&template.edges)
            .fold(seen, |seen, (place, edge)| {
                seen.with(off(place), place.2, edge.side)
            });
        let is_seen = seen.is_whole(places.len());
        return (is_seen && light.is_whole(image, template, &blur, &h)?).then_some(h);
    }
    None
}

/// How well the places of a tag agree with the fit.
#[derive(Debug, Default)]
struct Seen {
    /// Places that are far off, and those of them on the outline.
    misfits: usize,
    misfits_of_outline: usize,
    /// By the side of the black square: sum of the distances from the fit, px, and their number.
    sides: [(f64, f64); 4],
}

impl Seen {
    /// With one place more, `off` px from the fit.
    fn with(mut self, off: f64, module_px: f64, side: Option<usize>) -> Self {
        let is_off = off.abs() > (OFF_PX + OFF * module_px).min(OFF_MOST_PX);
        self.misfits += usize::from(is_off);
        if let Some(side) = side {
            self.misfits_of_outline += usize::from(is_off);
            let (sum, count) = &mut self.sides[side];
            (*sum, *count) = (*sum + off, *count + 1.0);
        }
        self
    }

    fn is_whole(&self, places: usize) -> bool {
        let is_there = |(sum, count): &(f64, f64)| (sum / count).abs() < SIDE_OFF_PX;
        self.misfits_of_outline <= OUTLINE_MISFITS
            && self.misfits as f64 <= MISFITS * places as f64
            && self.sides.iter().all(is_there)
    }
}

/// Levels of black and white over the tag: planes.
struct Light(SVector<f64, 6>);

impl Light {
    fn of(image: &Grey, template: &Template, blur: &Blur, h: &Matrix3<f64>) -> Option<Self> {
        let (mut a, mut b) = (SMatrix::<f64, 6, 6>::zeros(), SVector::<f64, 6>::zeros());
        for cell in &template.border {
            let row: SVector<f64, 6> = Self::row(blur.level(template, cell), cell.at);
            a.ger(1.0, &row, &row, 1.0);
            b.axpy(image.level(project(h, cell.at))?, &row, 1.0);
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

    /// Whether all of the white border is white, and of the black one black.
    fn is_whole(
        &self,
        image: &Grey,
        template: &Template,
        blur: &Blur,
        h: &Matrix3<f64>,
    ) -> Option<bool> {
        let is_right = |cell: &Cell| {
            let (black, contrast) = self.levels(cell.at);
            let share = (image.level(project(h, cell.at))? - black) / contrast;
            Some((share - blur.level(template, cell)).abs() < LEVEL)
        };
        let mut cells = template.border.iter().map(is_right);
        cells.try_fold(true, |all, is_right| Some(all && is_right?))
    }
}

/// A place on an edge, in the image.
struct Place {
    pixel: [f64; 2],
    /// Unit vector to white, at a right angle to the edge, px.
    normal: [f64; 2],
    /// Side of a module at a right angle to the edge, px.
    module_px: f64,
}

impl Place {
    fn of(h: &Matrix3<f64>, edge: &Edge) -> Self {
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
        let sign = across.signum();
        Self {
            pixel,
            normal: normal.map(|x| sign * x),
            module_px: MODULE * across.abs(),
        }
    }

    /// Samples across the edge: how far they reach to each side (px), the area under the levels p
    /// from black (0) to white (1), and that under p (1 - p).
    fn profile(&self, image: &Grey, light: &Light, at: [f64; 2]) -> Option<[f64; 3]> {
        let reach = REACH_PX.min(REACH * self.module_px);
        let steps = (reach / STEP).ceil().max(2.0);
        let step = reach / steps;
        let (black, contrast) = light.levels(at);
        let (mut area, mut soft) = (0.0, 0.0);
        let count = 2 * steps as usize;
        for k in 0..=count {
            let s = k as f64 * step - reach;
            let pixel = [0, 1].map(|i| self.pixel[i] + s * self.normal[i]);
            let share = (image.level(pixel)? - black) / contrast;
            let share = share.clamp(-0.3, 1.3);
            let weight = if k == 0 || k == count { 0.5 } else { 1.0 };
            area += weight * step * share;
            soft += weight * step * share * (1.0 - share);
        }
        Some([reach, area, soft.max(0.0)])
    }

    /// The derivative of the edge's offset by the unknowns.
    fn row(&self, h: &Matrix3<f64>, [x, y]: [f64; 2]) -> Unknowns {
        let w = h[(2, 0)] * x + h[(2, 1)] * y + h[(2, 2)];
        let [nu, nv] = self.normal.map(|n| n / w);
        let along = nu * self.pixel[0] + nv * self.pixel[1];
        Unknowns::from([
            nu * x,
            nu * y,
            nu,
            nv * x,
            nv * y,
            nv,
            -along * x,
            -along * y,
            -1.0,
        ])
    }
}
