//! From a driver's stamp to the middle of the exposure.

use clap::ValueEnum;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::abi::{TIMESTAMP_MASK, TIMESTAMP_MONOTONIC, TSTAMP_SRC_MASK, TSTAMP_SRC_SOE};

/// Which rows are exposed when.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Deserialize, Serialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Shutter {
    /// All rows at once; they are read when the exposure has ended.
    #[default]
    Global,
    /// Row after row.
    Rolling,
}

/// What a driver's stamp tells the time of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampedAt {
    /// The first row begins to be exposed.
    ExposureBegin,
    /// The first row begins to be read.
    ReadoutBegin,
    /// The last row has been read.
    ReadoutEnd,
}

impl StampedAt {
    /// What the flags of a buffer say; `None` if its stamp is not on CLOCK_MONOTONIC.
    ///
    /// `uvcvideo` always says "start of exposure". Without hardware stamps, which are off by default,
    /// it takes the time at which the first bytes of a frame arrive: they are read then.
    pub(super) fn of(flags: u32, has_arrival_stamps: bool) -> Option<Self> {
        if flags & TIMESTAMP_MASK != TIMESTAMP_MONOTONIC {
            return None;
        }
        match flags & TSTAMP_SRC_MASK {
            TSTAMP_SRC_SOE if has_arrival_stamps => Some(Self::ReadoutBegin),
            TSTAMP_SRC_SOE => Some(Self::ExposureBegin),
            // End of the frame, the only other source that there is.
            _ => Some(Self::ReadoutEnd),
        }
    }
}

/// Whether the driver of USB cameras takes the stamps of the camera itself.
pub(super) fn uvc_has_hardware_stamps() -> bool {
    let parameter = "/sys/module/uvcvideo/parameters/hwtimestamps";
    std::fs::read_to_string(parameter).is_ok_and(|text| !matches!(text.trim(), "0" | "N"))
}

/// What is known of a camera's exposure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// Length of the exposure of a row, ns.
    pub exposure_ns: u64,
    /// The shutter.
    pub shutter: Shutter,
    /// From the first row's being read to the last one's, ns.
    pub readout_ns: u64,
}

impl Timing {
    /// The middle of the exposure, of the middle row, ns.
    ///
    /// With the stamp t, exposure e and readout r:
    ///
    /// | stamp | global shutter | rolling shutter |
    /// |---|---|---|
    /// | begin of the exposure | t + e/2 | t + r/2 + e/2 |
    /// | begin of the readout | t - e/2 | t + r/2 - e/2 |
    /// | end of the readout | t - r - e/2 | t - r/2 - e/2 |
    pub fn middle_ns(&self, stamped_at: StampedAt, stamp_ns: u64) -> u64 {
        let [half, readout] = [self.exposure_ns / 2, self.readout_ns].map(i128::from);
        // From the begin of the first row's readout to the end of the middle row's exposure.
        let middle_row = match self.shutter {
            Shutter::Global => 0,
            Shutter::Rolling => readout / 2,
        };
        let readout_begin = match stamped_at {
            StampedAt::ExposureBegin => i128::from(self.exposure_ns),
            StampedAt::ReadoutBegin => 0,
            StampedAt::ReadoutEnd => -readout,
        };
        let middle = i128::from(stamp_ns) + readout_begin + middle_row - half;
        u64::try_from(middle).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn the_middle_of_the_exposure_follows_from_what_the_stamp_is_of() {
        use Shutter::{Global, Rolling};
        use StampedAt::{ExposureBegin, ReadoutBegin, ReadoutEnd};
        for (stamped_at, shutter, middle_ms) in [
            (ExposureBegin, Global, 1000 + 4),
            (ExposureBegin, Rolling, 1000 + 10 + 4),
            (ReadoutBegin, Global, 1000 - 4),
            (ReadoutBegin, Rolling, 1000 + 10 - 4),
            (ReadoutEnd, Global, 1000 - 20 - 4),
            (ReadoutEnd, Rolling, 1000 - 10 - 4),
        ] {
            let timing = Timing {
                exposure_ns: 8 * MS,
                shutter,
                readout_ns: 20 * MS,
            };
            let middle_ns = timing.middle_ns(stamped_at, 1000 * MS);
            assert_eq!(middle_ns, middle_ms * MS, "{stamped_at:?} {shutter:?}");
        }
    }

    #[test]
    fn flags_tell_clock_and_instant() {
        let of = |flags| StampedAt::of(flags, false);
        assert_eq!(of(0x2000), Some(StampedAt::ReadoutEnd));
        assert_eq!(of(0x1_2000), Some(StampedAt::ExposureBegin));
        // Mapped, done and a key frame beside.
        assert_eq!(of(0x1_200d), Some(StampedAt::ExposureBegin));
        for flags in [0, 0x4000, 0x1_0000, 0x6000] {
            assert_eq!(of(flags), None);
        }
        assert_eq!(StampedAt::of(0x1_2000, true), Some(StampedAt::ReadoutBegin));
        assert_eq!(StampedAt::of(0x2000, true), Some(StampedAt::ReadoutEnd));
    }
}
