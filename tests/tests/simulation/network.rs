//! The way of messages from one party to another: late, lost, doubled, out of order.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Shortest way of a message, ns.
const LEAST_NS: u64 = 2_000;

/// Which messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    Features,
    Robot,
    Desired,
    Twist,
    Requests,
    Replies,
}

/// How they travel.
#[derive(Clone, Copy, Debug)]
struct Link {
    /// Longest way, ns.
    late_ns: u64,
    /// Share of those that are lost, and of those that come twice.
    lost: f64,
    doubled: f64,
}

const WAYS: usize = 6;

/// The network of all parties.
pub struct Network {
    links: [Link; WAYS],
    /// As they were before they were disturbed.
    usual: [Link; WAYS],
    /// When the last command comes, ns: a newer one does not overtake it.
    twist_ns: u64,
    random: ChaCha8Rng,
}

impl Network {
    /// Shared memory, in half of all runs; in the others a little worse.
    pub fn new(mut random: ChaCha8Rng) -> Self {
        let is_calm = random.random_bool(0.5);
        let mut link = |lost: f64, doubled: f64| {
            let [late_ns, lost, doubled] = match is_calm {
                true => [40_000.0, 0.0, 0.0],
                false => [
                    random.random_range(40_000.0..2_500_000.0),
                    random.random_range(0.0..=lost),
                    random.random_range(0.0..=doubled),
                ],
            };
            let late_ns = late_ns as u64;
            Link {
                late_ns,
                lost,
                doubled,
            }
        };
        let links = [
            link(0.01, 0.05),
            link(0.05, 0.05),
            link(0.01, 0.05),
            link(0.005, 0.0),
            link(0.0, 0.1),
            link(0.05, 0.0),
        ];
        Self {
            links,
            usual: links,
            twist_ns: 0,
            random,
        }
    }

    /// From now on it is bad, in some of its parts.
    pub fn disturb(&mut self, random: &mut ChaCha8Rng) {
        for (way, link) in self.links.iter_mut().enumerate() {
            if random.random_bool(0.5) {
                *link = Link {
                    late_ns: random.random_range(1_000_000..200_000_000),
                    lost: random.random_range(0.0..0.4),
                    doubled: random.random_range(0.0..0.4),
                };
            }
            // A port gives the commands of a process in their order, and each once.
            if way == Way::Twist as usize {
                link.doubled = 0.0;
            }
        }
    }

    /// From now on it is as usual.
    pub fn recover(&mut self) {
        self.links = self.usual;
    }

    /// When a message that is sent at `now_ns` comes: never, once or twice, ns.
    pub fn arrivals(&mut self, way: Way, now_ns: u64) -> impl Iterator<Item = u64> + use<> {
        let Link {
            late_ns,
            lost,
            doubled,
        } = self.links[way as usize];
        let mut once = || now_ns + self.random.random_range(LEAST_NS..late_ns);
        let mut both = [once(), once()];
        if way == Way::Twist {
            both[0] = both[0].max(self.twist_ns);
            self.twist_ns = both[0];
        }
        let is_lost = self.random.random_bool(lost);
        let is_double = self.random.random_bool(doubled);
        let count = usize::from(!is_lost) + usize::from(!is_lost && is_double);
        both.into_iter().take(count)
    }
}
