//! Pieces without sharp concave corners that together cover a connected set of pixels.
//!
//! The law plans with the nearest border of a piece only. In the inner corner of an L that is one
//! arm, so the plan would lead through the other. So an L is covered by its two arms, which overlap
//! in the corner. Round hollows need no pieces: their border turns as the point moves along.

use crate::distance::Shape;
use crate::patch::Patch;

/// Radius of the disc that decides whether a concave corner is sharp, share of the image's longer
/// side.
const RADIUS: f64 = 0.05;
/// A corner is sharp if the disc stays further away from it than this share of its radius: 0.41 for
/// a right angle, 0.15 for one of 120 degrees.
const SHARP: f64 = 0.15;
/// Cells along the image's longer side: cuts are sought at this resolution.
const CELLS: i64 = 256;
/// Directions in which a piece may be cut at a sharp corner.
const DIRECTIONS: usize = 96;
/// A cut is judged by the pixels of the border that are at most this many radii away.
const RUN: f64 = 4.0;
/// A pixel of the border lies on a cut if it is this close to its line, cells.
const FLUSH: f64 = 1.0;
/// A cut runs along a border if more pixels lie on it than on neighbouring directions, and at least
/// this share of the most on any direction.
const BORDER: f64 = 0.35;
/// A rest of this thickness or less joins its neighbours, cells.
const REST: i64 = 1;
/// Most cuts until a piece has no sharp corner.
const MAX_CUTS: usize = 12;

/// A line through a corner, across which a piece does not reach.
struct Cut {
    /// The free pixel in the corner.
    corner: [i64; 2],
    /// Unit normal, towards the piece.
    normal: [f64; 2],
}

impl Cut {
    /// How far a pixel lies from the line through the corner's middle, on the side of the piece.
    fn side(&self, [x, y]: [i64; 2]) -> f64 {
        let [u, v] = self.corner;
        along(self.normal, [(x - u) as f64, (y - v) as f64])
    }

    /// The line that was found in cells of `cell` pixels, drawn along the pixels of a set.
    fn among_pixels(&self, set: &Patch, cell: i64) -> Self {
        let first = self.corner.map(|x| (x - 1) * cell);
        let free = (0..9 * cell * cell)
            .map(|n| [first[0] + n % (3 * cell), first[1] + n / (3 * cell)])
            .filter(|pixel| !set.holds(*pixel));
        let height = |[x, y]: [i64; 2]| along(self.normal, [x as f64, y as f64]);
        let corner = free.max_by(|a, b| height(*a).total_cmp(&height(*b)));
        Self {
            corner: corner.unwrap_or(self.corner.map(|x| x * cell)),
            normal: self.normal,
        }
    }
}

/// Covers a connected set by at most `most` pieces; returns the set itself if it needs more.
pub fn cover(set: &Patch, most: usize) -> Vec<Patch> {
    let [width, height] = set.image();
    let cell = (width.max(height) / CELLS).max(1);
    let cells = set.in_cells(cell);
    let radius = RADIUS * (width.max(height) / cell) as f64;
    let mut pieces: Vec<Patch> = Vec::new();
    let (mut rest, mut pixels) = (cells.clone(), set.clone());
    while let Some((seed, depth)) = rest.deepest() {
        if !pieces.is_empty() && depth <= REST {
            break;
        }
        if pieces.len() == most {
            return vec![set.clone()];
        }
        let (piece, cuts) = grown(&cells, seed, radius);
        let cuts: Vec<Cut> = cuts.iter().map(|cut| cut.among_pixels(set, cell)).collect();
        rest.remove(&piece);
        let piece = set.kept(|pixel| {
            piece.holds(pixel.map(|x| x / cell)) && cuts.iter().all(|cut| cut.side(pixel) > 0.0)
        });
        pixels.remove(&piece);
        pieces.push(piece);
    }
    share(pixels, &mut pieces);
    pieces.iter().map(Patch::tight).collect()
}

