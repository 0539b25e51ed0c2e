//! Geometry of a scene for tools that draw or inspect it.
//!
//! The control law, the emulator's referee and its renderer judge by mathematics of their own, so
//! that one mistake cannot hide on all sides: they must not call what is here, and their
//! `clippy.toml` refuses it.

use crate::{Mask, Occlusion, Part, Scene};

impl Part {
    /// Returns whether the part covers a point of the image (u, v), px.
    pub fn covers(&self, point: [f64; 2]) -> bool {
        let term = |k: usize| ((point[k] - self.center[k]).abs() / self.half[k]).powf(self.p);
        term(0) + term(1) < 1.0
    }

    /// The least and the greatest u and v of the part, px.
    pub fn bounds(&self) -> [[f64; 2]; 2] {
        let corner = |sign: f64| [0, 1].map(|k| self.center[k] + sign * self.half[k]);
        [corner(-1.0), corner(1.0)]
    }

    /// Corners (u, v) of the border, px, at equal steps of the direction from the centre.
    pub fn outline(&self, corners: usize) -> impl Iterator<Item = [f64; 2]> + use<> {
        let Self { center, half, p } = *self;
        (0..corners).map(move |i| {
            let (s, c) = (core::f64::consts::TAU * i as f64 / corners as f64).sin_cos();
            let radius = (c.abs().powf(p) + s.abs().powf(p)).powf(-1.0 / p);
            [
                center[0] + half[0] * radius * c,
                center[1] + half[1] * radius * s,
            ]
        })
    }
}

impl Occlusion {
    /// Returns whether the occlusion covers the centre of a pixel.
    pub fn covers_pixel(&self, column: usize, row: usize) -> bool {
        let center = [column as f64, row as f64];
        let is_painted = |mask: &Mask| mask.is_forbidden(column, row);
        self.parts.iter().any(|part| part.covers(center)) || self.mask.iter().any(is_painted)
    }
}

impl Scene {
    /// The pattern's points (u, v) in the image at the goal, px.
    pub fn goal_px(&self) -> impl Iterator<Item = [f64; 2]> {
        let (camera, t) = (&self.camera, self.goal.translation);
        self.pattern.iter().map(move |&point| {
            let turned = rotated(self.goal.rotation, point);
            let [x, y, z] = [0, 1, 2].map(|k| turned[k] + t[k]);
            [camera.cx + camera.fx * x / z, camera.cy + camera.fy * y / z]
        })
    }
}

/// A point turned by a rotation vector, rad.
///
/// Source: Rodrigues' formula, p cos a + (n x p) sin a + n (n.p) (1 - cos a).
fn rotated(rotation: [f64; 3], p: [f64; 3]) -> [f64; 3] {
    let angle = rotation.iter().map(|x| x * x).sum::<f64>().sqrt();
    if angle == 0.0 {
        return p;
    }
    let n = rotation.map(|x| x / angle);
    let (sin, cos) = angle.sin_cos();
    let along = (0..3).map(|k| n[k] * p[k]).sum::<f64>() * (1.0 - cos);
    [0, 1, 2].map(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        p[k] * cos + (n[i] * p[j] - n[j] * p[i]) * sin + n[k] * along
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(half: [f64; 2], p: f64) -> Part {
        let center = [300.0, 200.0];
        Part { center, half, p }
    }

    #[test]
    fn the_outline_is_the_border_of_what_is_covered() {
        for part in [part([75.0, 40.0], 2.0), part([30.0, 90.0], 8.0)] {
            let towards =
                |[u, v]: [f64; 2], by: f64| [300.0 + by * (u - 300.0), 200.0 + by * (v - 200.0)];
            for corner in part.outline(97) {
                assert!(part.covers(towards(corner, 0.999)), "{corner:?}");
                assert!(!part.covers(towards(corner, 1.001)), "{corner:?}");
                let [low, high] = part.bounds();
                assert!((0..2).all(|k| low[k] <= corner[k] && corner[k] <= high[k]));
            }
        }
        // The border itself is not covered.
        let circle = part([75.0, 75.0], 2.0);
        assert!(circle.covers([300.0, 274.0]) && !circle.covers([300.0, 275.0]));
    }

    #[test]
    fn the_goal_of_the_papers_scene_is_a_square_about_the_middle() {
        let scene = Scene::parse(crate::PAPER_SIM, "sim").unwrap();
        let square = [
            [312.0, 312.0],
            [712.0, 312.0],
            [712.0, 712.0],
            [312.0, 712.0],
        ];
        assert_eq!(scene.goal_px().count(), square.len());
        for (found, expected) in scene.goal_px().zip(square) {
            assert!((found[0] - expected[0]).hypot(found[1] - expected[1]) < 1e-9);
        }
    }

    #[test]
    fn a_rotation_vector_turns_by_the_right_hand() {
        use core::f64::consts::FRAC_PI_2;
        for (rotation, point, expected) in [
            ([0.0, 0.0, FRAC_PI_2], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
            ([FRAC_PI_2, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]),
            ([0.0, -FRAC_PI_2, 0.0], [2.0, 3.0, 0.0], [0.0, 3.0, 2.0]),
            ([0.0; 3], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]),
        ] {
            let found = rotated(rotation, point);
            assert!(
                (0..3).all(|k| (found[k] - expected[k]).abs() < 1e-12),
                "{found:?}"
            );
        }
    }
}
