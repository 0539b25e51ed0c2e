//! `vpc-memory mask`: the occlusions of a scene as pixels.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use memory_builder::paint;
use scene::Scene;

/// What to paint.
#[derive(Args)]
pub struct Mask {
    /// Scene file (TOML).
    scene: PathBuf,
    /// The image to write (PNG): white is forbidden, black free.
    #[arg(short, long)]
    output: PathBuf,
    /// Also write a scene file that has this mask in place of the scene's occlusions.
    #[arg(long)]
    scene_out: Option<PathBuf>,
    /// Overwrite what exists.
    #[arg(long)]
    force: bool,
}

impl Mask {
    /// Writes the mask, and the scene where one is asked for; says what was written.
    pub fn run(&self) -> anyhow::Result<String> {
        let scene = Scene::read(&self.scene)?;
        for file in [Some(&self.output), self.scene_out.as_ref()]
            .into_iter()
            .flatten()
        {
            refuse_existing(file, self.force)?;
        }
        let (width, height) = (scene.camera.width as u32, scene.camera.height as u32);
        scene::write_mask(&self.output, width, height, |i, j| {
            paint::is_forbidden(&scene, i, j)
        })
        .with_context(|| format!("{}: cannot write", self.output.display()))?;
        let mut said = format!("wrote {}, {width}x{height} px\n", self.output.display());
        if let Some(file) = &self.scene_out {
            let text = toml_schema::read_text(&self.scene)?;
            let text = scene::with_mask(&text, &beside(file, &self.output)?);
            fs::write(file, text).with_context(|| format!("{}: cannot write", file.display()))?;
            said += &if scene.occlusions.is_empty() {
                let image = self.output.display();
                format!(
                    "wrote {}; next: paint white in {image} where no feature may be\n",
                    file.display()
                )
            } else {
                let areas = Scene::read(file)?.areas().count();
                format!("wrote {}, {areas} areas\n", file.display())
            };
        }
        Ok(said)
    }
}

/// Refuses a file that exists, unless `force` is given.
pub fn refuse_existing(file: &Path, force: bool) -> anyhow::Result<()> {
    if file.exists() && !force {
        bail!(
            "{}: exists; allowed: a new file, or --force to overwrite",
            file.display()
        );
    }
    Ok(())
}

/// How a scene file names an image: by its name where it lies beside it, else by its whole path.
pub fn beside(scene: &Path, image: &Path) -> anyhow::Result<String> {
    let whole = |path: &Path| -> anyhow::Result<PathBuf> {
        std::path::absolute(path).with_context(|| path.display().to_string())
    };
    let (scene, image) = (whole(scene)?, whole(image)?);
    let path = match image.file_name() {
        Some(name) if scene.parent() == image.parent() => Path::new(name),
        _ => &image,
    };
    let Some(text) = path.to_str() else {
        bail!("{}: not UTF-8; allowed: a path that is", path.display());
    };
    Ok(text.to_owned())
}
