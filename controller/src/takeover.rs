//! Taking a run over in its middle, from what the records of its cycles tell.
//!
//! A recording that was begun while the daemon ran, or that lost records, does not tell what came before; yet most of
//! what a cycle leaves to the next can be told from the records that follow:
//!
//! | State | Known |
//! |---|---|
//! | mode, last twist, strategy | after one record |
//! | commands sent (delay compensation) | once features come that were exposed after the first record |
//! | gate, links, last features and where the next are expected | after two cycles of the law without a surprise |
//! | plan, the next warm start | with one free command: it is the twist, unless that was slowed down. Otherwise after a step that began from the memory or from nothing |
//! | whether the memory is asked, by hysteresis | where it was asked, or was not |
//! | progress and detours | after a stop, arrival, or a detour's begin or end; the number of tries after arrival |
//!
//! Until all of that is known, a replay is a prediction from one cycle to the next: after each, its state is corrected by
//! the record. Then it runs on by itself. What is still unknown then matters to rare events only (a detour begins; the
//! memory is out of range for the first time; it is asked soon after a detour): cycles in which it would decide are
//! corrected, too.
//!
//! Held by the tests of `ipc/recording/src/replay.rs`: runs cut anywhere, and replayed from there without a difference.

use ipc::{ClockMode, CycleRecord, Hold, RecallCode, SolverStatus, StrategyCode, TwistState};
use vpc::detour::FOLLOWING;
use vpc::{MAX_VARIABLES, Strategy, limit};

use crate::law::{Decision, strategy_of};
use crate::pilot::Pilot;

/// Tries of detours, and more: not known. A multiple of the number of ranks.
const UNKNOWN_TRIES: u32 = 1 << 30;

/// A cycle as it was recorded, and as it was replayed.
#[derive(Clone, Copy, Debug)]
pub struct Told<'a> {
    /// The record.
    pub recorded: &'a CycleRecord,
    /// What the pilot said now.
    pub replayed: &'a CycleRecord,
    /// When the command took effect, [`Pilot::effective_ns`], ns.
    pub effective_ns: u64,
    /// Releases missed just before this cycle.
    pub missed: u64,
    /// Whether its features were the first ones of a camera that started again.
    pub is_new: bool,
}

/// What is known of the state of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Takeover {
    /// Whether all that matters is known: the pilot runs by itself.
    settled: bool,
    /// Whether all commands since the last features' exposure are.
    commands: bool,
    /// Cycles in a row of which state and cause were foretold.
    agreed: u32,
    plan: bool,
    near: bool,
    /// Steps with a memory since progress was last in doubt.
    looks: u32,
    stall: bool,
    /// Whether the last cycle was on a detour.
    was_away: Option<bool>,
    /// Whether the memory gave an answer.
    answered: bool,
}

impl Takeover {
    /// For a pilot that has all that came before.
    pub fn known() -> Self {
        Self {
            settled: true,
            commands: true,
            agreed: 2,
            plan: true,
            near: true,
            looks: FOLLOWING,
            stall: true,
            was_away: Some(false),
            answered: true,
        }
    }

    /// For a pilot that knows nothing of the cycles before the next one.
    pub fn unknown(pilot: &mut Pilot) -> Self {
        let mut state = pilot.state();
        let history = &mut state.law.history;
        // Features from before the first command that is known are not refused; they are not compared, either.
        (history.count, history.from_rest) = (0, true);
        state.law.detour = vpc::detour::Detour {
            // As good as none, but not the mark of one that was forgotten.
            best_px: f64::MAX,
            tries: UNKNOWN_TRIES,
            ..vpc::detour::Detour::NONE
        };
        pilot.restore(&state);
        Self {
            settled: false,
            commands: false,
            agreed: 0,
            plan: false,
            near: false,
            looks: 0,
            stall: false,
            was_away: None,
            answered: false,
        }
    }

    /// Tells that it is not known what the next cycle received.
    pub fn lose_input(&mut self) {
        (self.settled, self.plan, self.agreed) = (false, false, 0);
    }

