//! A board as a drawing to print: SVG with sizes in mm.

use std::fmt::Write;

use tag_board::{Board, Kind};
use vpc_camera::sheet::tag;

/// A4, mm.
const PAPER: [f64; 2] = [210.0, 297.0];
/// Paper that a printer leaves white on each side, mm; the words stand in there.
const MARGIN: f64 = 10.0;

/// Draws a board in the middle of an A4 page, upright or across; of a larger page if it must be.
pub fn svg(board: &Board) -> String {
    let extent = board.extent().map(|side| 1e3 * side);
    let [width, height] = page(extent, 1e3 * board.module());
    let size = 1e3 * board.tag_size;
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} {height}\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
    );
    let place = |corner: [f64; 2]| [0, 1].map(|k| 0.5 * [width, height][k] + 1e3 * corner[k]);
    for (corner, side) in board.squares() {
        let ([x, y], side) = (place(corner), 1e3 * side);
        let _ = writeln!(
            text,
            "<rect x=\"{x:.4}\" y=\"{y:.4}\" width=\"{side:.4}\" height=\"{side:.4}\"/>"
        );
    }
    let is_turned = board.kind == Kind::Charuco && board.family.is_upside_down();
    for (number, corner) in board.tags() {
        let corner = place(corner);
        let [x, y] = corner.map(|x| x + 0.5 * size);
        let turn = if is_turned { 180 } else { 0 };
        let _ = writeln!(text, "<g transform=\"rotate({turn} {x:.4} {y:.4})\">");
        tag(&mut text, board.family, number, corner, size);
        text.push_str("</g>\n");
    }
    let words = format!("{}. Print at 100 %; this line is 100 mm:", words(board));
    let _ = writeln!(
        text,
        "<text x=\"{MARGIN}\" y=\"{}\" font-family=\"sans-serif\" font-size=\"2.6\">{words}</text>\n\
         <path d=\"M{} {}h100m-100 -1.2v2.4m100 -2.4v2.4\" stroke=\"#000\" stroke-width=\"0.2\" fill=\"none\"/>\n\
         </svg>",
        height - 6.0,
        MARGIN,
        height - 3.6,
    );
    text
}

/// What is printed, for its margin.
fn words(board: &Board) -> String {
    let Board {
        columns,
        rows,
        family,
        tag_size,
        gap,
        first,
        ..
    } = board;
    let tags = format!("{family}, {columns} x {rows}, tags from {first}: tag_size = {tag_size}");
    match (board.kind, board.square_size) {
        (Kind::Charuco, Some(square)) => format!("ChArUco, {tags}, square_size = {square} (m)"),
        (Kind::Chessboard, Some(square)) => {
            format!("{columns} x {rows} inner corners: square_size = {square} (m)")
        }
        (Kind::Aprilgrid, _) => format!("AprilGrid, {tags}, gap = {gap} (m)"),
        _ => format!("{tags}, gap = {gap} (m)"),
    }
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
