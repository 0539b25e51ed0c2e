//! Operators: what they ask and hear, and their queues at the daemon.

use std::collections::VecDeque;

use messages::{Action, Message, Reply, Request, StrategyCode};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::fault::Fault;

/// Places of an operator's queue: when it is full, the oldest request is dropped.
const QUEUE: usize = Request::QOS.buffer;
/// Most operators.
pub const MOST: usize = Request::QOS.publishers;

/// What an operator does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Habit {
    /// Asks what it is told to, and names the veto that the last answer told.
    Careful,
    /// Asks `arm` again and again, and names no veto.
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
    /// What came to the daemon and waits there, and when it came, ns.
    queue: VecDeque<(u64, Request)>,
    next_id: u64,
    sequence: u64,
    /// The veto that the last answer told; 0: none.
    veto: u32,
    /// The last answer.
    pub heard: Option<Reply>,
    random: ChaCha8Rng,
}

impl Operator {
    /// The operator of this number.
    pub fn new(number: usize, random: ChaCha8Rng) -> Self {
        Self {
            habit: Habit::Idle,
            queue: VecDeque::new(),
            next_id: (number as u64 + 1) << 32,
            sequence: 0,
            veto: 0,
            heard: None,
            random,
        }
    }

    /// A request as it publishes it at `now_ns`.
    pub fn stamped(&mut self, mut request: Request, now_ns: u64) -> Request {
        self.sequence += 1;
        self.next_id += 1;
        request.id = self.next_id;
        (request.stamp.sequence, request.stamp.published_ns) = (self.sequence, now_ns);
        request
    }

    /// `arm`, which names the veto that the last answer told.
    pub fn arm(&self) -> Request {
        Request::arm(0, self.veto)
    }

    /// What it asks by habit.
    pub fn habitual(&mut self) -> Option<Request> {
        match self.habit {
            Habit::ArmLoop => Some(Request::arm(0, 0)),
            Habit::Flood => Some(Request::new(0, Action::Status)),
            Habit::Wild => Some(wild(self.veto, &mut self.random)),
            Habit::Careful | Habit::Idle => None,
        }
    }

    /// Time to its next act, ns.
    pub fn pause_ns(&mut self) -> u64 {
        let most_ns = match self.habit {
            Habit::ArmLoop | Habit::Flood => 10_000_000,
            Habit::Wild => 150_000_000,
            Habit::Careful | Habit::Idle => 40_000_000,
        };
        self.random.random_range(most_ns / 2..most_ns)
    }

    /// A request comes to the daemon at `now_ns`.
    pub fn arrive(&mut self, request: Request, now_ns: u64) {
        if self.queue.len() == QUEUE {
            self.queue.pop_front();
        }
        self.queue.push_back((now_ns, request));
    }

    /// Whether a request waits.
    pub fn waits(&self) -> bool {
        !self.queue.is_empty()
    }

    /// The daemon takes the oldest request.
    pub fn oldest(&mut self) -> Option<Request> {
        self.queue.pop_front().map(|(_, request)| request)
    }

    /// When the oldest request came that waits, ns.
    pub fn waits_since_ns(&self) -> Option<u64> {
        self.queue.front().map(|(came_ns, _)| *came_ns)
    }

    /// Everything that waits is lost: the daemon is gone.
    pub fn forget(&mut self) {
        self.queue.clear();
    }

    /// Hears an answer, if it is one to it.
    pub fn hear(&mut self, reply: &Reply) {
        if reply.id >> 32 != self.next_id >> 32 {
            return;
        }
        self.veto = reply.veto;
        self.heard = Some(*reply);
    }
}

/// Anything, known or unknown.
fn wild(veto: u32, random: &mut ChaCha8Rng) -> Request {
    let named = [0, veto, random.random_range(0..4)][random.random_range(0..3)];
    let (strategy, neighbours) = [
        (StrategyCode::Previous, 0),
        (StrategyCode::Ibvs, 0),
        (StrategyCode::Knn, random.random_range(0..70)),
        (StrategyCode::Gpr, 0),
        (StrategyCode::Follow, 0),
    ][random.random_range(0..if Fault::ToGoal.is_awaited() { 4 } else { 5 })];
    match random.random_range(0..10) {
        0..4 => Request::arm(0, named),
        4 => Request::new(0, Action::Disarm),
        5 => Request::new(0, Action::Stop),
        6 => Request::strategy(0, strategy, neighbours),
        7 => Request {
            action: random.random_range(0..12),
            strategy: random.random_range(6..9),
            ..Request::arm(0, named)
        },
        _ => Request::new(0, Action::Status),
    }
}
