//! The task around the servoing: approach, settle, release the object, retreat. It runs on the
//! robot's side: the controller only ever sees features.

use serde::{Deserialize, Serialize};

/// A step of the task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TaskStep {
    /// No armed controller has commanded anything yet.
    Waiting,
    /// The controller moves the camera.
    Approach,
    /// The features are at the goal; the controller still regulates, and they must stay.
    Settling,
    /// The controller is no longer obeyed; the robot comes to rest, the gripper opens. Where the
    /// pattern may move, the gripper opens while the controller still follows it.
    Releasing,
    /// The robot backs away along the camera's axis; where the pattern may move, with the mean
    /// velocity that it had while the gripper opened.
    Retreating,
    /// The object is where it belongs, and the robot stands.
    Done,
}

impl TaskStep {
    /// In words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Approach => "approach",
            Self::Settling => "settling",
            Self::Releasing => "releasing",
            Self::Retreating => "retreating",
            Self::Done => "done",
        }
    }

    /// Whether the object has not yet been released.
    pub const fn is_approach(self) -> bool {
        matches!(self, Self::Waiting | Self::Approach | Self::Settling)
    }
}

/// How the task goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SequenceSettings {
    /// Largest component of s - s* that counts as being there, px.
    pub convergence_px: f64,
    /// How long the features must stay there, ns.
    pub dwell_ns: u64,
    /// How long the gripper takes to open, ns.
    pub opening_ns: u64,
    /// How far the robot backs away, m.
    pub retreat_m: f64,
    /// How fast, m/s.
    pub retreat_speed: f64,
    /// Whether the pattern may move.
    pub may_move: bool,
}

impl SequenceSettings {
    /// Half a second of dwell and of opening, 4 cm of retreat at this speed (m/s).
    pub fn new(convergence_px: f64, retreat_speed: f64) -> Self {
        Self {
            convergence_px,
            dwell_ns: 500_000_000,
            opening_ns: 500_000_000,
            retreat_m: 0.04,
            retreat_speed,
            may_move: false,
        }
    }
}

/// The robot's side in one millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Situation {
    /// The time, ns.
    pub now_ns: u64,
    /// Whether an armed controller commands.
    pub is_commanded: bool,
    /// A frame that was delivered just now: the largest component of s - s* in px, `None` within
    /// where not all markers were seen.
    pub frame: Option<Option<f64>>,
    /// Whether the robot stands.
    pub is_at_rest: bool,
    /// The camera's velocity (m/s, rad/s; camera frame).
    pub twist: [f64; 6],
    /// Whether the object may be released once it is at the goal.
    pub may_release: bool,
}

/// The sequence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sequence {
    settings: SequenceSettings,
    phase: TaskStep,
    since_ns: u64,
    /// When the last frame at the goal was delivered.
    good_ns: u64,
    /// When the gripper began to open.
    opening_ns: Option<u64>,
    /// Mean velocity of the camera since then, where the pattern may move, and its milliseconds.
    kept: [f64; 6],
    kept_ms: u32,
}

/// Longest time without a frame at the goal that does not begin the dwell anew, ns.
const PATIENCE_NS: u64 = 300_000_000;

impl Sequence {
    /// A sequence that waits for a controller.
    pub fn new(settings: SequenceSettings) -> Self {
        Self {
            settings,
            phase: TaskStep::Waiting,
            since_ns: 0,
            good_ns: 0,
            opening_ns: None,
            kept: [0.0; 6],
            kept_ms: 0,
        }
    }

    /// Whether the controller's commands are obeyed.
    pub fn obeys_controller(&self) -> bool {
        let follows = self.settings.may_move && self.phase == TaskStep::Releasing;
        self.phase.is_approach() || follows
    }

    /// Whether the gripper opens.
    pub fn is_opening(&self) -> bool {
        self.phase == TaskStep::Releasing && self.opening_ns.is_some()
    }

    /// The present step of the task.
    pub fn phase(&self) -> TaskStep {
        self.phase
    }

