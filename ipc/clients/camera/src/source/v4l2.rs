//! A camera under Linux: `/dev/videoN`, by V4L2.
//!
//! Source: "Video for Linux API", chapter "Input/Output", the kernel's userspace documentation.

mod abi;
mod buffers;
mod device;
mod stamp;
mod stream;

use std::io;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use rustix::io::Errno;

use self::abi::{fourcc, fourcc_name};
use self::device::Device;
pub use self::stamp::Shutter;
use self::stamp::Timing;
use self::stream::Stream;
use super::{Next, Source, SourceError};

/// Share by which the camera's rate may differ from the one asked for.
const RATE: f64 = 0.01;

/// What is asked of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Width and height, px.
    pub size: [u32; 2],
    /// Frames a second.
    pub rate_hz: f64,
    /// Length of the exposure, ns; of the driver where `None`.
    pub exposure_ns: Option<u64>,
    /// The shutter.
    pub shutter: Shutter,
    /// From the first row's being read to the last one's, ns.
    pub readout_ns: u64,
}

/// How the driver stores a pixel; both have the grey level in each first byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Grey,
    Yuyv,
}

impl Format {
    fn code(self) -> u32 {
        match self {
            Self::Grey => fourcc(b"GREY"),
            Self::Yuyv => fourcc(b"YUYV"),
        }
    }

    fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Grey => 1,
            Self::Yuyv => 2,
        }
    }
}

/// A camera that streams.
pub struct Camera(Stream<Device>);

impl std::fmt::Debug for Camera {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Camera").field(&self.0.name).finish()
    }
}

impl Camera {
    /// Opens a camera and starts it.
    ///
    /// # Errors
    /// There is no such device, another program uses it, it is no camera, it does not have the size,
    /// rate or a format that is taken, or its exposure is not known.
    pub fn open(path: &Path, request: &Request) -> Result<Self, SourceError> {
        let name = path.display().to_string();
        let system = |errno| refused(&name, errno);
        let mut device = Device::open(path).map_err(system)?;
        let about = device.about().map_err(system)?;
        if !about.is_camera() {
            let found = format!("{} gives no images to programs", about.card);
            return Err(SourceError::value(&name, found, "a video capture device"));
        }
        let (format, layout) = choose(&mut device, &name, request.size)?;
        check_rate(
            &name,
            request.rate_hz,
            device.set_rate(request.rate_hz).map_err(system)?,
        )?;
        let exposure_ns = match request.exposure_ns {
            Some(configured) => configured,
            None => device.exposure_ns().ok_or_else(|| {
                SourceError::value(
                    &name,
                    "the exposure is automatic, or the driver does not tell it",
                    "a fixed exposure (v4l2-ctl -c auto_exposure=1 -c exposure_time_absolute=50), or exposure_ms in the configuration",
                )
            })?,
        };
        device.start(layout.image_bytes).map_err(system)?;
        let timing = Timing {
            exposure_ns,
            shutter: request.shutter,
            readout_ns: request.readout_ns,
        };
        let has_arrival_stamps = about.driver == "uvcvideo" && !stamp::uvc_has_hardware_stamps();
        Ok(Self(Stream {
            name,
            has_arrival_stamps,
            format,
            size: request.size,
            stride: layout.stride,
            timing,
            pixels: Vec::new(),
            held: None,
            sequence: 0,
            last: None,
            buffers: device,
        }))
    }
}

impl Source for Camera {
    fn next(&mut self, stop: &AtomicBool) -> Result<Next<'_>, SourceError> {
        Ok(self.0.next(stop)?.map_or(Next::End, Next::Frame))
    }
}

