//! What a run came to: a line of JSON for programs, a sentence for people.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::following::FollowingReport;
use crate::late_frames::LateFrames;
use crate::lateness::LatenessReport;
use crate::progress::Progress;
use crate::referee::End;
use crate::robot::inspector::ArmReport;

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// At the goal, without a violation.
    Arrived,
    /// A point was deeper in an occlusion, or farther outside the image, than the scene allows.
    Violation,
    /// Not at the goal in time.
    TimeOut,
    /// The pattern was behind the camera.
    LostSight,
    /// Ended from outside.
    Stopped,
    /// Of an arm: the robot stopped itself.
    Reflex,
    /// Of an arm: it arrived, but its referee saw a limit exceeded.
    ArmViolation,
}

/// As in the line of JSON.
impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// What a run came to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// Which start, from 0.
    pub start: usize,
    /// How it ended.
    pub verdict: Verdict,
    /// Seconds from start to verdict.
    pub time_s: f64,
    /// Frames exposed.
    pub frames: u64,
    /// Frames after which the camera stood still for want of a valid command.
    pub stale: u64,
    /// Commands that were outside the limits.
    pub limited: u64,
    /// Largest component of s - s* at the end, px.
    pub error_px: f64,
    /// Least signed distance of any point of a frame from an occlusion or the border, px; negative
    /// inside.
    pub least_clearance_px: f64,
    /// The same between the frames.
    pub least_between_px: f64,
    /// Where markers have a size: least signed distance of any marker's edge at all these instants,
    /// px; negative where a marker was partly hidden, which is no violation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub least_edge_px: Option<f64>,
    /// The depth from which on being inside is a violation, px: `success.violation_px` of the
    /// scene.
    pub violation_px: f64,
    /// The violation, in words.
    pub violation: Option<String>,
    /// How well the camera followed after the arrival, where that was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub following: Option<FollowingReport>,
    /// Of an arm: what the sequence was about at the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<&'static str>,
    /// Of an arm: seconds until the features were at the goal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arrived_s: Option<f64>,
    /// Of an arm over a pattern that moves: how fast the camera moved relative to it at the release.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub release: Option<ReleaseReport>,
    /// Of an arm: what its referee reports.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arm: Option<ArmReport>,
    /// Of an arm on the fixed clock: how late its milliseconds began.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lateness: Option<LatenessReport>,
    /// In real time: the frames that came late, where any did. Where many did, the run says little
    /// of the controller.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub late: Option<LateFrames>,
}

/// How fast the camera moved relative to the object while the gripper opened: the most.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ReleaseReport {
    /// At the object's origin, m/s.
    pub m_s: f64,
    /// Relative turn rate, rad/s.
    pub rad_s: f64,
}

impl fmt::Display for ReleaseReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (mm_s, mrad_s) = (1e3 * self.m_s, 1e3 * self.rad_s);
        write!(f, "released at {mm_s:.1} mm/s and {mrad_s:.1} mrad/s")
    }
}

impl Outcome {
    /// Of a run from this start, without what only an arm knows.
    pub fn new(start: usize, progress: &Progress, violation_px: f64) -> Self {
        let (verdict, violation) = match &progress.end {
            None => (Verdict::Stopped, None),
            Some(End::Arrived) => (Verdict::Arrived, None),
            Some(End::TimeOut) => (Verdict::TimeOut, None),
            Some(End::LostSight) => (Verdict::LostSight, None),
            Some(End::Reflex) => (Verdict::Reflex, None),
            Some(End::Violation(violation)) => (Verdict::Violation, Some(violation.to_string())),
        };
        Self {
            start,
            verdict,
            time_s: rounded(progress.time_s),
            frames: progress.frames,
            stale: progress.stale,
            limited: progress.limited,
            error_px: rounded(progress.error_px),
            least_clearance_px: rounded(progress.referee.least_clearance()),
            least_between_px: rounded(progress.referee.least_between()),
            least_edge_px: progress.referee.least_edge().map(rounded),
            violation_px,
            violation,
            following: progress.following(),
            step: None,
            arrived_s: None,
            release: None,
            arm: None,
            lateness: None,
            late: None,
        }
    }

    /// Whether the goal was reached without a violation.
    pub fn is_success(&self) -> bool {
        self.verdict == Verdict::Arrived
    }

    /// The outcome as a sentence.
    pub fn sentence(&self) -> String {
        let mut verdict = self.verdict_sentence();
        if let Some(following) = &self.following {
            verdict += &format!("; {following}");
        }
        if let Some(release) = &self.release {
            verdict += &format!("; {release} relative to the pattern");
        }
        match &self.late {
            Some(late) => format!("{verdict}; {late}"),
            None => verdict,
        }
    }

