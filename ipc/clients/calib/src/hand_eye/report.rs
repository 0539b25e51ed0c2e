//! What is said about a result.

use std::fmt;

use super::{ENOUGH, HandEye, Mounting, PairFit, Reason};
use crate::verdict::Verdict;

/// Greatest standard deviations of a good result: half of what it may be off.
const SIGMA_M: f64 = 0.5 * OFF_M;
const SIGMA_DEG: f64 = 0.5 * OFF_DEG;
/// What a good result may be off, and a pose or a board before it is worth a word.
const OFF_M: f64 = 1e-3;
const OFF_DEG: f64 = 0.1;
/// A robot's poses miss by less: a Panda repeats to 0.1 mm, and is accurate to 1 mm or so.
const ROBOT_M: f64 = 3e-3;
const ROBOT_DEG: f64 = 0.3;
/// Greatest reprojection error, RMS, px.
const RMS_PX: f64 = 0.5;
/// The board's size and the focal length may be off by this share.
const SCALE: f64 = 0.005;
/// Farthest that a camera on a wrist is from the flange, m: what vpc-panda takes; and one that
/// stands from the base.
const FARTHEST: [f64; 2] = [1.0, 10.0];
/// Of so many times the poses that were taken, more are advised; beyond, better ones.
const MORE: f64 = 4.0;
/// An axis along which the place is known so much worse than along another is named.
const WEAK: f64 = 1.5;

/// A miss, m and rad.
fn words([moved, turned]: [f64; 2]) -> String {
    format!("{:.1} mm and {:.2} deg", 1e3 * moved, turned.to_degrees())
}

impl HandEye {
    /// The largest standard deviation of its place, m, and of its turn, deg.
    pub fn uncertainty(&self) -> Option<[f64; 2]> {
        let [place, turn] = self.sigma.as_ref().ok()?.as_chunks::<3>().0 else {
            return None;
        };
        let most = |each: &[f64; 3]| each.iter().copied().fold(0.0, f64::max);
        Some([most(place), most(turn).to_degrees()])
    }

    /// Whether it can be used, and what to do if not.
    pub fn verdict(&self) -> Verdict {
        let mut verdict = Verdict::default();
        let count = self.pairs.len();
        verdict.refuse_if(count < ENOUGH, || {
            format!("{count} poses; take {ENOUGH} or more")
        });
        if let Err(what) = &self.sigma {
            verdict.refuse_if(true, || {
                format!("the poses do not determine {what}; take more, turned about other axes")
            });
        }
        let [moved, turned] = [self.robot[0], self.robot[1].to_degrees()];
        let fault = self.fault();
        verdict.refuse_if(moved > ROBOT_M || turned > ROBOT_DEG, || {
            format!(
                "arm and images miss each other by {} along and about each axis, {} mm and {ROBOT_DEG} deg at most{}",
                words(self.robot),
                1e3 * ROBOT_M,
                fault.as_ref().map_or_else(|| self.direction(), |_| String::new())
            )
        });
        if let Some(fault) = fault {
            verdict.refuse_if(true, || fault);
        }
        let [place, turn] = self.uncertainty().unwrap_or_default();
        verdict.refuse_if(place > SIGMA_M || turn > SIGMA_DEG, || {
            format!(
                "the mounting is known to {:.2} mm and {turn:.3} deg (one standard deviation), {} mm and {SIGMA_DEG} deg are asked for; {}",
                1e3 * place,
                1e3 * SIGMA_M,
                self.more_poses(place, turn)
            )
        });
        let rms_px = self.rms_px.unwrap_or(0.0);
        verdict.refuse_if(rms_px > RMS_PX, || {
            format!(
                "reprojection errors of {rms_px:.2} px RMS, {RMS_PX} px at most; is this the calibration of this camera, is the board flat?"
            )
        });
        let far = self.camera.translation.vector.norm();
        let farthest = FARTHEST[usize::from(self.mounting == Mounting::EyeToHand)];
        let [frame, _] = self.mounting.frames();
        verdict.refuse_if(far > farthest, || {
            format!("the camera is {far:.2} m from the {frame}; {farthest} m at most")
        });
        verdict
    }

    /// Whether the images or the arm cause the misses, by their direction in the camera.
    fn direction(&self) -> String {
        let Self { spread, .. } = self;
        if spread.is_tilt() {
            let [across, about] = spread.turn.map(f64::to_degrees);
            return format!(
                "; the images are worse than the arm: the board's tilt is off by {across:.2} deg, its turn about the optical axis by {about:.2}; take a larger or nearer board with more tags, calibrate the lens again"
            );
        }
        if spread.is_depth() {
            let [along, across] = spread.shift.map(|m| 1e3 * m);
            return format!(
                "; the images are worse than the arm: the board is off by {along:.1} mm along the optical axis, by {across:.1} mm across it; take a larger or nearer board with more tags, calibrate the lens again"
            );
        }
        "; they look alike in all directions, so that arm and images cannot be told apart; did the arm stand still in each image, did the board?".to_owned()
    }

