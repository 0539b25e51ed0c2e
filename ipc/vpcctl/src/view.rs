//! What is known of a daemon from watching it: pure bookkeeping, fed message by message.

use std::collections::{BTreeMap, VecDeque};

use ipc::{CycleRecord, Features, Hold, Order, Received, RobotState, TwistState};

use crate::phase::{Histogram, Phase};

/// Most records kept.
const KEPT: usize = 1024;
/// Most changes of state kept.
const CHANGES: usize = 16;

/// A change of state or of its cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// When it began, CLOCK_MONOTONIC, ns.
    pub at_ns: u64,
    /// The state.
    pub state: TwistState,
    /// Why the law's twist is not sent.
    pub hold: Hold,
}

/// What is known of a daemon.
#[derive(Clone, Debug, Default)]
pub struct View {
    recent: VecDeque<CycleRecord>,
    changes: VecDeque<Change>,
    /// The newest state of the robot.
    pub robot: Option<RobotState>,
    /// The newest message of the camera.
    pub features: Option<Features>,
    /// Times of each phase since the watching began, in the order of [`Phase::ALL`].
    pub histograms: [Histogram; Phase::ALL.len()],
    /// Cycles received.
    pub received: u64,
    /// Cycles in which each cause kept the law's twist back, by its code; 0 is none.
    pub held: BTreeMap<u32, u64>,
    /// Cycles in which the memory was asked.
    pub recalled: u64,
    /// Page faults without a disk, page faults with one, calls that blocked and calls of the heap, all of the loop's
    /// thread between wake and send in the cycles watched.
    pub disturbances: [u64; 4],
    /// Cycles that were published and that we missed.
    pub missed: u64,
    /// Messages that broke the contract.
    pub refused: u64,
    /// Starts of the daemon after the first that we saw.
    pub restarts: u64,
}

impl View {
    /// Takes in a cycle.
    pub fn cycle(&mut self, received: &Received<CycleRecord>) {
        let record = received.message;
        match received.order {
            Order::Gap { missed } => self.missed += missed,
            Order::Restarted => {
                self.restarts += 1;
                self.recent.clear();
            }
            Order::First | Order::Next | Order::Repeated => (),
        }
        self.received += 1;
        for (phase, histogram) in Phase::ALL.into_iter().zip(&mut self.histograms) {
            histogram.count(phase.of(&record));
        }
        self.recalled += u64::from(record.recalled == ipc::RecallCode::Followed.code());
        *self.held.entry(record.hold).or_default() += 1;
        let counts = [
            record.minor_faults,
            record.major_faults,
            record.blocked,
            record.allocations,
        ];
        for (sum, count) in self.disturbances.iter_mut().zip(counts) {
            *sum += u64::from(count);
        }
        self.note_change(&record);
        if self.recent.len() == KEPT {
            self.recent.pop_front();
        }
        self.recent.push_back(record);
    }

    fn note_change(&mut self, record: &CycleRecord) {
        let (Some(state), Some(hold)) = (TwistState::from_code(record.state), record.hold()) else {
            return;
        };
        if self
            .changes
            .back()
            .is_some_and(|last| (last.state, last.hold) == (state, hold))
        {
            return;
        }
        if self.changes.len() == CHANGES {
            self.changes.pop_front();
        }
        self.changes.push_back(Change {
            at_ns: record.stamp.data_ns,
            state,
            hold,
        });
    }

    /// The newest cycle.
    pub fn latest(&self) -> Option<&CycleRecord> {
        self.recent.back()
    }

    /// The cycles of the last `span_ns` before the newest, oldest first; at most 1024.
    pub fn recent(&self, span_ns: u64) -> impl DoubleEndedIterator<Item = &CycleRecord> {
        let from = self
            .latest()
            .map_or(0, |last| last.stamp.data_ns.saturating_sub(span_ns));
        let first = self
            .recent
            .partition_point(|record| record.stamp.data_ns < from);
        self.recent.range(first..)
    }

    /// Changes of state and cause, oldest first; the last one is the present.
    pub fn changes(&self) -> impl DoubleEndedIterator<Item = &Change> {
        self.changes.iter()
    }

    /// The last cause that kept the law's twist back, and when it was over (`None` while it lasts), ns.
    pub fn last_cause(&self) -> Option<(Change, Option<u64>)> {
        let place = self
            .changes
            .iter()
            .rposition(|change| change.hold != Hold::None)?;
        let change = *self.changes.get(place)?;
        Some((change, self.changes.get(place + 1).map(|next| next.at_ns)))
    }

