//! A pattern as the camera sees it, without the law's checks of the goal.

use figures::{Offender, Points, Seen};
use scene::{Pose, Scene};
use vpc::{TaskError, camera, task};

/// The pattern of a scene at a pose, with its markers in their size. Points behind the camera are
/// left out.
pub fn seen(scene: &Scene, pose: &Pose) -> Seen {
    let pixels = |points: &[[f64; 3]]| -> Points {
        let placed = task::placed(points, pose);
        let pixel = |x| camera::project(&scene.camera, x);
        placed.filter_map(|x| pixel(x.into())).collect()
    };
    let half = 0.5 * scene.marker_size;
    let marker = |&[x, y, z]: &[f64; 3]| {
        let corners = [[-half, -half], [half, -half], [half, half], [-half, half]];
        pixels(&corners.map(|[a, b]| [x + a, y + b, z]))
    };
    let markers = scene.pattern.iter().filter(|_| half > 0.0);
    Seen {
        points: pixels(&scene.pattern),
        markers: markers.map(marker).collect(),
    }
}

/// The point that a task is refused for.
pub fn offender(error: &TaskError) -> Option<Offender> {
    let (point, radius) = match *error {
        // Not to be drawn.
        TaskError::GoalBehindCamera { .. } | TaskError::TooManyParts { .. } => return None,
        TaskError::GoalOffImage { point, .. }
        | TaskError::GoalOccluded { point, .. }
        | TaskError::GoalMasked { point, .. } => (point, 0.0),
        TaskError::GoalMarkerHidden { point, radius, .. } => (point, radius),
    };
    Some(Offender { point, radius })
}