    /// The camera velocity that the sequence itself wants, camera frame; `None` where the
    /// controller is obeyed.
    pub fn twist(&self) -> Option<[f64; 6]> {
        match self.phase {
            TaskStep::Retreating => {
                let mut twist = self.kept;
                twist[2] -= self.settings.retreat_speed;
                Some(twist)
            }
            _ if self.obeys_controller() => None,
            _ => Some([0.0; 6]),
        }
    }

    /// One millisecond; returns the phase that begins in it, if one does.
    pub fn step(&mut self, situation: &Situation) -> Option<TaskStep> {
        let next = self.next(situation);
        if next == self.phase {
            return None;
        }
        (self.phase, self.since_ns) = (next, situation.now_ns);
        Some(next)
    }

    fn next(&mut self, situation: &Situation) -> TaskStep {
        let now_ns = situation.now_ns;
        let elapsed_ns = now_ns.saturating_sub(self.since_ns);
        let is_there =
            matches!(situation.frame, Some(Some(error)) if error <= self.settings.convergence_px);
        match self.phase {
            TaskStep::Waiting if situation.is_commanded => TaskStep::Approach,
            TaskStep::Approach if is_there => {
                self.good_ns = now_ns;
                TaskStep::Settling
            }
            TaskStep::Settling => {
                let is_away = matches!(situation.frame, Some(Some(error)) if error > self.settings.convergence_px);
                if is_there {
                    self.good_ns = now_ns;
                }
                if is_away || now_ns.saturating_sub(self.good_ns) > PATIENCE_NS {
                    TaskStep::Approach
                } else if is_there && elapsed_ns >= self.settings.dwell_ns && situation.may_release
                {
                    TaskStep::Releasing
                } else {
                    TaskStep::Settling
                }
            }
            TaskStep::Releasing => {
                let follows = self.settings.may_move;
                if self.opening_ns.is_none() && (situation.is_at_rest || follows) {
                    self.opening_ns = Some(now_ns);
                }
                if follows {
                    self.keep(&situation.twist);
                }
                let open = |began: u64| now_ns.saturating_sub(began) >= self.settings.opening_ns;
                if self.opening_ns.is_some_and(open) {
                    TaskStep::Retreating
                } else {
                    TaskStep::Releasing
                }
            }
            TaskStep::Retreating => {
                let seconds = self.settings.retreat_m / self.settings.retreat_speed;
                if elapsed_ns as f64 * 1e-9 >= seconds {
                    TaskStep::Done
                } else {
                    TaskStep::Retreating
                }
            }
            phase => phase,
        }
    }

