//! What a tag looks like.
//!
//! Tag coordinates: x to the right, y down on the upright tag; its black square reaches from -1 to
//! 1. A module is the side of a bit.

use markers::Family;

use crate::blur::{area_below, below};

/// White modules that are taken to be about it: what a blur may reach.
const MARGIN: usize = 3;
/// Modules on each side of one that a blur reaches.
const REACH: usize = 2;
/// Modules along a side of the squares at the corners of a Kalibr board's tags: as wide as the gap
/// between two tags, and the rest is too far to matter.
const SQUARE: usize = 2;
/// Weights of those.
type Weights = [f64; 2 * REACH + 1];
/// Places along each edge of a module at which the border between black and white is measured, in
/// modules from its middle.
const ALONG: [f64; 2] = [-0.22, 0.22];

/// A place on the border between a black and a white module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Edge {
    /// Where, in tag coordinates.
    pub at: [f64; 2],
    /// From black to white: the unit vector in tag coordinates, along x or y.
    pub to_white: [f64; 2],
    /// The side of the black square that it is on: left, upper, right, lower.
    pub side: Option<usize>,
    /// Column and row of the black module, with the margin.
    black: [usize; 2],
    /// Which of the places along the edge.
    along: usize,
}

impl Edge {
    /// The axis across the edge: 0 is x, 1 is y.
    pub fn axis(&self) -> usize {
        usize::from(self.to_white[0] == 0.0)
    }
}

/// A module of the black or the white border.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cell {
    /// Its centre, in tag coordinates.
    pub at: [f64; 2],
    #[cfg(test)]
    is_white: bool,
    /// Column and row, with the margin.
    place: [usize; 2],
}

/// The modules of one tag.
#[derive(Clone, Debug)]
pub(crate) struct Template {
    /// 1 for white, row by row, with the margin.
    modules: Vec<f64>,
    /// Modules along a side: with the margin, with the white border, of the black square.
    wide: usize,
    pub side: usize,
    pub black: usize,
    /// Side of a module in tag coordinates.
    pub module: f64,
    /// Every border between black and white.
    pub edges: Vec<Edge>,
    /// The modules of the black and the white border.
    pub border: Vec<Cell>,
}

impl Template {
    /// Of the tag of this number, alone or with a black square at each corner.
    pub fn new(family: Family, number: u32, has_squares: bool) -> Self {
        let (side, black) = (family.side(), family.black());
        let (wide, first, last) = (side + 2 * MARGIN, MARGIN, MARGIN + side - 1);
        let is_square = |place: [usize; 2]| {
            let is_beyond = |k: usize| {
                (first + 1 - SQUARE..=first).contains(&k) || (last..last + SQUARE).contains(&k)
            };
            has_squares && place.into_iter().all(is_beyond)
        };
        let is_white = |place: [usize; 2]| {
            let is_about = place.iter().any(|k| *k <= first || *k >= last);
            match is_about {
                true => !is_square(place),
                false => family.is_white(number, place.map(|k| k - first - 1)),
            }
        };
        let modules = (0..wide * wide).map(|k| f64::from(u8::from(is_white([k % wide, k / wide]))));
        let modules: Vec<f64> = modules.collect();
        let module = 2.0 / black as f64;
        let centre = |k: usize| (k as f64 - 0.5 * (wide - 1) as f64) * module;
        let whole = first..last + 1;
        let cells = whole
            .clone()
            .flat_map(|j| whole.clone().map(move |i| [i, j]));
        let border = cells.clone().filter_map(|place| {
            // Rings from the outside: 0 is the white border, 1 the black one.
            let depth = place.map(|k| (k - first).min(last - k));
            let ring = depth[0].min(depth[1]);
            (ring < 2).then(|| Cell {
                at: place.map(centre),
                #[cfg(test)]
                is_white: is_white(place),
                place,
            })
        });
        let border = border.collect();
        let mut edges = Vec::new();
        for [i, j] in cells {
            for (axis, [k, l]) in [(0, [i + 1, j]), (1, [i, j + 1])] {
                let is_black = [[i, j], [k, l]].map(|[i, j]| modules[j * wide + i] == 0.0);
                if is_black[0] == is_black[1] {
                    continue;
                }
                let sign = if is_black[0] { 1.0 } else { -1.0 };
                let side = match ([i, j][axis], [k, l][axis]) {
                    _ if is_square([i, j]) || is_square([k, l]) => None,
                    (k, _) if k == first => Some(axis),
                    (_, k) if k == last => Some(axis + 2),
                    _ => None,
                };
                let middle = [0.5 * (centre(i) + centre(k)), 0.5 * (centre(j) + centre(l))];
                for (along, offset) in ALONG.into_iter().enumerate() {
                    let (mut at, mut to_white) = (middle, [0.0; 2]);
                    at[1 - axis] += offset * module;
                    to_white[axis] = sign;
                    edges.push(Edge {
                        at,
                        to_white,
                        side,
                        black: if is_black[0] { [i, j] } else { [k, l] },
                        along,
                    });
                }
            }
        }
        Self {
            modules,
            wide,
            side,
            black,
            module,
            edges,
            border,
        }
    }

