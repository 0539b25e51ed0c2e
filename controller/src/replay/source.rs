//! What the cycles of a recording received.

use std::collections::HashMap;
use std::ops::Range;

use messages::{
    CycleFlags, CycleRecord, DesiredTwist, Features, InputCode, Message, Reply, RobotState,
    Snapshot, Stamp,
};
use recording::Recording;

use decision::{Input, Inputs};

/// The messages of a recording by what the records say of them.
pub struct Source<'a> {
    features: HashMap<(u64, u64), &'a Features>,
    robot: HashMap<(u64, u64), &'a RobotState>,
    desired: HashMap<(u64, u64), &'a DesiredTwist>,
    /// By the cycle from which they count.
    replies: HashMap<u64, Vec<&'a Reply>>,
    /// By the cycle that follows them.
    snapshots: HashMap<u64, Vec<&'a Snapshot>>,
}

impl<'a> Source<'a> {
    /// Sorts the messages of a recording.
    pub fn new(recording: &'a Recording) -> Self {
        let mut source = Self {
            features: by_stamp(&recording.features),
            robot: by_stamp(&recording.robot),
            desired: by_stamp(&recording.desired),
            replies: HashMap::new(),
            snapshots: HashMap::new(),
        };
        for reply in &recording.replies {
            source.replies.entry(reply.cycle).or_default().push(reply);
        }
        for snapshot in &recording.snapshots {
            let same = source.snapshots.entry(snapshot.cycle).or_default();
            same.push(snapshot);
        }
        source
    }

    /// The snapshot before this cycle. A restarted daemon counts from 1 again: it was taken after
    /// `begin_ns`, and before the cycle.
    pub fn snapshot(&self, record: &CycleRecord, begin_ns: u64) -> Option<&'a Snapshot> {
        let same = self.snapshots.get(&record.cycle)?.iter();
        let taken_ns = |snapshot: &Snapshot| snapshot.stamp.data_ns;
        same.copied()
            .filter(|snapshot| (begin_ns..=record.stamp.data_ns).contains(&taken_ns(snapshot)))
            .max_by_key(|snapshot| taken_ns(snapshot))
    }

    /// The cycles of a run up to number `until`, beginning with the last one that has a snapshot;
    /// none if the run does not come to that number.
    pub fn last_stretch<'b>(
        &self,
        run: &'b [CycleRecord],
        begin_ns: u64,
        until: u64,
    ) -> &'b [CycleRecord] {
        let end = run.partition_point(|record| record.cycle <= until);
        let run = &run[..end];
        if run.last().is_none_or(|last| last.cycle != until) {
            return &[];
        }
        let has_snapshot = |record: &CycleRecord| self.snapshot(record, begin_ns).is_some();
        &run[run.iter().rposition(has_snapshot).unwrap_or(end)..]
    }

    /// What this cycle received; `None` if a message is not in the recording.
    pub fn inputs(&self, record: &CycleRecord) -> Option<Inputs> {
        Some(Inputs {
            now_ns: record.stamp.data_ns.checked_add(record.receive_ns)?,
            features: input(record.features_input, record.features_seen, &self.features)?,
            robot: input(record.robot_input, record.robot_seen, &self.robot)?,
            desired: input(record.desired_input, record.desired_seen, &self.desired)?,
            missed: record.missed,
            suspended: record.flags & CycleFlags::SUSPENDED.0 != 0,
            shutdown: record.flags & CycleFlags::SHUTDOWN.0 != 0,
        })
    }

    /// The answers to the requests that this cycle took, published in this time; `None` if some are
    /// not in the recording.
    pub fn replies(
        &self,
        record: &CycleRecord,
        published_ns: Range<u64>,
    ) -> Option<Vec<&'a Reply>> {
        let all = self.replies.get(&record.cycle).into_iter().flatten();
        let is_of_run = |reply: &&Reply| published_ns.contains(&reply.stamp.published_ns);
        let replies: Vec<_> = all.copied().filter(is_of_run).collect();
        (replies.len() == record.requests as usize).then_some(replies)
    }
}

fn key(stamp: &Stamp) -> (u64, u64) {
    (stamp.sequence, stamp.published_ns)
}

fn by_stamp<T: Message>(messages: &[T]) -> HashMap<(u64, u64), &T> {
    messages.iter().map(|m| (key(m.stamp()), m)).collect()
}

fn input<T: Copy>(code: u32, seen: Stamp, messages: &HashMap<(u64, u64), &T>) -> Option<Input<T>> {
    Some(match InputCode::from_code(code)? {
        InputCode::Nothing => Input::Nothing,
        InputCode::Message => Input::Message(**messages.get(&key(&seen))?),
        InputCode::Refused => Input::Refused(seen),
        InputCode::Failed => Input::Failed,
    })
}