    /// The cause that was found, and what to do.
    fn fault(&self) -> Option<String> {
        let cause = self.cause.as_ref()?;
        let is_off = |[moved, turned]: [f64; 2]| moved > OFF_M || turned.to_degrees() > OFF_DEG;
        let share = |size: f64| {
            let more = if size > 1.0 { "larger" } else { "smaller" };
            format!(
                "{:.1} % {more} than its file says",
                100.0 * (size - 1.0).abs()
            )
        };
        let fault = match &cause.reason {
            Reason::Pose { name, off } if is_off(*off) => format!(
                "pose {name} misses the others by {}; take it again, or leave it out",
                words(*off)
            ),
            Reason::Moved { name, off } if is_off(*off) => format!(
                "from pose {name} on, poses miss those before by {}: did the board or the camera move on its mount?",
                words(*off)
            ),
            Reason::Size { board, focal } => {
                let sizes = [board, focal].map(|size| size.filter(|s| (s - 1.0).abs() > SCALE));
                match sizes {
                    [None, None] => return None,
                    [Some(board), None] => format!(
                        "by the arm's motion the board is {}; measure the side of a black square",
                        share(board)
                    ),
                    [None, Some(focal)] => format!(
                        "by the arm's motion the focal length is {}; calibrate it again",
                        share(focal)
                    ),
                    [Some(board), Some(focal)] => format!(
                        "by the arm's motion the board is {}, or the focal length is {}; measure the side of a black square, calibrate the lens again",
                        share(board),
                        share(focal)
                    ),
                }
            }
            _ => return None,
        };
        let [before, with] = cause.sigma.map(words);
        Some(format!("{fault}; misses are {before} now, {with} without"))
    }

    /// How many, and turned about which axes.
    fn more_poses(&self, place: f64, turn: f64) -> String {
        let times = (place / SIGMA_M).max(turn / SIGMA_DEG).powi(2);
        let needed = (self.pairs.len() as f64 * times).ceil();
        if times > MORE {
            return format!("{needed} such poses would do: make the misses smaller first");
        }
        let sigma = self.sigma.as_ref().ok();
        let weak = sigma.and_then(|sigma| {
            let place = [sigma[0], sigma[1], sigma[2]];
            let least = place.iter().copied().fold(f64::INFINITY, f64::min);
            let axis = (0..3).max_by(|a, b| place[*a].total_cmp(&place[*b]))?;
            let name = ["x", "y", "z"][axis];
            (place[axis] > WEAK * least).then_some(name)
        });
        let axes = match weak {
            // A turn about an axis does not show the place along it.
            Some(name) => format!("the camera's axes other than {name}"),
            None => "different axes".to_owned(),
        };
        format!("take more poses, about {needed} in all, turned by more than 20 deg about {axes}")
    }
}

impl fmt::Display for HandEye {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place = self.camera.translation.vector * 1e3;
        let turn = self.camera.rotation.scaled_axis() * 180.0 / std::f64::consts::PI;
        let [camera, board] = self.mounting.frames();
        write!(
            f,
            "camera in the {camera}: {:.2} {:.2} {:.2} mm, ",
            place.x, place.y, place.z
        )?;
        write!(
            f,
            "rotation vector {:.3} {:.3} {:.3} deg",
            turn.x, turn.y, turn.z
        )?;
        if let Ok([x, y, z, a, b, c]) = self.sigma {
            let [x, y, z] = [x, y, z].map(|m| 1e3 * m);
            let [a, b, c] = [a, b, c].map(f64::to_degrees);
            write!(
                f,
                "\n+- {x:.2} {y:.2} {z:.2} mm, {a:.3} {b:.3} {c:.3} deg along and about its axes"
            )?;
        }
        let place = self.target.translation.vector * 1e3;
        writeln!(
            f,
            "\nboard in the {board}: {:.1} {:.1} {:.1} mm; seen there to {:.2} mm RMS",
            place.x,
            place.y,
            place.z,
            1e3 * self.scatter
        )?;
        write!(f, "{} poses; ", self.pairs.len())?;
        match self.rms_px {
            Some(rms) => write!(
                f,
                "reprojection error {rms:.3} px RMS; the arm's poses miss by "
            )?,
            None => write!(f, "arm and images miss each other by ")?,
        }
        writeln!(
            f,
            "{:.2} mm, {:.3} deg along and about each axis",
            1e3 * self.robot[0],
            self.robot[1].to_degrees()
        )?;
        if let Some(scale) = self.scale {
            writeln!(
                f,
                "size of the board by the arm's motion: {:.4} of the file's, +- {:.4}",
                scale.size, scale.sigma
            )?;
        }
        let score = |fit: &PairFit| fit.miss[0] / ROBOT_M + fit.miss[1].to_degrees() / ROBOT_DEG;
        let worst = self
            .pairs
            .iter()
            .max_by(|a, b| score(a).total_cmp(&score(b)));
        if let Some(worst) = worst {
            write!(f, "worst pose {}: {}", worst.name, words(worst.miss))?;
            if let Some(rms) = worst.rms_px {
                write!(f, ", {rms:.3} px")?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}