    /// A row of modules, from a column on.
    fn row(&self, row: usize, column: usize) -> &[f64] {
        &self.modules[row * self.wide + column..(row + 1) * self.wide]
    }
}

/// A blur of the tag: a Gaussian along each of its axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Blur {
    /// Standard deviation along x and y, modules.
    sigma: [f64; 2],
    /// Weights of a module and its neighbours for each place along an edge, by axis.
    along: [[Weights; ALONG.len()]; 2],
    /// The same for the middle of a module.
    middle: [Weights; 2],
}

impl Blur {
    /// Of these standard deviations along x and y, modules.
    pub fn new(sigma: [f64; 2]) -> Self {
        // So much that nothing is divided by zero.
        let sigma = sigma.map(|sigma| sigma.max(0.01));
        let weights = |sigma: f64, offset: f64| -> Weights {
            std::array::from_fn(|k| {
                let low = k as f64 - REACH as f64 - 0.5 - offset;
                let low_is_open = k == 0;
                let high_is_open = k == 2 * REACH;
                let low = if low_is_open { 0.0 } else { below(low / sigma) };
                let high = (k as f64 - REACH as f64 + 0.5 - offset) / sigma;
                let high = if high_is_open { 1.0 } else { below(high) };
                high - low
            })
        };
        Self {
            sigma,
            along: sigma.map(|sigma| ALONG.map(|offset| weights(sigma, offset))),
            middle: sigma.map(|sigma| weights(sigma, 0.0)),
        }
    }

    /// How white the middle of a module of the border is then: 0 to 1.
    pub fn level(&self, template: &Template, cell: &Cell) -> f64 {
        let [column, row] = cell.place.map(|k| k - REACH);
        let lines = self.middle[1].iter().enumerate().map(|(j, weight)| {
            let modules = template.row(row + j, column);
            let line = self.middle[0].iter().zip(modules);
            weight * line.map(|(weight, level)| weight * level).sum::<f64>()
        });
        lines.sum()
    }

    /// The level across an edge, from `reach` modules on the black side to as many on the white one,
    /// and at `ends` on both sides.
    pub fn across(&self, template: &Template, edge: &Edge, reach: f64, ends: f64) -> Across {
        let axis = edge.axis();
        let (sigma, weights) = (self.sigma[axis], &self.along[1 - axis][edge.along]);
        let sign = if edge.to_white[axis] > 0.0 { 1 } else { -1 };
        // The level of the modules across the edge, blurred along it, from black to white: the black
        // module is number 2, the white one number 3.
        let level = |k: isize| {
            let across = edge.black[axis].wrapping_add_signed(sign * (k - 2));
            let lines = weights.iter().enumerate().map(|(j, weight)| {
                let along = edge.black[1 - axis] + j - REACH;
                let (column, row) = if axis == 0 {
                    (across, along)
                } else {
                    (along, across)
                };
                weight * template.row(row, column)[0]
            });
            lines.sum::<f64>()
        };
        let mut last = level(0);
        let mut found = Across {
            area: 2.0 * reach * last,
            ends: [last; 2],
        };
        for k in 1..6 {
            let next = level(k);
            if next != last {
                let (at, rise) = (k as f64 - 3.0, next - last);
                let [above, under] = [reach, -reach].map(|x| area_below((x - at) / sigma));
                found.area += rise * sigma * (above - under);
                for (level, x) in found.ends.iter_mut().zip([-ends, ends]) {
                    *level += rise * below((x - at) / sigma);
                }
            }
            last = next;
        }
        found
    }

