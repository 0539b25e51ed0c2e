//! `vpc-calib hand-eye`.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use program::Exit;
use toml_schema::FileError;
use vpc_camera::lens;

use crate::arguments::HandEyeArguments;
use crate::camera::Camera;
use crate::command::views::Views;
use crate::command::{Failure, check_outputs, conclude, oriented, views};
use crate::hand_eye::{self, HandEye, Mounting, Pair};
use crate::pose_file::{self, RobotPose};
use crate::view::View;
use crate::{layout, output};

pub fn run(arguments: &HandEyeArguments, stop: &AtomicBool) -> Result<bool, Failure> {
    check_outputs(&arguments.output)?;
    let result = match (&arguments.poses, &arguments.images.images) {
        (Some(poses), None) => of_poses(poses, arguments.mounting())?,
        _ => of_images(arguments, stop)?,
    };
    conclude(&result, &result.verdict(), &arguments.output, |_| {
        output::hand_eye(&result)
    })
}

fn of_poses(path: &Path, mounting: Mounting) -> Result<HandEye, Failure> {
    let poses = pose_file::read(path)?;
    if let Some(without) = poses.iter().find(|pose| pose.board.is_none()) {
        let allowed = "columns board_x to board_qw too, or --images";
        let path = path.display().to_string();
        return Err(FileError::value(&path, "poses", &without.image, allowed).into());
    }
    hand_eye::calibrate_poses(&poses, mounting).map_err(Failure::not_enough)
}

fn of_images(arguments: &HandEyeArguments, stop: &AtomicBool) -> Result<HandEye, Failure> {
    let Some(camera) = &arguments.camera else {
        let allowed = "a calibration of the camera, for images";
        return Err(FileError::value("command line", "--camera", "none", allowed).into());
    };
    let lens = lens::read(camera)?;
    let (target, board) = arguments.target.read()?;
    let mut detector = oriented(board)?;
    let (size, mut pairs) = match &arguments.images.images {
        Some(folder) => {
            let poses = arguments
                .poses
                .clone()
                .unwrap_or_else(|| folder.join("poses.csv"));
            let poses = pose_file::read(&poses)?;
            let taken = views::of_folder(folder, &mut detector)?;
            (taken.size, together(taken, &poses, folder)?)
        }
        None => {
            let taken = views::of_camera(&arguments.images, detector, &target, true, stop)?;
            let pair = |(view, q): (View, Option<_>)| {
                q.map(|q| Pair {
                    flange: pose_file::flange(q),
                    view,
                })
            };
            (
                taken.size,
                taken.views.into_iter().filter_map(pair).collect(),
            )
        }
    };
    lens.check_size(size)?;
    if let Some(board) = &board {
        let views: Vec<View> = pairs.iter().map(|pair| pair.view.clone()).collect();
        layout::check(&views, board)?;
    }
    for pair in &mut pairs {
        pair.view.straighten(&lens);
    }
    let camera = Camera::pinhole(&lens);
    let result = hand_eye::calibrate(&pairs, arguments.mounting(), &camera, &target);
    result.map_err(Failure::not_enough)
}

/// Images with their poses, in the order of the poses.
fn together(taken: Views, poses: &[RobotPose], folder: &Path) -> Result<Vec<Pair>, Failure> {
    let mut pairs = Vec::new();
    for RobotPose { image, flange, .. } in poses {
        let found = taken.views.iter().find(|(view, _)| view.name == *image);
        let Some((view, _)) = found else {
            let message = format!(
                "{}: the poses name {image}, which is not there",
                folder.display()
            );
            return Err(Failure::new(Exit::NoInput, message));
        };
        pairs.push(Pair {
            flange: *flange,
            view: view.clone(),
        });
    }
    let without = taken.views.len() - pairs.len();
    if without > 0 {
        eprintln!("{without} images without a pose are left out");
    }
    Ok(pairs)
}
