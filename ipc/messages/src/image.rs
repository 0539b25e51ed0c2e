//! The header of an image.

use crate::codes::codes;
use crate::field::{Field, Kind, Meaning, Stamp, Wire};
use crate::message::{self, Invalid, Message, Payload, Qos, message};

/// Most pixels in a row, and most rows.
const MOST_SIDE: usize = 8192;

/// Most bytes of an image that a publisher can be opened for.
pub const MOST_IMAGE_BYTES: usize = 4 * MOST_SIDE * MOST_SIDE;

codes! {
    /// How a pixel is stored.
    Encoding {
        /// One byte: grey.
        Mono8 = 0 => "mono8",
        /// Three bytes: blue, green, red.
        Bgr8 = 1 => "bgr8",
        /// Three bytes: red, green, blue.
        Rgb8 = 2 => "rgb8",
        /// Two bytes: luma of each pixel, then one chroma of both of a pair (Y0 U Y1 V; YUY2).
        Yuyv = 3 => "yuyv",
    }
}

impl Encoding {
    /// Bytes of one pixel.
    pub const fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Mono8 => 1,
            Self::Yuyv => 2,
            Self::Bgr8 | Self::Rgb8 => 3,
        }
    }
}

message! {
    /// Header of an image. The image itself is a slice of `stride * height` bytes, top row first.
    ImageHeader {
        /// Head; `sequence` counts the camera's frames, lost ones too; `data_ns` is the middle of
        /// the exposure.
        stamp: Stamp,
        /// Begin of the exposure; 0 if unknown.
        exposure_begin_ns: u64 ["ns"],
        /// Length of the exposure; 0 if unknown.
        exposure_ns: u64 ["ns"],
        /// Pixels in a row.
        width: u32 ["px" range(1, MOST_SIDE)],
        /// Rows.
        height: u32 ["px" range(1, MOST_SIDE)],
        /// Bytes from one row to the next; no fewer than a row has.
        stride: u32,
        /// How a pixel is stored.
        encoding: u32 [code(Encoding)],
    }
    // A history of one: the finder of features may come after the image that a lockstep camera
    // waits on. The first byte is aligned for vector instructions.
    "vpc/image" [Payload::Bytes { alignment: 64 }] from "camera":
        Qos { history: 1, buffer: 2, subscribers: 8, publishers: 1 }
}

/// Stands for the slice in errors.
static BYTES: Field = Field {
    name: "bytes",
    doc: "Bytes of the image.",
    unit: "",
    kind: Kind::U64,
    count: 1,
    offset: 0,
    size: 0,
    meaning: Meaning::Any,
};

impl ImageHeader {
    /// An image without gaps between its rows, exposed at `data_ns` (middle of the
    /// exposure; its begin and length are unknown).
    pub fn new(width: u32, height: u32, encoding: Encoding, data_ns: u64) -> Self {
        let mut header = Self {
            width,
            height,
            stride: width.saturating_mul(encoding.bytes_per_pixel() as u32),
            encoding: encoding.code(),
            ..Self::default()
        };
        header.stamp.data_ns = data_ns;
        header
    }

    /// How a pixel is stored; `None` if the contract does not know the code.
    pub fn encoding(&self) -> Option<Encoding> {
        Encoding::from_code(self.encoding)
    }

    /// Checks size, encoding and stride. Returns the bytes of the image.
    ///
    /// # Errors
    /// [`Invalid`] names the first field that is wrong.
    pub fn bytes(&self) -> Result<usize, Invalid> {
        message::check_fields(self, false)?;
        let row = self.row_bytes();
        if (self.stride as usize) < row {
            let limits = (row as f64, f64::INFINITY);
            return Err(refuse("stride", f64::from(self.stride), limits));
        }
        Ok(self.stride as usize * self.height as usize)
    }

    /// Bytes of a row without what follows it.
    pub fn row_bytes(&self) -> usize {
        let pixel = self.encoding().map_or(1, Encoding::bytes_per_pixel);
        self.width as usize * pixel
    }

    /// Checks the header of an image of so many bytes, as its subscribers do.
    ///
    /// # Errors
    /// [`Invalid`] names the first field that is wrong.
    pub fn check_image(&self, bytes: usize) -> Result<(), Invalid> {
        self.check()?;
        let expected = self.bytes()?;
        if bytes != expected {
            let limits = (expected as f64, expected as f64);
            return Err(refuse("bytes", bytes as f64, limits));
        }
        let (begin, at) = (self.exposure_begin_ns, self.stamp.data_ns);
        let end = begin.saturating_add(self.exposure_ns);
        if begin != 0 && !(begin..=end).contains(&at) {
            let limits = (begin as f64, end as f64);
            return Err(refuse("data_ns", at as f64, limits));
        }
        Ok(())
    }
}

fn refuse(field: &str, found: f64, limits: (f64, f64)) -> Invalid {
    let mut fields = Stamp::FIELDS.iter().chain(ImageHeader::FIELDS);
    Invalid {
        service: ImageHeader::SERVICE,
        field: fields.find(|known| known.name == field).unwrap_or(&BYTES),
        index: 0,
        found,
        limits: Some(limits),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> ImageHeader {
        let mut header = ImageHeader::new(640, 480, Encoding::Bgr8, 1_500);
        header.stamp.sequence = 1;
        header
    }

    #[test]
    fn a_good_header_tells_the_bytes() {
        let mut header = header();
        assert_eq!(header.bytes(), Ok(640 * 3 * 480));
        assert_eq!(header.check_image(640 * 3 * 480), Ok(()));
        header.stride = 2048;
        assert_eq!(header.check_image(2048 * 480), Ok(()));
        (header.exposure_begin_ns, header.exposure_ns) = (1_000, 1_000);
        assert_eq!(header.check_image(2048 * 480), Ok(()));
    }

    #[test]
    fn each_fault_is_named_with_what_is_allowed() {
        let refused = |change: fn(&mut ImageHeader), bytes| {
            let mut header = header();
            change(&mut header);
            header.check_image(bytes).unwrap_err().to_string()
        };
        let whole = 640 * 3 * 480;
        for (change, bytes, words) in [
            (
                (|h| h.width = 0) as fn(&mut ImageHeader),
                whole,
                "width = 0; allowed: 1 to 8192",
            ),
            (
                |h| h.height = 8193,
                whole,
                "height = 8193; allowed: 1 to 8192",
            ),
            (
                |h| h.encoding = 4,
                whole,
                "encoding = 4; allowed: 0 mono8, 1 bgr8, 2 rgb8, 3 yuyv",
            ),
            (
                |h| h.stride = 1919,
                whole,
                "stride = 1919; allowed: 1920 or more",
            ),
            (|_| (), whole - 1, "bytes = 921599; allowed: 921600"),
            (
                |h| h.exposure_begin_ns = 1_501,
                whole,
                "data_ns = 1500; allowed: 1501",
            ),
            (
                |h| (h.exposure_begin_ns, h.exposure_ns) = (1_000, 499),
                whole,
                "data_ns = 1500; allowed: 1000 to 1499",
            ),
            (
                |h| h.stamp.sequence = 0,
                whole,
                "sequence = 0; allowed: 1 and more",
            ),
        ] {
            assert_eq!(refused(change, bytes), format!("vpc/image: {words}"));
        }
    }
}
