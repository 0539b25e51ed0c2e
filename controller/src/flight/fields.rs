//! The fields of what is recorded. Each struct is taken apart by name: who adds a field to one must say here how it is
//! recorded, or nothing compiles.

use ipc::{
    Action, CycleRecord, Features, Hold, Message, Order, Outcome, Received, RobotState, Stamp,
    StrategyCode, TwistState,
};
use vpc::Strategy;

use super::record::{Asked, AskedFor};
use super::words::{Kind, Visit, Words};
use crate::gate::{Gate, Input, Standing};
use crate::law::{Decision, held, strategy_code, strategy_of};
use crate::pilot::{Answer, Inputs, State};
use crate::robot::RobotWatch;
use crate::supervisor::{Mode, Rules, Situation, Supervisor};

impl Words for Inputs {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            now_ns,
            features,
            robot,
            missed,
            shutdown,
        } = self;
        visit.u64("now_ns", now_ns);
        visit.part("features", features);
        visit.part("robot", robot);
        visit.u64("missed", missed);
        visit.flag("shutdown", shutdown);
    }
}

/// A message that stands where none came.
trait Blank: Message + Words {
    fn blank() -> Self;
}

impl Blank for Features {
    fn blank() -> Self {
        Self::new(&[], 0)
    }
}

impl Blank for RobotState {
    fn blank() -> Self {
        Self::free_camera([0.0; 3], [0.0; 3], 0)
    }
}

impl<T: Blank> Words for Input<T> {
    /// `came` (0 nothing, 1 a message, 2 a refused one of which only the stamp is kept, 3 failure), `order` (0 first, 1
    /// next, 2 gap, 3 repeated, 4 restarted), `missed` (of a gap), and the message, zero where there is none.
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let none = T::blank();
        let refused = |stamp| {
            let mut message = none;
            *message.stamp_mut() = stamp;
            message
        };
        let (mut came, mut order, mut message) = match *self {
            Self::Nothing => (0, Order::First, none),
            Self::Message(received) => (1, received.order, received.message),
            Self::Refused(stamp) => (2, Order::First, refused(stamp)),
            Self::Failed => (3, Order::First, none),
        };
        visit.code(
            "came",
            &mut came,
            |code| code,
            |code| (code < 4).then_some(code),
        );
        order_words(visit, &mut order);
        visit.part("message", &mut message);
        *self = match came {
            1 => Self::Message(Received { message, order }),
            2 => Self::Refused(*message.stamp()),
            3 => Self::Failed,
            _ => Self::Nothing,
        };
    }
}

fn order_words<V: Visit>(visit: &mut V, order: &mut Order) {
    let (mut code, mut missed) = match *order {
        Order::First => (0, 0),
        Order::Next => (1, 0),
        Order::Gap { missed } => (2, missed),
        Order::Repeated => (3, 0),
        Order::Restarted => (4, 0),
    };
    visit.code(
        "order",
        &mut code,
        |code| code,
        |code| (code < 5).then_some(code),
    );
    visit.u64("missed", &mut missed);
    *order = match code {
        1 => Order::Next,
        2 => Order::Gap { missed },
        3 => Order::Repeated,
        4 => Order::Restarted,
        _ => Order::First,
    };
}

impl Words for Stamp {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            sequence,
            published_ns,
            data_ns,
        } = self;
        visit.u64("sequence", sequence);
        visit.u64("published_ns", published_ns);
        visit.u64("data_ns", data_ns);
    }
}

impl Words for Features {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            stamp,
            exposure_ns,
            count,
            visible,
            points,
        } = self;
        visit.part("stamp", stamp);
        visit.u64("exposure_ns", exposure_ns);
        visit.u32("count", count);
        visit.u32("visible", visible);
        visit.reals("points", points);
    }
}

impl Words for RobotState {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            stamp,
            features_sequence,
            mode,
            faults,
            translation,
            rotation,
            twist,
            joints,
            reserved,
            q,
            dq,
            room,
        } = self;
        visit.part("stamp", stamp);
        visit.u64("features_sequence", features_sequence);
        visit.u32("mode", mode);
        visit.u32("faults", faults);
        visit.reals("translation", translation);
        visit.reals("rotation", rotation);
        visit.reals("twist", twist);
        visit.u32("joints", joints);
        visit.u32("reserved", reserved);
        visit.reals("q", q);
        visit.reals("dq", dq);
        visit.reals("room", room);
    }
}

impl Words for Answer {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self { stamp, decision } = self;
        visit.part("stamp", stamp);
        decision.words(visit);
    }
}

impl Words for Decision {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self { twist, state, hold } = self;
        visit.reals("twist", twist);
        visit.code("state", state, TwistState::code, TwistState::from_code);
        visit.code("hold", hold, Hold::code, Hold::from_code);
    }
}

