//! What the loop leaves of a cycle.

use ipc::{Action, CycleRecord, Hold, Outcome, Request, Stamp, StrategyCode};

use super::words::{Layout, Seal, Visit, Words, words_of};
use crate::gate::{Gate, Input};
use crate::law::held;
use crate::pilot::{Answer, Inputs, State};
use crate::robot::RobotWatch;
use crate::supervisor::{Rules, Supervisor};

/// Cycles from one key to the next, where nothing is lost between.
pub const KEY_EVERY: u64 = 32;

/// Most requests of operators that the record of a cycle tells. Where there were more, the replay begins anew after it.
pub const MOST_ASKED: usize = 4;

/// A request of an operator that the pilot was given, and what it said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AskedFor {
    /// What was asked for.
    pub action: Action,
    /// For `strategy`: which.
    pub strategy: StrategyCode,
    /// For `strategy` knn: neighbours.
    pub neighbours: u32,
    /// The answer.
    pub outcome: Outcome,
}

impl AskedFor {
    const NOTHING: Self = Self {
        action: Action::Status,
        strategy: StrategyCode::Previous,
        neighbours: 0,
        outcome: Outcome::Done,
    };

    /// The request, as far as it matters to the pilot.
    pub fn request(&self) -> Request {
        Request {
            neighbours: self.neighbours,
            strategy: self.strategy.code(),
            ..Request::new(0, self.action)
        }
    }
}

/// The requests since the cycle before, in order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Asked {
    /// How many, also where there is no room to tell them.
    pub count: u32,
    /// The first of them; the rest asks for nothing.
    pub requests: [AskedFor; MOST_ASKED],
}

impl Asked {
    /// No requests.
    pub const NOTHING: Self = Self {
        count: 0,
        requests: [AskedFor::NOTHING; MOST_ASKED],
    };

    /// One more. Those that change nothing of the pilot are not kept.
    pub fn push(&mut self, request: &Request, outcome: Outcome) {
        let (action, strategy) = match (request.action(), request.strategy_code()) {
            (None | Some(Action::Status | Action::Record), _) | (_, None) => return,
            (Some(action), Some(strategy)) => (action, strategy),
        };
        if let Some(room) = self.requests.get_mut(self.count as usize) {
            *room = AskedFor {
                action,
                strategy,
                neighbours: request.neighbours,
                outcome,
            };
        }
        self.count = self.count.saturating_add(1);
    }

    /// Whether all of them are told.
    pub fn is_whole(&self) -> bool {
        self.count as usize <= MOST_ASKED
    }

    /// Those that are told.
    pub fn iter(&self) -> impl Iterator<Item = &AskedFor> {
        self.requests.iter().take(self.count as usize)
    }
}

/// One cycle: all that determined it but the state before, and all that came of it. Fixed size, plain data. Records are
/// equal where all bits are: a NaN equals itself, and the zeros differ.
#[derive(Clone, Copy, Debug)]
pub struct FlightRecord {
    /// Seal of the pilot's state before the cycle and its requests: tells two pasts apart, also between keys.
    pub before: u64,
    /// What operators asked for since the cycle before.
    pub asked: Asked,
    /// What the cycle knew.
    pub inputs: Inputs,
    /// What it decided to send.
    pub answer: Answer,
    /// Whether that went out.
    pub sent: bool,
    /// What telemetry says of it: the law's numbers, and what was measured about the run.
    pub told: CycleRecord,
    /// Seal of all of this, made by the loop. A change of any single word does not fit it.
    pub seal: u64,
}

impl FlightRecord {
    /// The record of a cycle, sealed.
    pub fn sealed(
        before: u64,
        asked: Asked,
        inputs: Inputs,
        answer: Answer,
        sent: bool,
        told: CycleRecord,
    ) -> Self {
        let mut record = Self {
            before,
            asked,
            inputs,
            answer,
            sent,
            told,
            seal: 0,
        };
        record.seal = record.computed_seal();
        record
    }

    /// A record of nothing, to be filled in.
    pub fn blank() -> Self {
        let inputs = Inputs {
            now_ns: 0,
            features: Input::Nothing,
            robot: Input::Nothing,
            missed: 0,
            shutdown: false,
        };
        Self::sealed(
            0,
            Asked::NOTHING,
            inputs,
            ANSWER,
            true,
            CycleRecord::default(),
        )
    }

    /// The fields of a record.
    pub fn layout() -> Layout {
        Layout::of(&mut Self::blank())
    }

    /// Number of the cycle, from 1.
    pub fn cycle(&self) -> u64 {
        self.told.cycle
    }

    /// The seal that fits.
    pub fn computed_seal(&self) -> u64 {
        Seal::of(&mut Unsealed(&mut self.clone()))
    }
}

/// An answer to nothing.
const ANSWER: Answer = Answer {
    stamp: Stamp {
        sequence: 0,
        published_ns: 0,
        data_ns: 0,
    },
    decision: held(Hold::None),
};

impl PartialEq for FlightRecord {
    fn eq(&self, other: &Self) -> bool {
        words_of(&mut self.clone()) == words_of(&mut other.clone())
    }
}

/// A record without its seal.
struct Unsealed<'a>(&'a mut FlightRecord);

impl Words for Unsealed<'_> {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let FlightRecord {
            before,
            asked,
            inputs,
            answer,
            sent,
            told,
            seal: _,
        } = self.0;
        visit.u64("before", before);
        visit.part("asked", asked);
        visit.part("inputs", inputs);
        visit.part("answer", answer);
        visit.flag("sent", sent);
        visit.part("told", told);
    }
}

impl Words for FlightRecord {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        Unsealed(self).words(visit);
        visit.u64("seal", &mut self.seal);
    }
}

/// A key frame: the pilot's state before a cycle and its requests, from which a replay can begin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key {
    /// Number of the cycle that follows.
    pub cycle: u64,
    /// The state.
    pub state: State,
    /// Seal of both.
    pub seal: u64,
}

impl Key {
    /// A key before this cycle, sealed.
    pub fn sealed(cycle: u64, state: State) -> Self {
        let mut key = Self {
            cycle,
            state,
            seal: 0,
        };
        key.seal = key.computed_seal();
        key
    }

    /// A key of nothing, to be filled in.
    pub fn blank() -> Self {
        let rules = Rules {
            limits: [0.0; 6],
            brake_ns: 0,
            lost_ns: None,
            armed: false,
        };
        let state = State {
            gate: Gate::new(None),
            robot: RobotWatch::new(None),
            law: vpc::State::new(vpc::Strategy::Previous),
            supervisor: Supervisor::new(rules),
            standing: ANSWER,
        };
        Self::sealed(0, state)
    }

    /// The fields of a key.
    pub fn layout() -> Layout {
        Layout::of(&mut Self::blank())
    }

    /// The seal that fits.
    pub fn computed_seal(&self) -> u64 {
        Seal::of(&mut Bare(&mut self.clone()))
    }
}

/// A key without its seal.
struct Bare<'a>(&'a mut Key);

impl Words for Bare<'_> {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Key {
            cycle,
            state,
            seal: _,
        } = self.0;
        visit.u64("cycle", cycle);
        visit.part("state", state);
    }
}

impl Words for Key {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        Bare(self).words(visit);
        visit.u64("seal", &mut self.seal);
    }
}
