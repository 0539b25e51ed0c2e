//! `vpc-camera tags`: the tags of a scene on a sheet to print, where its pattern has them.

use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::Args;
use markers::Family;
use scene::Scene;

/// Paper about the markers, mm.
const MARGIN: f64 = 15.0;

/// What to draw.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The scene: its pattern's points are the centres, its marker_size the side of a tag with the
    /// white border (TOML).
    scene: PathBuf,
    /// Numbers of the tags, in the order of the points; 0, 1, ... where they are not given.
    #[arg(long, value_delimiter = ',', value_name = "NUMBERS")]
    tags: Option<Vec<u32>>,
    /// Family of the tags, by OpenCV's name.
    #[arg(long, default_value_t)]
    family: Family,
    /// The drawing (SVG), in its true size.
    #[arg(short, long)]
    output: PathBuf,
    /// Overwrite what exists.
    #[arg(long)]
    force: bool,
}

/// Writes the drawing; returns what to say about it.
///
/// # Errors
/// What was refused, with what is allowed.
pub fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let file = arguments.output.display();
    if arguments.output.exists() && !arguments.force {
        bail!("{file}: exists; allowed: a new file, or --force to overwrite");
    }
    let scene = Scene::read(&arguments.scene)?;
    let points = scene.pattern.len();
    let numbers = match &arguments.tags {
        Some(numbers) => numbers.clone(),
        None => (0..points as u32).collect(),
    };
    let family = arguments.family;
    let text =
        svg(&scene, family, &numbers).with_context(|| arguments.scene.display().to_string())?;
    fs::write(&arguments.output, text).with_context(|| format!("{file}: cannot write"))?;
    let black = 1e3 * scene.marker_size * family.black_share();
    Ok(format!(
        "wrote {file}: print it at 100 %; each black square is {black:.2} mm wide, as measured between its outer edges\n"
    ))
}

/// Draws these tags of a family at the points of a scene's pattern, x to the right and y down.
///
/// # Errors
/// Markers without a size or that overlap, or numbers that are not one for each point.
pub fn svg(scene: &Scene, family: Family, numbers: &[u32]) -> anyhow::Result<String> {
    let points = Vec::from_iter(scene.pattern.iter().map(|p| [1e3 * p[0], 1e3 * p[1]]));
    let side = 1e3 * scene.marker_size;
    if side <= 0.0 {
        bail!(
            "pattern.marker_size: none; allowed: the side of a tag with its white border, above 0 m"
        );
    }
    let known = family.count();
    let is_known = numbers.iter().all(|number| *number < known);
    if numbers.len() != points.len() || !is_known {
        let count = points.len();
        bail!(
            "tags {numbers:?}; allowed: {count} numbers below {known}, one for each point of the pattern"
        );
    }
    for (k, a) in points.iter().enumerate() {
        if points[..k]
            .iter()
            .any(|b| (a[0] - b[0]).abs().max((a[1] - b[1]).abs()) < side - 1e-9)
        {
            bail!(
                "pattern.marker_size: {side} mm, and point {k} is nearer to another; allowed: tags beside each other"
            );
        }
    }
    let reach = 0.5 * side + MARGIN;
    let bound = |k: usize, sign: f64| {
        let values = points.iter().map(|p| sign * p[k]);
        sign * (values.fold(f64::NEG_INFINITY, f64::max) + reach)
    };
    let (left, top) = (bound(0, -1.0), bound(1, -1.0));
    let (width, height) = (bound(0, 1.0) - left, bound(1, 1.0) - top);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.3}mm\" height=\"{height:.3}mm\" viewBox=\"{left:.3} {top:.3} {width:.3} {height:.3}\">\n\
         <rect x=\"{left:.3}\" y=\"{top:.3}\" width=\"{width:.3}\" height=\"{height:.3}\" fill=\"#fff\"/>\n"
    );
    for (center, number) in points.iter().zip(numbers) {
        let black = side * family.black_share();
        let corner = center.map(|value| value - 0.5 * black);
        tag(&mut text, family, *number, corner, black);
    }
    let (x, y) = (left + 5.0, top + height - 5.0);
    let _ = writeln!(
        text,
        "<text x=\"{x:.3}\" y=\"{:.3}\" font-family=\"sans-serif\" font-size=\"2.6\">tags {numbers:?} of {family}; print at 100 %, \
         this line is 50 mm:</text>\n\
         <path d=\"M{x:.3} {y:.3}h50m-50 -1.2v2.4m50 -2.4v2.4\" stroke=\"#000\" stroke-width=\"0.2\" fill=\"none\"/>\n</svg>",
        y - 2.4
    );
    Ok(text)
}

