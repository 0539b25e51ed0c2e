//! Messages with views, into a file or live: all that is published, what was lost of it, and what
//! Foxglove draws.

use std::path::Path;
use std::sync::Arc;

use foxglove::messages::log::Level;
use messages::Order;
use recording::{CONFIG_FILE, RecordingFile, SCENE_FILE, Sink, WriteError};
use scene::{Scene, SceneFiles};

use crate::ledger::{Ledger, Notice};
use crate::scenery::{IMAGE, calibration, image, scenery};
use crate::view_writer::ViewWriter;
use crate::views::Viewed;
use crate::world::{frustum, pattern};

/// Name of the metadata record with the counts, at the end of the file.
const LEDGER: &str = "vpc.ledger";

/// Writes messages, their views and an account of what was lost.
pub struct Recorder<S = RecordingFile> {
    pub(crate) writer: ViewWriter<S>,
    ledger: Ledger,
    /// Least time between two messages of a topic that are passed on, ns; of a recording 0.
    apart_ns: u64,
}

impl Recorder {
    /// Creates the file.
    ///
    /// # Errors
    /// [`WriteError`]; a file that exists is refused without `force`.
    pub fn create(path: &Path, force: bool) -> Result<Self, WriteError> {
        let mut file = RecordingFile::create(path, force)?;
        file.flush()?;
        Ok(Self::new(file, 0))
    }

    /// Attaches a scene and the files that it names, and draws it; once for a recording.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn describe(&mut self, files: &SceneFiles) -> Result<(), WriteError> {
        let (scene, file) = (&files.scene, &mut self.writer.sink);
        for (name, bytes) in &files.beside {
            file.attach(name, bytes)?;
        }
        file.attach(SCENE_FILE, files.text.as_bytes())?;
        file.origin([
            (SCENE_FILE, files.path.clone()),
            ("task", scene.fingerprint().to_string()),
        ])?;
        let wall_ns = file.clock().wall_ns;
        self.draw(scene, wall_ns)?;
        self.draw_image_plane(scene, wall_ns)?;
        self.flush()
    }

    /// Attaches the configuration of the daemon; once for a recording.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn configure(&mut self, config: &str) -> Result<(), WriteError> {
        self.writer.sink.attach(CONFIG_FILE, config.as_bytes())?;
        self.flush()
    }

    /// Hands everything so far to the operating system.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.writer.sink.flush()
    }

    /// Ends the recording with its counts and its index, on the disk.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn finish(mut self) -> Result<Ledger, WriteError> {
        self.writer.sink.metadata(LEDGER, self.ledger.to_map())?;
        self.writer.sink.finish()?;
        Ok(self.ledger)
    }
}

impl<S: Sink> Recorder<S> {
    /// Messages and views into this sink; of each topic, messages at least `apart_ns` apart.
    pub(crate) fn new(sink: S, apart_ns: u64) -> Self {
        Self {
            writer: ViewWriter::new(sink),
            ledger: Ledger::default(),
            apart_ns,
        }
    }

    /// What was counted so far.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Draws what of a scene stands still.
    ///
    /// # Errors
    /// [`WriteError`].
    pub(crate) fn draw(&mut self, scene: &Scene, wall_ns: u64) -> Result<(), WriteError> {
        let to = &mut self.writer;
        to.put("/camera/calibration", 1, wall_ns, || {
            calibration(scene, wall_ns)
        })?;
        to.put("/camera/scene", 1, wall_ns, || scenery(scene, wall_ns))?;
        to.put("/world/pattern", 1, wall_ns, || pattern(scene, wall_ns))?;
        to.put("/world/frustum", 1, wall_ns, || frustum(scene, wall_ns))?;
        to.scene = Some(Arc::new(scene.clone()));
        Ok(())
    }

    /// Draws the image plane, where there is no image of a camera.
    ///
    /// # Errors
    /// [`WriteError`].
    pub(crate) fn draw_image_plane(
        &mut self,
        scene: &Scene,
        wall_ns: u64,
    ) -> Result<(), WriteError> {
        self.writer.put(IMAGE, 1, wall_ns, || image(scene, wall_ns))
    }

    /// Writes a message with its views; one that is the one before again is passed over.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn take<T: Viewed>(
        &mut self,
        message: &T,
        order: Order,
    ) -> Result<Option<Notice>, WriteError> {
        // Late subscribers are handed the last message again.
        if order == Order::Repeated {
            return Ok(None);
        }
        let notice = self.ledger.record(T::TOPIC, order);
        if let Some(notice) = &notice {
            let published_ns = message.stamp().published_ns;
            let text = notice.to_string();
            self.writer
                .log(Level::Warning, "recorder", text, published_ns)?;
        }
        // The daemon publishes the records of several cycles at once.
        let stamp = message.stamp();
        let at_ns = match stamp.data_ns {
            0 => stamp.published_ns,
            data_ns => data_ns,
        };
        if self.writer.is_due_after(self.apart_ns, T::TOPIC, at_ns) {
            self.writer.sink.write(message)?;
        }
        message.view(&mut self.writer)?;
        Ok(notice)
    }

    /// Counts a message that broke the contract.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn refuse(&mut self, topic: &'static str, reason: String) -> Result<Notice, WriteError> {
        let notice = self.ledger.refuse(topic, reason);
        let text = notice.to_string();
        self.writer
            .log(Level::Error, "recorder", text, ipc::now_ns())?;
        Ok(notice)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use messages::{CycleRecord, Message, Stamp};
    use recording::{Encoding, WallClock};

    use super::*;

    /// Keeps the topics of what comes.
    struct Topics(Vec<&'static str>);

    impl Sink for Topics {
        fn clock(&self) -> WallClock {
            WallClock::now()
        }

        fn put(
            &mut self,
            topic: &'static str,
            _: impl FnOnce() -> Encoding,
            _: u64,
            _: u64,
            _: impl FnOnce() -> Vec<u8>,
        ) -> Result<(), WriteError> {
            self.0.push(topic);
            Ok(())
        }
    }

    #[test]
    fn cycles_are_spaced_by_their_own_time() {
        let mut recorder = Recorder::new(Topics(Vec::new()), 3_500_000);
        let mut passed = |sequence, data_ns, published_ns| {
            let record = CycleRecord {
                stamp: Stamp {
                    sequence,
                    published_ns,
                    data_ns,
                },
                ..CycleRecord::default()
            };
            recorder.take(&record, Order::Next).unwrap();
            let topics = recorder.writer.sink.0.iter();
            topics.filter(|at| **at == CycleRecord::TOPIC).count()
        };
        // A daemon of 250 Hz; its ordinary thread looks every 5 ms, and then was held up for 100.
        let mut count = 0;
        for number in 1..=100 {
            let woken_ns = 4_000_000 * number;
            let look_ns = if number < 50 { 5_000_000 } else { 100_000_000 };
            count = passed(
                number,
                woken_ns,
                woken_ns.next_multiple_of(look_ns) + number,
            );
        }
        assert_eq!(count, 100);
        // 1 kHz; and messages of which nobody said when they were.
        for number in 1..=4 {
            count = passed(100 + number, 400_000_000 + 1_000_000 * number, 500_000_000);
        }
        assert_eq!(count, 101);
        for number in 1..=8 {
            count = passed(104 + number, 0, 500_000_000 + 1_000_000 * number);
        }
        assert_eq!(count, 103);
    }
}
