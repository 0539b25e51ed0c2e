//! `vpc-memory build`, of a whole memory or of a part of one.

use std::fs;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use memory_blob::Report;
use memory_builder::build;
use memory_builder::memory::{self, Collection};
use memory_builder::state::BuildState;
use scene::{SceneFiles, Share};
use vpc::Task;

use crate::{Overrides, open};

#[derive(Args)]
pub struct Build {
    /// Scene file (TOML).
    scene: PathBuf,
    /// The memory to write; with --part, the part.
    #[arg(short, long)]
    output: PathBuf,
    /// Make part I of N parts, I from 0 to N - 1, each on any machine; `vpc-memory merge` joins
    /// them. --trajectories and the seed are those of all parts.
    #[arg(long, value_name = "I/N")]
    part: Option<Share>,
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
pub fn set_threads(threads: Option<usize>) -> anyhow::Result<()> {
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
        let part = self.part.unwrap_or_default();
        if part.count() as usize > settings.trajectories {
            let (count, most) = (part.count(), settings.trajectories);
            bail!("--part {part}: {count} parts; allowed: at most one a trajectory, {most}");
        }
        let (each, guide) = (
            part.range(settings.trajectories).len(),
            settings.guide_after,
        );
        if self.part.is_some() && each <= guide {
            eprintln!(
                "vpc-memory: warning: {each} trajectories in part {part}: the first {guide} of each part are planned without the guidance of others; fewer parts make better trajectories"
            );
        }
        set_threads(self.threads)?;
        // A part is the state of a build, finished or not.
        let path = match self.part {
            Some(_) => self.output.clone(),
            None => beside(&self.output),
        };
        let mut state = BuildState::resume(&path, scene, &settings, part)?;
        let begun = std::mem::take(&mut state.progress);

        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register_conditional_shutdown(signal, 130, Arc::clone(&stop))?;
            signal_hook::flag::register(signal, Arc::clone(&stop))?;
        }
        let bar = progress_bar(state.header.wanted, begun.trajectories.len());
        let (clock, mut saved, mut failed) = (Instant::now(), Instant::now(), None);
        let progress = build::collect(&grown, &settings, part, begun, &stop, &mut |progress| {
            let found = progress.trajectories.len() as f64;
            bar.set_position(progress.trajectories.len() as u64);
            bar.set_message(format!(
                "{:.0} % of {} starts",
                100.0 * found / progress.tried as f64,
                progress.tried
            ));
            if saved.elapsed() >= Duration::from_secs(self.checkpoint_s) {
                failed = failed.take().or(state.save(&path, progress).err());
                stop.store(
                    failed.is_some() || stop.load(Ordering::Relaxed),
                    Ordering::Relaxed,
                );
                saved = Instant::now();
            }
        })?;
        bar.finish_and_clear();
        if let Some(error) = failed {
            return Err(error.into());
        }
        let is_complete = progress.trajectories.len() >= state.header.wanted;
        if self.part.is_some() || !is_complete {
            state.save(&path, &progress)?;
        }
        if !is_complete {
            let found = progress.trajectories.len();
            eprintln!(
                "vpc-memory: stopped at {found} trajectories; the same command goes on from {}",
                path.display()
            );
            std::process::exit(130);
        }
        let collected = clock.elapsed();
        let said = format!(
            "{} trajectories of {} starts in {:.1} s",
            progress.trajectories.len(),
            progress.tried,
            collected.as_secs_f64()
        );
        if self.part.is_some() {
            return Ok(format!("{}: part {part}, {said}\n", path.display()));
        }
        let mut collection = Collection::new(&task);
        collection.add(&task, &settings, &progress);
        memory::contents(&state.scene.scene, &task, &settings, collection)?.write(&self.output)?;
        if path.exists() {
            fs::remove_file(&path).with_context(|| path.display().to_string())?;
        }
        let file = open(&self.output, Some(&state.scene.scene))?;
        Ok(format!(
            "{}: {} bytes; {said}, regression in {:.1} s\n{}",
            self.output.display(),
            file.size(),
            (clock.elapsed() - collected).as_secs_f64(),
            Report::of(&file),
        ))
    }
}

/// Where an unfinished build of a whole memory is kept.
fn beside(output: &Path) -> PathBuf {
    let mut path = output.as_os_str().to_owned();
    path.push(".partial");
    path.into()
}

fn progress_bar(total: usize, begun: usize) -> ProgressBar {
    let bar = if std::io::stderr().is_terminal() {
        ProgressBar::new(total as u64)
    } else {
        ProgressBar::hidden()
    };
    let style = "{bar:40.cyan/blue} {pos}/{len} trajectories, {per_sec}, ETA {eta}, {msg}";
    bar.set_style(
        ProgressStyle::with_template(style).unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    bar.set_position(begun as u64);
    bar
}