    /// The area under p (1 - p) across an edge far from others, whose levels p go from black (0) to
    /// white (1), to `reach` modules on both sides; in modules.
    pub fn softness(&self, edge: &Edge, reach: f64) -> f64 {
        let sigma = self.sigma[edge.axis()];
        let x = reach / sigma;
        let p = below(x);
        let density = area_below(x) - x * p;
        // By parts, from the middle to x.
        let bell = (below(2.0_f64.sqrt() * x) - 0.5) / std::f64::consts::PI.sqrt();
        2.0 * sigma * (x * p * (1.0 - p) - (2.0 * p - 1.0) * density + bell)
    }

    /// Standard deviations along x and y, modules.
    pub fn sigma(&self) -> [f64; 2] {
        self.sigma
    }
}

/// Levels across an edge: 0 is black, 1 is white.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Across {
    /// The area under them, modules: the reach for an edge that is far from others.
    pub area: f64,
    /// The level near the end on the black side, and near that on the white one.
    pub ends: [f64; 2],
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first tags of every family.
    fn templates() -> impl Iterator<Item = Template> {
        let families = Family::NAMES.iter().map(|name| name.parse().unwrap());
        families.flat_map(|family| {
            (0..20).map(move |number| Template::new(family, number, number % 4 == 3))
        })
    }

    #[test]
    fn a_tag_has_its_outline_and_the_edges_of_its_bits() {
        for template in templates() {
            let white = template.border.iter().filter(|cell| cell.is_white).count();
            let rings = [template.side, template.black].map(|side| 4 * (side - 1));
            let border = [white, template.border.len() - white];
            let has_squares = template.row(MARGIN, MARGIN)[0] == 0.0;
            let squares = 4 * usize::from(has_squares);
            assert_eq!(border, [rings[0] - squares, rings[1] + squares]);
            let outline: Vec<&Edge> = template.edges.iter().filter(|e| e.side.is_some()).collect();
            let least = 4 * template.black * ALONG.len();
            assert_eq!(outline.len(), least);
            for edge in outline {
                let [x, y] = edge.at;
                let depth = x * edge.to_white[0] + y * edge.to_white[1];
                assert!((depth - 1.0).abs() < 1e-12, "{edge:?}");
            }
            assert!(template.edges.len() > least);
        }
    }

    #[test]
    fn without_blur_each_edge_is_where_it_is() {
        let blur = Blur::new([0.0; 2]);
        for template in templates() {
            for edge in &template.edges {
                let area = blur.across(&template, edge, 0.5, 0.5).area;
                assert!((area - 0.5).abs() < 1e-3, "{edge:?}: {area}");
            }
            for cell in &template.border {
                let level = blur.level(&template, cell);
                assert_eq!(level, f64::from(u8::from(cell.is_white)));
            }
        }
    }

    #[test]
    fn softness_is_the_area_that_samples_give() {
        let edge = &templates().next().unwrap().edges[0];
        for (sigma, reach) in [(0.1, 0.5), (0.35, 0.5), (0.65, 0.5), (0.65, 0.3)] {
            let samples = (0..1000).map(|k| (k as f64 - 499.5) * reach / 500.0);
            let level = samples.map(|x| below(x / sigma));
            let expected = level.map(|p| p * (1.0 - p) * reach / 500.0).sum::<f64>();
            let found = Blur::new([sigma; 2]).softness(edge, reach);
            assert!(
                (found - expected).abs() < 1e-4,
                "{sigma} {reach}: {found} {expected}"
            );
        }
    }
}
