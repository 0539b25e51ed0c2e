//! `vpc-memory build`.

use std::fs;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use memory_blob::Report;
use memory_builder::build;
use memory_builder::memory;
use memory_builder::progress::Progress;
use memory_builder::settings::BuildSettings;
use memory_builder::state::BuildIdentity;
use scene::{Scene, SceneFiles};
use vpc::Task;

use crate::{Overrides, open};

#[derive(Args)]
pub struct Build {
    /// Scene file (TOML).
    scene: PathBuf,
    /// The memory to write.
    #[arg(short, long)]
    output: PathBuf,
    /// Write what has been collected at least every so many seconds, so that after a kill the same
    /// command goes on from there.
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    checkpoint_s: u64,
    /// Threads; all cores by default.
    #[arg(long)]
    threads: Option<usize>,
    #[command(flatten)]
    overrides: Overrides,
}

/// Sets how many threads work; `None`: as many as there are processors.
fn set_threads(threads: Option<usize>) -> anyhow::Result<()> {
    if let Some(threads) = threads.filter(|threads| !(1..=1024).contains(threads)) {
        bail!("--threads = {threads}; allowed: 1 to 1024");
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0));
    Ok(pool.build_global()?)
}

impl Build {
    /// Builds, and says what came out.
    ///
    /// # Errors
    /// Names file, flag or key, its value, and what is allowed.
    pub fn run(&self) -> anyhow::Result<String> {
        let settings = self.overrides.settings()?;
        let scene = SceneFiles::read(&self.scene)?;
        let grown = settings.grown(&scene.scene)?;
        let task = Task::new(&grown).with_context(|| self.scene.display().to_string())?;
        set_threads(self.threads)?;
        let path = beside(&self.output);
        let clock = Instant::now();
        let progress = self.collect(&BuildIdentity::new(&scene, &settings), &grown, &settings)?;
        let collected = clock.elapsed();
        let is_empty = progress.trajectories.is_empty();
        if !is_empty {
            memory::contents(&scene.scene, &task, &settings, &progress)?.write(&self.output)?;
        }
        if path.exists() {
            fs::remove_file(&path).with_context(|| path.display().to_string())?;
        }
        if is_empty {
            bail!(
                "--foresight: no memory is written: foresight needs no trajectory from any of {} starts ({} of them it \
                 does not arrive from, whatever it thinks); try more starts, or a lower foresight.pays",
                progress.tried,
                progress.causes.iter().sum::<u64>()
            );
        }
        let file = open(&self.output, Some(&scene.scene))?;
        Ok(format!(
            "{}: {} bytes; {} trajectories of {} starts in {:.1} s, regression in {:.1} s\n{}",
            self.output.display(),
            file.size(),
            progress.trajectories.len(),
            progress.tried,
            collected.as_secs_f64(),
            (clock.elapsed() - collected).as_secs_f64(),
            Report::of(&file),
        ))
    }

    /// Collects all trajectories, from where an earlier build was interrupted; a signal saves those
    /// that there are and ends the program.
    fn collect(
        &self,
        build: &BuildIdentity,
        scene: &Scene,
        settings: &BuildSettings,
    ) -> anyhow::Result<Progress> {
        let path = beside(&self.output);
        let begun = build.resume(&path)?;
        let stop = program::stop_or_end_on_signals()?;
        let bar = progress_bar(settings, &begun);
        let (mut saved, mut failed) = (Instant::now(), None);
        let progress = build::collect(scene, settings, begun, &stop, &mut |progress| {
            say(&bar, settings, progress);
            if saved.elapsed() >= Duration::from_secs(self.checkpoint_s) {
                failed = build.save(&path, progress).err();
                if failed.is_some() {
                    stop.store(true, Ordering::Relaxed);
                }
                saved = Instant::now();
            }
        })?;
        bar.finish_and_clear();
        if let Some(error) = failed {
            return Err(error.into());
        }
        let found = progress.trajectories.len();
        if !build::is_enough(settings, &progress) {
            build.save(&path, &progress)?;
            eprintln!(
                "vpc-memory: stopped at {found} trajectories; the same command goes on from {}",
                path.display()
            );
            std::process::exit(130);
        }
        Ok(progress)
    }
}

/// Where an unfinished build is kept.
fn beside(output: &Path) -> PathBuf {
    let mut path = output.as_os_str().to_owned();
    path.push(".partial");
    path.into()
}

/// Counts trajectories, or starts where foresight may need none.
fn progress_bar(settings: &BuildSettings, begun: &Progress) -> ProgressBar {
    let (total, what) = match &settings.foresight {
        Some(foresight) => (foresight.starts, "starts"),
        None => (settings.trajectories as u64, "trajectories"),
    };
    let bar = if std::io::stderr().is_terminal() {
        ProgressBar::new(total)
    } else {
        ProgressBar::hidden()
    };
    let style =
        format!("{{bar:40.cyan/blue}} {{pos}}/{{len}} {what}, {{per_sec}}, ETA {{eta}}, {{msg}}");
    bar.set_style(
        ProgressStyle::with_template(&style).unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    say(&bar, settings, begun);
    bar
}

/// Shows on the bar how far a build has come.
fn say(bar: &ProgressBar, settings: &BuildSettings, progress: &Progress) {
    let (found, tried) = (progress.trajectories.len(), progress.tried);
    if settings.foresight.is_some() {
        bar.set_position(tried);
        bar.set_message(format!("{found} trajectories"));
    } else {
        bar.set_position(found as u64);
        let share = 100.0 * found as f64 / tried.max(1) as f64;
        bar.set_message(format!("{share:.0} % of {tried} starts"));
    }
}
