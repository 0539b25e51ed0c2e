//! Corners of boards, beside OpenCV's.

use std::path::PathBuf;

use tag_board::{Board, Kind};
use testkit::python::{Environment, run, script};
use vpc_calib::target::Point;

use crate::drawn::{apart, boards, rms, seen};

/// OpenCV's corners; `None`, after `not_run`, where there is none.
pub fn judged(what: &str, board: &Board, pictures: &[PathBuf]) -> Option<Vec<Vec<(u32, Point)>>> {
    let python = Environment::JUDGES.python(what)?;
    let mut given = serde_json::to_value(board).unwrap();
    given["pictures"] = serde_json::json!(pictures);
    let place = testkit::Place::new();
    let file = place.file("given.json", given.to_string());
    let program = testkit::root().join("ipc/clients/calib/tests/judges/boards.py");
    let said = run(script(&python, &program).arg(file)).unwrap();
    Some(serde_json::from_str(&said).unwrap())
}

#[test]
fn corners_of_every_board_are_found_as_often_as_by_opencv_and_as_exactly() {
    let pictures = testkit::repeats("pictures of each board", 4, 8);
    for (name, board) in boards() {
        let seen = seen(&board, pictures);
        let place = testkit::Place::new();
        let files = seen.pictures.iter().enumerate().map(|(k, picture)| {
            let file = place.path(&format!("{k}.png"));
            picture.write(&file).unwrap();
            file
        });
        let files: Vec<_> = files.collect();
        let Some(theirs) = judged(name, &board, &files) else {
            continue;
        };
        let theirs: Vec<f64> = theirs
            .iter()
            .zip(&seen.truths)
            .flat_map(|(found, truth)| {
                found.iter().map(move |(number, at)| {
                    // OpenCV may begin a chessboard at either end.
                    let same = truth
                        .iter()
                        .filter(|(n, _)| board.kind == Kind::Chessboard || n == number);
                    same.map(|(_, there)| apart(*at, *there))
                        .fold(f64::INFINITY, f64::min)
                })
            })
            .collect();
        testkit::tell(format_args!(
            "{name}, OpenCV: {} corners, {:.3} px RMS",
            theirs.len(),
            rms(&theirs)
        ));
        assert!(seen.ours.len() >= theirs.len(), "{name}");
        assert!(
            rms(&seen.ours) < 1.02 * rms(&theirs),
            "{name}: {}",
            rms(&theirs)
        );
    }
}
