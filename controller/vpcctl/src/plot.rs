//! `plot`: figures and the latency report of a recording.

use std::path::PathBuf;

use clap::Args;
use recorder::{Films, Report};
use recording::Recording;
use scene::Scene;

use crate::failure::Failure;

/// `plot`.
#[derive(Clone, Debug, Args)]
pub struct PlotArguments {
    /// The recording, whole or cut short.
    #[arg(value_name = "FILE.mcap")]
    pub recording: PathBuf,

    /// Directory for figures (SVG and PNG) and report; without it only the report, on standard
    /// output.
    #[arg(long, short, value_name = "DIR")]
    pub output: Option<PathBuf>,

    /// Also draw each run as a film (GIF) of its cycles with features: at most ten frames a second,
    /// and 150 in all, so a run of more than 15 s is shown faster.
    #[arg(long, requires = "output")]
    pub film: bool,

    /// Scene file, instead of the one in the recording.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,

    /// The report as JSON instead of text.
    #[arg(long)]
    pub json: bool,
}

/// Draws, and returns what goes to standard output.
///
/// # Errors
/// [`Failure`].
pub fn run(arguments: &PlotArguments) -> Result<String, Failure> {
    let scene = arguments.scene.as_deref().map(Scene::read).transpose()?;
    let recording = Recording::read(&arguments.recording)?;
    if let Some(cut) = &recording.cut {
        eprintln!(
            "vpcctl: {}: cut short: {cut}",
            arguments.recording.display()
        );
    }
    let report = Report::of(&recording);
    let mut text = match arguments.json {
        true => report.to_json(),
        false => report.to_string(),
    };
    if let Some(directory) = &arguments.output {
        let films = match arguments.film {
            true => Films::Wanted,
            false => Films::Unwanted,
        };
        let files = recorder::plot(&recording, scene.as_ref(), directory, films)?;
        if !arguments.json {
            text.push('\n');
            for file in files {
                text += &format!("wrote {}\n", file.display());
            }
        }
    }
    Ok(text)
}
