//! Corners of each kind of board in pictures, beside the truth.

use crate::drawn::{boards, rms, seen};

/// Pictures of each board.
const PICTURES: usize = 1;

#[test]
fn corners_of_every_board_are_found_exactly() {
    for (name, board) in boards() {
        let seen = seen(&board, PICTURES);
        let all: usize = seen.truths.iter().map(Vec::len).sum();
        let most = seen.ours.iter().copied().fold(0.0, f64::max);
        testkit::tell(format_args!(
            "{name}: {} of {all} corners, {:.3} px RMS, {most:.2} at most",
            seen.ours.len(),
            rms(&seen.ours)
        ));
        assert!(
            seen.ours.len() as f64 > 0.98 * all as f64,
            "{name}: {} of {all}",
            seen.ours.len()
        );
        assert!(
            rms(&seen.ours) < 0.06 && most < 0.3,
            "{name}: {}",
            rms(&seen.ours)
        );
    }
}