    /// Cycles a second, from the times at which the newest cycles woke up: those of the last two seconds.
    pub fn rate_hz(&self) -> Option<f64> {
        let (mut first, mut count) = (None, 0_u32);
        for record in self.recent(2_000_000_000) {
            first.get_or_insert((record.stamp.data_ns, record.cycle));
            count += 1;
        }
        let ((from, first), last) = (first?, self.latest()?);
        let time = last
            .stamp
            .data_ns
            .checked_sub(from)
            .filter(|&time| time > 0)?;
        // Cycles that we missed count as well; numbers that fall back are no daemon's of ours.
        let cycles = last.cycle.checked_sub(first).filter(|_| count > 1)?;
        Some(cycles as f64 / (time as f64 * 1e-9))
    }

    /// The newest state of the robot, unless that is older than a second: then it is silent.
    pub fn robot_at(&self, now_ns: u64) -> Option<&RobotState> {
        let heard = self.robot.as_ref()?;
        let age = now_ns.saturating_sub(heard.stamp.published_ns);
        (age <= 1_000_000_000).then_some(heard)
    }

    /// Age of the newest cycle, ns.
    pub fn silence_ns(&self, now_ns: u64) -> Option<u64> {
        Some(now_ns.saturating_sub(self.latest()?.stamp.published_ns))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Cycle `number` of a 100 Hz loop in this state.
    pub fn record(number: u64, state: TwistState, hold: Hold) -> CycleRecord {
        let mut record = CycleRecord {
            cycle: number,
            state: state.code(),
            hold: hold.code(),
            step_ns: 1000 * number,
            ..CycleRecord::default()
        };
        record.stamp.sequence = number;
        record.stamp.data_ns = number * 10_000_000;
        record.stamp.published_ns = record.stamp.data_ns + 500;
        record
    }

    fn fed(records: &[CycleRecord]) -> View {
        let mut view = View::default();
        for record in records {
            let order = Order::Next;
            let message = *record;
            view.cycle(&Received { message, order });
        }
        view
    }

    #[test]
    fn the_rate_counts_missed_cycles_too() {
        let cycle = |number| record(number, TwistState::Moving, Hold::None);
        let view = fed(&[cycle(1), cycle(2), cycle(11)]);
        let rate = view.rate_hz().unwrap();
        assert!((rate - 100.0).abs() < 1e-9, "{rate}");
        assert_eq!(fed(&[cycle(1)]).rate_hz(), None);
    }

    #[test]
    fn the_last_cause_is_remembered_after_it_is_over() {
        let moving = |number| record(number, TwistState::Moving, Hold::None);
        let mut records = vec![moving(1)];
        assert_eq!(fed(&records).last_cause(), None);
        records.push(record(2, TwistState::Holding, Hold::Stale));
        let (cause, over) = fed(&records).last_cause().unwrap();
        assert_eq!(
            (cause.hold, cause.at_ns, over),
            (Hold::Stale, 20_000_000, None)
        );
        records.extend([moving(3), moving(4)]);
        let (cause, over) = fed(&records).last_cause().unwrap();
        assert_eq!((cause.hold, over), (Hold::Stale, Some(30_000_000)));
    }

    #[test]
    fn a_restart_forgets_the_cycles_but_not_the_counts() {
        let mut view = fed(&[record(8, TwistState::Moving, Hold::None)]);
        let message = record(1, TwistState::Holding, Hold::NoFeatures);
        let order = Order::Restarted;
        view.cycle(&Received { message, order });
        assert_eq!((view.received, view.restarts), (2, 1));
        assert_eq!(view.recent(u64::MAX).count(), 1);
        assert_eq!(view.held[&Hold::NoFeatures.code()], 1);
    }

    #[test]
    fn a_robot_that_is_gone_is_silent() {
        let mut view = View::default();
        assert_eq!(view.robot_at(0), None);
        view.robot = Some(RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], 0));
        assert!(view.robot_at(1_000_000_000).is_some());
        assert!(view.robot_at(1_000_000_001).is_none());
    }

    #[test]
    fn what_falls_out_of_the_window_is_left_out() {
        let cycle = |number| record(number, TwistState::Moving, Hold::None);
        let view = fed(&(1..=2000).map(cycle).collect::<Vec<_>>());
        assert_eq!(view.recent(u64::MAX).count(), 1024);
        assert_eq!(view.recent(1_000_000_000).count(), 101);
        assert_eq!(view.histograms[Phase::Step as usize].total(), 2000);
    }
}
