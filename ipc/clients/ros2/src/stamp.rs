//! From header stamps, which are wall-clock times, to CLOCK_MONOTONIC.
//!
//! The distance of the two clocks is measured by reading them in pairs, again and again, so that it
//! follows a wall clock that is slewed. A step of the wall clock puts stamps in doubt that were
//! taken before it: they are refused until they would be too old anyway.

use rustix::time::{ClockId, clock_gettime};

use crate::message::Time;

/// Tries of a reading; the quickest counts.
const TRIES: usize = 3;
/// A change between two readings that no slewing explains: a step, ns.
const STEP_NS: u64 = 1_000_000;
/// Nanoseconds of a second.
const SECOND: i64 = 1_000_000_000;

/// Why a stamp is refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum StampError {
    #[error("its stamp is 0: the sender does not stamp")]
    Zero,
    #[error("its stamp has {0} ns; allowed: 0 to 999999999")]
    Nanoseconds(u32),
    #[error(
        "its stamp is {0:.1} ms in the future: are the clocks of both machines synchronized (PTP, NTP)?"
    )]
    Future(f64),
    #[error(
        "its stamp is {0:.1} ms old; allowed: {1} ms (max_age_ms). Simulated time, or clocks that are not synchronized?"
    )]
    Old(f64, u64),
    #[error("the wall clock stepped; stamps from before count again {0} ms later")]
    Step(u64),
    #[error("its stamp is not later than that of the message before")]
    Order,
}

impl StampError {
    /// A name for the counter.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Zero | Self::Nanoseconds(_) => "no stamp",
            Self::Future(_) => "stamp in the future",
            Self::Old(..) => "stamp too old",
            Self::Step(_) => "clock step",
            Self::Order => "out of order",
        }
    }
}

/// Reads the wall clock and CLOCK_MONOTONIC together: monotonic less wall, ns.
pub fn measure() -> i64 {
    let reading = || {
        let before = ipc::now_ns();
        let wall = clock_gettime(ClockId::Realtime);
        let after = ipc::now_ns();
        let wall = wall.tv_sec * SECOND + wall.tv_nsec;
        let middle = before + (after - before) / 2;
        (after - before, middle as i64 - wall)
    };
    let readings = (0..TRIES).map(|_| reading());
    readings.min().map_or(0, |(_, offset)| offset)
}

/// The wall-clock time of an instant of CLOCK_MONOTONIC, by the distance of both clocks, ns.
pub fn wall(monotonic_ns: u64, offset_ns: i64) -> Time {
    let wall = monotonic_ns as i64 - offset_ns;
    Time {
        sec: i32::try_from(wall.div_euclid(SECOND)).unwrap_or(i32::MAX),
        nanosec: wall.rem_euclid(SECOND) as u32,
    }
}

/// The distance of the clocks, followed.
#[derive(Clone, Debug)]
pub struct Clocks {
    offset_ns: i64,
    max_age_ns: u64,
    /// Until when stamps are in doubt, CLOCK_MONOTONIC, ns.
    doubt_until_ns: u64,
    /// Steps of the wall clock since the start.
    pub steps: u64,
}

/// The wall clock was set back, ms. Until it has caught up, the DDS library hands over no message of
/// a best-effort topic: it looks for those that came up to now.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the wall clock was set back by {0:.0} ms, more than max_age_ms: DDS hands over no message until it has caught up; start again"
)]
pub struct SetBack(pub f64);

impl Clocks {
    /// With a first measured distance, ns; stamps older than `max_age_ns` are refused.
    pub fn new(offset_ns: i64, max_age_ns: u64) -> Self {
        Self {
            offset_ns,
            max_age_ns,
            doubt_until_ns: 0,
            steps: 0,
        }
    }

    /// Takes a new measurement; returns the size of a step in ns, if it was one.
    ///
    /// # Errors
    /// [`SetBack`].
    pub fn follow(&mut self, offset_ns: i64, now_ns: u64) -> Result<Option<i64>, SetBack> {
        let change = offset_ns - self.offset_ns;
        self.offset_ns = offset_ns;
        if change.unsigned_abs() <= STEP_NS {
            return Ok(None);
        }
        self.steps += 1;
        // Set back, the wall clock makes what was stamped before look younger by the step.
        let doubt = self.max_age_ns + change.unsigned_abs().min(self.max_age_ns);
        self.doubt_until_ns = self.doubt_until_ns.max(now_ns + doubt);
        match change > self.max_age_ns as i64 {
            true => Err(SetBack(1e-6 * change as f64)),
            false => Ok(Some(change)),
        }
    }

    /// Monotonic less wall, ns.
    pub fn offset_ns(&self) -> i64 {
        self.offset_ns
    }

