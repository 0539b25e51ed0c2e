//! What the camera sends, and what it hears: features and twists, or images and twists.

use std::time::Duration;

use ipc::{CameraPorts, Domain, ImagePorts, OpenError, ReceiveError, Sent};
use messages::{Encoding, Features, ImageHeader, Stamp, TwistCommand};
use scene::Scene;

use crate::eye::{Shot, Sight};

/// The ports of a camera.
#[derive(Debug)]
pub(crate) enum Ports {
    /// Of one that knows its features.
    Features(CameraPorts),
    /// Of one that sends images.
    Images(ImagePorts),
}

impl Ports {
    pub fn open(domain: &Domain, scene: &Scene, sight: Sight) -> Result<Self, OpenError> {
        let most = scene.camera.width as usize * scene.camera.height as usize;
        Ok(match sight {
            Sight::Ideal => Self::Features(CameraPorts::open(domain)?),
            Sight::Rendered => Self::Images(ImagePorts::open(domain, most)?),
        })
    }

    /// What is sent, in a word.
    pub fn what(&self) -> &'static str {
        match self {
            Self::Features(_) => "features",
            Self::Images(_) => "images",
        }
    }

    /// The oldest command that was not taken.
    pub fn command(&mut self) -> Result<Option<TwistCommand>, ReceiveError> {
        let twist = match self {
            Self::Features(ports) => &mut ports.twist,
            Self::Images(ports) => &mut ports.twist,
        };
        Ok(twist.oldest()?.map(|received| received.message))
    }

    /// Sends a frame that was exposed for so long.
    pub fn send(&mut self, shot: &Shot, stamp: Stamp, exposure_ns: u64) -> anyhow::Result<Sent> {
        match (self, &shot.image) {
            (Self::Images(ports), Some(image)) => {
                let (width, height) = (
                    u32::try_from(image.width())?,
                    u32::try_from(image.height())?,
                );
                let header = ImageHeader {
                    stamp,
                    exposure_begin_ns: stamp.data_ns.saturating_sub(exposure_ns / 2),
                    exposure_ns,
                    ..ImageHeader::new(width, height, Encoding::Mono8, stamp.data_ns)
                };
                let mut loan = ports.images.loan(&header)?;
                loan.copy_from_slice(image.pixels());
                Ok(ports.images.publish_verbatim(loan)?)
            }
            (Self::Features(ports), _) => {
                let mut features = Features::new(&shot.points, stamp.data_ns);
                (features.stamp, features.exposure_ns) = (stamp, exposure_ns);
                features.visible = shot.visible;
                Ok(ports.features.publish_verbatim(&features)?)
            }
            (Self::Images(_), None) => anyhow::bail!("frame {} has no image", shot.number),
        }
    }

    /// Lockstep: the command that answers a frame; `None` if none comes in time.
    pub fn answer(
        &mut self,
        sent: &Sent,
        patience: Duration,
    ) -> Result<Option<TwistCommand>, ReceiveError> {
        let answer = match self {
            Self::Features(ports) => ports.wait_for_answer(sent, patience)?,
            Self::Images(ports) => ports.wait_for_answer(sent, patience)?,
        };
        Ok(answer.map(|received| received.message))
    }
}
