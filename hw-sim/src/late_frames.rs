//! Frames that come late because the emulator, or its machine, is slower than real time.

use std::fmt;

use serde::Serialize;

/// From this many periods on a frame is late: `vpcd` then brakes as if the camera were silent.
const PERIODS: u64 = 3;
/// Least time between two warnings, ns.
const PAUSE_NS: u64 = 5_000_000_000;

/// The frames of a run in real time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LateFrames {
    /// Frames exposed.
    pub frames: u64,
    /// Frames exposed three periods or more after they were due.
    pub late: u64,
    /// The most that a frame was late, s.
    pub most_s: f64,
    #[serde(skip)]
    warned_ns: Option<u64>,
}

impl LateFrames {
    /// A warning, at most one in five seconds, if what is due now, at `now_ns`, is late by
    /// `late_ns`, in a run that began at `since_ns`. Ask before the step: that may take long.
    pub fn warning(
        &mut self,
        now_ns: u64,
        late_ns: u64,
        since_ns: u64,
        rate_hz: f64,
    ) -> Option<String> {
        let is_silent = |warned_ns: u64| now_ns < warned_ns + PAUSE_NS;
        if !is_late(late_ns, rate_hz) || self.warned_ns.is_some_and(is_silent) {
            return None;
        }
        self.warned_ns = Some(now_ns);
        let elapsed_s = now_ns.saturating_sub(since_ns) as f64 * 1e-9;
        Some(format!(
            "slower than real time: frame {} comes {:.1} s late, {:.1} frames a second instead of {rate_hz}",
            self.frames + 1,
            late_ns as f64 * 1e-9,
            self.frames as f64 / elapsed_s,
        ))
    }

    /// Counts a frame that was exposed `late_ns` after it was due.
    pub fn add(&mut self, late_ns: u64, rate_hz: f64) {
        self.frames += 1;
        self.late += u64::from(is_late(late_ns, rate_hz));
        self.most_s = self.most_s.max(late_ns as f64 * 1e-9);
    }

    /// The frames as a part of an outcome, if any was late.
    pub fn report(self) -> Option<Self> {
        let most_s = (self.most_s * 1e3).round() / 1e3;
        (self.late > 0).then_some(Self { most_s, ..self })
    }
}

fn is_late(late_ns: u64, rate_hz: f64) -> bool {
    late_ns as f64 * 1e-9 * rate_hz >= PERIODS as f64
}

impl fmt::Display for LateFrames {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "slower than real time: {} of {} frames came {PERIODS} periods late or more, up to {:.1} s; this may have decided the run",
            self.late, self.frames, self.most_s
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 33_333_333;

    #[test]
    fn frames_within_three_periods_are_not_late() {
        let mut frames = LateFrames::default();
        for k in 0..300 {
            let now_ns = k * PERIOD_NS + 90_000_000;
            assert_eq!(frames.warning(now_ns, 90_000_000, 0, 30.0), None);
            frames.add(90_000_000, 30.0);
        }
        assert_eq!(frames.report(), None);
        assert!(frames.warning(10, 101_000_000, 0, 30.0).is_some());
        frames.add(101_000_000, 30.0);
        assert_eq!(frames.report().map(|frames| frames.late), Some(1));
    }

    #[test]
    fn a_slow_camera_is_reported_every_five_seconds() {
        let mut frames = LateFrames::default();
        let mut warnings = Vec::new();
        for k in 0..11 {
            let now_ns = k * 1_000_000_000;
            let late_ns = now_ns - k * PERIOD_NS;
            warnings.extend(frames.warning(now_ns, late_ns, 0, 30.0));
            frames.add(late_ns, 30.0);
        }
        let expected = [
            "slower than real time: frame 2 comes 1.0 s late, 1.0 frames a second instead of 30",
            "slower than real time: frame 7 comes 5.8 s late, 1.0 frames a second instead of 30",
        ];
        assert_eq!(warnings, expected.map(str::to_owned));
        let report = frames.report().unwrap();
        assert_eq!((report.frames, report.late, report.most_s), (11, 10, 9.667));
    }
}
