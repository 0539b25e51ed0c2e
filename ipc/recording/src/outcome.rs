//! What a replay found.

use std::fmt;

use ipc::{CycleRecord, Hold, TwistState};
use serde::Serialize;

/// Cycles, about a second, after which a state that was taken over is near the true one.
const LATE: u64 = 30;

/// A cycle that came out otherwise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Its number.
    pub cycle: u64,
    /// Largest difference of a component of the twist, m/s and rad/s.
    pub difference: f64,
    /// The twist that was sent.
    pub recorded: [f64; 6],
    /// The twist that came out.
    pub replayed: [f64; 6],
    /// State and cause that were recorded.
    pub recorded_state: String,
    /// State and cause that came out.
    pub replayed_state: String,
}

/// Cycles before which something is not in the recording: each was replayed from a state taken over from the records
/// before it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TakenOver {
    /// Number of the first one.
    pub first: u64,
    /// Number of the last one; from the next on the state is known.
    pub last: u64,
    /// Largest difference of a component of a twist, m/s and rad/s; it tells how much was not known, and of no fault.
    pub largest: f64,
    /// The same of the cycles after its first 30, about a second.
    pub largest_late: f64,
}

/// What a replay found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Outcome {
    /// Cycles replayed.
    pub cycles: u64,
    /// ... in which the law ran.
    pub steps: u64,
    /// ... that were judged: all that decided them is in the recording.
    pub judged: u64,
    /// Judged cycles whose twist, state and cause came out bit for bit.
    pub equal: u64,
    /// ... that differ by more than the tolerance, or in state or cause.
    pub different: u64,
    /// Largest difference of a component of a twist, m/s and rad/s.
    pub largest: f64,
    /// The first cycle that differs.
    pub first: Option<Difference>,
    /// Number of the first cycle in the recording; above 1 it was begun in mid-run.
    pub begins_at: u64,
    /// The cycles that were not judged.
    pub taken_over: Vec<TakenOver>,
    /// Features that cycles used and that are not in the recording.
    pub missing_features: u64,
    /// Records of cycles that are not in the recording, between those that are.
    pub missing_cycles: u64,
}

/// Largest difference of a component of the twists, m/s and rad/s.
fn difference(recorded: &CycleRecord, replayed: &CycleRecord) -> f64 {
    let pairs = recorded.twist.iter().zip(&replayed.twist);
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

fn words(record: &CycleRecord) -> String {
    let state = TwistState::from_code(record.state).map_or("?".to_owned(), |s| s.to_string());
    match Hold::from_code(record.hold) {
        Some(Hold::None) | None => state,
        Some(cause) => format!("{state}: {cause}"),
    }
}

impl Outcome {
    /// Judges a cycle: a twist that differs by at most `tolerance` (m/s, rad/s) counts as the same.
    pub(crate) fn judge(&mut self, recorded: &CycleRecord, replayed: &CycleRecord, tolerance: f64) {
        let difference = difference(recorded, replayed);
        let situation = |record: &CycleRecord| (record.state, record.hold);
        let is_same_situation = situation(recorded) == situation(replayed);
        let bits = |record: &CycleRecord| record.twist.map(f64::to_bits);
        self.judged += 1;
        self.equal += u64::from(is_same_situation && bits(recorded) == bits(replayed));
        self.largest = self.largest.max(difference);
        if is_same_situation && difference <= tolerance {
            return;
        }
        self.different += 1;
        self.first.get_or_insert_with(|| Difference {
            cycle: recorded.cycle,
            difference,
            recorded: recorded.twist,
            replayed: replayed.twist,
            recorded_state: words(recorded),
            replayed_state: words(replayed),
        });
    }

    /// Notes a cycle that cannot be judged.
    pub(crate) fn take_over(&mut self, recorded: &CycleRecord, replayed: &CycleRecord) {
        let (number, largest) = (recorded.cycle, difference(recorded, replayed));
        match self.taken_over.last_mut() {
            Some(stretch) if stretch.last + 1 == number => {
                stretch.last = number;
                stretch.largest = stretch.largest.max(largest);
                if number - stretch.first >= LATE {
                    stretch.largest_late = stretch.largest_late.max(largest);
                }
            }
            _ => self.taken_over.push(TakenOver {
                first: number,
                last: number,
                largest,
                largest_late: 0.0,
            }),
        }
    }
}

/// The outcome as text.
impl fmt::Display for Outcome {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            to,
            "{} cycles, the law ran in {}; {} judged: {} bit for bit the same, {} different; largest difference of a \
             twist {:e}",
            self.cycles, self.steps, self.judged, self.equal, self.different, self.largest
        )?;
        if self.begins_at > 1 {
            writeln!(
                to,
                "begins at cycle {}: what came before is not in the recording",
                self.begins_at
            )?;
        }
        for stretch in &self.taken_over {
            write!(
                to,
                "not judged: cycles {} to {}, replayed from a state that was taken over from the records; they differ \
                 by at most {:e}",
                stretch.first, stretch.last, stretch.largest
            )?;
            if stretch.last - stretch.first >= LATE {
                write!(to, ", after the first {LATE} by {:e}", stretch.largest_late)?;
            }
            writeln!(to)?;
        }
        if self.judged == 0 {
            writeln!(
                to,
                "nothing was compared: before no cycle all that it goes by is in the recording"
            )?;
        }
        if self.missing_cycles > 0 {
            writeln!(
                to,
                "{} cycles are not in the recording: what they left behind is unknown",
                self.missing_cycles
            )?;
        }
        if self.missing_features > 0 {
            writeln!(
                to,
                "{} features that were used are not in the recording",
                self.missing_features
            )?;
        }
        if let Some(first) = &self.first {
            writeln!(
                to,
                "first different: cycle {}, by {:e}\n  recorded {} {:?}\n  replayed {} {:?}",
                first.cycle,
                first.difference,
                first.recorded_state,
                first.recorded,
                first.replayed_state,
                first.replayed
            )?;
        }
        Ok(())
    }
}
