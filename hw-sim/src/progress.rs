//! How far a run has come, and how it ended: the same for every carrier.

use scene::Scene;

use crate::camera::{Outline, Points};
use crate::following::{Following, FollowingReport};
use crate::pose::RigidPose;
use crate::referee::{End, Referee};

/// A run so far.
#[derive(Clone, Debug)]
pub struct Progress {
    /// Judges the true features.
    pub referee: Referee,
    /// Seconds since the first command of an armed controller; 0 before.
    pub time_s: f64,
    /// Frames exposed.
    pub frames: u64,
    /// Frames after the beginning at which no valid command was there, so that the camera stood
    /// still.
    pub stale: u64,
    /// Commands that were outside the limits.
    pub limited: u64,
    /// Largest component of the true s - s* at the last exposure, px.
    pub error_px: f64,
    /// Seconds until the features were first at the goal.
    pub arrived_s: Option<f64>,
    /// How it ended, once it has.
    pub end: Option<End>,
    following: Following,
    begun_ns: Option<u64>,
}

impl Progress {
    /// A run that has not begun.
    pub fn new(scene: &Scene) -> Self {
        Self {
            referee: Referee::new(scene),
            time_s: 0.0,
            frames: 0,
            stale: 0,
            limited: 0,
            error_px: f64::INFINITY,
            arrived_s: None,
            end: None,
            following: Following::new(scene, 0.0),
            begun_ns: None,
        }
    }

    /// Lets the run go on after the arrival, to measure for `follow_s` seconds how well the camera
    /// follows; 0: not at all.
    pub fn follow_for(&mut self, scene: &Scene, follow_s: f64) {
        self.following = Following::new(scene, follow_s);
    }

    /// Whether the features have been at the goal, and the following has been measured.
    pub fn has_followed(&self) -> bool {
        let end_s = self.following.end_s();
        let is_over = |arrived_s: f64| self.time_s >= arrived_s + end_s;
        self.arrived_s.is_some_and(is_over)
    }

    /// Seconds from the arrival to the end of the measurement; 0 where none is made.
    pub fn following_s(&self) -> f64 {
        self.following.end_s()
    }

    /// Measures a frame after the arrival: the true features, px, the object in the camera frame,
    /// and the command that stands (m/s, rad/s; camera frame).
    pub fn follow(&mut self, points: &Points, object: &RigidPose, command: &[f64; 6]) {
        if let Some(arrived_s) = self.arrived_s {
            let since_s = self.time_s - arrived_s;
            self.following.add(since_s, points, object, command);
        }
    }

    /// How well the camera followed; `None` where that was not measured.
    pub fn following(&self) -> Option<FollowingReport> {
        self.following.report()
    }

    /// Seconds from the begin of the run to an instant; 0 before.
    pub fn since_s(&self, now_ns: u64) -> f64 {
        let since_ns = |begun: u64| now_ns.saturating_sub(begun);
        self.begun_ns
            .map_or(0.0, |begun| since_ns(begun) as f64 * 1e-9)
    }

    /// Whether an armed controller has commanded.
    pub fn has_begun(&self) -> bool {
        self.begun_ns.is_some()
    }

    /// An armed controller commands: the first time, the run begins.
    pub fn begin(&mut self, now_ns: u64) {
        self.begun_ns.get_or_insert(now_ns);
    }

    /// The time is now this instant, ns.
    pub fn tick(&mut self, now_ns: u64) {
        let begun = self.begun_ns.unwrap_or(now_ns);
        self.time_s = now_ns.saturating_sub(begun) as f64 * 1e-9;
    }

    /// Has the referee judge the true features, and measure the true edges of the markers; returns
    /// its judgement.
    pub fn judge(
        &mut self,
        points: &Points,
        outlines: impl Iterator<Item = Option<Outline>>,
    ) -> Option<End> {
        self.referee.measure_edges(outlines);
        self.error_px = self.referee.error(points);
        let end = self.referee.judge(points);
        if end == Some(End::Arrived) {
            self.arrived_s.get_or_insert(self.time_s);
        }
        end
    }

    /// The same between two frames: a violation ends the run.
    pub fn judge_between(
        &mut self,
        points: &Points,
        outlines: impl Iterator<Item = Option<Outline>>,
    ) {
        self.referee.measure_edges(outlines);
        if let Some(end) = self.referee.judge_between(points) {
            self.finish(end);
        }
    }

    /// Ends the run, unless it has ended before.
    pub fn finish(&mut self, end: End) {
        self.end.get_or_insert(end);
    }
}
