//! From exposure to delivery: frames arrive late, with jitter, in order, and some never. Pure: time is what the caller
//! says it is.

use std::collections::VecDeque;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What happens to frames on their way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latency {
    /// From the stamp of the exposure to the delivery, ns.
    pub latency_ns: u64,
    /// Uniform deviation of the latency to either side, ns; at most the latency.
    pub jitter_ns: u64,
    /// Probability that a frame is lost, 0 to 1.
    pub drop: f64,
    /// Most frames under way, 1 to 4096; one more is lost.
    pub capacity: usize,
    /// Seed of jitter and losses.
    pub seed: u64,
}

impl Default for Latency {
    /// 110 ms without jitter or losses, at most 32 frames under way.
    fn default() -> Self {
        Self {
            latency_ns: 110_000_000,
            jitter_ns: 0,
            drop: 0.0,
            capacity: 32,
            seed: 0,
        }
    }
}

/// A value of [`Latency`] is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LatencyError {
    /// The jitter would deliver frames before their exposure.
    #[error("jitter_ns = {jitter_ns}; allowed: at most latency_ns = {latency_ns}")]
    Jitter {
        /// Jitter, ns.
        jitter_ns: u64,
        /// Latency, ns.
        latency_ns: u64,
    },
    /// Not a probability.
    #[error("drop = {drop}; allowed: 0 to 1")]
    Drop {
        /// What was found.
        drop: f64,
    },
    /// No room, or too much.
    #[error("capacity = {capacity}; allowed: 1 to 4096 frames")]
    Capacity {
        /// What was found.
        capacity: usize,
    },
}

/// What became of an exposed frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It will be delivered.
    UnderWay {
        /// When, ns.
        due_ns: u64,
    },
    /// It was lost by chance.
    Lost,
    /// It was lost because as many frames as allowed are under way.
    Full,
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

/// Frames under way, of images or of features.
#[derive(Clone, Debug)]
pub struct Transit<T> {
    latency: Latency,
    under_way: VecDeque<Delivered<T>>,
    last_due_ns: u64,
    random: ChaCha8Rng,
}

impl<T> Transit<T> {
    /// Nothing under way yet. Memory for all frames is taken here.
    ///
    /// # Errors
    /// [`LatencyError`] where a value is out of range.
    pub fn new(latency: Latency) -> Result<Self, LatencyError> {
        let Latency {
            latency_ns,
            jitter_ns,
            drop,
            capacity,
            seed,
        } = latency;
        if jitter_ns > latency_ns {
            return Err(LatencyError::Jitter {
                jitter_ns,
                latency_ns,
            });
        }
        if !(0.0..=1.0).contains(&drop) {
            return Err(LatencyError::Drop { drop });
        }
        if !(1..=4096).contains(&capacity) {
            return Err(LatencyError::Capacity { capacity });
        }
        Ok(Self {
            latency,
            under_way: VecDeque::with_capacity(capacity),
            last_due_ns: 0,
            random: ChaCha8Rng::seed_from_u64(seed),
        })
    }

    /// Exposes a frame with this stamp; stamps are given in order.
    pub fn expose(&mut self, payload: T, stamp_ns: u64) -> Fate {
        // Both drawn for every frame, so that one flaw does not change the numbers of another.
        let lost = self.random.random::<f64>() < self.latency.drop;
        let deviation = 2.0 * self.random.random::<f64>() - 1.0;
        if lost {
            return Fate::Lost;
        }
        if self.under_way.len() >= self.latency.capacity {
            return Fate::Full;
        }
        let jitter = (deviation * self.latency.jitter_ns as f64).round() as i64;
        let due = (stamp_ns + self.latency.latency_ns).saturating_add_signed(jitter);
        // A frame that is quicker than the one before it waits for it.
        let due_ns = due.max(self.last_due_ns);
        self.last_due_ns = due_ns;
        self.under_way.push_back(Delivered {
            payload,
            stamp_ns,
            due_ns,
        });
        Fate::UnderWay { due_ns }
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

    /// Frames under way.
    pub fn under_way(&self) -> usize {
        self.under_way.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 33_333_333;

    fn transit(latency: Latency) -> Transit<u64> {
        Transit::new(latency).unwrap()
    }

    #[test]
    fn a_frame_arrives_its_latency_after_the_stamp_and_not_before() {
        let mut transit = transit(Latency::default());
        let due_ns = 1_110_000_000;
        assert_eq!(transit.expose(7, 1_000_000_000), Fate::UnderWay { due_ns });
        assert_eq!(transit.next_due_ns(), Some(due_ns));
        assert_eq!(transit.deliver(due_ns - 1), None);
        let frame = Delivered {
            payload: 7,
            stamp_ns: 1_000_000_000,
            due_ns,
        };
        assert_eq!(transit.deliver(due_ns), Some(frame));
        assert_eq!((transit.deliver(u64::MAX), transit.under_way()), (None, 0));
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
    fn losses_follow_the_seed_and_do_not_change_the_jitter_of_the_rest() {
        let latency = Latency {
            jitter_ns: 5_000_000,
            seed: 9,
            capacity: 4096,
            ..Latency::default()
        };
        let fates = |latency| {
            let mut transit = transit(latency);
            (0..4000)
                .map(|k| transit.expose(k, k * PERIOD_NS))
                .collect::<Vec<_>>()
        };
        let lossy = Latency {
            drop: 0.01,
            ..latency
        };
        let (all, some) = (fates(latency), fates(lossy));
        assert_eq!(some, fates(lossy));
        let lost = some.iter().filter(|fate| **fate == Fate::Lost).count();
        assert!((20..60).contains(&lost), "{lost}");
        let same = |(a, b): (&Fate, &Fate)| *b == Fate::Lost || a == b;
        assert!(all.iter().zip(&some).all(same));
    }

    #[test]
    fn a_full_queue_loses_the_newest() {
        let mut transit = transit(Latency {
            capacity: 2,
            ..Latency::default()
        });
        assert!(matches!(transit.expose(0, 0), Fate::UnderWay { .. }));
        assert!(matches!(transit.expose(1, 1), Fate::UnderWay { .. }));
        assert_eq!(transit.expose(2, 2), Fate::Full);
        let payloads: Vec<u64> = std::iter::from_fn(|| transit.deliver(u64::MAX))
            .map(|frame| frame.payload)
            .collect();
        assert_eq!(payloads, [0, 1]);
    }

    #[test]
    fn values_out_of_range_are_named() {
        let refused = |latency| Transit::<()>::new(latency).unwrap_err().to_string();
        let jitter = Latency {
            jitter_ns: 110_000_001,
            ..Latency::default()
        };
        assert!(refused(jitter).contains("jitter_ns = 110000001; allowed: at most"));
        let drop = Latency {
            drop: f64::NAN,
            ..Latency::default()
        };
        assert!(refused(drop).contains("drop = NaN"));
        let capacity = Latency {
            capacity: 0,
            ..Latency::default()
        };
        assert!(refused(capacity).contains("capacity = 0"));
    }
}