    /// The instant of a stamp, CLOCK_MONOTONIC, ns; `shift_ns` is added to it.
    ///
    /// # Errors
    /// [`StampError`]: there is none, it is in the future or too old, or the wall clock stepped.
    pub fn instant(&self, stamp: &Time, shift_ns: i64, now_ns: u64) -> Result<u64, StampError> {
        if stamp.sec == 0 && stamp.nanosec == 0 {
            return Err(StampError::Zero);
        }
        if i64::from(stamp.nanosec) >= SECOND {
            return Err(StampError::Nanoseconds(stamp.nanosec));
        }
        let wall = i64::from(stamp.sec) * SECOND + i64::from(stamp.nanosec);
        let age = now_ns as i64 - (wall + self.offset_ns + shift_ns);
        let ms = |ns: i64| 1e-6 * ns as f64;
        if now_ns < self.doubt_until_ns {
            return Err(StampError::Step((self.doubt_until_ns - now_ns) / 1_000_000));
        }
        if age < -(messages::FUTURE_NS as i64) {
            return Err(StampError::Future(-ms(age)));
        }
        if age > self.max_age_ns as i64 {
            return Err(StampError::Old(ms(age), self.max_age_ns / 1_000_000));
        }
        // vpcd allows no less than this tolerance; an instant in the future helps nobody.
        Ok(now_ns.saturating_sub(age.max(0) as u64))
    }
}

/// Lets instants pass that grow.
#[derive(Clone, Copy, Debug, Default)]
pub struct Order(u64);

impl Order {
    /// The instant, ns.
    ///
    /// # Errors
    /// [`StampError::Order`] if it is not later than the one before.
    pub fn after(&mut self, instant_ns: u64) -> Result<u64, StampError> {
        if instant_ns <= self.0 {
            return Err(StampError::Order);
        }
        self.0 = instant_ns;
        Ok(instant_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: u64 = 50 * SECOND as u64;
    const OFFSET: i64 = -1_700_000_000 * SECOND;
    const MS: i64 = 1_000_000;

    fn clocks() -> Clocks {
        Clocks::new(OFFSET, 200 * MS as u64)
    }

    fn aged(age_ns: i64) -> Time {
        wall((NOW as i64 - age_ns) as u64, OFFSET)
    }

    #[test]
    fn a_stamp_becomes_the_instant_it_was_taken_at() {
        let instant = |age| clocks().instant(&aged(age), 0, NOW);
        assert_eq!(instant(20 * MS), Ok(NOW - 20 * MS as u64));
        assert_eq!(instant(200 * MS), Ok(NOW - 200 * MS as u64));
        // Within the tolerance of one clock for all.
        assert_eq!(instant(-MS / 2), Ok(NOW));
        assert_eq!(
            clocks().instant(&aged(20 * MS), 5 * MS, NOW),
            Ok(NOW - 15 * MS as u64)
        );
    }

    #[test]
    fn what_is_old_from_the_future_or_no_stamp_is_refused() {
        let refused = |stamp: Time| clocks().instant(&stamp, 0, NOW).unwrap_err();
        assert_eq!(refused(aged(201 * MS)), StampError::Old(201.0, 200));
        assert_eq!(refused(aged(-2 * MS)), StampError::Future(2.0));
        assert_eq!(refused(Time::default()), StampError::Zero);
        let broken = Time {
            nanosec: 1_000_000_000,
            ..aged(0)
        };
        assert_eq!(refused(broken), StampError::Nanoseconds(1_000_000_000));
        let earliest = Time {
            sec: i32::MIN,
            nanosec: 0,
        };
        assert!(matches!(refused(earliest), StampError::Old(..)));
    }

    #[test]
    fn a_stepped_clock_puts_stamps_in_doubt_for_a_while() {
        let mut clocks = clocks();
        for k in 1..=10 {
            assert_eq!(clocks.follow(OFFSET + k * MS / 2, NOW), Ok(None));
        }
        let shifted = clocks.instant(&aged(20 * MS), 0, NOW).unwrap();
        assert_eq!(shifted, NOW - 15 * MS as u64);
        // The wall clock is set back by 50 ms: what was stamped before looks younger than it is.
        let stepped = OFFSET + 55 * MS;
        assert_eq!(clocks.follow(stepped, NOW), Ok(Some(50 * MS)));
        assert_eq!(clocks.steps, 1);
        assert!(matches!(
            clocks.instant(&aged(60 * MS), 0, NOW),
            Err(StampError::Step(250))
        ));
        let later = NOW + 250 * MS as u64;
        let fresh = wall(later - 10 * MS as u64, stepped);
        let instant = clocks.instant(&fresh, 0, later);
        assert_eq!(instant, Ok(later - 10 * MS as u64));
        // Set back by more than the greatest age, it makes the library deaf; set forward it does not.
        assert!(matches!(clocks.follow(stepped - SECOND, NOW), Ok(Some(_))));
        assert_eq!(clocks.follow(stepped, NOW), Err(SetBack(1000.0)));
    }

    #[test]
    fn instants_must_grow() {
        let mut order = Order::default();
        assert_eq!(order.after(5), Ok(5));
        assert_eq!(order.after(5), Err(StampError::Order));
        assert_eq!(order.after(4), Err(StampError::Order));
        assert_eq!(order.after(6), Ok(6));
    }

    #[test]
    fn the_measured_distance_holds() {
        let (offset, now) = (measure(), ipc::now_ns());
        let wall = clock_gettime(ClockId::Realtime);
        let error = now as i64 - offset - (wall.tv_sec * SECOND + wall.tv_nsec);
        assert!(error.abs() < SECOND, "{error} ns");
    }
}
