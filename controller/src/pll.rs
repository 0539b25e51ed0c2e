//! The clock `phase`: a grid that keeps its nominal period and takes its phase from the camera, so
//! that every cycle begins a little after its features arrive, however the two clocks drift. Pure;
//! times are arguments.
//!
//! A second-order filter follows the exposures (period and phase), another the delay from exposure
//! to publication and its spread. The release after the next should come at *expected arrival +
//! margin + spread*; the grid moves there by at most [`SLEW`] of a period per cycle. Without frames
//! it runs free.

use messages::{FUTURE_NS, PhaseCode, Stamp};

/// Largest departure of an interval from the nominal period, as a share of it: small enough for the
/// law's model of one period.
pub const SLEW: f64 = 0.02;
/// Largest departure of the camera's period from the nominal one that is followed, as a share of
/// it; below [`SLEW`], so that something is left to catch up with.
const DRIFT: f64 = 0.015;
/// Gain of the filter on the phase of the exposures; that on the period is the one of critical
/// damping.
const GAIN: f64 = 0.1;
/// Gain on delay and spread.
const DELAY_GAIN: f64 = 1.0 / 16.0;
/// Spreads (mean absolute deviations) waited for beyond the margin: 99 of 100 frames for a Gaussian
/// one, all for a uniform one.
const SPREADS: f64 = 3.0;
/// Largest spread, as a share of the period, at which the phase is used.
const WIDEST: f64 = 0.125;
/// Doubt in the filter with which it begins again: five frames in a row that it did not expect.
const DOUBT: u32 = 20;
/// Doubt that such a frame adds; each expected one takes 1 away.
const OUTLIER: u32 = 4;
/// Frames after which the filter is trusted.
const TRUSTED: u32 = 8;
/// Periods without a frame after which the grid is free.
const SILENCE: f64 = 10.0;
/// Share of the period within which the grid counts as locked, and beyond which no more.
const LOCKED: (f64, f64) = (0.02, 0.1);
/// Oldest exposure that a publication may have, ns: beyond, the stamp is no exposure.
const OLDEST_NS: u64 = 1_000_000_000;

/// The grid's relation to the camera's frames.
#[derive(Clone, Debug)]
pub struct CameraPll {
    period: f64,
    margin: f64,
    beat: Option<Beat>,
    code: PhaseCode,
    /// This release minus the intended one, ns.
    error: f64,
}

/// The camera's beat; times in ns after the first frame.
#[derive(Clone, Debug)]
struct Beat {
    origin_ns: u64,
    /// An exposure, filtered.
    exposed: f64,
    period: f64,
    /// From exposure to publication.
    delay: f64,
    spread: f64,
    heard: u32,
    doubt: u32,
    last_ns: u64,
}

impl CameraPll {
    /// A free grid with this period that will aim this far after the arrivals, at most half a
    /// period; ns.
    pub fn new(period_ns: u64, margin_ns: u64) -> Self {
        let period = period_ns as f64;
        Self {
            period,
            margin: (margin_ns as f64).min(0.5 * period),
            beat: None,
            code: PhaseCode::Free,
            error: 0.0,
        }
    }

    /// Takes a frame that has come. One from the future is ignored: no later one would be newer,
    /// and no silence after it long enough.
    pub fn hear(&mut self, stamp: &Stamp, now_ns: u64) {
        if stamp.published_ns > now_ns.saturating_add(FUTURE_NS) {
            return;
        }
        match &mut self.beat {
            Some(beat) if beat.doubt < DOUBT => beat.hear(stamp, self.period),
            // The first one, or the first of another beat.
            beat => *beat = Some(Beat::new(stamp, self.period)),
        }
    }

    /// From the release at `release_ns` to the next one, ns: the nominal period within [`SLEW`].
    pub fn interval_ns(&mut self, release_ns: u64) -> u64 {
        let Some(wanted) = self.wanted(release_ns) else {
            (self.code, self.error) = (PhaseCode::Free, 0.0);
            return self.period as u64;
        };
        let (offset, period) = wanted;
        let before = self.error;
        self.error = -wrapped(offset, period);
        // Half a period away both ways are as long: keep to the one that was taken.
        if self.error.abs() > 0.4 * period
            && self.error * before < 0.0
            && before.abs() > 0.3 * period
        {
            self.error += period.copysign(before);
        }
        let share = self.error.abs() / self.period;
        self.code = match self.code {
            PhaseCode::Locked if share <= LOCKED.1 => PhaseCode::Locked,
            _ if share <= LOCKED.0 => PhaseCode::Locked,
            _ => PhaseCode::Seeking,
        };
        let most = SLEW * self.period;
        let step = (period - self.period - self.error).clamp(-most, most);
        (self.period + step) as u64
    }

