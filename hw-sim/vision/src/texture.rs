//! Soft noise on surfaces: one tile, repeated.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Side of the tile, texels.
const TILE: usize = 256;
/// Size of a texel on the plane, m.
const TEXEL: f32 = 0.0006;

/// A tile of soft noise, about -1 to 1: grains of several sizes, each half as strong as the next
/// larger one.
#[derive(Clone, Debug)]
pub(crate) struct Texture {
    /// Row by row.
    tile: Box<[f32; TILE * TILE]>,
}

impl Texture {
    pub fn new(random: &mut ChaCha8Rng) -> Self {
        let mut tile = Box::new([0.0f32; TILE * TILE]);
        for (cell, weight) in [(64, 0.5), (16, 0.35), (4, 0.25), (2, 0.15)] {
            let side = TILE / cell;
            let knots: Vec<f32> = (0..side * side)
                .map(|_| 2.0 * random.random::<f32>() - 1.0)
                .collect();
            for (i, x) in tile.iter_mut().enumerate() {
                let (u, v) = (i % TILE, i / TILE);
                let (a, b) = (
                    (u % cell) as f32 / cell as f32,
                    (v % cell) as f32 / cell as f32,
                );
                let ease = |t: f32| t * t * (3.0 - 2.0 * t);
                let knot = |p: usize, q: usize| {
                    knots[(v / cell + q) % side * side + (u / cell + p) % side]
                };
                let (a, b) = (ease(a), ease(b));
                let upper = knot(0, 0) * (1.0 - a) + knot(1, 0) * a;
                let lower = knot(0, 1) * (1.0 - a) + knot(1, 1) * a;
                *x += weight * (upper * (1.0 - b) + lower * b);
            }
        }
        Self { tile }
    }

    /// The texel of a column and row, which count on beyond the tile.
    pub fn texel(&self, column: usize, row: usize) -> f32 {
        self.tile[row % TILE * TILE + column % TILE]
    }

    /// The grain at a point of the plane (m), bilinear between texels.
    #[inline(always)]
    pub fn at(&self, x: f32, y: f32) -> f32 {
        // Positive within 10 m of the pattern, so that the cast rounds down; farther away nobody
        // looks.
        const FAR: f32 = (64 * TILE) as f32;
        let (x, y) = (x * (1.0 / TEXEL) + FAR, y * (1.0 / TEXEL) + FAR);
        let (column, row) = (x as i32, y as i32);
        let (a, b) = (x - column as f32, y - row as f32);
        let wrap = |i: i32| i as usize % TILE;
        let (u, v) = (wrap(column), wrap(row) * TILE);
        let (right, below) = (
            wrap(column.wrapping_add(1)),
            wrap(row.wrapping_add(1)) * TILE,
        );
        let upper = self.tile[v + u] * (1.0 - a) + self.tile[v + right] * a;
        let lower = self.tile[below + u] * (1.0 - a) + self.tile[below + right] * a;
        upper * (1.0 - b) + lower * b
    }
}