    fn verdict_sentence(&self) -> String {
        let after = format!("after {:.1} s", self.time_s);
        let error = format!("{:.1} px from the goal", self.error_px);
        match self.verdict {
            Verdict::Arrived => {
                let (clearance, joints) = (self.clearance(), self.joints());
                format!("arrived at the goal {after}; {clearance}{joints}")
            }
            Verdict::TimeOut => format!("did not arrive in time: {error} {after}"),
            Verdict::LostSight => format!("lost sight of the pattern {after}"),
            Verdict::Reflex => format!("the robot stopped itself {after}, {error}"),
            Verdict::ArmViolation => {
                format!("arrived {after}, but the robot exceeded its limits")
            }
            Verdict::Violation => {
                let violation = self.violation.as_deref().unwrap_or_default();
                format!("violation {after}: {violation}")
            }
            // Before the first frame no error is known.
            Verdict::Stopped if self.frames == 0 => format!("stopped {after}"),
            Verdict::Stopped => format!("stopped {after}, {error}"),
        }
    }

    /// How much of their speed the joints used.
    fn joints(&self) -> String {
        let arm = self.arm.as_ref();
        arm.map_or_else(String::new, |arm| {
            let share = 100.0 * arm.joint_velocity;
            format!("; joints at up to {share:.0} % of their speed limits")
        })
    }

    fn clearance(&self) -> String {
        let (least, allowed) = (self.least_clearance_px, self.violation_px);
        let points = if least < 0.0 {
            let depth = -least;
            format!("at most {depth:.1} px deep in an occlusion; the scene allows {allowed} px")
        } else {
            format!("{least:.1} px from occlusions and border, or more")
        };
        match self.least_edge_px {
            None => points,
            Some(edge) if edge < 0.0 => {
                format!("{points}; markers were up to {:.1} px hidden", -edge)
            }
            Some(edge) => format!("{points}; the markers' edges {edge:.1} px"),
        }
    }
}

/// To thousandths: more digits say nothing.
fn rounded(x: f64) -> f64 {
    // A zero without a sign.
    (x * 1e3).round() / 1e3 + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Points, outlines, project};
    use crate::pose::from_scene;
    use scene::Scene;

    fn outcome(point: [f64; 2], end: Option<End>) -> Outcome {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let mut progress = Progress::new(&scene);
        let points: Points = [point].into_iter().collect();
        progress.judge(&points, outlines(&scene, &from_scene(&scene.goal)));
        (progress.time_s, progress.end) = (1.43, end);
        Outcome::new(0, &progress, scene.success.violation_px)
    }

    #[test]
    fn a_depth_that_the_scene_allows_is_told_with_what_is_allowed() {
        // Half a pixel inside the spot about (850, 560) of radius 75.
        let inside = outcome([775.5, 560.0], Some(End::Arrived));
        let expected = "arrived at the goal after 1.4 s; at most 0.5 px deep in an occlusion; the scene allows 15 px";
        assert_eq!(inside.sentence(), expected);
        assert!(inside.is_success() && inside.violation.is_none());
        let clear = outcome([755.0, 560.0], Some(End::Arrived)).sentence();
        let words = "20.0 px from occlusions and border, or more";
        assert!(clear.ends_with(words), "{clear}");
        let mut arm = outcome([755.0, 560.0], Some(End::Arrived));
        arm.arm = Some(ArmReport {
            joint_velocity: 0.614,
            ..ArmReport::default()
        });
        let words = format!("{words}; joints at up to 61 % of their speed limits");
        assert!(arm.sentence().ends_with(&words), "{}", arm.sentence());
    }

    #[test]
    fn where_markers_have_a_size_their_edges_are_told_too() {
        let mut scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        let mut sentence = |up: f64| {
            scene.occlusions[1].parts[0].center[1] -= up;
            let mut progress = Progress::new(&scene);
            let goal = from_scene(&scene.goal);
            let points = project(&scene, &goal).unwrap();
            progress.end = progress.judge(&points, outlines(&scene, &goal));
            Outcome::new(0, &progress, scene.success.violation_px).sentence()
        };
        // Between the lower points and the grasped object, which begins at v = 385, are 83.5 px; its
        // corners are a little rounded.
        let clear = sentence(0.0);
        let words = "85.6 px from occlusions and border, or more; the markers' edges 56.8 px";
        assert!(clear.ends_with(words), "{clear}");
        let hidden = sentence(60.0);
        assert!(hidden.contains("; 26.3 px from"), "{hidden}");
        let words = "; markers were up to 2.5 px hidden";
        assert!(hidden.ends_with(words), "{hidden}");
    }

    #[test]
    fn a_run_whose_frames_came_late_says_so() {
        let mut late = outcome([755.0, 560.0], Some(End::TimeOut));
        let mut frames = LateFrames::default();
        (frames.frames, frames.late, frames.most_s) = (33, 31, 29.9);
        late.late = Some(frames);
        let words = "after 1.4 s; slower than real time: 31 of 33 frames came 3 periods late or more, up to 29.9 s; this may have decided the run";
        assert!(late.sentence().ends_with(words), "{}", late.sentence());
        let json = serde_json::json!(late)["late"].to_string();
        assert_eq!(json, r#"{"frames":33,"late":31,"most_s":29.9}"#);
    }

    #[test]
    fn a_run_that_was_not_decided_was_stopped() {
        let stopped = outcome([755.0, 560.0], None);
        assert_eq!(
            (stopped.verdict, stopped.is_success()),
            (Verdict::Stopped, false)
        );
        assert!(stopped.sentence().starts_with("stopped after 1.4 s"));
    }
}