impl Words for State {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            gate,
            robot,
            law,
            supervisor,
            standing,
        } = self;
        visit.part("gate", gate);
        visit.part("robot", robot);
        visit.part("law", law);
        visit.part("supervisor", supervisor);
        visit.part("standing", standing);
    }
}

impl Words for Gate {
    /// `standing` is 0 for good, else 1 more than the code of the hold.
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            stale_ns,
            last,
            believed,
            good_ns,
            standing,
            gap,
            restarted,
        } = self;
        visit.option("stale_ns", stale_ns);
        visit.part("last", last);
        visit.part("believed", believed);
        visit.option("good_ns", good_ns);
        visit.code(
            "standing",
            standing,
            |standing| match standing {
                Standing::Good => 0,
                Standing::Held(hold) => 1 + hold.code(),
            },
            |code| match code.checked_sub(1) {
                None => Some(Standing::Good),
                Some(hold) => Hold::from_code(hold).map(Standing::Held),
            },
        );
        visit.flag("gap", gap);
        visit.flag("restarted", restarted);
    }
}

impl Words for RobotWatch {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            lost_ns,
            heard_ns,
            at_fault,
        } = self;
        visit.option("lost_ns", lost_ns);
        visit.option("heard_ns", heard_ns);
        visit.flag("at_fault", at_fault);
    }
}

impl Words for Supervisor {
    /// `mode` is 0 for armed, 1 for disarming, 2 for disarmed, the latter two with their cause.
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            rules,
            mode,
            last,
            sent,
            situation,
            overruns,
            failures,
            refusals,
        } = self;
        visit.part("rules", rules);
        let (mut code, mut cause) = match *mode {
            Mode::Armed => (0, Hold::None),
            Mode::Disarming(cause) => (1, cause),
            Mode::Disarmed(cause) => (2, cause),
        };
        visit.code(
            "mode",
            &mut code,
            |code| code,
            |code| (code < 3).then_some(code),
        );
        visit.code("cause", &mut cause, Hold::code, Hold::from_code);
        *mode = match code {
            1 => Mode::Disarming(cause),
            2 => Mode::Disarmed(cause),
            _ => Mode::Armed,
        };
        visit.option("last", last);
        visit.part("sent", sent);
        let mut is_known = situation.is_some();
        visit.flag("is_situation_known", &mut is_known);
        let mut known = situation.unwrap_or(NO_SITUATION);
        visit.part("situation", &mut known);
        *situation = is_known.then_some(known);
        visit.u32("overruns", overruns);
        visit.u32("failures", failures);
        visit.u32("refusals", refusals);
    }
}

/// Stands where no cycle was before.
const NO_SITUATION: Situation = Situation {
    decision: held(Hold::None),
    good_ns: None,
    solver_failed: None,
    recall_refused: None,
    missed: 0,
    robot: None,
    shutdown: false,
};

impl Words for Rules {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            limits,
            brake_ns,
            lost_ns,
            armed,
        } = self;
        visit.reals("limits", limits);
        visit.u64("brake_ns", brake_ns);
        visit.option("lost_ns", lost_ns);
        visit.flag("armed", armed);
    }
}

impl Words for Situation {
    /// `solver_failed` and `recall_refused` are 0 for no, 1 for yes, 2 where it was not asked; `robot` is the code of a hold, 0 where nothing
    /// is wrong.
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            decision,
            good_ns,
            solver_failed,
            recall_refused,
            missed,
            robot,
            shutdown,
        } = self;
        visit.part("decision", decision);
        visit.option("good_ns", good_ns);
        maybe_words(visit, "solver_failed", solver_failed);
        maybe_words(visit, "recall_refused", recall_refused);
        visit.u64("missed", missed);
        visit.code(
            "robot",
            robot,
            |robot| robot.unwrap_or(Hold::None).code(),
            |code| Hold::from_code(code).map(|hold| (hold != Hold::None).then_some(hold)),
        );
        visit.flag("shutdown", shutdown);
    }
}

impl Words for vpc::detour::Detour {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            best_px,
            cycles,
            tries,
            left,
            following,
            count,
            target,
        } = self;
        visit.real("best_px", best_px);
        visit.u32("cycles", cycles);
        visit.u32("tries", tries);
        visit.u32("left", left);
        visit.u32("following", following);
        visit.u32("count", count);
        visit.reals("target", target.as_flattened_mut());
    }
}

/// 0 for no, 1 for yes, 2 for neither.
fn maybe_words<V: Visit>(visit: &mut V, name: &'static str, maybe: &mut Option<bool>) {
    visit.code(
        name,
        maybe,
        |maybe| maybe.map_or(2, u32::from),
        |code| match code {
            0 => Some(Some(false)),
            1 => Some(Some(true)),
            2 => Some(None),
            _ => None,
        },
    );
}