    /// Whether all that decided this cycle was known. Where not, the pilot's state is corrected by the record.
    pub fn look(&mut self, pilot: &mut Pilot, told: &Told) -> bool {
        if self.settled && self.is_in_doubt(pilot, told) {
            self.lose_input();
        }
        let was_known = self.settled;
        if !was_known {
            self.follow(pilot, told);
        }
        self.note(pilot, told);
        self.settled = was_known || self.is_enough(told);
        was_known
    }

    /// Whether what is not known decided this cycle, or may have.
    fn is_in_doubt(&self, pilot: &Pilot, told: &Told) -> bool {
        let (recorded, replayed) = (told.recorded, told.replayed);
        let is_away = [recorded, replayed].map(is_away);
        let tries = pilot.state().law.detour.tries;
        let other_target = way_point(recorded) != way_point(replayed);
        // Which sample a search finds, and when, hangs on the number of tries.
        let is_other = is_away[0] != is_away[1] || (is_away[0] && other_target);
        let detour = if tries >= UNKNOWN_TRIES {
            is_other
        } else {
            !self.stall && is_away[0] != is_away[1]
        };
        let refused = !self.answered && recorded.recalled == RecallCode::Refused.code();
        // Another strategy asks the memory while a detour's trajectory is followed.
        let is_asked = !is_away[0] && recorded.recalled != RecallCode::Unasked.code();
        // The first of these cycles may be the one in which the detour ended, which still asked as before.
        let asked = is_asked && !self.stall && self.looks <= FOLLOWING;
        let robot =
            recorded.hold == Hold::RobotLost.code() && pilot.state().robot.heard_ns.is_none();
        detour || refused || asked || robot || !self.suffices(strategy(recorded))
    }

    /// Whether all is known that the law needs under a strategy.
    fn suffices(&self, strategy: Option<Strategy>) -> bool {
        match strategy {
            None | Some(Strategy::Ibvs) => true,
            Some(strategy) => self.plan && (self.near || !strategy.needs_memory()),
        }
    }

    /// Whether the pilot can run by itself after this cycle.
    fn is_enough(&self, told: &Told) -> bool {
        let recorded = told.recorded;
        // Such a cycle also sets back what the supervisor counts.
        let is_clean = is_command(recorded)
            && has_stepped(recorded)
            && recorded.status != SolverStatus::NumericalFailure.code()
            && recorded.recalled != RecallCode::Refused.code()
            && told.missed == 0;
        is_clean && self.agreed >= 2 && self.commands && self.suffices(strategy(recorded))
    }

    /// Corrects the pilot's state by the record.
    fn follow(&mut self, pilot: &mut Pilot, told: &Told) {
        let (recorded, replayed) = (told.recorded, told.replayed);
        let settings = *pilot.law().settings();
        let is_foretold = (recorded.state, recorded.hold) == (replayed.state, replayed.hold);
        let mut state = pilot.state();
        // What this step itself went by was known if they were before it.
        let had_commands = self.commands;
        self.agreed = if is_foretold { self.agreed + 1 } else { 0 };
        let known = TwistState::from_code(recorded.state).zip(Hold::from_code(recorded.hold));
        if let Some((twist_state, hold)) = known {
            let sent = Decision {
                twist: recorded.twist,
                state: twist_state,
                hold,
            };
            state.supervisor.follow(sent);
            if is_command(recorded) {
                state.standing.decision = sent;
            }
        }
        state.law.history.push(&recorded.twist, told.effective_ns);
        self.commands |=
            state.law.seen.count > 0 && state.law.seen_ns >= state.law.history.from_ns[0];
        let strategy = strategy(recorded).unwrap_or(settings.strategy);
        state.law.strategy = strategy;
        let has_planned = has_stepped(recorded) && strategy != Strategy::Ibvs;
        if has_planned && let Some(near) = is_near(recorded, strategy, &settings) {
            (state.law.near, self.near) = (near, true);
        }

        if has_planned && strategy.needs_memory() && settings.detour {
            let target = is_away(recorded).then(|| way_point(recorded));
            let target = target.as_deref();
            let detour = &mut state.law.detour;
            // One that was just forgotten is right.
            if detour.best_px != f64::INFINITY || target.is_some() {
                self.stall |= detour.follow(target, self.was_away, recorded.error_px);
            }
        }
        if !is_foretold {
            (self.stall, self.looks) = (false, 0);
            state.law.detour.best_px = state.law.detour.best_px.min(f64::MAX);
        }

        if is_refusal(recorded) {
            state.law.previous = [0.0; MAX_VARIABLES];
            self.plan = true;
        } else if has_planned {
            // A plan that was not slowed down is the command: the limits were kept before.
            let is_told =
                settings.nc == 1 && is_command(recorded) && recorded.violation_px <= limit::SLACK;
            if is_told {
                state.law.previous = [0.0; MAX_VARIABLES];
                state.law.previous[..6].copy_from_slice(&recorded.twist);
            }
            let from_memory = is_away(recorded) || recorded.recalled == RecallCode::Followed.code();
            let is_computed = from_memory && self.agreed >= 2 && had_commands;
            self.plan = is_told || is_computed;
        }
        if told.is_new && is_foretold {
            self.begin_anew(recorded.clock == ClockMode::Lockstep.code());
        }
        match is_command(recorded) && has_stepped(recorded) {
            true => pilot.follow(&state, &recorded.twist),
            false => pilot.restore(&state),
        }
    }

