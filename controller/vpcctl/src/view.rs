//! The daemon's state as its messages show it; pure.

use std::collections::{BTreeMap, VecDeque};

use messages::{
    Bound, CycleRecord, Features, Hold, ImageHeader, Order, Received, RobotState, TwistState,
};
use scene::Arm;

use crate::latency::{Histogram, STAGES, durations};
use crate::units::duration;

/// Most records kept.
const RECORDS: usize = 1024;
/// Most changes of state kept.
const CHANGES: usize = 16;
/// Most headers of images kept.
const IMAGES: usize = 256;
/// The time that rates are measured over, ns.
const RATE_NS: u64 = 2_000_000_000;
/// Age from which the robot's state, and the camera's features, count as missing, ns.
const SILENT_NS: [u64; 2] = [1_000_000_000, 500_000_000];

/// A change of the state or its cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// When it began, CLOCK_MONOTONIC, ns.
    pub at_ns: u64,
    /// The state from then on.
    pub state: TwistState,
    /// Why the law's twist is not sent; `None` if it is.
    pub hold: Option<Hold>,
}

/// What is known of a daemon.
#[derive(Clone, Debug, Default)]
pub struct View {
    recent: VecDeque<CycleRecord>,
    changes: VecDeque<Change>,
    /// State of the newest cycle, and its cause as [`cause`](Self::cause) has it.
    standing: Option<(TwistState, Option<Hold>)>,
    images: VecDeque<ImageHeader>,
    /// The newest cycle that used features: what a run came to, also when it is over.
    pub seen: Option<CycleRecord>,
    /// The newest state of the robot.
    pub robot: Option<RobotState>,
    /// The arm of the daemon's scene, where that is known.
    pub arm: Option<Arm>,
    /// The newest message of the camera.
    pub features: Option<Features>,
    /// Durations of each of [`STAGES`].
    pub histograms: [Histogram; STAGES.len()],
    /// Cycles received.
    pub received: u64,
    /// Cycles by the code of what kept the law's twist back; 0 is nothing.
    pub held: BTreeMap<u32, u64>,
    /// Cycles in which the memory was asked.
    pub recalled: u64,
    /// Page faults without a disk and with one, blocking calls and calls of the heap by the loop's
    /// thread between wake and send.
    pub disturbances: [u64; 4],
    /// Cycles that were published and not received.
    pub missed: u64,
    /// Messages that broke the contract.
    pub refused: u64,
    /// Restarts of the daemon.
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
                self.seen = None;
                self.standing = None;
            }
            Order::First | Order::Next | Order::Repeated => (),
        }
        self.received += 1;
        for (histogram, ns) in self.histograms.iter_mut().zip(durations(&record)) {
            histogram.count(ns);
        }
        self.recalled += u64::from(record.recalled == messages::RecallCode::Followed.code());
        *self.held.entry(record.hold).or_default() += 1;
        let faults = [record.minor_faults, record.major_faults];
        let calls = [record.blocked, record.allocations];
        for (sum, count) in self
            .disturbances
            .iter_mut()
            .zip(faults.iter().chain(&calls))
        {
            *sum += u64::from(*count);
        }
        if record.count > 0 {
            self.seen = Some(record);
        }
        self.note_change(&record);
        keep(&mut self.recent, record, RECORDS);
    }

    fn note_change(&mut self, record: &CycleRecord) {
        let Some(state) = TwistState::from_code(record.state) else {
            return;
        };
        let hold = record.hold();
        // A fault of the robot, say, replaces the cause of a daemon that is disarmed already.
        let is_disarmed = matches!(self.standing, Some((TwistState::Disarmed, _)));
        if !is_disarmed || state != TwistState::Disarmed || hold == Some(Hold::Operator) {
            self.standing = Some((state, hold));
        }
        let last = self.changes.back();
        if last.is_none_or(|last| (last.state, last.hold) != (state, hold)) {
            let at_ns = record.stamp.data_ns;
            keep(&mut self.changes, Change { at_ns, state, hold }, CHANGES);
        }
    }

    /// The newest cycle.
    pub fn latest(&self) -> Option<&CycleRecord> {
        self.recent.back()
    }

    /// The cycles of the last `span_ns` before the newest, oldest first; at most 1024.
    pub fn recent(&self, span_ns: u64) -> impl DoubleEndedIterator<Item = &CycleRecord> {
        let newest = self.latest().map_or(0, |last| last.stamp.data_ns);
        let from = newest.saturating_sub(span_ns);
        let first = self
            .recent
            .partition_point(|record| record.stamp.data_ns < from);
        self.recent.range(first..)
    }

    /// The cycles that used features in the last `span_ns` before the newest of them, oldest first.
    pub fn trail(&self, span_ns: u64) -> impl Iterator<Item = &CycleRecord> {
        let newest = self.seen.map_or(0, |seen| seen.stamp.data_ns);
        let from = newest.saturating_sub(span_ns);
        let used = self.recent.iter().filter(|record| record.count > 0);
        used.filter(move |record| record.stamp.data_ns >= from)
    }

    /// Changes of state and cause, oldest first; the last one is the present.
    pub fn changes(&self) -> impl DoubleEndedIterator<Item = &Change> {
        self.changes.iter()
    }

    /// What keeps the law's twist back since the newest cycle; of a disarmed daemon what disarmed it,
    /// or an operator's stop since then.
    pub fn cause(&self) -> Option<Hold> {
        self.standing.and_then(|(_, hold)| hold)
    }

    /// The last cause that kept the law's twist back, and when it ended, ns; `None` while it lasts.
    pub fn last_cause(&self) -> Option<(Hold, Option<u64>)> {
        let place = self
            .changes
            .iter()
            .rposition(|change| change.hold.is_some())?;
        let hold = self.changes.get(place)?.hold?;
        Some((hold, self.changes.get(place + 1).map(|next| next.at_ns)))
    }

    /// Measured rate of the cycles of the last two seconds, Hz. Cycles that were missed count.
    pub fn rate_hz(&self) -> Option<f64> {
        let (first, last) = (self.recent(RATE_NS).next()?, self.latest()?);
        let time_ns = last.stamp.data_ns.checked_sub(first.stamp.data_ns)?;
        let cycles = last.cycle.checked_sub(first.cycle)?;
        (time_ns > 0).then(|| cycles as f64 / (time_ns as f64 * 1e-9))
    }

    /// Takes in the header of an image.
    pub fn add_image(&mut self, header: &ImageHeader, order: Order) {
        if order == Order::Restarted {
            self.images.clear();
        }
        keep(&mut self.images, *header, IMAGES);
    }

    /// The header of the newest image.
    pub fn image(&self) -> Option<&ImageHeader> {
        self.images.back()
    }

    /// Measured rate of the camera's frames in the last two seconds of images, Hz. Those that were
    /// lost, or not looked at, count.
    pub fn image_rate_hz(&self) -> Option<f64> {
        let last = self.images.back()?.stamp;
        let from = last.published_ns.saturating_sub(RATE_NS);
        let mut images = self.images.iter().map(|image| image.stamp);
        let first = images.find(|first| first.published_ns >= from)?;
        let time_ns = last.published_ns.checked_sub(first.published_ns)?;
        let frames = last.sequence.checked_sub(first.sequence)?;
        (time_ns > 0).then(|| frames as f64 / (time_ns as f64 * 1e-9))
    }

    /// The newest state of the robot, unless it is older than a second.
    pub fn robot_at(&self, now_ns: u64) -> Option<&RobotState> {
        let heard = self.robot.as_ref()?;
        let age = now_ns.saturating_sub(heard.stamp.published_ns);
        (age <= SILENT_NS[0]).then_some(heard)
    }

    /// What the robot does, with its faults.
    pub fn robot_words(&self, now_ns: u64) -> String {
        let Some(robot) = self.robot_at(now_ns) else {
            return "silent".to_owned();
        };
        let mode = word(robot.mode());
        match faults(robot) {
            none if none.is_empty() => mode,
            faults => format!("{mode}: {}", faults.join(", ")),
        }
    }

    /// What of the arm binds the law's command, of the newest cycle with features.
    pub fn bound(&self) -> Option<Bound<'_>> {
        let bound = self.seen.as_ref().or(self.latest())?.bound()?;
        Some(match &self.arm {
            Some(arm) => bound.named(arm.names()),
            None => bound,
        })
    }

    /// What is wrong with the joints that the robot told last, in words.
    pub fn joint_fault(&self) -> Option<String> {
        let names = self.arm.as_ref().map_or(&[][..], |arm| &arm.joint_names);
        Some(self.latest()?.joint_fault()?.words(names).to_string())
    }

    /// How long ago the camera sent the newest features, ns, where that is too long.
    pub fn camera_silence_ns(&self, now_ns: u64) -> Option<u64> {
        let sent = self.features.map(|features| features.stamp.published_ns);
        let newest = self.latest().filter(|last| last.features_sequence > 0);
        let used = newest.map(|last| last.stamp.data_ns.saturating_sub(last.features_age_ns));
        let seen = self.seen.map(|record| record.stamp.data_ns);
        let age = now_ns.saturating_sub(sent.max(used).max(seen)?);
        (age > SILENT_NS[1]).then_some(age)
    }

    /// Why the law's twist is not sent: the words of the contract, but of a camera that was there
    /// and is no more, since when, and by how much it is late. `None` if the twist is sent.
    pub fn cause_words(&self, now_ns: u64) -> Option<String> {
        let latest = self.latest()?;
        let hold = latest.hold()?;
        let words = match hold {
            Hold::Stale | Hold::Lost | Hold::NoFeatures => self
                .camera_silence_ns(now_ns)
                .map(|age| format!("camera silent for {}", duration(age))),
            Hold::RobotLate | Hold::ImageLate => Some(format!("{hold} by {:.2} s", latest.lag_s)),
            Hold::NoWay => self.bound().map(|bound| format!("{hold}: {bound}")),
            Hold::NoJoints | Hold::JointsNotFollowing => {
                let number = || {
                    let arm = self.arm.as_ref().filter(|_| hold == Hold::NoJoints);
                    let joints = arm?.joints.len();
                    let told = self.robot_at(now_ns).map_or(0, |robot| robot.joints);
                    Some(format!(
                        "the robot tells {told}, the scene's arm has {joints}"
                    ))
                };
                let fault = self.joint_fault().or_else(number);
                fault.map(|fault| format!("{hold}: {fault}"))
            }
            _ => None,
        };
        Some(words.unwrap_or_else(|| hold.to_string()))
    }

    /// Age of the newest cycle, ns.
    pub fn silence_ns(&self, now_ns: u64) -> Option<u64> {
        Some(now_ns.saturating_sub(self.latest()?.stamp.published_ns))
    }
}

