//! The gate: which features may reach the law, and what to do without. Pure; the time is an argument.
//!
//! It knows messages: their order, their age, whether all points were visible. The law's own gate then checks the
//! numbers against the scene.

use ipc::{Features, Hold, InputCode, Message, Order, ReceiveError, Received, Stamp};

/// What a cycle received, as far as it matters to what is done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Input<T = Features> {
    /// A message, and where it stands in the sequence.
    Message(Received<T>),
    /// Nothing.
    Nothing,
    /// A message with this head that did not pass its checks.
    Refused(Stamp),
    /// The connection failed.
    Failed,
}

impl<T: Message> Input<T> {
    /// What came, and the head of the message; all zero where there is none.
    pub fn seen(&self) -> (InputCode, Stamp) {
        match self {
            Self::Nothing => (InputCode::Nothing, Stamp::default()),
            Self::Message(received) => (InputCode::Message, *received.message.stamp()),
            Self::Refused(stamp) => (InputCode::Refused, *stamp),
            Self::Failed => (InputCode::Failed, Stamp::default()),
        }
    }
}

impl<T> From<Result<Option<Received<T>>, ReceiveError>> for Input<T> {
    fn from(received: Result<Option<Received<T>>, ReceiveError>) -> Self {
        match received {
            Ok(Some(received)) => Self::Message(received),
            Ok(None) => Self::Nothing,
            Err(ReceiveError::Invalid { stamp, .. }) => Self::Refused(stamp),
            Err(ReceiveError::Transport { .. }) => Self::Failed,
        }
    }
}

/// What a cycle is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// Run the law on these features.
    Step {
        /// The features.
        features: Features,
        /// What they are to the ones before.
        link: Link,
    },
    /// Nothing new, and the last command is still good: send it again.
    Repeat,
    /// Send the zero twist, as the answer to the message with this head.
    Hold(Hold, Stamp),
}

/// What features are to those of the law's previous step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// One period later, with the law's command in force.
    Next,
    /// Frames are missing between, or the command was not in force all the time: the prediction means nothing.
    Broken,
    /// A new run: nothing of before means anything.
    New,
}

/// How much later than now features may claim to be published, ns: one clock serves all processes.
pub(crate) const FUTURE_NS: u64 = 1_000_000;

/// The gate. Plain data: a copy goes on as the original does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    pub(crate) stale_ns: Option<u64>,
    pub(crate) last: Stamp,
    /// Head of the last message that came in order.
    pub(crate) believed: Stamp,
    pub(crate) good_ns: Option<u64>,
    pub(crate) standing: Standing,
    pub(crate) gap: bool,
    /// Whether the last message that came in order was the first of a camera that started again.
    pub(crate) restarted: bool,
}

/// What became of the last message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Standing {
    Good,
    Held(Hold),
}

impl Gate {
    /// A gate that holds when no message came for `stale_ns`; `None` in lockstep, where time does not pass and stamps
    /// are not looked at.
    pub fn new(stale_ns: Option<u64>) -> Self {
        Self {
            stale_ns,
            last: Stamp::default(),
            believed: Stamp::default(),
            good_ns: None,
            standing: Standing::Held(Hold::NoFeatures),
            gap: true,
            restarted: false,
        }
    }

    /// Whether time is real: it is not in lockstep.
    pub fn is_live(&self) -> bool {
        self.stale_ns.is_some()
    }

    /// Judges what was received by `now_ns` (CLOCK_MONOTONIC).
    pub fn judge(&mut self, input: &Input, now_ns: u64) -> Verdict {
        match input {
            Input::Message(received) if received.order != Order::Repeated => {
                self.fresh(received, now_ns)
            }
            Input::Message(_) | Input::Nothing => self.nothing(now_ns),
            Input::Refused(stamp) => {
                self.last = *stamp;
                self.hold(Hold::Invalid)
            }
            Input::Failed => self.hold(Hold::Transport),
        }
    }

    /// Holds until the next good message, and tells the law then that there was a gap: for refusals by the law, too.
    pub fn hold(&mut self, cause: Hold) -> Verdict {
        self.standing = Standing::Held(cause);
        self.gap = true;
        Verdict::Hold(cause, self.last)
    }

    /// Tells the law at the next features that its last command was not in force all the time: it was not sent.
    pub fn mark_gap(&mut self) {
        self.gap = true;
    }

    /// Notes that the law could use the features that the gate let pass.
    pub fn approve(&mut self) {
        self.good_ns = Some(self.last.published_ns);
    }

    /// When the last features were published that the law could use, CLOCK_MONOTONIC, ns; `None` before the first.
    pub fn good_ns(&self) -> Option<u64> {
        self.good_ns
    }