/// Returns a large piece around `seed`: the set, cut along its borders at its sharpest corner
/// repeatedly.
fn grown(set: &Patch, seed: [i64; 2], radius: f64) -> (Patch, Vec<Cut>) {
    let (mut piece, mut cuts) = (set.clone(), Vec::new());
    for _ in 0..MAX_CUTS {
        let tight = piece.tight();
        let border = border(set, &tight);
        let Some(corner) = sharpest(&border, &tight, radius) else {
            break;
        };
        let offset = |[x, y]: [i64; 2]| [(x - corner[0]) as f64, (y - corner[1]) as f64];
        let near: Vec<[f64; 2]> = border
            .iter()
            .map(|pixel| offset(*pixel))
            .filter(|[u, v]| u.hypot(*v) <= RUN * radius)
            .collect();
        let normal = |k: usize| {
            let angle = std::f64::consts::TAU * k as f64 / DIRECTIONS as f64;
            [angle.cos(), angle.sin()]
        };
        let flush: Vec<usize> = (0..DIRECTIONS)
            .map(|k| {
                let is_flush = |offset: &&[f64; 2]| along(normal(k), **offset).abs() <= FLUSH;
                near.iter().filter(is_flush).count()
            })
            .collect();
        // The two borders that meet in the corner: of both, the one that leaves more.
        let best = flush.iter().copied().max().unwrap_or(0);
        let runs_along = |k: &usize| {
            let is_most = (1..=2).all(|d| {
                let neighbours = [(k + d) % DIRECTIONS, (k + DIRECTIONS - d) % DIRECTIONS];
                neighbours.iter().all(|n| flush[*n] <= flush[*k])
            });
            is_most && flush[*k] as f64 >= BORDER * best as f64
        };
        let best = (0..DIRECTIONS)
            .filter(runs_along)
            .map(|k| Cut {
                corner,
                normal: normal(k),
            })
            .filter(|cut| cut.side(seed) > 0.0)
            .map(|cut| (piece.reached(seed, |pixel| cut.side(pixel) > 0.0), cut))
            .max_by_key(|(piece, _)| piece.count());
        match best {
            Some((smaller, cut)) if smaller.count() < piece.count() => {
                piece = smaller;
                cuts.push(cut);
            }
            _ => break,
        }
    }
    (piece, cuts)
}

fn along(normal: [f64; 2], offset: [f64; 2]) -> f64 {
    normal[0] * offset[0] + normal[1] * offset[1]
}

/// Returns the free pixels that touch a piece of a set along a side.
fn border(set: &Patch, piece: &Patch) -> Vec<[i64; 2]> {
    let [width, height] = set.image();
    let (first, last) = piece.window();
    let rows = (first[1] - 1).max(0)..=(last[1] + 1).min(height - 1);
    rows.flat_map(|y| {
        let columns = (first[0] - 1).max(0)..=(last[0] + 1).min(width - 1);
        columns.map(move |x| [x, y])
    })
    .filter(|&[x, y]| {
        let sides = [[x - 1, y], [x + 1, y], [x, y - 1], [x, y + 1]];
        !set.holds([x, y]) && sides.iter().any(|side| piece.holds(*side))
    })
    .collect()
}

/// Returns the pixel of a piece's border in its sharpest concave corner, if any is sharp.
fn sharpest(border: &[[i64; 2]], piece: &Patch, radius: f64) -> Option<[i64; 2]> {
    let reach = 2.0 * radius;
    let beyond = reach.ceil() as i64 + 1;
    let shape = Shape::of(piece, beyond);
    let (first, last) = piece.window();
    let origin = first.map(|x| x - beyond);
    let count: [i64; 2] = std::array::from_fn(|k| last[k] + beyond - origin[k] + 1);
    // Discs about the middles of pixels.
    let middle = |i: i64, j: i64| [i as f64 + 0.5, j as f64 + 0.5];
    let is_clear: Vec<bool> = (0..count[0] * count[1])
        .map(|n| {
            let (i, j) = (origin[0] + n % count[0], origin[1] + n / count[0]);
            shape.distance(middle(i, j)) >= radius
        })
        .collect();

    // How far a pixel is from the nearest disc that stays clear of the piece; at its side, half a
    // pixel less.
    let gap = |[x, y]: [i64; 2]| {
        let near = |k: usize, x: i64| {
            (x - beyond).max(origin[k])..=(x + beyond).min(origin[k] + count[k] - 1)
        };
        let mut nearest = reach;
        for j in near(1, y) {
            for i in near(0, x) {
                if is_clear[((j - origin[1]) * count[0] + i - origin[0]) as usize] {
                    nearest = nearest.min(((i - x) as f64).hypot((j - y) as f64));
                }
            }
        }
        nearest + 0.5 - radius
    };
    border
        .iter()
        .map(|pixel| (gap(*pixel), *pixel))
        .filter(|(gap, _)| *gap > SHARP * radius)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, pixel)| pixel)
}

/// Adds every pixel of a rest to a piece that it touches.
fn share(mut rest: Patch, pieces: &mut [Patch]) {
    loop {
        let joins: Vec<([i64; 2], usize)> = rest
            .pixels()
            .filter_map(|[x, y]| {
                let touches = |piece: &Patch| {
                    (y - 1..=y + 1).any(|j| (x - 1..=x + 1).any(|i| piece.holds([i, j])))
                };
                Some(([x, y], pieces.iter().position(touches)?))
            })
            .collect();
        if joins.is_empty() {
            return;
        }
        for (pixel, index) in joins {
            pieces[index].add(pixel);
        }
        pieces.iter().for_each(|piece| rest.remove(piece));
    }
}
