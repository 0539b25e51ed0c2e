//! The decision of a cycle: gate, then law. A function of its inputs and of what earlier cycles left, with no clock
//! and no port: the loop calls it live, the replay of a flight record calls it again, and both get the same bits.

use ipc::{CycleRecord, Features, Hold, Stamp};

use crate::gate::{Gate, Input, Verdict};
use crate::law::{self, Decision, Law};

/// All that a cycle learns from outside before it decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// When it looked, CLOCK_MONOTONIC, ns.
    pub now_ns: u64,
    /// What came from the camera.
    pub features: Input,
}

/// What a cycle is to send.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Head of the features message that it answers; all zero where there is none.
    pub stamp: Stamp,
    /// The command.
    pub decision: Decision,
}

/// Gate and law, with what a cycle leaves to the next.
pub struct Pilot {
    gate: Gate,
    law: Law,
    /// The last command of the law, for cycles without news.
    standing: Answer,
}

impl Pilot {
    /// A pilot before its first cycle; features are stale after `stale_ns` of silence, never in lockstep (`None`).
    pub fn new(law: Law, stale_ns: Option<u64>) -> Self {
        Self {
            gate: Gate::new(stale_ns),
            law,
            standing: Answer {
                stamp: Stamp::default(),
                decision: law::held(Hold::NoFeatures),
            },
        }
    }

    /// What stays the same in the record of each cycle.
    pub fn describe(&self, record: &mut CycleRecord) {
        self.law.describe(record);
    }

    /// One decision, and in `record` what there is to tell about it: all but times and counts. Never allocates.
    pub fn decide(&mut self, inputs: &Inputs, record: &mut CycleRecord) -> Answer {
        let answer = match self.gate.judge(&inputs.features, inputs.now_ns) {
            Verdict::Step { features, link } => {
                show(&features, record);
                let decision = self.law.step(&features, link, record);
                if decision.hold != Hold::None {
                    self.gate.hold(decision.hold);
                }
                self.standing = Answer {
                    stamp: features.stamp,
                    decision,
                };
                self.standing
            }
            Verdict::Repeat => self.standing,
            Verdict::Hold(cause, stamp) => Answer {
                stamp,
                decision: law::held(cause),
            },
        };
        record.features_sequence = answer.stamp.sequence;
        record.twist = answer.decision.twist;
        record.state = answer.decision.state.code();
        record.hold = answer.decision.hold.code();
        answer
    }
}

/// Copies the features into the record.
fn show(features: &Features, record: &mut CycleRecord) {
    record.count = features.count;
    record.points = features.points;
}
