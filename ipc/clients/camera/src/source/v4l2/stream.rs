//! The images of a started camera, one after another.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rustix::io::Errno;

use super::super::{Frame, SourceError};
use super::buffers::{BUFFERS, Buffer, Buffers};
use super::stamp::{StampedAt, Timing};
use super::{Format, refused};
use crate::grey::Grey;

/// How long to wait before looking at the stop flag again.
const LOOK: Duration = Duration::from_millis(50);
/// A camera that sends nothing for as long is given up.
const SILENCE_NS: u64 = 2_000_000_000;
/// A stamp of CLOCK_MONOTONIC is no older than this when its frame is received, and not later.
const OLDEST_NS: u64 = 1_000_000_000;

/// The images of a started camera.
pub(super) struct Stream<B> {
    pub name: String,
    pub format: Format,
    pub size: [u32; 2],
    pub stride: usize,
    pub timing: Timing,
    /// Stamps tell when the first bytes arrived, whatever their flag says.
    pub has_arrival_stamps: bool,
    /// The grey levels, where the driver has other bytes between them.
    pub pixels: Vec<u8>,
    /// The buffer that the last frame is in.
    pub held: Option<u32>,
    pub sequence: u64,
    /// The driver's number of the last frame.
    pub last: Option<u32>,
    pub buffers: B,
}

impl<B: Buffers> Stream<B> {
    pub fn next(&mut self, stop: &AtomicBool) -> Result<Option<Frame<'_>>, SourceError> {
        if let Some(index) = self.held.take() {
            self.give(index)?;
        }
        let Some(buffer) = self.newest(stop)? else {
            return Ok(None);
        };
        self.held = Some(buffer.index);
        // The driver counts from 0, and begins again after 2^32.
        let ahead = self
            .last
            .map_or(1, |last| buffer.sequence.wrapping_sub(last));
        self.sequence += u64::from(ahead);
        self.last = Some(buffer.sequence);
        let data_ns = self.middle_ns(&buffer)?;
        let [width, height] = self.size.map(|side| side as usize);
        let bytes = self.buffers.bytes(buffer.index);
        let image = match self.format {
            Format::Grey => Grey::new(bytes, width, height, self.stride),
            Format::Yuyv => {
                take_luma(bytes, width, self.stride, height, &mut self.pixels);
                Grey::new(&self.pixels, width, height, width)
            }
        };
        let image = image.ok_or_else(|| {
            let found = format!("a buffer of {} bytes", bytes.len());
            SourceError::value(&self.name, found, format!("images of {width}x{height} px"))
        })?;
        Ok(Some(Frame {
            sequence: self.sequence,
            data_ns,
            exposure_ns: self.timing.exposure_ns,
            published_ns: None,
            image,
        }))
    }

    /// The newest whole frame. Older ones, and those that the driver marks as damaged, are given
    /// back and leave a gap.
    fn newest(&mut self, stop: &AtomicBool) -> Result<Option<Buffer>, SourceError> {
        let begin_ns = self.buffers.now_ns();
        let mut newest: Option<Buffer> = None;
        while newest.is_none() {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            if self.buffers.now_ns().saturating_sub(begin_ns) > SILENCE_NS {
                let found = format!("no whole frame for {} s", SILENCE_NS / 1_000_000_000);
                return Err(SourceError::value(&self.name, found, "a camera that sends"));
            }
            match self.buffers.wait(LOOK) {
                Ok(true) => (),
                // A signal ends the wait, too.
                Ok(false) | Err(Errno::INTR) => continue,
                Err(errno) => return Err(refused(&self.name, errno)),
            }
            // Bounded: as many as there are buffers.
            for _ in 0..BUFFERS {
                let Some(buffer) = self.take()? else { break };
                if buffer.is_damaged() || buffer.used < self.image_bytes() {
                    self.give(buffer.index)?;
                } else if let Some(older) = newest.replace(buffer) {
                    self.give(older.index)?;
                }
            }
        }
        Ok(newest)
    }

    fn take(&mut self) -> Result<Option<Buffer>, SourceError> {
        self.buffers
            .take()
            .map_err(|errno| refused(&self.name, errno))
    }

    fn give(&mut self, index: u32) -> Result<(), SourceError> {
        self.buffers
            .give(index)
            .map_err(|errno| refused(&self.name, errno))
    }

    /// Bytes from the first pixel to the last.
    fn image_bytes(&self) -> usize {
        let [width, height] = self.size.map(|side| side as usize);
        self.stride * (height - 1) + width * self.format.bytes_per_pixel()
    }

    /// The middle of the exposure, CLOCK_MONOTONIC.
    fn middle_ns(&self, buffer: &Buffer) -> Result<u64, SourceError> {
        let Some(stamped_at) = StampedAt::of(buffer.flags, self.has_arrival_stamps) else {
            let found = "the driver does not stamp its frames on CLOCK_MONOTONIC";
            let allowed = "a driver whose stamps are monotonic: times would be guesses";
            return Err(SourceError::value(&self.name, found, allowed));
        };
        // Some drivers take another clock than their flag says (uvcvideo with clock=1).
        let now_ns = self.buffers.now_ns();
        if !(now_ns.saturating_sub(OLDEST_NS)..=now_ns).contains(&buffer.stamp_ns) {
            let found = format!("a frame stamped {} ns at {now_ns} ns", buffer.stamp_ns);
            let allowed = "stamps on CLOCK_MONOTONIC of the last second";
            return Err(SourceError::value(&self.name, found, allowed));
        }
        Ok(self.timing.middle_ns(stamped_at, buffer.stamp_ns))
    }
}

