//! `vpc-calib intrinsics`.

use std::sync::atomic::AtomicBool;

use crate::arguments::IntrinsicsArguments;
use crate::command::{Failure, check_outputs, conclude, views};
use crate::detector::Detector;
use crate::view::View;
use crate::{intrinsics, layout, output};

pub fn run(arguments: &IntrinsicsArguments, stop: &AtomicBool) -> Result<bool, Failure> {
    check_outputs(&arguments.output)?;
    let (target, board) = arguments.target.read()?;
    let mut detector = Detector::new(&board.unwrap_or_default())?;
    let taken = match &arguments.images.images {
        Some(folder) => views::of_folder(folder, &mut detector)?,
        None => views::of_camera(&arguments.images, detector, &target, false, stop)?,
    };
    let views: Vec<View> = taken.views.into_iter().map(|(view, _)| view).collect();
    if let Some(board) = &board {
        layout::check(&views, board)?;
    }
    let result = intrinsics::calibrate(&views, &target, taken.size, arguments.k3);
    let result = result.map_err(Failure::not_enough)?;
    let is_good = conclude(&result, &result.verdict(), &arguments.output, |path| {
        output::intrinsics(path, &result)
    })?;
    if is_good {
        print!("{}", output::scene_keys(&result.camera));
    }
    Ok(is_good)
}
