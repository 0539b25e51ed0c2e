//! The gate: which features may reach the law, and what to do without them. Pure; the time is an
//! argument.
//!
//! It checks messages: their order and their age. The law then checks the numbers against the
//! scene.

use messages::{FUTURE_NS, Features, Hold, Order, Stamp};
use serde::{Deserialize, Serialize};

use crate::input::Input;

/// What a cycle is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// Run the law on these features.
    Step {
        /// The features.
        features: Features,
        /// Their relation to the previous ones.
        link: Link,
    },
    /// Nothing new, and the last features are still good: answer the prediction, or send the last
    /// command again.
    Repeat,
    /// Send the zero twist, as the answer to the message with this head.
    Hold(Hold, Stamp),
}

/// The relation of features to those of the law's previous step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// One period later, with the law's command in force.
    Next,
    /// Frames are missing in between, or the command was not in force all the time: the prediction
    /// is void.
    Broken,
    /// A new run: all earlier state is void.
    New,
}

/// The gate. Plain data: a copy goes on as the original does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gate {
    stale_ns: Option<u64>,
    /// Head of the last message.
    heard: Option<Stamp>,
    /// Head of the last message that came in order.
    believed: Stamp,
    good_ns: Option<u64>,
    /// Why the last message was refused; `None` if it was not.
    held: Option<Hold>,
    gap: bool,
    /// Whether the last message that came in order was the first of a camera that started again.
    restarted: bool,
}

impl Gate {
    /// A gate that holds when no message came for `stale_ns`; `None` in lockstep, where time does
    /// not pass and stamps are not checked.
    pub fn new(stale_ns: Option<u64>) -> Self {
        Self {
            stale_ns,
            heard: None,
            believed: Stamp::default(),
            good_ns: None,
            held: Some(Hold::NoFeatures),
            gap: true,
            restarted: false,
        }
    }

    /// Whether time is real; in lockstep it is simulated.
    pub fn is_live(&self) -> bool {
        self.stale_ns.is_some()
    }

    /// Judges what was received by `now_ns` (CLOCK_MONOTONIC).
    pub fn judge(&mut self, input: &Input<Features>, now_ns: u64) -> Verdict {
        match input {
            Input::Message(features) => match Order::after(self.heard, &features.stamp) {
                Order::Repeated => self.nothing(now_ns),
                order => self.fresh(features, order, now_ns),
            },
            Input::Nothing => self.nothing(now_ns),
            Input::Refused(stamp) => {
                self.heard = Some(*stamp);
                self.hold(Hold::Invalid)
            }
            Input::Failed => self.hold(Hold::Transport),
        }
    }

    /// Holds until the next good message, and tells the law then that there was a gap: for refusals
    /// by the law, too.
    pub fn hold(&mut self, hold: Hold) -> Verdict {
        self.held = Some(hold);
        self.gap = true;
        Verdict::Hold(hold, self.last())
    }

    /// Lets the law know at the next features that its last command was not in force all the time:
    /// it was not sent.
    pub fn mark_gap(&mut self) {
        self.gap = true;
    }

    /// Notes that the law could use the features that the gate let pass.
    pub fn approve(&mut self) {
        self.good_ns = Some(self.last().published_ns);
    }

    /// When the last features were published that the law could use, CLOCK_MONOTONIC, ns; `None`
    /// before the first.
    pub fn good_ns(&self) -> Option<u64> {
        self.good_ns
    }

    /// Head of the last message; zero before the first.
    fn last(&self) -> Stamp {
        self.heard.unwrap_or_default()
    }

    fn fresh(&mut self, features: &Features, order: Order, now_ns: u64) -> Verdict {
        self.heard = Some(features.stamp);
        if self.is_live()
            && let Some(hold) = self.wrong_time(&features.stamp, order, now_ns)
        {
            return self.hold(hold);
        }
        self.believed = features.stamp;
        if self.is_stale(now_ns) {
            return self.hold(Hold::Stale);
        }
        let link = match order {
            Order::First | Order::Restarted => Link::New,
            Order::Next if !self.gap => Link::Next,
            _ => Link::Broken,
        };
        (self.gap, self.held) = (false, None);
        Verdict::Step {
            features: *features,
            link,
        }
    }

