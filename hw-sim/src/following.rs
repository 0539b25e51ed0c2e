//! How well a camera follows a pattern, once it has arrived.

use std::fmt;

use scene::Scene;
use serde::{Deserialize, Serialize};

use crate::camera::{Points, project};
use crate::pose::{RigidPose, from_scene};

/// Time between the arrival and the begin of the measurement, s: at the arrival the error is still
/// the scene's threshold.
pub const SETTLE_S: f64 = 1.0;

/// Measures how well a camera follows, for a while that begins [`SETTLE_S`] after the arrival.
#[derive(Clone, Debug)]
pub struct Following {
    /// How long it measures, s; 0: not at all.
    follow_s: f64,
    goal: Points,
    /// The object in the camera frame, at the goal.
    place: RigidPose,
    limits: [f64; 6],
    command: Option<[f64; 6]>,
    frames: u64,
    coordinates: u64,
    changes: u64,
    /// Sums of squares: px, mm, mm, shares.
    squares: [f64; 4],
    worst_px: f64,
}

/// How well a camera followed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FollowingReport {
    /// Frames that were measured.
    pub frames: u64,
    /// RMS of s - s* over all coordinates, px.
    pub rms_px: f64,
    /// Largest component of s - s*, px.
    pub worst_px: f64,
    /// RMS distance of the camera from where it belongs relative to the pattern, mm. A wrong angle
    /// of view counts with the distance as its lever.
    pub rms_mm: f64,
    /// RMS distance of the object's origin in the camera frame from its place at the goal, mm.
    pub rms_object_mm: f64,
    /// RMS change of the command from frame to frame, as a share of the limit (largest component).
    pub change: f64,
}

impl Following {
    /// Measures for `follow_s` seconds against the goal of the scene.
    pub fn new(scene: &Scene, follow_s: f64) -> Self {
        let goal = from_scene(&scene.goal);
        Self {
            follow_s,
            goal: project(scene, &goal).unwrap_or_default(),
            place: goal,
            limits: scene.limits.velocity(),
            command: None,
            frames: 0,
            coordinates: 0,
            changes: 0,
            squares: [0.0; 4],
            worst_px: 0.0,
        }
    }

    /// Seconds after the arrival at which a run may end.
    pub fn end_s(&self) -> f64 {
        if self.follow_s > 0.0 {
            SETTLE_S + self.follow_s
        } else {
            0.0
        }
    }

    /// Adds a frame, `since_s` after the arrival: the true features, px, the object in the camera
    /// frame, and the command that stands (m/s, rad/s; camera frame).
    pub fn add(&mut self, since_s: f64, points: &Points, object: &RigidPose, command: &[f64; 6]) {
        if since_s < SETTLE_S || since_s > self.end_s() {
            return;
        }
        let pairs = points.iter().flatten().zip(self.goal.iter().flatten());
        for (s, goal) in pairs {
            let error = s - goal;
            self.squares[0] += error * error;
            self.worst_px = self.worst_px.max(error.abs());
            self.coordinates += 1;
        }
        let apart = |a: &RigidPose, b: &RigidPose| a.translation.vector - b.translation.vector;
        let camera = apart(&object.inverse(), &self.place.inverse());
        self.squares[1] += camera.norm_squared() * 1e6;
        self.squares[2] += apart(object, &self.place).norm_squared() * 1e6;
        self.frames += 1;
        if let Some(before) = self.command.replace(*command) {
            let share = |k: usize| (command[k] - before[k]).abs() / self.limits[k];
            self.squares[3] += (0..6).map(share).fold(0.0, f64::max).powi(2);
            self.changes += 1;
        }
    }

    /// The figures, if a frame was measured.
    pub fn report(&self) -> Option<FollowingReport> {
        let rms = |k: usize, count: u64| (self.squares[k] / count.max(1) as f64).sqrt();
        (self.frames > 0).then(|| FollowingReport {
            frames: self.frames,
            rms_px: rms(0, self.coordinates),
            worst_px: self.worst_px,
            rms_mm: rms(1, self.frames),
            rms_object_mm: rms(2, self.frames),
            change: rms(3, self.changes),
        })
    }
}

impl FollowingReport {
    /// Of several runs with their frames together; `None` of none.
    pub fn of<'a>(runs: impl Iterator<Item = &'a Self>) -> Option<Self> {
        let (mut frames, mut squares, mut worst_px) = (0, [0.0; 4], 0.0_f64);
        for run in runs {
            frames += run.frames;
            worst_px = worst_px.max(run.worst_px);
            let figures = [run.rms_px, run.rms_mm, run.rms_object_mm, run.change];
            for (square, x) in squares.iter_mut().zip(figures) {
                *square += run.frames as f64 * x * x;
            }
        }
        let [rms_px, rms_mm, rms_object_mm, change] = squares.map(|x| (x / frames as f64).sqrt());
        (frames > 0).then_some(Self {
            frames,
            rms_px,
            worst_px,
            rms_mm,
            rms_object_mm,
            change,
        })
    }
}

impl fmt::Display for FollowingReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "followed to {:.2} px RMS, {:.1} px at most; the camera to {:.2} mm, the object in its view to {:.2} mm; the command changes by {:.1} % a frame",
            self.rms_px,
            self.worst_px,
            self.rms_mm,
            self.rms_object_mm,
            100.0 * self.change
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::project;

    #[test]
    fn errors_are_measured_from_a_second_after_the_arrival() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let mut following = Following::new(&scene, 2.0);
        assert_eq!((following.end_s(), following.report()), (3.0, None));
        let mut object = from_scene(&scene.goal);
        // 3 mm to the right at 0.6 m: 4 px in u.
        object.translation.x += 0.003;
        let points = project(&scene, &object).unwrap();
        let limit = scene.limits.velocity()[0];
        for k in 0..120 {
            let command = [0.1 * limit * f64::from(k % 2), 0.0, 0.0, 0.0, 0.0, 0.0];
            following.add(f64::from(k) / 30.0, &points, &object, &command);
        }
        let report = following.report().unwrap();
        assert_eq!(report.frames, 61);
        for (found, expected) in [
            (report.rms_px, 4.0 / 2.0_f64.sqrt()),
            (report.worst_px, 4.0),
            (report.rms_mm, 3.0),
            (report.rms_object_mm, 3.0),
            (report.change, 0.1),
        ] {
            assert!((found - expected).abs() < 1e-9, "{report:?}");
        }
        let both = FollowingReport::of([report, report].iter()).unwrap();
        assert!((both.rms_mm - 3.0).abs() < 1e-9 && both.frames == 122);
        assert_eq!(FollowingReport::of([].iter()), None);
        assert_eq!(Following::new(&scene, 0.0).end_s(), 0.0);
    }
}
