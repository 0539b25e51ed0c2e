//! The image plane in Braille: occlusions, trails, way point, goal, features.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::Block;
use ratatui::widgets::canvas::{Canvas, Context, Painter, Points, Shape};

use super::screen::Screen;
use crate::stage::Stage;

/// How much of the past a trail shows, ns.
const TRAIL_NS: u64 = 5_000_000_000;

/// Columns, borders and all, of an image plane of this many rows whose pixels are square: a character is twice as high
/// as wide.
pub fn columns(rows: u16, size: [f64; 2]) -> u16 {
    let inner = f64::from(rows.saturating_sub(2));
    (2.0 * inner * size[0] / size[1]).round() as u16 + 2
}

/// Rows, borders and all, for this many columns.
pub fn rows(columns: u16, size: [f64; 2]) -> u16 {
    let inner = f64::from(columns.saturating_sub(2));
    (inner * size[1] / size[0] / 2.0).round() as u16 + 2
}

/// Areas in which no feature may be: every second dot, so that what is drawn above stays readable.
struct Hatch<'a> {
    stage: &'a Stage,
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
                if (x + y) % 2 == 0 && self.stage.touches([u - du, v - dv], [u + du, v + dv]) {
                    painter.paint(x, y, self.color);
                }
            }
        }
    }
}

/// Draws the image plane into this area.
pub fn draw(frame: &mut Frame, area: Rect, screen: &Screen) {
    let size = screen.stage.size(screen.view);
    let title = format!(" image {:.0} x {:.0} px ", size[0], size[1]);
    let canvas = Canvas::default()
        .block(Block::bordered().title(title))
        .marker(Marker::Braille)
        .x_bounds([0.0, size[0]])
        .y_bounds([0.0, size[1]])
        .paint(|context| paint(context, screen, size[1]));
    frame.render_widget(canvas, area);
}

fn paint(context: &mut Context, screen: &Screen, height: f64) {
    let color = |color| screen.color(color);
    if !screen.stage.is_bare() {
        context.draw(&Hatch {
            stage: screen.stage,
            height,
            color: color(Color::DarkGray),
        });
        context.layer();
    }
    let up = |[u, v]: [f64; 2]| (u, height - v);
    let trail: Vec<(f64, f64)> = screen
        .view
        .recent(TRAIL_NS)
        .flat_map(|record| record.pairs())
        .map(up)
        .collect();
    context.draw(&Points::new(&trail, color(Color::Blue)));
    context.layer();
    let mut print = |[u, v]: [f64; 2], text: String, style: Style| {
        context.print(u, height - v, Line::from(Span::styled(text, style)));
    };
    for point in screen.stage.goal() {
        print(
            point,
            "+".to_owned(),
            Style::new().fg(color(Color::Green)).bold(),
        );
    }
    let Some(record) = screen.view.latest() else {
        return;
    };
    for point in record.way_point_pairs() {
        print(
            point,
            "o".to_owned(),
            Style::new().fg(color(Color::Yellow)).bold(),
        );
    }
    for (index, point) in record.pairs().enumerate() {
        let style = Style::new().fg(color(Color::Cyan)).bold();
        print(point, (index + 1).to_string(), style);
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