    /// What the release before the last [`CameraPll::interval_ns`] was to the camera's phase, and
    /// how far after the wanted one it was, ns.
    pub fn standing(&self) -> (PhaseCode, i64) {
        (self.code, self.error as i64)
    }

    /// From this release to a wanted one, and the camera's period; `None` if nothing is known.
    fn wanted(&mut self, release_ns: u64) -> Option<(f64, f64)> {
        let beat = self.beat.as_ref()?;
        let silence = release_ns.saturating_sub(beat.last_ns) as f64;
        if silence > SILENCE * self.period {
            self.beat = None;
            return None;
        }
        let is_known = beat.heard >= TRUSTED
            && beat.doubt <= 2 * OUTLIER
            && beat.spread <= WIDEST * self.period;
        if !is_known {
            return None;
        }
        let lead = (self.margin + SPREADS * beat.spread).min(0.5 * self.period);
        let wanted = beat.exposed + beat.delay + lead;
        Some((wanted - beat.time(release_ns), beat.period))
    }
}

impl Beat {
    fn new(stamp: &Stamp, period: f64) -> Self {
        let exposed_ns = exposure(stamp);
        Self {
            origin_ns: exposed_ns,
            exposed: 0.0,
            period,
            delay: (stamp.published_ns - exposed_ns) as f64,
            spread: 0.0,
            heard: 1,
            doubt: 0,
            last_ns: stamp.published_ns,
        }
    }

    /// Time after the first frame, ns.
    fn time(&self, ns: u64) -> f64 {
        ns.wrapping_sub(self.origin_ns) as i64 as f64
    }

    fn hear(&mut self, stamp: &Stamp, nominal: f64) {
        if stamp.published_ns <= self.last_ns {
            return;
        }
        let exposed_ns = exposure(stamp);
        let exposed = self.time(exposed_ns);
        let frames = ((exposed - self.exposed) / self.period).round();
        let residual = exposed - self.exposed - frames * self.period;
        self.last_ns = stamp.published_ns;
        if frames < 1.0 || residual.abs() > 0.25 * nominal {
            self.doubt += OUTLIER;
            return;
        }
        self.doubt = self.doubt.saturating_sub(1);
        self.heard = self.heard.saturating_add(1);
        // How wrong the expected arrival was; a single late frame moves neither delay nor spread
        // much.
        let expected = self.exposed + frames * self.period + self.delay;
        let most = 4.0 * self.spread + 0.02 * nominal;
        let late = (self.time(stamp.published_ns) - expected).clamp(-most, most);
        self.spread += DELAY_GAIN * (late.abs() - self.spread);
        let delay = (stamp.published_ns - exposed_ns) as f64 - self.delay;
        self.delay += DELAY_GAIN * delay.clamp(-most, most);
        let gain = GAIN.max(1.0 / f64::from(self.heard));
        self.exposed += frames * self.period + gain * residual;
        self.period += GAIN * GAIN / 4.0 * residual / frames;
        let most = DRIFT * nominal;
        self.period = self.period.clamp(nominal - most, nominal + most);
    }
}

/// The exposure, or the publication where the stamp cannot be one.
fn exposure(stamp: &Stamp) -> u64 {
    match stamp.published_ns.checked_sub(stamp.data_ns) {
        Some(age) if age <= OLDEST_NS => stamp.data_ns,
        _ => stamp.published_ns,
    }
}