    fn fresh(&mut self, received: &Received<Features>, now_ns: u64) -> Verdict {
        let features = received.message;
        let before = self.believed;
        self.last = features.stamp;
        if self.stale_ns.is_some() {
            let now = now_ns.saturating_add(FUTURE_NS);
            let Stamp {
                published_ns,
                data_ns,
                ..
            } = features.stamp;
            if published_ns > now || data_ns > now {
                return self.hold(Hold::Clock);
            }
            let is_same_camera = !matches!(received.order, Order::First | Order::Restarted);
            let is_older = published_ns < before.published_ns || data_ns < before.data_ns;
            if published_ns < before.published_ns || (is_same_camera && is_older) {
                return self.hold(Hold::Order);
            }
            // A camera that hangs and sends one exposure again and again, also where it seems to have started again (a
            // driver that does not count its messages); 0 is for who does not know the instant.
            if data_ns == before.data_ns && data_ns != 0 {
                return self.hold(Hold::Stale);
            }
            // A driver that does not count its messages seems to start again with each, and what is compared with the
            // features before (a frozen image, points mixed up) would never be looked at.
            let is_restart = received.order == Order::Restarted;
            if is_restart && self.restarted {
                return self.hold(Hold::Order);
            }
            self.restarted = is_restart;
        }
        self.believed = features.stamp;
        if self.is_stale(now_ns) {
            return self.hold(Hold::Stale);
        }
        if !features.all_visible() {
            return self.hold(Hold::Hidden);
        }
        let link = match received.order {
            Order::First | Order::Restarted => Link::New,
            Order::Next if !self.gap => Link::Next,
            _ => Link::Broken,
        };
        self.gap = false;
        self.standing = Standing::Good;
        Verdict::Step { features, link }
    }

