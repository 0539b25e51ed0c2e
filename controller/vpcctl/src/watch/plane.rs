//! The image plane in Braille: occlusions, trails, way point, goal, features. Hidden ones are
//! red, in the ellipse of where they are believed.

use messages::CycleRecord;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::Block;
use ratatui::widgets::canvas::{Canvas, Context, Line as CanvasLine, Painter, Points, Shape};

use super::palette::Palette;
use crate::image_plane::ImagePlane;
use crate::view::View;

/// How much of the past a trail shows, ns.
const TRAIL_NS: u64 = 5_000_000_000;

/// Columns, with borders, that give an image plane of this many rows square pixels. A character is
/// twice as high as wide.
pub fn columns(rows: u16, size: [f64; 2]) -> u16 {
    let inner = f64::from(rows.saturating_sub(2));
    (2.0 * inner * size[0] / size[1]).round() as u16 + 2
}

/// Rows with borders for this many columns.
pub fn rows(columns: u16, size: [f64; 2]) -> u16 {
    let inner = f64::from(columns.saturating_sub(2));
    (inner * size[1] / size[0] / 2.0).round() as u16 + 2
}

/// Areas in which no feature may be: every second dot, so that what is drawn above stays readable.
struct Hatch<'a> {
    plane: &'a ImagePlane,
    height: f64,
    color: Color,
}

impl Shape for Hatch<'_> {
    fn draw(&self, painter: &mut Painter) {
        let (&[left, right], &[bottom, top]) = painter.bounds();
        let Some((columns, rows)) = painter.get_point(right, bottom) else {
            return;
        };
        for x in 0..=columns {
            for y in 0..=rows {
                // Nodes of the grid reach from edge to edge, and half a step around.
                let part = |i: usize, of: usize| i as f64 / of.max(1) as f64;
                let half = |size: f64, of: usize| size / of.max(1) as f64 / 2.0;
                let (du, dv) = (half(right - left, columns), half(top - bottom, rows));
                let u = left + part(x, columns) * (right - left);
                let v = self.height - (top - part(y, rows) * (top - bottom));
                if (x + y) % 2 == 0 && self.plane.touches([u - du, v - dv], [u + du, v + dv]) {
                    painter.paint(x, y, self.color);
                }
            }
        }
    }
}

/// Draws the image plane into this area.
pub fn draw(frame: &mut Frame, area: Rect, plane: &ImagePlane, view: &View, palette: Palette) {
    let size = plane.size(view);
    let hint = match plane.has_scene() {
        true => "",
        false => "without scene ",
    };
    let title = format!(" image {:.0} x {:.0} px {hint}", size[0], size[1]);
    let canvas = Canvas::default()
        .block(Block::bordered().title(title))
        .marker(Marker::Braille)
        .x_bounds([0.0, size[0]])
        .y_bounds([0.0, size[1]])
        .paint(|context| paint(context, plane, view, size[1], palette));
    frame.render_widget(canvas, area);
}

fn paint(context: &mut Context, plane: &ImagePlane, view: &View, height: f64, palette: Palette) {
    let color = palette.color(Color::DarkGray);
    context.draw(&Hatch {
        plane,
        height,
        color,
    });
    context.layer();
    let trail: Vec<(f64, f64)> = view
        .trail(TRAIL_NS)
        .flat_map(|record| record.pairs())
        .map(|[u, v]| (u, height - v))
        .collect();
    context.draw(&Points::new(&trail, palette.color(Color::Blue)));
    context.layer();
    for way in view.seen.iter().flat_map(CycleRecord::foreseen) {
        let way: Vec<_> = way.collect();
        for pair in way.windows(2) {
            if let &[[u, v], [to_u, to_v]] = pair {
                let color = palette.color(Color::Yellow);
                context.draw(&CanvasLine::new(u, height - v, to_u, height - to_v, color));
            }
        }
    }
    let ellipses = view.seen.iter().flat_map(CycleRecord::ellipses);
    let outlines: Vec<(f64, f64)> = ellipses
        .flat_map(|(_, outline)| outline)
        .map(|[u, v]| (u, height - v))
        .collect();
    context.draw(&Points::new(&outlines, palette.color(Color::Red)));
    context.layer();
    let mut print = |[u, v]: [f64; 2], text: String, color: Color| {
        let style: Style = palette.style(color).bold();
        context.print(u, height - v, Line::from(Span::styled(text, style)));
    };
    for point in plane.goal() {
        print(point, "+".to_owned(), Color::Green);
    }
    let Some(seen) = &view.seen else {
        return;
    };
    for point in seen.way_point_pairs() {
        print(point, "o".to_owned(), Color::Yellow);
    }
    for (index, point) in seen.pairs().enumerate() {
        let color = if seen.sees(index) {
            Color::Cyan
        } else {
            Color::Red
        };
        print(point, index.to_string(), color);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_square_where_characters_are_twice_as_high_as_wide() {
        assert_eq!(columns(20, [1600.0, 1200.0]), 50);
        assert_eq!(rows(50, [1600.0, 1200.0]), 20);
    }
}