/// Appends a value; the oldest makes room.
fn keep<T>(queue: &mut VecDeque<T>, value: T, most: usize) {
    if queue.len() == most {
        queue.pop_front();
    }
    queue.push_back(value);
}

/// The faults that the robot reports.
pub fn faults(robot: &RobotState) -> Vec<&'static str> {
    robot.faults().names().map(|fault| fault.text).collect()
}

/// The name of a code of the contract; "unknown" for an unknown code.
pub fn word(value: Option<impl ToString>) -> String {
    value.map_or_else(|| "unknown".to_owned(), |value| value.to_string())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Cycle `number` of a 100 Hz loop in this state.
    pub fn record(number: u64, state: TwistState, hold: impl Into<Option<Hold>>) -> CycleRecord {
        let mut record = CycleRecord {
            cycle: number,
            state: state.code(),
            hold: Hold::number(hold.into()),
            step_ns: 1000 * number,
            ..CycleRecord::default()
        };
        record.stamp.sequence = number;
        record.stamp.data_ns = number * 10_000_000;
        record.stamp.published_ns = record.stamp.data_ns + 500;
        record
    }

    /// Takes in images with these numbers, of a camera of 100 Hz.
    pub fn images(view: &mut View, numbers: &[u64]) {
        for &number in numbers {
            let mut header = ImageHeader::new(640, 480, messages::Encoding::Mono8, 0);
            (header.stamp.sequence, header.stamp.published_ns) = (number, number * 10_000_000);
            view.add_image(&header, Order::Next);
        }
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
        let cycle = |number| record(number, TwistState::Moving, None);
        let view = fed(&[cycle(1), cycle(2), cycle(11)]);
        let rate = view.rate_hz().unwrap();
        assert!((rate - 100.0).abs() < 1e-9, "{rate}");
        assert_eq!(fed(&[cycle(1)]).rate_hz(), None);
    }

    #[test]
    fn the_rate_of_images_counts_unseen_ones() {
        let mut view = View::default();
        images(&mut view, &[1]);
        assert_eq!(view.image_rate_hz(), None);
        images(&mut view, &[2, 5, 600, 610]);
        assert_eq!(view.image_rate_hz(), Some(100.0));
        let mut other = *view.image().unwrap();
        (other.stamp.sequence, other.stamp.published_ns) = (1, 0);
        view.add_image(&other, Order::Restarted);
        assert_eq!(view.image_rate_hz(), None);
    }

    #[test]
    fn the_last_cause_is_remembered_after_it_is_over() {
        let moving = |number| record(number, TwistState::Moving, None);
        let mut records = vec![moving(1)];
        assert_eq!(fed(&records).last_cause(), None);
        records.push(record(2, TwistState::Holding, Hold::Stale));
        let view = fed(&records);
        assert_eq!(view.last_cause(), Some((Hold::Stale, None)));
        assert_eq!(view.changes().last().unwrap().at_ns, 20_000_000);
        records.extend([moving(3), moving(4)]);
        let (cause, over) = fed(&records).last_cause().unwrap();
        assert_eq!((cause, over), (Hold::Stale, Some(30_000_000)));
    }

    #[test]
    fn a_disarmed_daemon_keeps_its_cause_until_an_operator_acts() {
        let disarmed = |hold| record(1, TwistState::Disarmed, hold);
        let moving = record(1, TwistState::Moving, None);
        let (lost, fault, operator) = (Hold::Lost, Hold::RobotFault, Hold::Operator);
        let cause = |records: &[CycleRecord]| fed(records).cause().unwrap();
        for first in [Hold::NotArmed, Hold::Operator] {
            assert_eq!(cause(&[disarmed(first), disarmed(fault)]), first);
        }
        let braking = record(1, TwistState::Braking, lost);
        let mut records = vec![moving, braking, disarmed(lost), disarmed(fault)];
        assert_eq!(cause(&records), lost);
        records.push(disarmed(operator));
        assert_eq!(cause(&records), operator);
        records.extend([moving, disarmed(fault)]);
        assert_eq!(cause(&records), fault);
        // Another daemon.
        let mut view = fed(&records);
        let message = disarmed(Hold::Unclean);
        let order = Order::Restarted;
        view.cycle(&Received { message, order });
        assert_eq!(view.cause(), Some(Hold::Unclean));
    }

    #[test]
    fn a_restart_forgets_the_cycles_but_not_the_counts() {
        let mut view = fed(&[record(8, TwistState::Moving, None)]);
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
    fn no_way_is_told_with_what_binds_and_unknown_joints_with_their_number() {
        let no_way = record(1, TwistState::Holding, Hold::NoWay);
        let words = |view: &View| view.cause_words(0).unwrap();
        let view = fed(&[no_way]);
        assert_eq!(words(&view), "no way known");
        let mut view = crate::joints::tests::with_arm(view, 0);
        assert_eq!(
            words(&view),
            "no way known: panda_joint4 is at the end of its range"
        );
        view.arm = None;
        assert_eq!(
            words(&view),
            "no way known: joint 4 is at the end of its range"
        );
        let view = fed(&[record(1, TwistState::Holding, Hold::NoJoints)]);
        assert_eq!(words(&view), "joints unknown");
        let mut view = crate::joints::tests::with_arm(view, 0);
        view.robot.as_mut().unwrap().joints = 6;
        let told = "joints unknown: the robot tells 6, the scene's arm has 7";
        assert_eq!(words(&view), told);
        view.robot = None;
        assert_eq!(words(&view), told.replace('6', "0"));
        let mut refused = record(2, TwistState::Holding, Hold::NoJoints);
        refused.joint_fault = messages::JointFaultCode::Range.code();
        (refused.joint_fault_index, refused.joint_fault_found) = (6, 5.0);
        refused.joint_fault_allowed = [-2.947, 2.947];
        let view = crate::joints::tests::with_arm(fed(&[refused]), 0);
        assert_eq!(
            words(&view),
            "joints unknown: panda_joint7 is told at 5.000; allowed: -2.947 to 2.947"
        );
    }

    #[test]
    fn what_is_late_is_told_with_its_lag() {
        let mut late = record(1, TwistState::Disarmed, Hold::RobotLate);
        late.lag_s = 0.406;
        let words = fed(&[late]).cause_words(0);
        assert_eq!(words.as_deref(), Some("robot is late by 0.41 s"));
    }

    #[test]
    fn what_falls_out_of_the_window_is_left_out() {
        let cycle = |number| record(number, TwistState::Moving, None);
        let view = fed(&(1..=2000).map(cycle).collect::<Vec<_>>());
        assert_eq!(view.recent(u64::MAX).count(), 1024);
        assert_eq!(view.recent(1_000_000_000).count(), 101);
        assert_eq!(view.histograms[2].counts.iter().sum::<u64>(), 2000);
    }

    #[test]
    fn a_camera_that_ended_is_told_and_its_features_stay() {
        let mut used = record(4, TwistState::Moving, None);
        used.count = 4;
        let stale = record(60, TwistState::Holding, Hold::Stale);
        let view = fed(&[used, stale]);
        let words = |now_ns| view.cause_words(now_ns);
        assert_eq!(words(100_000_000).as_deref(), Some("stale features"));
        assert_eq!(
            words(2_040_000_000).as_deref(),
            Some("camera silent for 2.00 s")
        );
        assert_eq!(view.seen.map(|record| record.cycle), Some(4));
        // Without features there was no camera; another cause is another matter.
        assert_eq!(
            fed(&[stale]).cause_words(u64::MAX).as_deref(),
            Some("stale features")
        );
        let robot = record(61, TwistState::Holding, Hold::RobotFault);
        assert_eq!(
            fed(&[used, robot]).cause_words(u64::MAX).as_deref(),
            Some("robot fault")
        );
        assert_eq!(fed(&[used]).cause_words(u64::MAX), None);
    }
}