/// An offset within half a period.
fn wrapped(offset: f64, period: f64) -> f64 {
    offset - (offset / period).round() * period
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const PERIOD: u64 = 33_333_333;
    const MS: f64 = 1e6;

    /// A camera beside the loop, on a clock that is moved by hand.
    struct Camera {
        period: f64,
        delay: f64,
        jitter: f64,
        drop: f64,
    }

    impl Default for Camera {
        fn default() -> Self {
            Self {
                period: PERIOD as f64,
                delay: 5.0 * MS,
                jitter: 0.0,
                drop: 0.0,
            }
        }
    }

    /// What was seen: latencies from arrival to release where a frame had come, ns, and intervals.
    #[derive(Default)]
    struct Seen {
        latencies: Vec<f64>,
        intervals: Vec<u64>,
        without: usize,
    }

    impl Seen {
        fn share(&self, share: f64) -> f64 {
            let mut sorted = self.latencies.clone();
            sorted.sort_by(f64::total_cmp);
            sorted[((sorted.len() - 1) as f64 * share) as usize]
        }
    }

    /// Runs from `start` on for so many cycles; the loop sees the newest frame that has been
    /// published.
    fn run(
        pll: &mut CameraPll,
        camera: &Camera,
        start: u64,
        offset: f64,
        cycles: usize,
    ) -> (Seen, u64) {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let mut seen = Seen::default();
        let mut release = start;
        let (mut frame, mut heard) = (0_u64, 0);
        let mut coming: Vec<Stamp> = Vec::new();
        for _ in 0..cycles {
            while coming
                .last()
                .is_none_or(|stamp| stamp.published_ns <= release + PERIOD)
            {
                let exposed = start as f64 + offset + frame as f64 * camera.period;
                let late = camera.delay + camera.jitter * random.random_range(-1.0..1.0);
                frame += 1;
                if random.random_range(0.0..1.0) >= camera.drop {
                    coming.push(Stamp {
                        sequence: frame,
                        data_ns: exposed as u64,
                        published_ns: (exposed + late) as u64,
                    });
                }
            }
            let here = coming.iter().filter(|stamp| stamp.published_ns <= release);
            match here.max_by_key(|stamp| stamp.sequence) {
                Some(stamp) if stamp.sequence > heard => {
                    heard = stamp.sequence;
                    seen.latencies.push((release - stamp.published_ns) as f64);
                    pll.hear(stamp, release);
                }
                _ => seen.without += 1,
            }
            coming.retain(|stamp| stamp.sequence > heard);
            let interval = pll.interval_ns(release);
            seen.intervals.push(interval);
            release += interval;
        }
        (seen, release)
    }

    fn assert_slow(seen: &Seen) {
        let most = (SLEW * PERIOD as f64) as u64 + 1;
        let farthest = seen.intervals.iter().map(|i| i.abs_diff(PERIOD)).max();
        assert!(farthest <= Some(most), "{farthest:?}");
    }

    /// From the 200th cycle on, features come one margin before the cycle.
    fn assert_settled(seen: &Seen) {
        let last = &seen.latencies[200..];
        assert!(
            last.iter().all(|latency| (latency - MS).abs() < 0.05 * MS),
            "{last:?}"
        );
    }

    #[test]
    fn latency_is_the_margin_however_the_cameras_clock_drifts() {
        for drift in [1.0, 1.0 + 2e-4, 1.0 - 2e-4, 30.0 / 29.97, 0.995, 1.005] {
            for offset in [0.0, 9.0, 11.0, 12.5, 20.0, 28.3] {
                let camera = Camera {
                    period: PERIOD as f64 * drift,
                    ..Camera::default()
                };
                let mut pll = CameraPll::new(PERIOD, 1_000_000);
                let (seen, release) = run(&mut pll, &camera, 1 << 40, offset * MS, 150);
                assert_slow(&seen);
                // Five seconds later, on the same clocks.
                let next = release as f64 - (1_u64 << 40) as f64 - offset * MS;
                let onward = camera.period - next.rem_euclid(camera.period);
                let (seen, _) = run(&mut pll, &camera, release, onward, 3000);
                assert_slow(&seen);
                let (least, most) = (seen.share(0.01), seen.share(0.99));
                assert!(
                    least > 0.9 * MS && most < 1.1 * MS,
                    "drift {drift}, offset {offset}: {least} to {most}"
                );
                assert!(seen.without <= 2, "{}", seen.without);
                assert_eq!(pll.standing().0, PhaseCode::Locked);
            }
        }
    }

    #[test]
    fn a_free_grid_drifts_through_the_whole_period() {
        let camera = Camera {
            period: PERIOD as f64 * 1.001,
            ..Camera::default()
        };
        let mut release = 1 << 40;
        let mut latencies = Vec::new();
        // Nobody tells it of the frames.
        let mut pll = CameraPll::new(PERIOD, 1_000_000);
        for frame in 0..1000_u64 {
            release += pll.interval_ns(release);
            let exposed = (1_u64 << 40) as f64 + frame as f64 * camera.period;
            latencies.push((release as f64 - exposed).rem_euclid(PERIOD as f64));
        }
        let widest = latencies.iter().copied().fold(0.0, f64::max);
        assert!(widest > 0.95 * PERIOD as f64);
    }

    #[test]
    fn jitter_of_the_delivery_is_waited_for() {
        let camera = Camera {
            period: PERIOD as f64 * 1.0002,
            delay: 115.0 * MS,
            jitter: 3.0 * MS,
            ..Camera::default()
        };
        let mut pll = CameraPll::new(PERIOD, 1_000_000);
        let (seen, _) = run(&mut pll, &camera, 1 << 40, 0.0, 3000);
        assert_slow(&seen);
        // Margin, three spreads of 1.5 ms, and up to 3 ms either way.
        assert!(seen.share(0.99) < 10.0 * MS, "{}", seen.share(0.99));
        assert!(seen.without < 3000 / 50, "{}", seen.without);
    }

    #[test]
    fn lost_frames_leave_it_locked() {
        let camera = Camera {
            period: PERIOD as f64 * 0.9998,
            drop: 0.4,
            ..Camera::default()
        };
        let mut pll = CameraPll::new(PERIOD, 1_000_000);
        run(&mut pll, &camera, 1 << 40, 12.0 * MS, 200);
        assert_eq!(pll.standing().0, PhaseCode::Locked);
        let mut pll = CameraPll::new(PERIOD, 1_000_000);
        let (seen, _) = run(&mut pll, &camera, 1 << 40, 12.0 * MS, 3000);
        assert!(seen.share(0.9) < 1.2 * MS, "{}", seen.share(0.9));
    }

    #[test]
    fn without_frames_it_runs_free_and_with_them_it_locks_again() {
        let camera = Camera::default();
        let mut pll = CameraPll::new(PERIOD, 1_000_000);
        let (_, mut release) = run(&mut pll, &camera, 1 << 40, 0.0, 200);
        assert_eq!(pll.standing().0, PhaseCode::Locked);
        let silent: Vec<u64> = (0..30)
            .map(|_| {
                let interval = pll.interval_ns(release);
                release += interval;
                interval
            })
            .collect();
        assert!(
            silent[11..].iter().all(|interval| *interval == PERIOD),
            "{silent:?}"
        );
        assert_eq!(pll.standing(), (PhaseCode::Free, 0));
        // The camera comes back with another phase.
        let (seen, _) = run(&mut pll, &camera, release, 21.0 * MS, 300);
        assert_slow(&seen);
        assert_settled(&seen);
    }

    #[test]
    fn a_camera_that_changes_its_phase_at_once_is_followed() {
        let camera = Camera::default();
        let mut pll = CameraPll::new(PERIOD, 1_000_000);
        let (_, release) = run(&mut pll, &camera, 1 << 40, 0.0, 200);
        let (seen, _) = run(&mut pll, &camera, release, 15.0 * MS, 300);
        assert_slow(&seen);
        assert_settled(&seen);
    }

    #[test]
    fn a_frame_from_the_future_does_not_disturb_the_phase() {
        let camera = Camera::default();
        for cycles in [0, 200] {
            let mut pll = CameraPll::new(PERIOD, 1_000_000);
            let (_, release) = run(&mut pll, &camera, 1 << 40, 0.0, cycles);
            let future = Stamp {
                sequence: 1,
                published_ns: u64::MAX,
                data_ns: u64::MAX,
            };
            pll.hear(&future, release);
            // The camera goes on at another phase, and is followed.
            let (seen, mut release) = run(&mut pll, &camera, release, 15.0 * MS, 300);
            assert_settled(&seen);
            // And ends.
            pll.hear(&future, release);
            for _ in 0..12 {
                release += pll.interval_ns(release);
            }
            assert_eq!(pll.standing(), (PhaseCode::Free, 0));
        }
    }

    #[test]
    fn a_camera_of_another_rate_leaves_the_grid_alone() {
        let camera = Camera {
            period: 40.0 * MS,
            ..Camera::default()
        };
        let mut pll = CameraPll::new(PERIOD, 1_000_000);
        let (seen, _) = run(&mut pll, &camera, 1 << 40, 0.0, 3000);
        let moved = seen
            .intervals
            .iter()
            .filter(|interval| **interval != PERIOD)
            .count();
        assert!(moved < 30, "{moved}");
        // Half the rate is a phase, too.
        let camera = Camera {
            period: 2.0 * PERIOD as f64,
            ..camera
        };
        let (seen, _) = run(&mut pll, &camera, 1 << 41, 0.0, 600);
        assert!(seen.share(0.8) < 1.05 * MS, "{}", seen.share(0.8));
    }

    #[test]
    fn no_stamp_whatsoever_moves_the_grid_faster_than_its_bound() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut pll = CameraPll::new(PERIOD, 1_000_000);
        let mut release = 1_u64 << 40;
        for _ in 0..100_000 {
            let near = release.wrapping_add(random.random_range(0..2 * PERIOD)) - PERIOD;
            let any = |random: &mut ChaCha8Rng| match random.random_range(0..4) {
                0 => random.random(),
                1 => [0, 1, u64::MAX, 1 << 63][random.random_range(0..4)],
                _ => near,
            };
            let stamp = Stamp {
                sequence: 1,
                published_ns: any(&mut random),
                data_ns: any(&mut random),
            };
            pll.hear(&stamp, release);
            let interval = pll.interval_ns(release);
            assert!(interval.abs_diff(PERIOD) <= (SLEW * PERIOD as f64) as u64 + 1);
            release += interval;
        }
    }
}
