//! What is drawn into an image: circles, lines and words, in a few colours.

use foxglove::messages::{
    CircleAnnotation, Color, Point2, PointsAnnotation, TextAnnotation, Timestamp,
    points_annotation::Type,
};

pub(crate) const BLUE: Color = color(0.12, 0.31, 0.85, 1.0);
pub(crate) const RED: Color = color(0.85, 0.12, 0.12, 1.0);
pub(crate) const AMBER: Color = color(0.66, 0.38, 0.0, 1.0);
pub(crate) const GREY: Color = color(0.45, 0.47, 0.5, 1.0);
pub(crate) const SHADE: Color = color(0.45, 0.47, 0.5, 0.3);
pub(crate) const DARK: Color = color(0.1, 0.1, 0.1, 1.0);
pub(crate) const LIGHT: Color = color(1.0, 1.0, 1.0, 0.8);
pub(crate) const CLEAR: Color = color(0.0, 0.0, 0.0, 0.0);

const fn color(r: f64, g: f64, b: f64, a: f64) -> Color {
    Color { r, g, b, a }
}

/// A time on the wall clock.
pub(crate) fn time(wall_ns: u64) -> Option<Timestamp> {
    let sec = u32::try_from(wall_ns / 1_000_000_000).ok()?;
    Timestamp::new_checked(sec, (wall_ns % 1_000_000_000) as u32)
}

/// Foxglove counts from the corner of the first pixel, we from its centre.
fn point([u, v]: [f64; 2]) -> Point2 {
    Point2 {
        x: u + 0.5,
        y: v + 0.5,
    }
}

pub(crate) fn circle(
    at: Option<Timestamp>,
    center: [f64; 2],
    diameter: f64,
    line: Color,
    fill: Color,
) -> CircleAnnotation {
    CircleAnnotation {
        timestamp: at,
        position: Some(point(center)),
        diameter,
        thickness: 2.0,
        fill_color: Some(fill),
        outline_color: Some(line),
        ..CircleAnnotation::default()
    }
}

pub(crate) fn lines(
    at: Option<Timestamp>,
    kind: Type,
    corners: impl Iterator<Item = [f64; 2]>,
    line: Color,
) -> PointsAnnotation {
    PointsAnnotation {
        timestamp: at,
        r#type: kind.into(),
        points: corners.map(point).collect(),
        outline_color: Some(line),
        fill_color: Some(CLEAR),
        thickness: 2.0,
        ..PointsAnnotation::default()
    }
}

pub(crate) fn text(at: Option<Timestamp>, left: [f64; 2], text: String) -> TextAnnotation {
    TextAnnotation {
        timestamp: at,
        position: Some(point(left)),
        text,
        font_size: 16.0,
        text_color: Some(DARK),
        background_color: Some(LIGHT),
        ..TextAnnotation::default()
    }
}
