//! Numbers and structs that the kernel and its programs agree on.
//!
//! Source: `linux/videodev2.h`, with its names, for 64-bit systems.
//!
//! No crate replaces this file: `v4l` 0.14 needs libclang to build and panics when it cannot close a
//! stream; `linux-video` 0.1 has had no release since its first.

use rustix::ioctl::{Opcode, opcode};

pub(super) const BUF_TYPE_VIDEO_CAPTURE: u32 = 1;
pub(super) const MEMORY_MMAP: u32 = 1;
pub(super) const FIELD_NONE: u32 = 1;
pub(super) const CAP_VIDEO_CAPTURE: u32 = 0x1;
pub(super) const CAP_STREAMING: u32 = 0x0400_0000;
pub(super) const CAP_DEVICE_CAPS: u32 = 0x8000_0000;
pub(super) const CAP_TIMEPERFRAME: u32 = 0x1000;
pub(super) const CID_EXPOSURE_AUTO: u32 = 0x009a_0901;
pub(super) const CID_EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;
/// Of `CID_EXPOSURE_AUTO`: manual, and shutter priority.
pub(super) const EXPOSURE_IS_FIXED: [i32; 2] = [1, 2];

pub(super) const ERROR: u32 = 0x40;
pub(super) const TIMESTAMP_MASK: u32 = 0xe000;
pub(super) const TIMESTAMP_MONOTONIC: u32 = 0x2000;
pub(super) const TSTAMP_SRC_MASK: u32 = 0x7_0000;
pub(super) const TSTAMP_SRC_SOE: u32 = 0x1_0000;

#[repr(C)]
#[derive(Default)]
pub(super) struct Capability {
    pub driver: [u8; 16],
    pub card: [u8; 32],
    pub bus_info: [u8; 32],
    pub version: u32,
    pub capabilities: u32,
    pub device_caps: u32,
    pub reserved: [u32; 3],
}

#[repr(C)]
#[derive(Default)]
pub(super) struct FmtDesc {
    pub index: u32,
    pub kind: u32,
    pub flags: u32,
    pub description: [u8; 32],
    pub pixelformat: u32,
    pub mbus_code: u32,
    pub reserved: [u32; 3],
}

/// With `v4l2_pix_format` in the union. The union holds pointers: it is aligned as they are.
#[repr(C, align(8))]
#[derive(Default)]
pub(super) struct Format {
    pub kind: u32,
    pub padding: u32,
    pub width: u32,
    pub height: u32,
    pub pixelformat: u32,
    pub field: u32,
    pub bytesperline: u32,
    pub sizeimage: u32,
    pub others: [u32; 6],
    pub rest: [[u32; 2]; 19],
}

/// With `v4l2_captureparm` in the union.
#[repr(C)]
#[derive(Default)]
pub(super) struct StreamParm {
    pub kind: u32,
    pub capability: u32,
    pub capturemode: u32,
    pub numerator: u32,
    pub denominator: u32,
    pub extendedmode: u32,
    pub readbuffers: u32,
    pub reserved: [u32; 4],
    pub rest: [[u32; 5]; 8],
}

#[repr(C)]
#[derive(Default)]
pub(super) struct RequestBuffers {
    pub count: u32,
    pub kind: u32,
    pub memory: u32,
    pub capabilities: u32,
    pub flags: u8,
    pub reserved: [u8; 3],
}

/// `v4l2_buffer`, whose union holds the offset of memory that is to be mapped.
#[repr(C, align(8))]
#[derive(Default)]
pub(super) struct V4l2Buffer {
    pub index: u32,
    pub kind: u32,
    pub bytesused: u32,
    pub flags: u32,
    pub field: u32,
    pub padding: u32,
    pub seconds: i64,
    pub microseconds: i64,
    pub timecode: [u32; 4],
    pub sequence: u32,
    pub memory: u32,
    pub offset: u32,
    pub rest_of_union: u32,
    pub length: u32,
    pub reserved2: u32,
    pub request_fd: u32,
}

#[repr(C)]
#[derive(Default)]
pub(super) struct Control {
    pub id: u32,
    pub value: i32,
}

/// The argument of an ioctl.
///
/// # Safety
/// It has the layout that the kernel expects for `OPCODE`, which changes nothing else in memory, and
/// any bytes that the kernel writes there are valid.
#[allow(unsafe_code)]
pub(super) unsafe trait Argument<const OPCODE: Opcode> {}

macro_rules! ioctls {
    ($($name:ident = $direction:ident $argument:ty, $number:literal;)*) => {$(
        pub(super) const $name: Opcode = opcode::$direction::<$argument>(b'V', $number);
        // SAFETY: a struct of `linux/videodev2.h` made of whole numbers; a test compares sizes,
        // offsets and opcodes with the header. The memory that QBUF gives to the driver is the
        // driver's own (MEMORY_MMAP).
        #[allow(unsafe_code)]
        unsafe impl Argument<$name> for $argument {}
    )*};
}

ioctls! {
    QUERYCAP = read Capability, 0;
    ENUM_FMT = read_write FmtDesc, 2;
    S_FMT = read_write Format, 5;
    REQBUFS = read_write RequestBuffers, 8;
    QUERYBUF = read_write V4l2Buffer, 9;
    QBUF = read_write V4l2Buffer, 15;
    DQBUF = read_write V4l2Buffer, 17;
    STREAMON = write i32, 18;
    S_PARM = read_write StreamParm, 22;
    G_CTRL = read_write Control, 27;
}

/// The number of a format.
pub(super) const fn fourcc(name: &[u8; 4]) -> u32 {
    u32::from_le_bytes(*name)
}

pub(super) fn fourcc_name(code: u32) -> String {
    String::from_utf8_lossy(&code.to_le_bytes())
        .trim_end()
        .to_owned()
}

#[cfg(test)]
mod tests;
