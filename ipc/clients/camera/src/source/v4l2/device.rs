//! The device: ioctls, and the driver's buffers in memory.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::ptr::NonNull;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::OFlags;
use rustix::io::Errno;
use rustix::ioctl::{Opcode, Updater, ioctl};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

use super::abi::*;
use super::buffers::{BUFFERS, Buffer, Buffers};

/// Most formats that are asked for.
const MOST_FORMATS: u32 = 64;

/// What a device says about itself.
pub(super) struct About {
    pub driver: String,
    pub card: String,
    capabilities: u32,
}

impl About {
    /// Returns whether it gives images, in memory that can be mapped.
    pub fn is_camera(&self) -> bool {
        let needed = CAP_VIDEO_CAPTURE | CAP_STREAMING;
        self.capabilities & needed == needed
    }
}

/// How images lie in memory, as the driver answers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    pub code: u32,
    pub size: [u32; 2],
    pub stride: usize,
    pub image_bytes: usize,
}

/// A buffer of the driver in this process's memory.
struct Mapping {
    begin: NonNull<u8>,
    bytes: usize,
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: `map` mapped just this, and nobody borrows from what is dropped.
        #[allow(unsafe_code)]
        let _ = unsafe { munmap(self.begin.as_ptr().cast(), self.bytes) };
    }
}

// SAFETY: a mapping belongs to the process, not to the thread that made it.
#[allow(unsafe_code)]
unsafe impl Send for Mapping {}

/// An open device. Closing it ends the stream.
pub(super) struct Device {
    mappings: Vec<Mapping>,
    /// A bit for each buffer that is the program's.
    taken: u32,
    file: File,
}

impl Device {
    pub fn open(path: &Path) -> Result<Self, Errno> {
        // Without blocking: `take` returns at once.
        let flags = OFlags::NONBLOCK.bits() as i32;
        let mut options = OpenOptions::new();
        let options = options.read(true).write(true).custom_flags(flags);
        let file = options.open(path);
        let errno = |error: std::io::Error| Errno::from_io_error(&error).unwrap_or(Errno::IO);
        Ok(Self {
            file: file.map_err(errno)?,
            mappings: Vec::new(),
            taken: 0,
        })
    }

    fn call<const OPCODE: Opcode, A: Argument<OPCODE>>(&self, mut argument: A) -> Result<A, Errno> {
        loop {
            // SAFETY: what `Argument` promises.
            #[allow(unsafe_code)]
            let done = unsafe {
                let updater = Updater::<OPCODE, A>::new(&mut argument);
                ioctl(&self.file, updater)
            };
            match done {
                Err(Errno::INTR) => (),
                done => return done.map(|()| argument),
            }
        }
    }

    pub fn about(&self) -> Result<About, Errno> {
        let found = self.call::<QUERYCAP, _>(Capability::default())?;
        let words = |bytes: &[u8]| {
            let text = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
            String::from_utf8_lossy(text).into_owned()
        };
        let capabilities = match found.capabilities & CAP_DEVICE_CAPS {
            0 => found.capabilities,
            // Of this node, not of the whole device.
            _ => found.device_caps,
        };
        Ok(About {
            driver: words(&found.driver),
            card: words(&found.card),
            capabilities,
        })
    }

    /// The codes of the formats that the device has.
    pub fn formats(&self) -> Vec<u32> {
        let one = |index| {
            let kind = BUF_TYPE_VIDEO_CAPTURE;
            let description = FmtDesc {
                index,
                kind,
                ..FmtDesc::default()
            };
            let found = self.call::<ENUM_FMT, _>(description).ok()?;
            Some(found.pixelformat)
        };
        (0..MOST_FORMATS).map_while(one).collect()
    }

    /// Asks for a size and a format; the driver answers with the nearest that it has.
    pub fn set_format(&mut self, [width, height]: [u32; 2], code: u32) -> Result<Layout, Errno> {
        let answer = self.call::<S_FMT, _>(Format {
            kind: BUF_TYPE_VIDEO_CAPTURE,
            width,
            height,
            pixelformat: code,
            field: FIELD_NONE,
            ..Format::default()
        })?;
        Ok(Layout {
            code: answer.pixelformat,
            size: [answer.width, answer.height],
            stride: answer.bytesperline as usize,
            image_bytes: answer.sizeimage as usize,
        })
    }

    /// Asks for a rate; the one that the driver answers, Hz, or `None` if it does not tell.
    pub fn set_rate(&mut self, rate_hz: f64) -> Result<Option<f64>, Errno> {
        const PARTS: f64 = 1000.0;
        let answer = self.call::<S_PARM, _>(StreamParm {
            kind: BUF_TYPE_VIDEO_CAPTURE,
            numerator: PARTS as u32,
            denominator: (rate_hz * PARTS).round() as u32,
            ..StreamParm::default()
        });
        match answer {
            Ok(answer) if answer.capability & CAP_TIMEPERFRAME != 0 && answer.numerator > 0 => Ok(
                Some(f64::from(answer.denominator) / f64::from(answer.numerator)),
            ),
            Ok(_) | Err(Errno::NOTTY | Errno::INVAL) => Ok(None),
            Err(errno) => Err(errno),
        }
    }

