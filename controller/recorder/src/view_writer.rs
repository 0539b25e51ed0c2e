//! Messages with views beside them: what Foxglove draws, and a log.

use std::collections::HashMap;
use std::sync::Arc;

use arm::Mount;
use foxglove::messages::{Log, Timestamp, log::Level};
use foxglove::{Encode, Schema};
use messages::{Bound, Stamp};
use recording::{Encoding, Sink, WriteError};
use scene::Scene;

use crate::annotation::time;

/// Least time between two drawings on one topic, ns: nobody sees more than 66 a second.
const APART_NS: u64 = 15_000_000;

/// Writes views and an entry of the log where something happens.
pub struct ViewWriter<S> {
    /// Where all goes, for the messages themselves.
    pub(crate) sink: S,
    /// State and hold of the last cycle.
    pub(crate) situation: Option<[u32; 2]>,
    /// What of the arm binds the command of the last cycle with features.
    pub(crate) bound: Option<Bound<'static>>,
    /// The scene, once it is known.
    pub(crate) scene: Option<Arc<Scene>>,
    /// The camera on the arm's flange, where it is known.
    pub(crate) mount: Option<Mount>,
    drawn_ns: HashMap<&'static str, u64>,
    logged: u64,
}

impl<S: Sink> ViewWriter<S> {
    /// Views beside the messages of this sink.
    pub(crate) fn new(sink: S) -> Self {
        Self {
            sink,
            situation: None,
            bound: None,
            scene: None,
            mount: None,
            drawn_ns: HashMap::new(),
            logged: 0,
        }
    }

    /// Writes an entry of the log.
    pub(crate) fn log(
        &mut self,
        level: Level,
        name: &str,
        text: String,
        monotonic_ns: u64,
    ) -> Result<(), WriteError> {
        self.logged += 1;
        let wall_ns = self.sink.clock().wall_of(monotonic_ns);
        self.put("/log", self.logged, wall_ns, || Log {
            timestamp: time(wall_ns),
            level: level.into(),
            message: text,
            name: name.to_owned(),
            ..Log::default()
        })
    }

    /// Returns whether a drawing on this topic may be made now, which then counts as its time.
    pub(crate) fn is_due(&mut self, topic: &'static str, published_ns: u64) -> bool {
        self.is_due_after(APART_NS, topic, published_ns)
    }

    /// The same for another least time between two, ns.
    pub(crate) fn is_due_after(&mut self, apart_ns: u64, topic: &'static str, at_ns: u64) -> bool {
        let last = self.drawn_ns.get(topic);
        let due = last.is_none_or(|last| at_ns.abs_diff(*last) >= apart_ns);
        if due {
            self.drawn_ns.insert(topic, at_ns);
        }
        due
    }

    /// Writes the view of a message, at its time.
    pub(crate) fn draw<M: Encode>(
        &mut self,
        topic: &'static str,
        stamp: &Stamp,
        view: impl FnOnce(Option<Timestamp>) -> M,
    ) -> Result<(), WriteError> {
        let wall_ns = self.sink.clock().wall_of(stamp.published_ns);
        self.put(topic, stamp.sequence, wall_ns, || view(time(wall_ns)))
    }

    /// Writes a view, which is made only where it is needed.
    pub(crate) fn put<M: Encode>(
        &mut self,
        topic: &'static str,
        sequence: u64,
        wall_ns: u64,
        view: impl FnOnce() -> M,
    ) -> Result<(), WriteError> {
        let encoding = || {
            let schema = M::get_schema().unwrap_or_else(|| Schema::new("", "", &[][..]));
            Encoding {
                schema: (schema.name, schema.encoding, schema.data.into_owned()),
                message: M::get_message_encoding(),
            }
        };
        self.sink.put(topic, encoding, sequence, wall_ns, || {
            let mut data = Vec::new();
            // Fails only where the buffer is full, and a vector grows.
            let _ = view().encode(&mut data);
            data
        })
    }
}