    /// Why the times of a new message are refused, compared with now and with the previous message.
    fn wrong_time(&mut self, stamp: &Stamp, order: Order, now_ns: u64) -> Option<Hold> {
        let Stamp {
            published_ns,
            data_ns,
            ..
        } = *stamp;
        let before = self.believed;
        if published_ns.max(data_ns) > now_ns.saturating_add(FUTURE_NS) {
            return Some(Hold::Clock);
        }
        let is_same_camera = !matches!(order, Order::First | Order::Restarted);
        if published_ns < before.published_ns || (is_same_camera && data_ns < before.data_ns) {
            return Some(Hold::Order);
        }
        // A camera that hangs and sends one exposure again and again, also where it seems to have
        // started again (a driver that does not count its messages); 0 means that the exposure time
        // is unknown.
        if data_ns == before.data_ns && data_ns != 0 {
            return Some(Hold::Stale);
        }
        // A driver that does not count its messages seems to start again with each, and what is
        // compared with the features before (a frozen image, points mixed up) would never be looked
        // at.
        let is_restart = order == Order::Restarted;
        if is_restart && self.restarted {
            return Some(Hold::Order);
        }
        self.restarted = is_restart;
        None
    }

    fn nothing(&mut self, now_ns: u64) -> Verdict {
        match self.held {
            Some(hold) => Verdict::Hold(hold, self.last()),
            None if self.is_stale(now_ns) => self.hold(Hold::Stale),
            None => {
                // The next features are more than one period away from the law's last ones.
                self.gap = true;
                Verdict::Repeat
            }
        }
    }

    /// Age is silence, from publication on: a camera with a long but steady latency is not stale.
    fn is_stale(&self, now_ns: u64) -> bool {
        self.stale_ns
            .is_some_and(|limit| now_ns.saturating_sub(self.believed.published_ns) > limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: u64 = 100;

    fn message(sequence: u64, published_ns: u64) -> Features {
        let mut features = Features::new(&[[1.0, 2.0]; 4], published_ns);
        features.stamp.sequence = sequence;
        features.stamp.published_ns = published_ns;
        features
    }

    fn came(sequence: u64, published_ns: u64) -> Input<Features> {
        Input::Message(message(sequence, published_ns))
    }

    fn link(verdict: Verdict) -> Option<Link> {
        match verdict {
            Verdict::Step { link, .. } => Some(link),
            _ => None,
        }
    }

    fn hold(verdict: Verdict) -> Option<Hold> {
        match verdict {
            Verdict::Hold(hold, _) => Some(hold),
            _ => None,
        }
    }

    #[test]
    fn before_the_first_message_there_is_nothing_to_do_but_hold() {
        let mut gate = Gate::new(Some(LIMIT));
        assert_eq!(hold(gate.judge(&Input::Nothing, 0)), Some(Hold::NoFeatures));
    }

    #[test]
    fn steady_messages_are_linked_and_a_gap_breaks_the_link_once() {
        let mut gate = Gate::new(Some(LIMIT));
        let mut judge = |input: Input<Features>, now| link(gate.judge(&input, now));
        assert_eq!(judge(came(1, 0), 1), Some(Link::New));
        assert_eq!(judge(came(2, 30), 31), Some(Link::Next));
        assert_eq!(judge(came(4, 90), 91), Some(Link::Broken));
        assert_eq!(judge(came(5, 120), 121), Some(Link::Next));
        assert_eq!(judge(came(1, 150), 151), Some(Link::New));
    }

    #[test]
    fn without_news_the_command_is_repeated_until_it_is_stale() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(1, 0), 1);
        assert_eq!(gate.judge(&Input::Nothing, 50), Verdict::Repeat);
        assert_eq!(gate.judge(&Input::Nothing, 100), Verdict::Repeat);
        assert_eq!(hold(gate.judge(&Input::Nothing, 101)), Some(Hold::Stale));
        // Good features end it, and the law gets `Link::Broken` for the gap.
        assert_eq!(link(gate.judge(&came(2, 200), 201)), Some(Link::Broken));
    }

