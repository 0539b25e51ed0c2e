//! `record`: what the domain says, as an MCAP file.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use clap::Args;
use recording::{Context, Ledger, Options};
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::exit::Failure;
use crate::image_plane::scene_file;

/// `record`.
#[derive(Clone, Debug, Args)]
pub struct RecordArguments {
    /// File to write. It is readable up to the last second whatever happens, and indexed at the end.
    #[arg(value_name = "FILE.mcap")]
    pub output: PathBuf,

    /// Scene file: drawn, and kept in the recording.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,

    /// The daemon's configuration: kept in the recording, and its scene where --scene is not given.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// End after this time, 0.05 to 86400 s; without it by SIGINT (Ctrl-C) or SIGTERM.
    #[arg(long, value_name = "SECONDS", value_parser = duration)]
    pub duration: Option<Duration>,

    /// Overwrite the file.
    #[arg(long)]
    pub force: bool,
}

fn duration(text: &str) -> Result<Duration, String> {
    match text.parse::<f64>() {
        Ok(seconds) if (0.05..=86_400.0).contains(&seconds) => Ok(Duration::from_secs_f64(seconds)),
        _ => Err("allowed: 0.05 to 86400 seconds".to_owned()),
    }
}

/// Records until the time is over or a signal comes; lost messages are told on standard error as they are noticed. The
/// line to be written at the end.
///
/// # Errors
/// [`Failure`].
pub fn run(domain: &Path, arguments: &RecordArguments) -> Result<String, Failure> {
    // A configuration names the scene; else it is the daemon's.
    let scene = match arguments.config {
        Some(_) => arguments.scene.clone(),
        None => scene_file(domain, arguments.scene.as_deref()),
    };
    let context = Context::read(scene.as_deref(), arguments.config.as_deref())?;
    if context.scene.is_none() {
        eprintln!("vpcctl: no scene in this recording: `plot` and `replay` will need --scene");
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    let options = Options {
        domain: domain.to_owned(),
        output: arguments.output.clone(),
        force: arguments.force,
        duration: arguments.duration,
    };
    let ledger = recording::record(&options, &context, &stop, |notice| {
        eprintln!("vpcctl: {notice}");
    })?;
    Ok(summary(&arguments.output, &ledger))
}

fn summary(path: &Path, ledger: &Ledger) -> String {
    let mut text = format!("{}:", path.display());
    for (topic, account) in ledger.accounts() {
        text += &format!(" {topic} {}", account.recorded);
        if account.lost > 0 {
            text += &format!(" (lost {})", account.lost);
        }
    }
    if ledger.total().recorded == 0 {
        text += " nothing was said";
    }
    text + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_stand_in_the_summary() {
        let mut ledger = Ledger::default();
        assert_eq!(
            summary(Path::new("a.mcap"), &ledger),
            "a.mcap: nothing was said\n"
        );
        ledger.record("/vpc/twist", ipc::Order::First);
        ledger.record("/vpc/twist", ipc::Order::Gap { missed: 3 });
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
