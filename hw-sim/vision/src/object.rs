//! An object before the camera: opaque, lit from the front, with a grain of its own.

use scene::Occlusion;

use crate::layer::{Area, coverage, relief};
use crate::lens::Lens;
use crate::look::Look;
use crate::texture::Texture;

/// An object, ready to be drawn.
#[derive(Clone, Debug)]
pub(crate) struct Object {
    area: Area,
    coverage: Vec<f32>,
    light: Vec<f32>,
}

impl Object {
    pub fn new(
        occlusion: &Occlusion,
        lens: &Lens,
        look: &Look,
        texture: &Texture,
        width: usize,
        height: usize,
    ) -> Self {
        let area = Area::around(occlusion, lens, 1.0, width, height);
        let mut light = relief(occlusion, lens, area);
        for (i, x) in light.iter_mut().enumerate() {
            let (u, v) = (area.column + i % area.width, area.row + i / area.width);
            let grain = texture.texel(u / 5, v * 5);
            let level = look.object_level as f32 * (0.55 + 0.6 * *x);
            *x = level + 0.5 * look.texture as f32 * grain;
        }
        Self {
            area,
            coverage: coverage(occlusion, lens, area),
            light,
        }
    }

    /// Covers what lies behind the object, in levels of an image of this width.
    pub fn cover(&self, levels: &mut [f32], width: usize) {
        for (row, range) in self.area.rows(width) {
            let inside = row * self.area.width..(row + 1) * self.area.width;
            let layer = self.light[inside.clone()]
                .iter()
                .zip(&self.coverage[inside]);
            for (level, (light, coverage)) in levels[range].iter_mut().zip(layer) {
                *level += coverage * (light - *level);
            }
        }
    }
}
