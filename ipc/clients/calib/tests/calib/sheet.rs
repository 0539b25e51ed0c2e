//! The printed board is the board: its corners are found where the file says.

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg;
use tag_board::Board;
use vpc_calib::detector::Detector;
use vpc_calib::picture::Picture;
use vpc_calib::sheet;
use vpc_calib::target::Target;

use crate::drawn::boards;

/// Dots a mm, and by how much the sheet is turned, deg: no camera sees it straight on its pixels.
const DOTS: f64 = 3.0;
const TURN: f64 = 3.0;

fn printed(board: &Board) -> Picture {
    let svg = sheet::svg(board);
    let tree = usvg::Tree::from_str(&svg, &usvg::Options::default()).unwrap();
    // CSS has 96 px an inch.
    let scale = (DOTS * 25.4 / 96.0) as f32;
    let size = tree.size().to_int_size().scale_by(scale).unwrap();
    let mut pixmap = Pixmap::new(size.width(), size.height()).unwrap();
    resvg::render(
        &tree,
        Transform::from_scale(scale, scale).post_rotate_at(
            TURN as f32,
            0.5 * size.width() as f32,
            0.5 * size.height() as f32,
        ),
        &mut pixmap.as_mut(),
    );
    let pixels: Vec<u8> = pixmap.pixels().iter().map(|pixel| pixel.green()).collect();
    let size = [size.width(), size.height()];
    // A lens blurs; the finder expects it.
    let pixels = blurred(&blurred(&pixels, 1), size[0] as usize);
    Picture { size, pixels }
}

/// Each pixel with a quarter of its neighbours so many pixels before and after it.
fn blurred(pixels: &[u8], step: usize) -> Vec<u8> {
    let at = |k: usize| u32::from(pixels[k.min(pixels.len() - 1)]);
    let mean = |k: usize| (at(k.saturating_sub(step)) + 2 * at(k) + at(k + step) + 2) / 4;
    (0..pixels.len()).map(|k| mean(k) as u8).collect()
}

#[test]
fn a_printed_board_has_its_corners_where_the_file_says() {
    let small = Board {
        columns: 9,
        rows: 14,
        tag_size: 0.016,
        gap: 0.004,
        first: 440,
        ..Board::default()
    };
    let others = boards().into_iter().map(|(_, board)| board);
    for board in [Board::default(), small].into_iter().chain(others) {
        let picture = printed(&board);
        let mut view = Detector::new(&board)
            .unwrap()
            .view("sheet", &picture.grey().unwrap())
            .unwrap();
        let target = Target::from(&board);
        assert_eq!(view.points.len(), target.len());
        view.keep_known(&target);
        assert_eq!(view.points.len(), target.len());
        // Tags are fitted whole; where squares meet there are fewer pixels.
        let bar = if board.square_size.is_some() {
            0.025
        } else {
            0.02
        };
        for ([x, y], [u, v]) in view.pairs(&target) {
            // The centre of the first pixel is (0, 0).
            let [width, height] = picture.size.map(f64::from);
            let [a, b] = [u + 0.5 - 0.5 * width, v + 0.5 - 0.5 * height];
            let (sine, cosine) = TURN.to_radians().sin_cos();
            let mm = [cosine * a + sine * b, cosine * b - sine * a].map(|x| x / DOTS);
            let off = (mm[0] - 1e3 * x).hypot(mm[1] - 1e3 * y);
            assert!(off < bar, "{off} mm at {x} {y}");
        }
    }
}
