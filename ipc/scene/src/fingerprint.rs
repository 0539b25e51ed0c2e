//! The fingerprint of a task: whether a memory was built for this scene.

use core::fmt;

use sha2::{Digest, Sha256};

use crate::{Occlusion, Part, Scene};

/// SHA-256 of what makes two tasks the same for a memory: camera, pattern, goal, limits and
/// occlusions. The weights of the cost, the success criteria, the region of starts and the size of
/// the markers shape the trajectories but do not forbid their use, so they are left out, and so are
/// the names of occlusions.
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
        let put = |hash: &mut Sha256, numbers: &[f64]| {
            numbers.iter().for_each(|x| hash.update(x.to_le_bytes()));
        };
        put(&mut hash, &self.camera.numbers());
        put(&mut hash, &[self.pattern.len() as f64]);
        put(&mut hash, self.pattern.as_flattened());
        put(&mut hash, &self.goal.translation);
        put(&mut hash, &self.goal.rotation);
        put(&mut hash, &[self.limits.linear, self.limits.angular]);
        put(&mut hash, &[self.occlusions.len() as f64]);
        for Occlusion { parts, mask, .. } in &self.occlusions {
            let count = parts.len() as f64;
            // A negative count announces a mask, so that no list of numbers reads like one.
            let announced = if mask.is_some() { -1.0 - count } else { count };
            put(&mut hash, &[announced]);
            for Part { center, half, p } in parts {
                put(&mut hash, &[center[0], center[1], half[0], half[1], *p]);
            }
            if let Some(mask) = mask {
                put(&mut hash, &[mask.width() as f64, mask.height() as f64]);
                hash.update(mask.pixels());
            }
        }
        Fingerprint(hash.finalize().into())
    }
}
