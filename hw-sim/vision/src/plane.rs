//! The plane of the pattern: table, box and the tags on it.

use crate::homography::{Homography, Point};
use crate::look::Look;
use crate::sheet::Sheet;
use crate::tag::Tag;
use crate::texture::Texture;

/// Pixels of a row over which the plane is taken to be linear.
const SPAN: usize = 16;
/// The box reaches this many sides of a tag's black square beyond the tag's centre.
const EDGE: f64 = 1.0;

/// The plane with its tags.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    look: Look,
    sheets: Vec<Sheet>,
    /// Corner of the box that is least and that is greatest in x and y, m.
    outline: [Point; 2],
}

impl Plane {
    pub fn new(look: &Look, tags: &[Tag]) -> Self {
        let mut outline = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        for tag in tags {
            let margin = EDGE * tag.size;
            for k in 0..2 {
                outline[0][k] = outline[0][k].min(tag.center[k] - margin);
                outline[1][k] = outline[1][k].max(tag.center[k] + margin);
            }
        }
        Self {
            look: *look,
            sheets: tags.iter().map(|tag| Sheet::new(tag, look)).collect(),
            outline,
        }
    }

    /// Finds where tags may be seen in an image of this size while the map goes from the first to
    /// the last. Call it before the rows are drawn.
    pub fn aim(&mut self, maps: &[Homography], size: [usize; 2]) {
        for sheet in &mut self.sheets {
            sheet.aim(maps, size);
        }
    }

    /// Draws a row of the image, `line`, as seen by a map from the plane.
    pub fn draw(&self, line: &mut [f32], row: usize, map: &Homography, texture: &Texture) {
        let Some(back) = map.inverse() else {
            line.fill(self.look.table_level as f32);
            return;
        };
        self.draw_ground(line, row, &back, texture);
        for sheet in &self.sheets {
            sheet.draw(line, row, &back);
        }
    }

    /// Box and table, textured and lit from the left; `back` leads to the plane.
    fn draw_ground(&self, line: &mut [f32], row: usize, back: &Homography, texture: &Texture) {
        let at = |u: f64| back.apply([u, row as f64]);
        let (box_level, table_level) = (self.look.box_level as f32, self.look.table_level as f32);
        let amount = self.look.texture as f32;
        let outline = self.outline.map(|corner| corner.map(|x| x as f32));
        // Exact where spans meet, and linear between: only tags need more.
        let mut from = at(0.0);
        for (k, span) in line.chunks_mut(SPAN).enumerate() {
            let to = at((k * SPAN + SPAN) as f64);
            let (Some(first), Some(next)) = (from, to) else {
                // Beyond the horizon of the plane.
                span.fill(table_level);
                from = to;
                continue;
            };
            let step = [0, 1].map(|k| ((next[k] - first[k]) / SPAN as f64) as f32);
            let [mut x, mut y] = first.map(|x| x as f32);
            for level in span {
                let on_box = (x > outline[0][0] && x < outline[1][0])
                    && (y > outline[0][1] && y < outline[1][1]);
                let (base, amount) = if on_box {
                    (box_level, amount)
                } else {
                    (table_level, 1.5 * amount)
                };
                let grain = texture.at(x, y);
                *level = (1.0 - 0.5 * x.clamp(-0.3, 0.3)) * (base + amount * grain);
                x += step[0];
                y += step[1];
            }
            from = to;
        }
    }
}