    /// A camera that started again: the law forgot everything, in lockstep the commands as well.
    fn begin_anew(&mut self, in_lockstep: bool) {
        (self.near, self.stall) = (true, true);
        if in_lockstep {
            (self.commands, self.agreed, self.plan) = (true, 2, true);
        }
    }

    /// Notes what a cycle fixes, followed or not.
    fn note(&mut self, pilot: &Pilot, told: &Told) {
        let recorded = told.recorded;
        let is_away = is_away(recorded);
        self.answered |= is_away || recorded.recalled == RecallCode::Followed.code();
        if !is_command(recorded) {
            self.was_away = Some(false);
        } else if has_stepped(recorded) {
            self.was_away = Some(is_away);
            let asks = strategy(recorded).is_some_and(Strategy::needs_memory);
            self.looks = self.looks.saturating_add(u32::from(asks));
        }
        // Held, or near the goal.
        let is_forgotten = pilot.state().law.detour.best_px == f64::INFINITY;
        self.stall |= is_forgotten && self.commands && self.agreed > 0;
    }
}

fn strategy(record: &CycleRecord) -> Option<Strategy> {
    let code = StrategyCode::from_code(record.strategy)?;
    strategy_of(code, record.neighbours)
}

/// Whether the law's twist was sent.
fn is_command(record: &CycleRecord) -> bool {
    let moves = [TwistState::Moving, TwistState::Arrived].map(TwistState::code);
    record.hold == Hold::None.code() && moves.contains(&record.state)
}

fn has_stepped(record: &CycleRecord) -> bool {
    record.status != SolverStatus::Idle.code()
}

fn is_away(record: &CycleRecord) -> bool {
    record.recalled == RecallCode::Detour.code()
}

fn way_point(record: &CycleRecord) -> Vec<[f64; 2]> {
    let pairs = record.way_point.chunks_exact(2).map(|p| [p[0], p[1]]);
    pairs.take(record.way_point_count as usize).collect()
}

/// Whether the law, not the gate before it, refused the features.
fn is_refusal(record: &CycleRecord) -> bool {
    let causes = [
        Hold::Count,
        Hold::NotFinite,
        Hold::OffImage,
        Hold::Mixed,
        Hold::Frozen,
    ];
    !has_stepped(record) && causes.map(Hold::code).contains(&record.hold)
}

/// Whether features were near an occlusion, by the hysteresis of the law, where that can be told.
fn is_near(record: &CycleRecord, strategy: Strategy, settings: &vpc::Settings) -> Option<bool> {
    match RecallCode::from_code(record.recalled)? {
        RecallCode::Followed | RecallCode::Refused => Some(true),
        RecallCode::Unasked if strategy.needs_memory() => Some(false),
        _ if record.clearance_px < settings.trigger_px => Some(true),
        _ if record.clearance_px >= settings.trigger_px * settings.hysteresis => Some(false),
        _ => None,
    }
}