/// The luma of YUYV.
fn take_luma(bytes: &[u8], width: usize, stride: usize, height: usize, pixels: &mut Vec<u8>) {
    pixels.clear();
    for row in bytes.chunks(stride).take(height) {
        pixels.extend(row.iter().step_by(2).take(width));
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Shutter, abi};
    use super::*;
    use std::collections::VecDeque;

    /// A driver whose frames and answers are written down.
    struct Fake {
        now_ns: u64,
        /// What is full at each wait.
        full: VecDeque<Result<Vec<Buffer>, Errno>>,
        ready: VecDeque<Buffer>,
        given: Vec<u32>,
        memory: Vec<Vec<u8>>,
    }

    impl Buffers for Fake {
        fn wait(&mut self, timeout: Duration) -> Result<bool, Errno> {
            self.now_ns += timeout.as_nanos() as u64;
            self.ready
                .extend(self.full.pop_front().unwrap_or(Ok(vec![]))?);
            Ok(!self.ready.is_empty())
        }

        fn take(&mut self) -> Result<Option<Buffer>, Errno> {
            Ok(self.ready.pop_front())
        }

        fn give(&mut self, index: u32) -> Result<(), Errno> {
            self.given.push(index);
            Ok(())
        }

        fn bytes(&self, index: u32) -> &[u8] {
            &self.memory[index as usize]
        }

        fn now_ns(&self) -> u64 {
            self.now_ns
        }
    }

    const SOE: u32 = abi::TIMESTAMP_MONOTONIC | abi::TSTAMP_SRC_SOE;
    const NOW_NS: u64 = 5_000_000_000;

    fn full(index: u32, sequence: u32) -> Buffer {
        Buffer {
            index,
            sequence,
            flags: SOE,
            used: 16,
            stamp_ns: NOW_NS,
        }
    }

    fn stream(full: Vec<Result<Vec<Buffer>, Errno>>) -> Stream<Fake> {
        Stream {
            name: "/dev/video9".to_owned(),
            format: Format::Yuyv,
            size: [3, 2],
            stride: 8,
            timing: Timing {
                exposure_ns: 4_000_000,
                shutter: Shutter::Global,
                readout_ns: 0,
            },
            has_arrival_stamps: false,
            pixels: Vec::new(),
            held: None,
            sequence: 0,
            last: None,
            buffers: Fake {
                now_ns: NOW_NS,
                full: full.into(),
                ready: VecDeque::new(),
                given: Vec::new(),
                memory: (0..4).map(|index| vec![index; 16]).collect(),
            },
        }
    }

    fn refusal(stream: &mut Stream<Fake>) -> String {
        let refused = stream.next(&AtomicBool::new(false));
        refused.map(|_| ()).unwrap_err().to_string()
    }

    #[test]
    fn the_newest_frame_is_taken_and_older_ones_leave_a_gap() {
        let stop = AtomicBool::new(false);
        let mut stream = stream(vec![
            Ok(vec![full(0, 7)]),
            Ok(vec![]),
            Ok(vec![full(1, 8), full(2, 9), full(3, 12)]),
        ]);
        let frame = stream.next(&stop).unwrap().unwrap();
        assert_eq!((frame.sequence, frame.published_ns), (1, None));
        assert_eq!(frame.data_ns, NOW_NS + 2_000_000);
        assert_eq!(frame.image.row(1), [0, 0, 0]);
        let frame = stream.next(&stop).unwrap().unwrap();
        assert_eq!(frame.sequence, 6);
        assert_eq!(frame.image.row(0), [3, 3, 3]);
        // The one that is looked at stays taken.
        assert_eq!(stream.buffers.given, [0, 1, 2]);
    }

    #[test]
    fn the_count_goes_on_where_the_driver_begins_again() {
        let stop = AtomicBool::new(false);
        let mut stream = stream(vec![Ok(vec![full(0, u32::MAX)]), Ok(vec![full(1, 1)])]);
        assert_eq!(stream.next(&stop).unwrap().unwrap().sequence, 1);
        assert_eq!(stream.next(&stop).unwrap().unwrap().sequence, 3);
    }

    #[test]
    fn damaged_frames_are_given_back() {
        let stop = AtomicBool::new(false);
        let damaged = Buffer {
            flags: SOE | abi::ERROR,
            ..full(0, 1)
        };
        let short = Buffer {
            used: 13,
            ..full(1, 2)
        };
        let mut stream = stream(vec![Ok(vec![damaged, short]), Ok(vec![full(2, 3)])]);
        let frame = stream.next(&stop).unwrap().unwrap();
        assert_eq!(frame.image.row(0), [2, 2, 2]);
        assert_eq!(stream.buffers.given, [0, 1]);
    }

    #[test]
    fn a_stop_ends_the_wait_and_so_does_a_silent_camera() {
        assert!(
            stream(vec![])
                .next(&AtomicBool::new(true))
                .unwrap()
                .is_none()
        );
        assert!(refusal(&mut stream(vec![])).contains("no whole frame for 2 s"));
        let mut interrupted = stream(vec![Err(Errno::INTR), Ok(vec![full(0, 0)])]);
        let frame = interrupted.next(&AtomicBool::new(false)).unwrap();
        assert!(frame.is_some());
    }

    #[test]
    fn a_camera_that_vanishes_is_told_from_one_that_is_busy() {
        let gone = refusal(&mut stream(vec![Err(Errno::NODEV)]));
        assert!(gone.contains("/dev/video9: the camera is gone"), "{gone}");
        let busy = refused("/dev/video9", Errno::BUSY).to_string();
        assert!(busy.contains("another program uses it"), "{busy}");
    }

    #[test]
    fn stamps_of_another_clock_are_refused() {
        let of = |flags: u32, stamp_ns: u64| {
            let buffer = Buffer {
                flags,
                stamp_ns,
                ..full(0, 1)
            };
            refusal(&mut stream(vec![Ok(vec![buffer])]))
        };
        for flags in [0, abi::TSTAMP_SRC_SOE, 0x4000] {
            assert!(of(flags, NOW_NS).contains("does not stamp its frames on CLOCK_MONOTONIC"));
        }
        for stamp_ns in [0, NOW_NS - 1_000_000_000, NOW_NS + 60_000_000] {
            assert!(of(SOE, stamp_ns).contains("stamps on CLOCK_MONOTONIC of the last second"));
        }
    }

    #[test]
    fn luma_is_every_second_byte_of_a_row() {
        let bytes = [
            1, 90, 2, 91, 3, 92, 4, 93, 0, 0, 5, 90, 6, 91, 7, 92, 8, 93, 0, 0,
        ];
        let mut pixels = vec![99];
        take_luma(&bytes, 4, 10, 2, &mut pixels);
        assert_eq!(pixels, [1, 2, 3, 4, 5, 6, 7, 8]);
    }
}