    /// Takes the camera's velocity of a millisecond into the mean.
    fn keep(&mut self, twist: &[f64; 6]) {
        self.kept_ms += 1;
        let share = 1.0 / f64::from(self.kept_ms);
        for (kept, v) in self.kept.iter_mut().zip(twist) {
            *kept += share * (v - *kept);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn sequence() -> Sequence {
        Sequence::new(SequenceSettings::new(5.0, 0.02))
    }

    fn situation(ms: u64, frame: Option<Option<f64>>) -> Situation {
        Situation {
            now_ns: ms * MS,
            is_commanded: true,
            frame,
            is_at_rest: false,
            twist: [0.0; 6],
            may_release: true,
        }
    }

    /// Frames with this error from one instant to another, ms.
    fn frames(sequence: &mut Sequence, from: u64, to: u64, error: Option<f64>) {
        for ms in (from..to).step_by(33) {
            sequence.step(&situation(ms, Some(error)));
        }
    }

    fn settled() -> Sequence {
        let mut sequence = sequence();
        frames(&mut sequence, 0, 100, Some(80.0));
        frames(&mut sequence, 100, 700, Some(3.0));
        sequence
    }

    #[test]
    fn nothing_begins_before_a_controller_commands() {
        let mut sequence = sequence();
        let idle = Situation {
            is_commanded: false,
            ..situation(5, Some(Some(1.0)))
        };
        assert_eq!(sequence.step(&idle), None);
        assert_eq!(sequence.step(&situation(6, None)), Some(TaskStep::Approach));
        assert_eq!(sequence.twist(), None);
    }

    #[test]
    fn the_object_is_released_after_a_dwell_and_not_before() {
        let mut sequence = sequence();
        frames(&mut sequence, 0, 100, Some(80.0));
        assert_eq!(sequence.phase(), TaskStep::Approach);
        frames(&mut sequence, 100, 560, Some(3.0));
        assert_eq!(sequence.phase(), TaskStep::Settling);
        assert_eq!(settled().phase(), TaskStep::Releasing);
    }

    #[test]
    fn features_that_leave_the_goal_restart_the_dwell() {
        let mut sequence = sequence();
        frames(&mut sequence, 0, 400, Some(3.0));
        frames(&mut sequence, 400, 433, Some(6.0));
        assert_eq!(sequence.phase(), TaskStep::Approach);
        frames(&mut sequence, 433, 800, Some(3.0));
        assert_eq!(sequence.phase(), TaskStep::Settling);
        frames(&mut sequence, 800, 1200, None);
        assert_eq!(sequence.phase(), TaskStep::Approach);
    }

    #[test]
    fn a_frame_with_a_hidden_marker_does_not_interrupt_the_dwell() {
        let mut sequence = sequence();
        frames(&mut sequence, 0, 300, Some(3.0));
        frames(&mut sequence, 300, 333, None);
        frames(&mut sequence, 333, 700, Some(3.0));
        assert_eq!(sequence.phase(), TaskStep::Releasing);
    }

    #[test]
    fn a_pattern_that_may_move_is_released_in_motion() {
        let mut settings = SequenceSettings::new(5.0, 0.02);
        settings.may_move = true;
        let mut sequence = Sequence::new(settings);
        let at = |ms: u64, frame| Situation {
            twist: [0.01, 0.0, 0.001 * (ms % 2) as f64, 0.0, 0.0, 0.1],
            ..situation(ms, frame)
        };
        let begins = |sequence: &mut Sequence, phase, from: u64, frame| {
            (from..from + 1000).find(|&ms| sequence.step(&at(ms, frame)) == Some(phase))
        };
        let there = Some(Some(3.0));
        let let_go = begins(&mut sequence, TaskStep::Releasing, 0, there).unwrap();
        // The controller follows, and the robot never stands.
        assert!(sequence.obeys_controller());
        let open = begins(&mut sequence, TaskStep::Retreating, let_go + 1, None);
        assert_eq!(open, Some(let_go + 501));
        let [vx, vy, vz, wx, wy, wz] = sequence.twist().unwrap();
        assert!(!sequence.obeys_controller());
        let expected = [0.01, 0.0, -0.0195, 0.0, 0.0, 0.1];
        for (found, expected) in [vx, vy, vz, wx, wy, wz].iter().zip(expected) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
    }

    #[test]
    fn the_gripper_opens_at_rest_and_the_retreat_has_its_length() {
        let mut sequence = settled();
        let at = |ms, is_at_rest| Situation {
            is_at_rest,
            ..situation(ms, None)
        };
        assert_eq!(sequence.twist(), Some([0.0; 6]));
        assert_eq!(sequence.step(&at(2000, false)), None);
        assert_eq!(sequence.step(&at(2001, true)), None);
        assert_eq!(sequence.step(&at(2500, true)), None);
        assert_eq!(sequence.step(&at(2501, true)), Some(TaskStep::Retreating));
        assert_eq!(sequence.twist(), Some([0.0, 0.0, -0.02, 0.0, 0.0, 0.0]));
        assert_eq!(sequence.step(&at(4500, false)), None);
        assert_eq!(sequence.step(&at(4502, false)), Some(TaskStep::Done));
        assert_eq!(sequence.twist(), Some([0.0; 6]));
    }
}