    /// The length of the exposure, ns; `None` if it is automatic or the driver does not tell.
    pub fn exposure_ns(&self) -> Option<u64> {
        const UNIT_NS: u64 = 100_000;
        let control = |id| self.call::<G_CTRL, _>(Control { id, value: 0 }).ok();
        // A camera without this control has no automatic exposure.
        let mode = control(CID_EXPOSURE_AUTO).map(|mode| mode.value);
        if mode.is_some_and(|mode| !EXPOSURE_IS_FIXED.contains(&mode)) {
            return None;
        }
        let units = control(CID_EXPOSURE_ABSOLUTE)?.value;
        Some(u64::try_from(units).ok()? * UNIT_NS)
    }

    /// Maps the driver's buffers, of `image_bytes` or more, and starts the stream.
    pub fn start(&mut self, image_bytes: usize) -> Result<(), Errno> {
        let (kind, memory) = (BUF_TYPE_VIDEO_CAPTURE, MEMORY_MMAP);
        let answer = self.call::<REQBUFS, _>(RequestBuffers {
            count: BUFFERS,
            kind,
            memory,
            ..RequestBuffers::default()
        })?;
        // One is looked at while the driver fills the next; a driver may give more than it was
        // asked for.
        if !(2..=u32::BITS).contains(&answer.count) {
            return Err(Errno::NOMEM);
        }
        for index in 0..answer.count {
            let found = self.call::<QUERYBUF, _>(described(index))?;
            if (found.length as usize) < image_bytes {
                return Err(Errno::NOMEM);
            }
            let mapping = self.map(found.offset, found.length as usize)?;
            self.mappings.push(mapping);
            self.call::<QBUF, _>(described(index))?;
        }
        self.call::<STREAMON, _>(BUF_TYPE_VIDEO_CAPTURE as i32)?;
        Ok(())
    }

    fn map(&self, offset: u32, bytes: usize) -> Result<Mapping, Errno> {
        let (read, shared) = (ProtFlags::READ, MapFlags::SHARED);
        let at = std::ptr::null_mut();
        // SAFETY: new memory at an address that the kernel chooses.
        #[allow(unsafe_code)]
        let begin = unsafe { mmap(at, bytes, read, shared, &self.file, u64::from(offset)) }?;
        let begin = NonNull::new(begin.cast()).ok_or(Errno::NOMEM)?;
        Ok(Mapping { begin, bytes })
    }
}

/// The description of a buffer in a call.
fn described(index: u32) -> V4l2Buffer {
    V4l2Buffer {
        index,
        kind: BUF_TYPE_VIDEO_CAPTURE,
        memory: MEMORY_MMAP,
        ..V4l2Buffer::default()
    }
}

impl Buffers for Device {
    fn wait(&mut self, timeout: Duration) -> Result<bool, Errno> {
        let timeout = Timespec {
            tv_sec: timeout.as_secs() as i64,
            tv_nsec: i64::from(timeout.subsec_nanos()),
        };
        let mut polled = [PollFd::new(&self.file, PollFlags::IN)];
        let count = poll(&mut polled, Some(&timeout))?;
        // An error, for instance of a camera that is gone, is told by `take`.
        Ok(count > 0)
    }

    fn take(&mut self) -> Result<Option<Buffer>, Errno> {
        let full = match self.call::<DQBUF, _>(described(0)) {
            Err(Errno::AGAIN) => return Ok(None),
            full => full?,
        };
        if full.index as usize >= self.mappings.len() {
            return Err(Errno::IO);
        }
        self.taken |= 1 << full.index;
        let [seconds, micros] = [full.seconds, full.microseconds].map(i64::unsigned_abs);
        Ok(Some(Buffer {
            index: full.index,
            sequence: full.sequence,
            flags: full.flags,
            used: full.bytesused as usize,
            stamp_ns: seconds * 1_000_000_000 + micros * 1_000,
        }))
    }

    fn give(&mut self, index: u32) -> Result<(), Errno> {
        self.taken &= !(1 << index);
        self.call::<QBUF, _>(described(index))?;
        Ok(())
    }

    fn bytes(&self, index: u32) -> &[u8] {
        if self.taken & (1 << index) == 0 {
            return &[];
        }
        let Some(mapping) = self.mappings.get(index as usize) else {
            return &[];
        };
        // SAFETY: mapped as long as the device lives, and whole bytes of any value. The driver
        // writes no buffer that is taken, and `give`, after which it does, needs the device for
        // itself: the slice is gone then.
        #[allow(unsafe_code)]
        unsafe {
            std::slice::from_raw_parts(mapping.begin.as_ptr(), mapping.bytes)
        }
    }

    fn now_ns(&self) -> u64 {
        ipc::now_ns()
    }
}
