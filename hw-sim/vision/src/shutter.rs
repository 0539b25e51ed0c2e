//! When the rows of a frame are exposed.

/// A rolling shutter: rows are exposed one after the other, from the top.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shutter {
    /// How long each row is exposed, ns.
    pub exposure_ns: u64,
    /// From the start of the first row to that of the last, ns; 0 for a global shutter.
    pub readout_ns: u64,
}

impl Shutter {
    /// The stamp of a frame that starts at `start_ns`: the middle of the exposure of its middle row.
    pub fn stamp_ns(&self, start_ns: u64) -> u64 {
        start_ns + self.readout_ns / 2 + self.exposure_ns / 2
    }

    /// The middles of the exposures of the first and of the last row of a frame that starts at `start_ns`, ns: the
    /// instants whose poses [`crate::Renderer::render_rolling`] wants.
    pub fn rows_ns(&self, start_ns: u64) -> [u64; 2] {
        [0, self.readout_ns].map(|delay| start_ns + delay + self.exposure_ns / 2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stamp_lies_halfway_between_first_and_last_row() {
        let shutter = Shutter {
            exposure_ns: 6_000_000,
            readout_ns: 20_000_000,
        };
        assert_eq!(shutter.rows_ns(100_000_000), [103_000_000, 123_000_000]);
        assert_eq!(shutter.stamp_ns(100_000_000), 113_000_000);
    }
}