/// The first format that is taken and that the camera has at this size.
fn choose(
    device: &mut Device,
    name: &str,
    size: [u32; 2],
) -> Result<(Format, device::Layout), SourceError> {
    for format in [Format::Grey, Format::Yuyv] {
        let layout = device.set_format(size, format.code());
        let layout = layout.map_err(|errno| refused(name, errno))?;
        // A driver answers with what it has.
        if layout.code != format.code() {
            continue;
        }
        if layout.size != size {
            let [width, height] = layout.size;
            let found = format!("the camera answers {width}x{height} px");
            let allowed = format!(
                "{}x{} px, as configured; v4l2-ctl --list-formats-ext shows what there is",
                size[0], size[1]
            );
            return Err(SourceError::value(name, found, allowed));
        }
        check_layout(name, format, &layout)?;
        return Ok((format, layout));
    }
    let codes = device.formats();
    let codes: Vec<_> = codes.into_iter().map(fourcc_name).collect();
    let found = format!("the camera has {}", codes.join(", "));
    Err(SourceError::value(name, found, "GREY or YUYV"))
}

fn check_layout(name: &str, format: Format, layout: &device::Layout) -> Result<(), SourceError> {
    let row = layout.size[0] as usize * format.bytes_per_pixel();
    let least = layout.stride * (layout.size[1] as usize).saturating_sub(1) + row;
    if layout.stride < row || layout.image_bytes < least {
        let found = format!(
            "images of {} bytes with rows of {}",
            layout.image_bytes, layout.stride
        );
        let allowed = format!("{least} bytes or more with rows of {row} or more");
        return Err(SourceError::value(name, found, allowed));
    }
    Ok(())
}

fn check_rate(name: &str, asked_hz: f64, answer_hz: Option<f64>) -> Result<(), SourceError> {
    match answer_hz {
        Some(rate) if (rate / asked_hz - 1.0).abs() > RATE => {
            let found = format!("the camera answers {rate:.2} frames a second");
            let allowed = format!("{asked_hz} Hz, as configured");
            Err(SourceError::value(name, found, allowed))
        }
        // A driver that cannot be asked tells its rate by its stamps.
        _ => Ok(()),
    }
}

/// Words for what the kernel answers.
fn refused(name: &str, errno: Errno) -> SourceError {
    let found = match errno {
        Errno::BUSY => "another program uses it",
        Errno::NODEV | Errno::NXIO => "the camera is gone",
        Errno::NOTTY => "this is no camera",
        Errno::NOENT => "there is no such device",
        _ => return SourceError::system(name, io::Error::from(errno)),
    };
    let allowed = "a camera that is free; v4l2-ctl --list-devices shows what there is";
    SourceError::value(name, found, allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_and_the_layout_are_those_asked_for() {
        assert!(check_rate("a", 30.0, Some(30000.0 / 1001.0)).is_ok());
        assert!(check_rate("a", 30.0, None).is_ok());
        let error = check_rate("a", 30.0, Some(15.0)).unwrap_err().to_string();
        assert_eq!(
            error,
            "a: the camera answers 15.00 frames a second; allowed: 30 Hz, as configured"
        );
        let layout = |stride, image_bytes| device::Layout {
            code: Format::Yuyv.code(),
            size: [640, 480],
            stride,
            image_bytes,
        };
        assert!(check_layout("a", Format::Yuyv, &layout(1280, 614_400)).is_ok());
        for (stride, bytes) in [(640, 614_400), (1280, 614_399), (0, 614_400)] {
            assert!(check_layout("a", Format::Yuyv, &layout(stride, bytes)).is_err());
        }
    }

    #[test]
    fn what_is_no_camera_is_refused_in_words() {
        let request = Request {
            size: [640, 480],
            rate_hz: 30.0,
            exposure_ns: None,
            shutter: Shutter::Global,
            readout_ns: 0,
        };
        for (path, said) in [
            (
                "/dev/video-none",
                "/dev/video-none: there is no such device",
            ),
            ("/dev/null", "/dev/null: this is no camera"),
            ("/tmp", "/tmp: "),
        ] {
            let error = Camera::open(Path::new(path), &request).unwrap_err();
            assert!(error.to_string().starts_with(said), "{error}");
        }
    }
}