    #[test]
    fn a_camera_that_seems_to_start_again_with_each_message_is_held() {
        let mut gate = Gate::new(Some(LIMIT));
        let mut judge = |at, number| hold(gate.judge(&came(number, at), at + 1));
        assert_eq!(judge(10, 7), None);
        assert_eq!(judge(20, 7), None);
        assert_eq!(judge(30, 7), Some(Hold::Order));
        assert_eq!(judge(40, 7), Some(Hold::Order));
        // Until it counts.
        assert_eq!(judge(50, 8), None);
        assert_eq!(judge(60, 8), None);
        assert_eq!(judge(70, 11), None);
    }

    #[test]
    fn a_message_from_long_ago_is_stale_when_it_comes() {
        let mut gate = Gate::new(Some(LIMIT));
        assert_eq!(hold(gate.judge(&came(1, 0), 500)), Some(Hold::Stale));
        let mut lockstep = Gate::new(None);
        assert_eq!(link(lockstep.judge(&came(1, 0), 500)), Some(Link::New));
    }

    #[test]
    fn features_from_the_future_poison_nothing() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(1, 10), 11);
        let future = 11 + FUTURE_NS + 1;
        let verdict = gate.judge(&came(2, future), 11);
        assert_eq!(hold(verdict), Some(Hold::Clock));
        let verdict = gate.judge(&came(3, 12), 13);
        assert_eq!(link(verdict), Some(Link::Broken));
    }

    #[test]
    fn older_features_are_out_of_order_from_any_camera() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(5, 50), 51);
        // The next one, and the first of a camera that starts again.
        for number in [6, 1] {
            let verdict = gate.judge(&came(number, 49), 52);
            assert_eq!(hold(verdict), Some(Hold::Order));
        }
        let mut older_exposure = message(2, 53);
        older_exposure.stamp.data_ns = 49;
        let verdict = gate.judge(&Input::Message(older_exposure), 54);
        assert_eq!(hold(verdict), Some(Hold::Order));
        // A camera that starts again has exposures of its own.
        older_exposure.stamp.sequence = 1;
        let verdict = gate.judge(&Input::Message(older_exposure), 54);
        assert_eq!(link(verdict), Some(Link::New));
    }

    #[test]
    fn one_exposure_sent_again_and_again_is_stale() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(1, 0), 1);
        gate.judge(&came(2, 30), 31);
        let mut frozen = message(3, 60);
        frozen.stamp.data_ns = 30;
        let frozen = Input::Message(frozen);
        assert_eq!(hold(gate.judge(&frozen, 61)), Some(Hold::Stale));
        // Nor is it new by another count.
        let mut restarted = message(1, 90);
        restarted.stamp.data_ns = 30;
        let restarted = Input::Message(restarted);
        assert_eq!(hold(gate.judge(&restarted, 91)), Some(Hold::Stale));
        let mut lockstep = Gate::new(None);
        lockstep.judge(&came(2, 30), 31);
        assert_eq!(link(lockstep.judge(&frozen, 61)), Some(Link::Next));
    }

    #[test]
    fn only_what_the_law_could_use_is_good() {
        let mut gate = Gate::new(Some(LIMIT));
        assert_eq!(gate.good_ns(), None);
        gate.judge(&came(1, 10), 11);
        gate.approve();
        gate.judge(&came(2, 40), 41);
        gate.hold(Hold::OffImage);
        gate.judge(&Input::Nothing, 60);
        assert_eq!(gate.good_ns(), Some(10));
    }

    #[test]
    fn a_repeated_message_is_no_news() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(1, 0), 1);
        assert_eq!(gate.judge(&came(1, 0), 2), Verdict::Repeat);
    }

    #[test]
    fn a_bad_message_holds_until_a_good_one_comes() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(1, 0), 1);
        let invalid = message(0, 30).stamp;
        assert_eq!(
            gate.judge(&Input::Refused(invalid), 31),
            Verdict::Hold(Hold::Invalid, invalid)
        );
        assert_eq!(hold(gate.judge(&Input::Nothing, 32)), Some(Hold::Invalid));
        assert_eq!(link(gate.judge(&came(3, 90), 91)), Some(Link::Broken));
    }
}
