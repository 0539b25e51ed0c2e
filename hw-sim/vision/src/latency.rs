//! From exposure to delivery: frames arrive late, with jitter and in order; some are lost. The time
//! is an argument.

use std::collections::VecDeque;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// How late frames arrive, and how many are lost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latency {
    /// From the stamp of the exposure to the delivery, ns.
    pub latency_ns: u64,
    /// Uniform deviation of the latency to either side, ns; at most the latency.
    pub jitter_ns: u64,
    /// Share of the frames that is lost, 0 to 1.
    pub drop: f64,
    /// Mean number of frames that are lost in a row; 0: each is lost by itself, so that it is 1 / (1
    /// - drop). Never less than that.
    pub burst: f64,
    /// Seed of jitter and losses.
    pub seed: u64,
}

impl Default for Latency {
    /// 110 ms without jitter or losses.
    fn default() -> Self {
        Self {
            latency_ns: 110_000_000,
            jitter_ns: 0,
            drop: 0.0,
            burst: 0.0,
            seed: 0,
        }
    }
}

impl Latency {
    /// The probability that a frame is lost, by whether the one before was (Gilbert's model).
    fn loss_after(&self, was_lost: bool) -> f64 {
        let after_loss = (1.0 - 1.0 / self.burst.max(1.0)).max(self.drop);
        if after_loss == self.drop || was_lost {
            return after_loss;
        }
        // What makes the share that is lost in the long run what is asked for.
        self.drop * (1.0 - after_loss) / (1.0 - self.drop)
    }
}

/// A frame that has arrived.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delivered<T> {
    /// What was exposed.
    pub payload: T,
    /// The stamp of its exposure, ns.
    pub stamp_ns: u64,
    /// When it arrived, ns; never before an earlier frame.
    pub due_ns: u64,
}

/// Frames for which memory is taken beforehand.
const CAPACITY: usize = 64;

/// Frames under way, of images or of features.
#[derive(Clone, Debug)]
pub struct Transit<T> {
    latency: Latency,
    under_way: VecDeque<Delivered<T>>,
    last_due_ns: u64,
    was_lost: bool,
    random: ChaCha8Rng,
}

impl<T> Transit<T> {
    /// Nothing under way yet. Memory for 64 frames is taken here.
    pub fn new(latency: Latency) -> Self {
        Self {
            latency,
            under_way: VecDeque::with_capacity(CAPACITY),
            last_due_ns: 0,
            was_lost: false,
            random: ChaCha8Rng::seed_from_u64(latency.seed),
        }
    }

    /// Exposes a frame with this stamp, and returns whether it will be delivered; stamps are given
    /// in order.
    pub fn expose(&mut self, payload: T, stamp_ns: u64) -> bool {
        // Both drawn for every frame, so that one flaw does not change the numbers of another.
        let lost = self.random.random::<f64>() < self.latency.loss_after(self.was_lost);
        self.was_lost = lost;
        let deviation = 2.0 * self.random.random::<f64>() - 1.0;
        if lost {
            return false;
        }
        let jitter = (deviation * self.latency.jitter_ns as f64).round() as i64;
        let due = (stamp_ns + self.latency.latency_ns).saturating_add_signed(jitter);
        // A frame that is quicker than the one before it waits for it.
        self.last_due_ns = due.max(self.last_due_ns);
        self.under_way.push_back(Delivered {
            payload,
            stamp_ns,
            due_ns: self.last_due_ns,
        });
        true
    }

    /// When the next frame arrives, ns; none under way, none.
    pub fn next_due_ns(&self) -> Option<u64> {
        self.under_way.front().map(|frame| frame.due_ns)
    }

