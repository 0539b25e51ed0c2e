//! A board as a drawing to print: SVG with sizes in mm.

use std::fmt::Write;

use markers::Family;
use tag_board::Board;
use vpc_camera::sheet::tag;

/// A4, mm.
const PAPER: [f64; 2] = [210.0, 297.0];
/// Paper that a printer leaves white on each side, mm; the words stand in there.
const MARGIN: f64 = 10.0;

/// Draws a board in the middle of an A4 page, upright or across; of a larger page if it must be.
pub fn svg(board: &Board) -> String {
    let family = Family::default();
    let extent = board.extent().map(|side| 1e3 * side);
    let [width, height] = page(extent, 1e3 * board.module());
    let (size, gap) = (1e3 * board.tag_size, 1e3 * board.gap);
    let last = board.first + board.columns * board.rows - 1;
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} {height}\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
    );
    for (number, corner) in board.tags() {
        let corner = [0, 1].map(|k| 0.5 * [width, height][k] + 1e3 * corner[k]);
        tag(&mut text, family, number, corner, size);
    }
    let words = format!(
        "36h11, {} x {}, tags {} to {last}: tag_size = {}, gap = {} (m). Print at 100 %; this line is 100 mm:",
        board.columns, board.rows, board.first, board.tag_size, board.gap
    );
    let _ = writeln!(
        text,
        "<text x=\"{MARGIN}\" y=\"{}\" font-family=\"sans-serif\" font-size=\"2.6\">{words}</text>\n\
         <path d=\"M{} {}h100m-100 -1.2v2.4m100 -2.4v2.4\" stroke=\"#000\" stroke-width=\"0.2\" fill=\"none\"/>\n\
         <!-- black squares of {size} mm, {gap} mm apart -->\n</svg>",
        height - 6.0,
        MARGIN,
        height - 3.6,
    );
    text
}

/// Width and height, mm.
fn page(extent: [f64; 2], module: f64) -> [f64; 2] {
    let needed = extent.map(|side| side + 2.0 * (MARGIN + module));
    let fits = |page: [f64; 2]| (0..2).all(|k| needed[k] <= page[k] + 1e-9);
    let [short, long] = PAPER;
    let pages = [[short, long], [long, short]];
    pages.into_iter().find(|page| fits(*page)).unwrap_or(needed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_are_a4_where_the_board_fits() {
        assert_eq!(page([255.0, 180.0], 3.75), [297.0, 210.0]);
        assert_eq!(page([100.0, 250.0], 3.75), [210.0, 297.0]);
        assert_eq!(page([400.0, 250.0], 5.0), [430.0, 280.0]);
    }
}
