//! `vpc-camera mask`: learns what hides the view from images in which it does not move while the
//! background does, and writes a mask and a scene that has it.

mod activity;
mod error;
mod exposure;
mod frames;
mod learned;
mod plane;
mod region;
mod source;

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use scene::Scene;

use crate::lens::{self, Lens};

pub use error::{LEAST_IMAGES, LearnError};
pub use frames::Frames;
pub use learned::{Learned, Settings, learn};
pub use region::{Region, StillArea};

/// The files that are written.
const MASK: &str = "mask.png";
const SCENE: &str = "scene.toml";

/// What to learn from, and where to.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Folder of .png and .pgm images, a .y4m video, or `shm` for the images on `vpc/image`; while
    /// they are taken, the camera moves and what hides the view does not.
    #[arg(long, value_name = "PATH|shm")]
    frames: String,
    /// The scene that gets the mask instead of its occlusions (TOML).
    #[arg(long)]
    scene: PathBuf,
    /// Calibration of the camera that took the images; without it, they are taken to be those of
    /// the scene's camera, without distortion.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Folder for mask.png and scene.toml.
    #[arg(short, long)]
    output: PathBuf,
    /// How far the mask reaches beyond what was found, px.
    #[arg(long, value_name = "PX", default_value_t = Settings::default().grow_px)]
    grow: f64,
    /// Least area that counts, px.
    #[arg(long, value_name = "PX", default_value_t = Settings::default().least_px)]
    least: usize,
    /// Standard deviation of the camera's noise, levels; estimated where it is not given.
    #[arg(long, value_name = "LEVELS")]
    noise: Option<f64>,
    /// Images to take with `shm`.
    #[arg(long, default_value_t = 60)]
    count: usize,
    /// Least time between two of them, s.
    #[arg(long, value_name = "S", default_value_t = 0.2)]
    every: f64,
    /// Directory of the domain, with `shm`.
    #[arg(long)]
    domain: Option<PathBuf>,
    /// Overwrite what exists.
    #[arg(long)]
    force: bool,
}

/// Learns a mask, writes it and the scene; returns what to say about them.
///
/// # Errors
/// What was refused, with what is allowed.
pub fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let scene = Scene::read(&arguments.scene)?;
    let [mask_file, scene_file] = [MASK, SCENE].map(|name| arguments.output.join(name));
    for (flag, value, allowed, range) in [
        ("grow", arguments.grow, "0 to 200 px", 0.0..=200.0),
        ("every", arguments.every, "0 to 60 s", 0.0..=60.0),
        (
            "noise",
            arguments.noise.unwrap_or(1.0),
            "0.1 to 50 levels",
            0.1..=50.0,
        ),
    ] {
        if !range.contains(&value) {
            bail!("--{flag} {value}; allowed: {allowed}");
        }
    }
    for file in [&mask_file, &scene_file] {
        if file.exists() && !arguments.force {
            bail!(
                "{}: exists; allowed: a new file, or --force to overwrite",
                file.display()
            );
        }
    }
    let frames = match arguments.frames.as_str() {
        "shm" => source::receive(
            arguments.domain.as_deref(),
            arguments.count,
            arguments.every,
        )?,
        path => source::read(Path::new(path))?,
    };
    let (width, height) = (frames.width(), frames.height());
    let camera = &scene.camera;
    let lens = match &arguments.calibration {
        Some(file) => lens::read(file)?,
        None => Lens::pinhole(camera),
    };
    lens.check_size([width, height].map(|side| side as u32))?;
    let settings = Settings {
        grow_px: arguments.grow,
        least_px: arguments.least,
        noise: arguments.noise,
    };
    let learned = learn(&frames, &settings)?;
    fs::create_dir_all(&arguments.output)
        .with_context(|| arguments.output.display().to_string())?;
    // What the real camera does not see is free: the image's border is the law's.
    let is_covered = |column: u32, row: u32| {
        let pixel = lens.distort([f64::from(column), f64::from(row)], camera);
        pixel.is_some_and(|[u, v]| learned.mask.covers([u, v]))
    };
    let size = [camera.width, camera.height].map(|side| side as u32);
    scene::write_mask(&mask_file, size[0], size[1], is_covered)
        .with_context(|| format!("{}: cannot write", mask_file.display()))?;
    let text = toml_schema::read_text(&arguments.scene)?;
    fs::write(&scene_file, scene::with_mask(&text, MASK))
        .with_context(|| format!("{}: cannot write", scene_file.display()))?;
    let areas = Scene::read(&scene_file)?.areas().count();

    let mut words = String::new();
    let (count, noise, sure) = (frames.count(), learned.noise, 100.0 * learned.sure);
    writeln!(
        words,
        "{count} images of {width}x{height} px, noise {noise:.1} levels, sure of {sure:.1} % of the image"
    )?;
    for area in &learned.areas {
        let seen = 100.0 * area.seen;
        writeln!(
            words,
            "still: {area}, {} px; texture moves along {seen:.0} % of its border",
            area.pixels
        )?;
    }
    let share = 100.0 * learned.mask.count() as f64 / (width * height) as f64;
    let grow = arguments.grow;
    writeln!(
        words,
        "wrote {}: grown by {grow} px, {share:.1} % of the image",
        mask_file.display()
    )?;
    writeln!(words, "wrote {}: {areas} areas", scene_file.display())?;
    Ok(words)
}
