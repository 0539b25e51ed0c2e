//! The plane of the pattern: table, box and the tags on them.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::gloss::Gloss;
use crate::homography::{Homography, Point};
use crate::lens::{Lens, Rays};
use crate::look::Look;
use crate::sheet::Sheet;
use crate::tag::Tag;
use crate::texture::Texture;

/// Pixels of a row over which the plane is taken to be linear.
const SPAN: usize = 16;
/// The box reaches this many sides of a tag's black square beyond the tag's centre.
const EDGE: f64 = 1.0;

/// How far from the box tags may lie about on the table, sides of a black square.
const ABOUT: f64 = 8.0;
/// Clutter has numbers below, the highest first.
const CLUTTER_NUMBERS: usize = 36;
/// Distinguishes the random numbers of the clutter from those of the texture.
const CLUTTER: u64 = 0x7a65;

/// The plane with its tags.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    look: Look,
    gloss: Option<Gloss>,
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
        let clutter = clutter(tags, look, outline);
        let all = tags.iter().chain(&clutter);
        Self {
            look: *look,
            gloss: Gloss::new(look),
            sheets: all.map(|tag| Sheet::new(tag, look)).collect(),
            outline,
        }
    }

    /// Finds where tags may be seen in an image while they are seen by these maps, one after
    /// another; see [`Sheet::aim`]. Call it before the rows are drawn.
    pub fn aim(&mut self, maps: &[Homography], lens: &Lens, image: [Point; 2], size: [usize; 2]) {
        for sheet in &mut self.sheets {
            sheet.aim(maps, lens, image, size);
        }
    }

    /// Draws a row of the image, `line`, as seen by the maps from the plane at the begin and at the
    /// end of its exposure. The ground is seen as in the middle, and the mirrored light from `eye`
    /// (object's frame, m).
    pub fn draw(
        &self,
        line: &mut [f32],
        row: usize,
        maps: &[Homography; 2],
        eye: &Vector3<f64>,
        rays: &Rays,
        texture: &Texture,
    ) {
        let [Some(first), Some(last)] = maps.map(|map| map.inverse()) else {
            line.fill(self.look.table_level as f32);
            return;
        };
        self.draw_ground(line, row, &first.between(&last, 0.5), rays, texture);
        let shine = |at: Point| self.gloss.map_or(0.0, |gloss| gloss.at(at, eye));
        for sheet in &self.sheets {
            sheet.draw(line, row, &[first, last], rays, shine);
        }
    }

    /// Box and table, textured and lit from the left; `back` leads to the plane.
    fn draw_ground(
        &self,
        line: &mut [f32],
        row: usize,
        back: &Homography,
        rays: &Rays,
        texture: &Texture,
    ) {
        let at = |u: usize| back.apply(rays.along(u, row));
        let (box_level, table_level) = (self.look.box_level as f32, self.look.table_level as f32);
        let amount = self.look.texture as f32;
        let outline = self.outline.map(|corner| corner.map(|x| x as f32));
        // Exact where spans meet, and linear between: only tags need more.
        let mut from = at(0);
        for (k, span) in line.chunks_mut(SPAN).enumerate() {
            let to = at(k * SPAN + SPAN);
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

/// Tags that lie about on the table beside the box, `outline`: as many as the look asks for, of the
/// size of the first one; the last is a copy of that one, farther away.
fn clutter(tags: &[Tag], look: &Look, outline: [Point; 2]) -> Vec<Tag> {
    let Some(&first) = tags.first() else {
        return Vec::new();
    };
    let mut random = ChaCha8Rng::seed_from_u64(look.seed ^ CLUTTER);
    let is_used = |number: &usize| tags.iter().any(|tag| tag.number == *number);
    let count = CLUTTER_NUMBERS.min(look.family.count() as usize);
    let numbers = (0..count).rev().filter(|number| !is_used(number));
    let mut numbers = numbers
        .take(look.clutter.saturating_sub(1))
        .collect::<Vec<_>>();
    numbers.extend((look.clutter > 0).then_some(first.number));
    let mut lying: Vec<Tag> = Vec::new();
    // A pattern that leaves no room has less clutter.
    for _ in 0..100 * look.clutter {
        let Some(&number) = numbers.get(lying.len()) else {
            break;
        };
        let is_copy = lying.len() + 1 == look.clutter;
        let about = ABOUT * first.size;
        let center = [0, 1].map(|k| {
            let (least, most) = (outline[0][k] - about, outline[1][k] + about);
            least + (most - least) * random.random::<f64>()
        });
        // From the box, and from the others, by its diagonal.
        let beside = [0, 1].map(|k| (outline[0][k] - center[k]).max(center[k] - outline[1][k]));
        let clear = if is_copy { 0.5 * about } else { first.size };
        let is_free = lying.iter().all(|other| {
            let apart = [0, 1].map(|k| other.center[k] - center[k]);
            apart[0].hypot(apart[1]) > 2.0 * first.size
        });
        if beside[0].max(beside[1]) > clear && is_free {
            lying.push(Tag {
                number,
                center,
                size: first.size,
            });
        }
    }
    lying
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clutter_lies_beside_the_box_with_other_numbers() {
        let tags = Tag::board(2, 2, 0.024, 0.1);
        let outline = Plane::new(&Look::default(), &tags).outline;
        for seed in 0..20 {
            let look = Look {
                clutter: 6,
                seed,
                ..Look::default()
            };
            let lying = clutter(&tags, &look, outline);
            assert_eq!(lying.len(), 6);
            assert_eq!(lying, clutter(&tags, &look, outline));
            let away = |tag: &Tag| {
                let [x, y] = [0, 1].map(|k| tag.center[k].abs() - outline[1][k]);
                x.max(y)
            };
            assert!(lying.iter().all(|tag| away(tag) > 0.024));
            assert!(lying[..5].iter().all(|tag| tag.number > 3));
            assert!(lying[5].number == 0 && away(&lying[5]) > 4.0 * 0.024);
        }
        assert!(clutter(&tags, &Look::default(), outline).is_empty());
    }
}
