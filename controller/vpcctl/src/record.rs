//! `record`: what a domain publishes, as an MCAP file.

use std::path::{Path, PathBuf};
use std::time::Duration;

use arm::{Mount, Pose};
use clap::Args;
use hand_eye::Frame;
use recorder::{Ledger, Options};
use scene::{FileError, SceneFiles};

use crate::failure::Failure;
use crate::units::number;

/// `record`.
#[derive(Clone, Debug, Args)]
pub struct RecordArguments {
    /// File to write. If the recorder is killed, all but the last second can be read.
    #[arg(value_name = "FILE.mcap")]
    pub output: PathBuf,

    /// Scene file to draw and to keep in the recording, instead of the one that vpcd runs on.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,

    /// Hand-eye calibration of the camera on the flange: TOML, or YAML of easy_handeye or OpenCV. With
    /// it, Foxglove shows the arm where it stands.
    #[arg(long, value_name = "FILE")]
    pub hand_eye: Option<PathBuf>,

    /// End after this time, 0.05 to 86400 s, instead of by Ctrl-C (SIGINT) or SIGTERM.
    #[arg(long, value_name = "SECONDS", value_parser = duration)]
    pub duration: Option<Duration>,

    /// Overwrite the file if it exists.
    #[arg(long)]
    pub force: bool,
}

fn duration(text: &str) -> Result<Duration, String> {
    number(text, 0.05..=86_400.0, " seconds").map(Duration::from_secs_f64)
}

/// Records until the time is over or a signal comes, and returns the summary; what happens
/// meanwhile, such as lost messages, goes to standard error at once.
///
/// # Errors
/// [`Failure`].
pub fn run(domain: &Path, arguments: &RecordArguments) -> Result<String, Failure> {
    let scene = arguments
        .scene
        .as_deref()
        .map(SceneFiles::read)
        .transpose()?;
    let mount = arguments.hand_eye.as_deref().map(mount).transpose()?;
    let stop = program::stop_on_signals()?;
    let options = Options {
        domain: domain.to_owned(),
        output: arguments.output.clone(),
        force: arguments.force,
        duration: arguments.duration,
        scene,
        mount,
    };
    let ledger = recorder::record(&options, &stop, |notice| {
        eprintln!("vpcctl: {notice}");
    })?;
    Ok(summary(&arguments.output, &ledger))
}

/// The camera in the flange, by a file.
///
/// # Errors
/// [`FileError`].
pub fn mount(file: &Path) -> Result<Mount, FileError> {
    let hand_eye = hand_eye::read(file, Frame::Flange)?;
    Ok(hand_eye.mount(&Pose::identity()))
}

fn summary(path: &Path, ledger: &Ledger) -> String {
    let mut text = format!("{}:", path.display());
    for (topic, account) in ledger.accounts() {
        text += &format!(" {topic} {}", account.recorded);
        if account.lost > 0 {
            text += &format!(" (lost {})", account.lost);
        }
    }
    if ledger.accounts().all(|(_, account)| account.recorded == 0) {
        text += " no messages";
    }
    text + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_summary_counts_losses() {
        let mut ledger = Ledger::default();
        assert_eq!(
            summary(Path::new("a.mcap"), &ledger),
            "a.mcap: no messages\n"
        );
        ledger.record("/vpc/twist", messages::Order::First);
        ledger.record("/vpc/twist", messages::Order::Gap { missed: 3 });
        assert_eq!(
            summary(Path::new("a.mcap"), &ledger),
            "a.mcap: /vpc/twist 2 (lost 3)\n"
        );
    }

    #[test]
    fn a_duration_is_seconds_in_its_range() {
        assert_eq!(duration("1.5"), Ok(Duration::from_millis(1500)));
        for text in ["0", "-1", "nan", "1e9", "soon"] {
            assert!(duration(text).is_err(), "{text}");
        }
    }
}
