//! The fingerprint of a task: whether a memory was built for this scene.

use core::fmt;

use sha2::{Digest, Sha256};

use crate::{Camera, Scene};

/// SHA-256 of what makes two tasks the same for a memory: camera, pattern, goal, limits and
/// occlusions. The weights of the cost, the success criteria and the region of starts shape the
/// trajectories but do not forbid their use, so they are left out, and so are the names of
/// occlusions.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Fingerprint([u8; 32]);

impl Fingerprint {
    /// The 32 bytes of the digest.
    pub const fn bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

impl fmt::Display for Fingerprint {
    /// 64 lower-case hexadecimal digits.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl Scene {
    /// The fingerprint of the task. Numbers enter as the bits of little-endian f64 in the order of
    /// the struct's fields, each list preceded by its length as f64, after the line `vpc-task-1\n`.
    /// A mask enters as its size and one byte a pixel, 1 forbidden and 0 free, and the length n of
    /// its occlusion's list of parts as -1 - n.
    pub fn fingerprint(&self) -> Fingerprint {
        let mut hash = Sha256::new();
        hash.update(b"vpc-task-1\n");
        let mut put = |numbers: &[f64]| numbers.iter().for_each(|x| hash.update(x.to_le_bytes()));
        let Camera {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            rate_hz,
        } = self.camera;
        put(&[
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            rate_hz,
            self.pattern.len() as f64,
        ]);
        self.pattern.iter().for_each(|point| put(point));
        put(&self.goal.translation);
        put(&self.goal.rotation);
        put(&[
            self.limits.linear,
            self.limits.angular,
            self.occlusions.len() as f64,
        ]);
        for occlusion in &self.occlusions {
            let mut put =
                |numbers: &[f64]| numbers.iter().for_each(|x| hash.update(x.to_le_bytes()));
            let count = occlusion.parts.len() as f64;
            // A negative count announces a mask, so that no list of numbers reads like one.
            put(&[if occlusion.mask.is_some() {
                -1.0 - count
            } else {
                count
            }]);
            for part in &occlusion.parts {
                put(&part.center);
                put(&part.half);
                put(&[part.p]);
            }
            if let Some(mask) = &occlusion.mask {
                put(&[mask.width() as f64, mask.height() as f64]);
                hash.update(mask.pixels());
            }
        }
        Fingerprint(hash.finalize().into())
    }
}
