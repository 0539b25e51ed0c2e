//! A program that visits goals: it lets the daemon take up one scene after the other, and arms by
//! itself, as `vpcctl visit` does (`controller/vpcctl/src/visit.rs`).

use messages::{Outcome, Request, TwistState};

use crate::plan::Place;
use crate::queue::Event;
use crate::world::World;

/// Between two looks, ns.
const PAUSE_NS: u64 = 10_000_000;
/// How long a daemon that has begun again may take until it sees camera and robot, ns.
const PATIENCE_NS: u64 = 3_000_000_000;
/// The operator's place that it has.
pub const OPERATOR: usize = 6;

/// Where a visit is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Step {
    /// It is about to let the daemon take up a scene.
    TakeUp,
    /// It waits for the next daemon, after the one of this number.
    Waits(u64),
    /// It asks to arm, until then, ns.
    Arms(u64),
    /// The camera is on its way.
    Goes,
    Over,
}

/// The program.
pub struct Visitor {
    goals: Vec<Place>,
    /// The veto that its operator knows of.
    known: u32,
    number: usize,
    step: Step,
}

impl Visitor {
    /// One that goes from goal to goal, and arms in spite of the veto that is known.
    pub fn new(goals: Vec<Place>, known: u32) -> Self {
        Self {
            goals,
            known,
            number: 0,
            step: Step::TakeUp,
        }
    }

    /// Whether it has nothing more to do.
    pub fn is_over(&self) -> bool {
        self.step == Step::Over
    }
}

impl World<'_> {
    /// It looks, and does what is to be done.
    pub fn visit(&mut self) {
        let Some(visitor) = &self.visitor else {
            return;
        };
        let Visitor {
            number,
            step,
            known,
            ..
        } = *visitor;
        let goal = visitor.goals.get(number).copied();
        let next = match (step, goal) {
            (_, None) => Step::Over,
            (Step::TakeUp, _) if !self.is_at_work => step,
            (Step::TakeUp, Some(goal)) => match self.take_up(goal) {
                true => Step::Waits(self.process),
                false => Step::Over,
            },
            (Step::Waits(before), _) if self.process > before && self.is_at_work => {
                Step::Arms(self.now_ns + PATIENCE_NS)
            }
            (Step::Arms(until_ns), _) => {
                let heard = self.operators[OPERATOR].heard.take();
                match heard.and_then(|reply| reply.outcome()) {
                    Some(Outcome::Done) => Step::Goes,
                    Some(Outcome::Vetoed) => Step::Over,
                    _ if self.now_ns > until_ns => Step::Over,
                    _ => {
                        self.ask(OPERATOR, Request::arm(0, known));
                        step
                    }
                }
            }
            (Step::Goes, _) => match self.last_state {
                TwistState::Arrived => {
                    if let Some(visitor) = &mut self.visitor {
                        visitor.number += 1;
                    }
                    Step::TakeUp
                }
                TwistState::Disarmed => Step::Over,
                _ => step,
            },
            _ => step,
        };
        if next != step {
            self.tell(|| format!("visit: {next:?}"));
        }
        if let Some(visitor) = &mut self.visitor {
            visitor.step = next;
        }
        if next != Step::Over {
            self.queue.at(self.now_ns + PAUSE_NS, Event::Visit);
        }
    }

    /// Lets the daemon take up a scene, unless that differs in more than the goal.
    fn take_up(&mut self, place: Place) -> bool {
        let stock = self.plan.stock;
        if !stock.is_same_task(self.place, place) {
            return false;
        }
        (self.place, self.scene) = (place, stock.scene(place));
        self.reload();
        true
    }
}
