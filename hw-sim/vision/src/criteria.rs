//! What markers look like, how far they move, and what is refused.

/// Whether markers are brighter or darker than what they lie on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Polarity {
    /// Bright discs.
    #[default]
    Bright,
    /// Dark discs.
    Dark,
}

/// How markers look and how far they move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectorSettings {
    /// Bright or dark discs.
    pub polarity: Polarity,
    /// Radius of the discs on the plane of the pattern, m; above 0, at most 1.
    pub marker_radius_m: f64,
    /// Least and greatest mean radius in the image, px; 3 to 200.
    pub radius_px: [f64; 2],
    /// Least contrast to the background, levels; 5 to 250.
    pub contrast: f64,
    /// How far the rim of a whole disc may be from an ellipse, px; 0.1 to 5. Smaller rejects discs that are barely
    /// touched by an occlusion, larger bears more noise.
    pub rim_px: f64,
    /// How far a marker may be from its prediction, px; 1 to 500. Never more than 0.4 of the distance to the next one.
    pub gate_px: f64,
    /// How far the pattern may be turned against the last known arrangement when all markers were lost, rad; 0 to pi. A
    /// pattern that looks the same after a half turn needs less than pi/2, a square less than pi/4.
    pub turn_max: f64,
    /// Frames without two visible markers after which predictions are given up, 0 to 1000.
    pub patience: u32,
}

impl Default for DetectorSettings {
    fn default() -> Self {
        Self {
            polarity: Polarity::Bright,
            marker_radius_m: crate::Look::default().marker_radius_m,
            radius_px: [4.0, 24.0],
            contrast: 50.0,
            rim_px: 0.3,
            gate_px: 25.0,
            turn_max: 1.4,
            patience: 5,
        }
    }
}

/// Why a detector cannot be made, or an image not be searched.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DetectorError {
    /// A setting is out of its range.
    #[error("detector: {key} = {value}; allowed: {allowed}")]
    Value {
        /// The field.
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
        let pi = std::f64::consts::PI;
        let refuse = |key, value: String, allowed| {
            Err(DetectorError::Value {
                key,
                value,
                allowed,
            })
        };
        for (key, value, least, most, allowed) in [
            (
                "marker_radius_m",
                self.marker_radius_m,
                1e-6,
                1.0,
                "above 0, at most 1 m",
            ),
            ("contrast", self.contrast, 5.0, 250.0, "5 to 250 levels"),
            ("rim_px", self.rim_px, 0.1, 5.0, "0.1 to 5 px"),
            ("gate_px", self.gate_px, 1.0, 500.0, "1 to 500 px"),
            ("turn_max", self.turn_max, 0.0, pi, "0 to pi rad"),
        ] {
            if !(least..=most).contains(&value) {
                return refuse(key, value.to_string(), allowed);
            }
        }
        let [least, most] = self.radius_px;
        if !(least >= 3.0 && most <= 200.0 && least < most) {
            let value = format!("{:?}", self.radius_px);
            return refuse(
                "radius_px",
                value,
                "two numbers, 3 to 200 px, the first below the second",
            );
        }
        if self.patience > 1000 {
            return refuse("patience", self.patience.to_string(), "0 to 1000 frames");
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
            gate_px: 0.0,
            ..DetectorSettings::default()
        };
        let message = settings.check().unwrap_err().to_string();
        assert_eq!(message, "detector: gate_px = 0; allowed: 1 to 500 px");
    }
}
