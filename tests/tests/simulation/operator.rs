//! Operators: their queues, and what they have asked and heard.

use std::collections::{BTreeMap, VecDeque};

use messages::{Action, Message, Outcome, Reply, Request, StrategyCode};
use rand::{Rng, RngExt};

/// Places of an operator's queue: when it is full, the oldest request is dropped.
const QUEUE: usize = Request::QOS.buffer;
/// Most operators.
pub const MOST: usize = Request::QOS.publishers;

/// What an operator does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Habit {
    /// Asks what it is told to, and names the stop that the last refusal told of.
    Careful,
    /// Asks `arm` again and again, and names no stop.
    ArmLoop,
    /// Fills its queue with questions for the state.
    Flood,
    /// Asks anything at any time.
    Wild,
    /// Does nothing.
    Idle,
}

/// One operator.
pub struct Operator {
    pub habit: Habit,
    queue: VecDeque<Request>,
    /// When it asked what is in the queue, or was taken from there and not answered yet, ns.
    asked_ns: BTreeMap<u64, u64>,
    next_id: u64,
    sequence: u64,
    /// The count of stops that the last refusal told of.
    stops: u32,
    /// The last answer.
    pub heard: Option<Reply>,
    /// Requests that were answered, for the figures.
    pub answered: u64,
}

impl Operator {
    /// The operator of this number.
    pub fn new(number: usize, habit: Habit) -> Self {
        Self {
            habit,
            queue: VecDeque::new(),
            asked_ns: BTreeMap::new(),
            next_id: (number as u64 + 1) << 32,
            sequence: 0,
            stops: 0,
            heard: None,
            answered: 0,
        }
    }

    /// Asks, at `now_ns`.
    pub fn ask(&mut self, request: Request, now_ns: u64) {
        let mut request = request;
        self.sequence += 1;
        self.next_id += 1;
        request.id = self.next_id;
        (request.stamp.sequence, request.stamp.published_ns) = (self.sequence, now_ns);
        if self.queue.len() == QUEUE
            && let Some(dropped) = self.queue.pop_front()
        {
            self.asked_ns.remove(&dropped.id);
        }
        self.asked_ns.insert(request.id, now_ns);
        self.queue.push_back(request);
    }

    /// Asks `arm`, and names the stop that the last refusal told of.
    pub fn arm(&mut self, now_ns: u64) {
        self.ask(Request::arm(0, self.stops), now_ns);
    }

    /// What it does by habit, just before `now_ns`.
    pub fn act(&mut self, now_ns: u64, random: &mut impl Rng) {
        match self.habit {
            Habit::ArmLoop => self.ask(Request::arm(0, 0), now_ns),
            Habit::Flood => (0..=QUEUE).for_each(|_| {
                self.ask(Request::new(0, Action::Status), now_ns);
            }),
            Habit::Wild => {
                let request = wild(self.stops, random);
                self.ask(request, now_ns);
            }
            Habit::Careful | Habit::Idle => (),
        }
    }

    /// Whether a request waits.
    pub fn waits(&self) -> bool {
        !self.queue.is_empty()
    }

    /// The daemon takes the oldest request.
    pub fn oldest(&mut self) -> Option<Request> {
        self.queue.pop_front()
    }

    /// Everything that waits is lost: the daemon is gone.
    pub fn forget(&mut self) {
        self.queue.clear();
        self.asked_ns.clear();
    }

    /// Hears an answer. Returns whether it is the answer to a request that had none yet.
    pub fn hear(&mut self, reply: &Reply) -> bool {
        self.stops = match reply.outcome() {
            Some(Outcome::Stopped) => reply.stops,
            _ => 0,
        };
        self.heard = Some(*reply);
        self.answered += 1;
        self.asked_ns.remove(&reply.id) == Some(reply.stamp.data_ns)
    }

    /// When it asked the oldest request that has had no answer yet, ns.
    pub fn waits_since_ns(&self) -> Option<u64> {
        self.asked_ns.values().min().copied()
    }
}

/// Anything, known or unknown.
fn wild(stops: u32, random: &mut impl Rng) -> Request {
    let seen = [0, stops, random.random_range(0..4)][random.random_range(0..3)];
    let (strategy, neighbours) = [
        (StrategyCode::Previous, 0),
        (StrategyCode::Ibvs, 0),
        (StrategyCode::Knn, random.random_range(0..70)),
        (StrategyCode::Gpr, 0),
    ][random.random_range(0..4)];
    match random.random_range(0..10) {
        0..4 => Request::arm(0, seen),
        4 => Request::new(0, Action::Disarm),
        5 => Request::new(0, Action::Stop),
        6 => Request::strategy(0, strategy, neighbours),
        7 => Request {
            action: random.random_range(0..12),
            strategy: random.random_range(0..9),
            ..Request::arm(0, seen)
        },
        _ => Request::new(0, Action::Status),
    }
}