/// Draws a tag into an SVG: a black square with this upper left corner and side, mm, and its white
/// bits, which are one path so that no seam shows between them.
pub fn tag(text: &mut String, family: Family, number: u32, [x, y]: [f64; 2], side: f64) {
    let modules = family.black();
    let module = side / modules as f64;
    let _ = write!(
        text,
        "<rect x=\"{x:.4}\" y=\"{y:.4}\" width=\"{side:.4}\" height=\"{side:.4}\"/><path fill=\"#fff\" d=\""
    );
    for place in (0..modules * modules).map(|k| [k % modules, k / modules]) {
        if family.is_white(number, place) {
            let [column, row] = place.map(|k| k as f64 * module);
            let [u, v] = [x + column, y + row];
            let _ = write!(text, "M{u:.4} {v:.4}h{module:.4}v{module:.4}h-{module:.4}z");
        }
    }
    text.push_str("\"/>\n");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawn::Drawing;
    use crate::grey::Grey;
    use crate::tags::{TagFinder, Templates};

    /// Pixels a millimetre: edges lie between pixels, as a camera sees them.
    const SCALE: f64 = 2.3;

    /// What a printer makes of the squares: the levels of an image, its width and height.
    fn drawn(text: &str, origin: [f64; 2], size: [f64; 2]) -> (Vec<u8>, usize, usize) {
        let mut squares = Vec::new();
        for line in text.lines().filter(|line| line.contains("<path fill")) {
            let number = |text: &str, key: &str| -> f64 {
                let (_, rest) = text.split_once(key).unwrap();
                let end = rest.find(['"', ' ', 'h', 'v']).unwrap_or(rest.len());
                rest[..end].parse().unwrap()
            };
            let (square, bits) = line.split_once("<path").unwrap();
            let of = |key| number(square, key);
            squares.push((of("x=\""), of("y=\""), of("width=\""), 0.0));
            for bit in bits.split('M').skip(1) {
                squares.push((number(bit, ""), number(bit, " "), number(bit, "h"), 255.0));
            }
        }
        let [width, height] = size.map(|side| (SCALE * side) as usize);
        let mut drawing = Drawing::new(width, height, 255.0);
        drawing.paint(|u, v| {
            let [a, b] = [(u, origin[0]), (v, origin[1])].map(|(x, o)| (x + 0.5) / SCALE + o);
            let is_in = |(x, y, side, _): &&(f64, f64, f64, f64)| {
                (*x..x + side).contains(&a) && (*y..y + side).contains(&b)
            };
            // The last one lies above the others.
            squares.iter().rev().find(is_in).map(|square| square.3)
        });
        (drawing.pixels(0.0, 1), width, height)
    }

    fn edited(from: &str, to: &str) -> Scene {
        let text = scene::TAGS_ROBOT.replace(from, to);
        assert_ne!(text, scene::TAGS_ROBOT);
        Scene::parse(&text, "tags").unwrap()
    }

    #[test]
    fn printed_tags_are_found_where_the_pattern_has_them() {
        let scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        let numbers = [7, 0, 586, 42];
        let family = Family::default();
        let text = svg(&scene, family, &numbers).unwrap();
        // Millimetres, and a line of 50 of them.
        assert!(
            text.contains("width=\"180.000mm\" height=\"150.000mm\" viewBox=\"-90.000 -75.000")
        );
        let (pixels, width, height) = drawn(&text, [-90.0, -75.0], [180.0, 150.0]);
        let image = Grey::new(&pixels, width, height, width).unwrap();
        let mut finder =
            TagFinder::new(&Templates::new(family).unwrap(), width, height, 1).unwrap();
        let found = finder.find(&image).unwrap();
        assert_eq!(found.len(), 4);
        for (number, [x, y, _]) in numbers.iter().zip(&scene.pattern) {
            let tag = found.iter().find(|tag| tag.number == *number).unwrap();
            // Upper left first: the tag is upright.
            let half = 0.5 * 0.8 * scene.marker_size;
            for ([u, v], [dx, dy]) in [
                (tag.centre, [0.0, 0.0]),
                (tag.corners[0], [-half, -half]),
                (tag.corners[2], [half, half]),
            ] {
                let at = [(x + dx) * 1e3 + 90.0, (y + dy) * 1e3 + 75.0];
                let [a, b] = at.map(|mm| SCALE * mm - 0.5);
                assert!((u - a).hypot(v - b) < 0.1, "{number}: {u} {v}, {a} {b}");
            }
        }
    }

    #[test]
    fn what_cannot_be_printed_is_refused() {
        let refused = |scene: &Scene, numbers: &[u32]| {
            svg(scene, Family::default(), numbers)
                .unwrap_err()
                .to_string()
        };
        let tags = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        let points = edited("marker_size = 0.03", "");
        let large = edited("marker_size = 0.03", "marker_size = 0.1");
        assert!(refused(&points, &[0, 1, 2, 3]).starts_with("pattern.marker_size: none; allowed"));
        assert!(refused(&large, &[0, 1, 2, 3]).contains("marker_size: 100 mm, and point"));
        assert!(refused(&tags, &[0, 1, 2]).contains("allowed: 4 numbers below 587"));
        assert!(refused(&tags, &[0, 1, 2, 587]).contains("allowed: 4 numbers below 587"));
    }
}
