//! Settings of the detector.

/// How markers look: bright discs on the plane of the pattern.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectorSettings {
    /// Radius of the discs on the plane of the pattern, m; above 0, at most 1.
    pub marker_radius_m: f64,
    /// Least and greatest mean radius in the image, px; 3 to 200.
    pub radius_px: [f64; 2],
}

impl Default for DetectorSettings {
    fn default() -> Self {
        Self {
            marker_radius_m: crate::Look::default().marker_radius_m,
            radius_px: [4.0, 24.0],
        }
    }
}

/// Why a detector cannot be made, or an image not be searched.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DetectorError {
    /// A setting is out of its range.
    #[error("detector: {key} = {value}; allowed: {allowed}")]
    Value {
        /// Name of the field in the settings.
        key: &'static str,
        /// What was found.
        value: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The image has another size than the scene's camera.
    #[error("image of {} x {} px; allowed: {} x {}, the scene's", found[0], found[1], expected[0], expected[1])]
    Size {
        /// Width and height of the image, px.
        found: [usize; 2],
        /// Width and height in the scene, px.
        expected: [usize; 2],
    },
}

impl DetectorSettings {
    /// Checks every number.
    pub(crate) fn check(&self) -> Result<(), DetectorError> {
        let refuse = |key, value, allowed| {
            Err(DetectorError::Value {
                key,
                value,
                allowed,
            })
        };
        let (radius, [least, most]) = (self.marker_radius_m, self.radius_px);
        if !(1e-6..=1.0).contains(&radius) {
            return refuse(
                "marker_radius_m",
                radius.to_string(),
                "above 0, at most 1 m",
            );
        }
        if !(least >= 3.0 && most <= 200.0 && least < most) {
            let value = format!("{:?}", self.radius_px);
            let allowed = "two numbers, 3 to 200 px, the first below the second";
            return refuse("radius_px", value, allowed);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_setting_out_of_range_is_named() {
        let settings = DetectorSettings {
            marker_radius_m: 0.0,
            ..DetectorSettings::default()
        };
        let message = settings.check().unwrap_err().to_string();
        let expected = "detector: marker_radius_m = 0; allowed: above 0, at most 1 m";
        assert_eq!(message, expected);
    }
}