impl Words for Asked {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self { count, requests } = self;
        visit.u32("count", count);
        for request in requests {
            let AskedFor {
                action,
                strategy,
                neighbours,
                outcome,
            } = request;
            visit.enter("request");
            visit.code("action", action, Action::code, Action::from_code);
            visit.code(
                "strategy",
                strategy,
                StrategyCode::code,
                StrategyCode::from_code,
            );
            visit.u32("neighbours", neighbours);
            visit.code("outcome", outcome, Outcome::code, Outcome::from_code);
            visit.leave();
        }
    }
}

impl Words for vpc::State {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            strategy,
            near,
            detour,
            previous,
            predicted,
            seen,
            seen_ns,
            is_linked,
            still_px,
            history,
        } = self;
        strategy_words(visit, strategy);
        visit.flag("near", near);
        visit.part("detour", detour);
        visit.reals("previous", previous);
        visit.u32("count", &mut predicted.count);
        visit.reals("predicted", predicted.points.as_flattened_mut());
        visit.u32("seen_count", &mut seen.count);
        visit.reals("seen", seen.points.as_flattened_mut());
        visit.u64("seen_ns", seen_ns);
        visit.flag("is_linked", is_linked);
        visit.real("still_px", still_px);
        visit.part("history", history);
    }
}

impl Words for vpc::delay::History {
    fn words<V: Visit>(&mut self, visit: &mut V) {
        let Self {
            count,
            from_ns,
            twists,
            from_rest,
            validity_ns,
        } = self;
        visit.u32("count", count);
        visit.field("from_ns", Kind::Unsigned, from_ns);
        visit.reals("twists", twists.as_flattened_mut());
        visit.flag("from_rest", from_rest);
        visit.u64("validity_ns", validity_ns);
    }
}

/// The strategy's code and its neighbours, 0 but for k-NN.
fn strategy_words<V: Visit>(visit: &mut V, strategy: &mut Strategy) {
    let (mut code, mut neighbours) = strategy_code(*strategy);
    visit.code(
        "strategy",
        &mut code,
        StrategyCode::code,
        StrategyCode::from_code,
    );
    visit.u32("neighbours", &mut neighbours);
    // What is no strategy changes nothing, and its seal does not fit.
    *strategy = strategy_of(code, neighbours).unwrap_or(*strategy);
}

/// One line for each field of a telemetry record: how it is recorded, and whether the pilot tells it.
macro_rules! told {
    ($($field:ident: $word:ident $whose:ident,)+) => {
        impl Words for CycleRecord {
            fn words<V: Visit>(&mut self, visit: &mut V) {
                let Self { stamp, reserved, $($field,)+ } = self;
                visit.part("stamp", stamp);
                $(visit.$word(stringify!($field), $field);)+
                visit.u32("reserved", reserved);
            }
        }

        /// What of a telemetry record does not come from the pilot but from the loop: clocks, counters, meters.
        pub fn measured(told: &CycleRecord) -> CycleRecord {
            let CycleRecord { stamp, reserved, $($field,)+ } = *told;
            let mut measured = CycleRecord { stamp, reserved, ..CycleRecord::default() };
            $(told!(@ $whose measured.$field, $field);)+
            measured
        }
    };
    (@ loop $to:expr, $from:ident) => { $to = $from; };
    (@ pilot $to:expr, $from:ident) => { let _ = $from; };
}

told! {
    cycle: u64 loop,
    clock: u32 loop,
    status: u32 pilot,
    wake_latency_ns: u64 loop,
    receive_ns: u64 loop,
    step_ns: u64 loop,
    send_ns: u64 loop,
    overruns: u64 loop,
    features_sequence: u64 pilot,
    features_age_ns: u64 loop,
    lost_records: u64 loop,
    count: u32 pilot,
    way_point_count: u32 pilot,
    recalled: u32 pilot,
    strategy: u32 pilot,
    neighbours: u32 pilot,
    np: u32 pilot,
    iterations: u32 pilot,
    qp_iterations: u32 pilot,
    hold: u32 pilot,
    state: u32 pilot,
    points: reals pilot,
    way_point: reals pilot,
    twist: reals pilot,
    cost: real pilot,
    violation_px: real pilot,
    clearance_px: real pilot,
    error_px: real pilot,
    realtime: u32 loop,
    phase: u32 loop,
    phase_error_ns: i64 loop,
    minor_faults: u32 loop,
    major_faults: u32 loop,
    blocked: u32 loop,
    allocations: u32 loop,
    features_input: u32 loop,
    robot_input: u32 loop,
    features_seen: part loop,
    robot_seen: part loop,
    requests: u32 loop,
    missed: u32 loop,
    flags: u32 loop,
}
