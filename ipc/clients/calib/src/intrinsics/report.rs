//! What is said about a result.

use std::fmt;

use super::{ENOUGH, Intrinsics, ViewFit};
use crate::verdict::Verdict;

/// Fewest tilted views about each axis.
const TILTED: usize = 2;
/// A view is tilted from here on, deg; views are asked for at 20.
const TILT_DEG: f64 = 15.0;
/// Greatest standard deviation of a focal length: a third of what a result may be off, 0.3 %.
const FOCAL: f64 = 0.001;
/// Greatest standard deviation of the principal point, of the image's width.
const CENTER: f64 = 0.002;
/// Greatest reprojection error, RMS, px; corners are found to 0.1 px.
const RMS_PX: f64 = 0.5;
/// Greatest share of points that are dropped.
const DROPPED: f64 = 0.05;
/// A view with so many times the median error is worth a word.
const WORST: f64 = 3.0;
/// Fewest corners that each ninth of the image must have shown.
const CORNERS: usize = 8;

impl Intrinsics {
    /// Whether it can be used, and what to do if not.
    pub fn verdict(&self) -> Verdict {
        let mut verdict = Verdict::default();
        let count = self.views.len();
        verdict.refuse_if(count < ENOUGH, || {
            format!("{count} views; take {ENOUGH} or more")
        });
        for (axis, name) in ["horizontal", "vertical"].into_iter().enumerate() {
            let is_tilted = |view: &&ViewFit| view.tilt_deg()[axis].abs() > TILT_DEG;
            let tilted = self.views.iter().filter(is_tilted).count();
            verdict.refuse_if(tilted < TILTED, || {
                format!(
                    "{tilted} views are tilted about the {name} axis; take more, tilted by more than 20 deg"
                )
            });
        }
        if let Err(what) = &self.sigma {
            verdict.refuse_if(true, || {
                format!("the views do not determine {what}; take more, tilted by more than 20 deg")
            });
        }
        let share = |name: &str, of: f64| self.sigma_of(name).unwrap_or(0.0) / of;
        let focal = share("fx", self.camera.focal[0]).max(share("fy", self.camera.focal[1]));
        verdict.refuse_if(focal > FOCAL, || {
            format!(
                "focal lengths to {:.2} % (one standard deviation), {:.1} % asked for; take more views tilted by more than 20 deg",
                100.0 * focal,
                100.0 * FOCAL
            )
        });
        let center = share("cx", 1.0).max(share("cy", 1.0));
        let most = CENTER * f64::from(self.camera.size[0]);
        verdict.refuse_if(center > most, || {
            format!(
                "principal point to {center:.1} px, {most:.1} px asked for; take more tilted views"
            )
        });
        verdict.refuse_if(self.rms_px > RMS_PX, || {
            format!(
                "reprojection errors of {:.2} px RMS, {RMS_PX} px at most; is the board flat, are images sharp?",
                self.rms_px
            )
        });
        let [kept, dropped] = self.points;
        verdict.refuse_if(dropped as f64 > DROPPED * (kept + dropped) as f64, || {
            format!(
                "{dropped} of {} corners miss their places; is the board flat, are images sharp?",
                kept + dropped
            )
        });
        let names = [
            "upper left",
            "upper middle",
            "upper right",
            "middle left",
            "middle",
            "middle right",
            "lower left",
            "lower middle",
            "lower right",
        ];
        let empty = names
            .iter()
            .zip(self.coverage)
            .filter(|(_, corners)| *corners < CORNERS);
        let empty: Vec<_> = empty.map(|(name, _)| *name).collect();
        verdict.refuse_if(!empty.is_empty(), || {
            format!(
                "hardly a corner was seen in the {} of the image; take views with the board there",
                empty.join(", ")
            )
        });
        verdict
    }
}

impl fmt::Display for Intrinsics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let values = [
            ("fx", self.camera.focal[0]),
            ("fy", self.camera.focal[1]),
            ("cx", self.camera.center[0]),
            ("cy", self.camera.center[1]),
        ];
        for (name, value) in values {
            write!(f, "{name} {value:9.3} px")?;
            if let Some(sigma) = self.sigma_of(name) {
                write!(f, " +- {sigma:.3}")?;
            }
            writeln!(f)?;
        }
        for (name, value) in ["k1", "k2", "p1", "p2", "k3"]
            .iter()
            .zip(self.camera.distortion)
        {
            write!(f, "{name} {value:9.5}")?;
            match self.sigma_of(name) {
                Some(sigma) => writeln!(f, "    +- {sigma:.5}")?,
                None => writeln!(f, "    fixed")?,
            }
        }
        let [kept, dropped] = self.points;
        writeln!(
            f,
            "{} views, {kept} corners, {dropped} dropped; reprojection error {:.3} px RMS",
            self.views.len(),
            self.rms_px
        )?;
        let mut errors: Vec<f64> = self.views.iter().map(|view| view.rms_px).collect();
        errors.sort_by(f64::total_cmp);
        if let Some(worst) = self.worst() {
            let is_bad = worst.rms_px > WORST * errors[errors.len() / 2];
            let hint = if is_bad {
                ": blurred? leave it out"
            } else {
                ""
            };
            writeln!(
                f,
                "worst view {} with {:.3} px{hint}",
                worst.name, worst.rms_px
            )?;
        }
        Ok(())
    }
}