    fn nothing(&mut self, now_ns: u64) -> Verdict {
        match self.standing {
            Standing::Held(cause) => Verdict::Hold(cause, self.last),
            Standing::Good if self.is_stale(now_ns) => self.hold(Hold::Stale),
            Standing::Good => {
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

    fn came(sequence: u64, published_ns: u64, order: Order) -> Input {
        Input::Message(Received {
            message: message(sequence, published_ns),
            order,
        })
    }

    fn link(verdict: Verdict) -> Option<Link> {
        match verdict {
            Verdict::Step { link, .. } => Some(link),
            _ => None,
        }
    }

    fn cause(verdict: Verdict) -> Option<Hold> {
        match verdict {
            Verdict::Hold(cause, _) => Some(cause),
            _ => None,
        }
    }

    #[test]
    fn before_the_first_message_there_is_nothing_to_do_but_hold() {
        let mut gate = Gate::new(Some(LIMIT));
        assert_eq!(
            cause(gate.judge(&Input::Nothing, 0)),
            Some(Hold::NoFeatures)
        );
    }

    #[test]
    fn steady_messages_are_linked_and_a_gap_breaks_the_link_once() {
        let mut gate = Gate::new(Some(LIMIT));
        let mut judge = |input: Input, now| link(gate.judge(&input, now));
        assert_eq!(judge(came(1, 0, Order::First), 1), Some(Link::New));
        assert_eq!(judge(came(2, 30, Order::Next), 31), Some(Link::Next));
        assert_eq!(
            judge(came(4, 90, Order::Gap { missed: 1 }), 91),
            Some(Link::Broken)
        );
        assert_eq!(judge(came(5, 120, Order::Next), 121), Some(Link::Next));
        assert_eq!(judge(came(1, 150, Order::Restarted), 151), Some(Link::New));
    }

    #[test]
    fn without_news_the_command_is_repeated_until_it_is_stale() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(1, 0, Order::First), 1);
        assert_eq!(gate.judge(&Input::Nothing, 50), Verdict::Repeat);
        assert_eq!(gate.judge(&Input::Nothing, 100), Verdict::Repeat);
        assert_eq!(cause(gate.judge(&Input::Nothing, 101)), Some(Hold::Stale));
        // Good features end it, and the law is told of the gap.
        assert_eq!(
            link(gate.judge(&came(2, 200, Order::Next), 201)),
            Some(Link::Broken)
        );
    }

    #[test]
    fn a_camera_that_seems_to_start_again_with_each_message_is_held() {
        let mut gate = Gate::new(Some(LIMIT));
        let mut judge = |at, order| cause(gate.judge(&came(7, at, order), at + 1));
        assert_eq!(judge(10, Order::First), None);
        assert_eq!(judge(20, Order::Restarted), None);
        assert_eq!(judge(30, Order::Restarted), Some(Hold::Order));
        assert_eq!(judge(40, Order::Restarted), Some(Hold::Order));
        // Until it counts.
        assert_eq!(judge(50, Order::Next), None);
        assert_eq!(judge(60, Order::Restarted), None);
        assert_eq!(judge(70, Order::Gap { missed: 2 }), None);
    }

    #[test]
    fn a_message_from_long_ago_is_stale_when_it_comes() {
        let mut gate = Gate::new(Some(LIMIT));
        assert_eq!(
            cause(gate.judge(&came(1, 0, Order::First), 500)),
            Some(Hold::Stale)
        );
        let mut lockstep = Gate::new(None);
        assert_eq!(
            link(lockstep.judge(&came(1, 0, Order::First), 500)),
            Some(Link::New)
        );
    }

    #[test]
    fn features_from_the_future_are_a_matter_of_the_clock_and_poison_nothing() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(1, 10, Order::First), 11);
        let future = 11 + FUTURE_NS + 1;
        let verdict = gate.judge(&came(2, future, Order::Next), 11);
        assert_eq!(cause(verdict), Some(Hold::Clock));
        let verdict = gate.judge(&came(3, 12, Order::Next), 13);
        assert_eq!(link(verdict), Some(Link::Broken));
    }

    #[test]
    fn older_features_are_out_of_order_from_the_same_camera_or_another() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(5, 50, Order::First), 51);
        for order in [Order::Next, Order::Restarted] {
            assert_eq!(
                cause(gate.judge(&came(6, 49, order), 52)),
                Some(Hold::Order)
            );
        }
        let mut older_exposure = message(7, 53);
        older_exposure.stamp.data_ns = 49;
        let received = |message, order| Input::Message(Received { message, order });
        let verdict = gate.judge(&received(older_exposure, Order::Next), 54);
        assert_eq!(cause(verdict), Some(Hold::Order));
        // A camera that starts again has exposures of its own.
        let verdict = gate.judge(&received(older_exposure, Order::Restarted), 54);
        assert_eq!(link(verdict), Some(Link::New));
    }

    #[test]
    fn one_exposure_sent_again_and_again_is_stale() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(1, 0, Order::First), 1);
        gate.judge(&came(2, 30, Order::Next), 31);
        let mut frozen = message(3, 60);
        frozen.stamp.data_ns = 30;
        let frozen = Input::Message(Received {
            message: frozen,
            order: Order::Next,
        });
        assert_eq!(cause(gate.judge(&frozen, 61)), Some(Hold::Stale));
        // Nor is it new by another count.
        let mut restarted = message(1, 90);
        restarted.stamp.data_ns = 30;
        let restarted = Input::Message(Received {
            message: restarted,
            order: Order::Restarted,
        });
        assert_eq!(cause(gate.judge(&restarted, 91)), Some(Hold::Stale));
        let mut lockstep = Gate::new(None);
        lockstep.judge(&came(1, 30, Order::First), 31);
        assert_eq!(link(lockstep.judge(&frozen, 61)), Some(Link::Next));
    }

    #[test]
    fn only_what_the_law_could_use_is_good() {
        let mut gate = Gate::new(Some(LIMIT));
        assert_eq!(gate.good_ns(), None);
        gate.judge(&came(1, 10, Order::First), 11);
        gate.approve();
        gate.judge(&came(2, 40, Order::Next), 41);
        gate.hold(Hold::OffImage);
        gate.judge(&Input::Nothing, 60);
        assert_eq!(gate.good_ns(), Some(10));
    }

    #[test]
    fn a_repeated_message_is_no_news() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(1, 0, Order::First), 1);
        assert_eq!(gate.judge(&came(1, 0, Order::Repeated), 2), Verdict::Repeat);
    }

    #[test]
    fn a_bad_message_holds_until_a_good_one_comes() {
        let mut gate = Gate::new(Some(LIMIT));
        gate.judge(&came(1, 0, Order::First), 1);
        let invalid = message(0, 30).stamp;
        let refused = Input::from(Err(ReceiveError::Invalid {
            invalid: ipc::Message::check(&message(0, 30)).unwrap_err(),
            stamp: invalid,
        }));
        assert_eq!(
            gate.judge(&refused, 31),
            Verdict::Hold(Hold::Invalid, invalid)
        );
        assert_eq!(cause(gate.judge(&Input::Nothing, 32)), Some(Hold::Invalid));
        let mut hidden = message(2, 60);
        hidden.visible = 0b0111;
        let hidden = Input::Message(Received {
            message: hidden,
            order: Order::Next,
        });
        assert_eq!(cause(gate.judge(&hidden, 61)), Some(Hold::Hidden));
        assert_eq!(
            link(gate.judge(&came(3, 90, Order::Next), 91)),
            Some(Link::Broken)
        );
    }
}