    /// The oldest frame that has arrived by `now_ns`; call until there is none.
    pub fn deliver(&mut self, now_ns: u64) -> Option<Delivered<T>> {
        let due = self.next_due_ns().is_some_and(|due| due <= now_ns);
        due.then(|| self.under_way.pop_front()).flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 33_333_333;

    fn transit(latency: Latency) -> Transit<u64> {
        Transit::new(latency)
    }

    #[test]
    fn a_frame_arrives_its_latency_after_the_stamp_and_not_before() {
        let mut transit = transit(Latency::default());
        let due_ns = 1_110_000_000;
        assert!(transit.expose(7, 1_000_000_000));
        assert_eq!(transit.next_due_ns(), Some(due_ns));
        assert_eq!(transit.deliver(due_ns - 1), None);
        let frame = Delivered {
            payload: 7,
            stamp_ns: 1_000_000_000,
            due_ns,
        };
        assert_eq!(transit.deliver(due_ns), Some(frame));
        assert_eq!(
            (transit.deliver(u64::MAX), transit.next_due_ns()),
            (None, None)
        );
    }

    /// Latencies of 4000 frames, ns; asserts that they arrive in order, each with its stamp.
    fn latencies(jitter_ns: u64) -> Vec<u64> {
        let mut transit = transit(Latency {
            jitter_ns,
            seed: 5,
            ..Latency::default()
        });
        let (mut earlier, mut latencies) = (0, Vec::new());
        for k in 0..4000 {
            let stamp = k * PERIOD_NS;
            transit.expose(k, stamp);
            while let Some(frame) = transit.deliver(stamp) {
                assert!(frame.due_ns >= earlier);
                assert_eq!(frame.stamp_ns, latencies.len() as u64 * PERIOD_NS);
                assert_eq!(frame.payload, latencies.len() as u64);
                earlier = frame.due_ns;
                latencies.push(frame.due_ns - frame.stamp_ns);
            }
        }
        latencies
    }

    #[test]
    fn jitter_spreads_the_latency_evenly() {
        let all = latencies(16_000_000);
        assert!(all.iter().all(|x| (94_000_000..=126_000_000).contains(x)));
        let early = all.iter().filter(|x| **x < 102_000_000).count();
        let late = all.iter().filter(|x| **x > 118_000_000).count();
        for count in [early, late] {
            assert!((900..1100).contains(&count), "{count}");
        }
    }

    #[test]
    fn a_frame_that_is_quicker_than_the_one_before_waits_for_it() {
        // Jitter over three periods: half of the frames would overtake.
        let all = latencies(100_000_000);
        assert!(all.len() > 3990);
        let together = all.windows(2).filter(|x| x[0] == x[1] + PERIOD_NS).count();
        assert!(together > 1000, "{together}");
    }

    #[test]
    fn losses_follow_the_seed_and_leave_the_jitter() {
        let latency = Latency {
            jitter_ns: 5_000_000,
            seed: 9,
            ..Latency::default()
        };
        let dues = |latency| {
            let mut transit = transit(latency);
            let mut expose = |k| {
                let due = transit.expose(k, k * PERIOD_NS);
                due.then(|| transit.under_way.back().unwrap().due_ns)
            };
            (0..4000).map(&mut expose).collect::<Vec<_>>()
        };
        let lossy = Latency {
            drop: 0.01,
            ..latency
        };
        let (all, some) = (dues(latency), dues(lossy));
        assert_eq!(some, dues(lossy));
        let lost = some.iter().filter(|due| due.is_none()).count();
        assert!((20..60).contains(&lost), "{lost}");
        let same = |(a, b): (&Option<u64>, &Option<u64>)| b.is_none() || a == b;
        assert!(all.iter().zip(&some).all(same));
    }

    #[test]
    fn bursts_have_the_length_asked_for_and_take_the_same_share() {
        for (drop, burst, expected) in [(0.1, 5.0, 5.0), (0.3, 0.0, 1.0 / 0.7), (0.3, 2.0, 2.0)] {
            let mut transit = transit(Latency {
                drop,
                burst,
                seed: 2,
                ..Latency::default()
            });
            let lost: Vec<bool> = (0..60_000)
                .map(|k| {
                    while transit.deliver(k * PERIOD_NS).is_some() {}
                    !transit.expose(k, k * PERIOD_NS)
                })
                .collect();
            let count = lost.iter().filter(|lost| **lost).count() as f64;
            let bursts = lost.windows(2).filter(|pair| !pair[0] && pair[1]).count() as f64;
            let share = count / lost.len() as f64;
            assert!((share / drop - 1.0).abs() < 0.07, "{share}");
            assert!((count / bursts / expected - 1.0).abs() < 0.07);
        }
    }
}
