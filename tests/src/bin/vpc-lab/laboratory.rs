//! `cargo laboratory`: the paper's robot experiment with rendered images, tags and the errors of a
//! laboratory.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};
use clap::Args;
use hw_sim::motion::{HELP, MotionKeys};
use system_tests::children::Children;
use system_tests::flags::check;
use system_tests::flaw::{self, Flaw};
use system_tests::laboratory::{self, Row, Setup};
use system_tests::source::{Product, Source};
use toml::{Table, Value};

/// Runs `hw-sim` with a Panda and a rendered camera, `vpc-camera` and `vpcd` as processes in
/// lockstep, from many starts, with errors between what is and what the programs are told.
///
/// The first row has no errors, the second one all of them at once.
#[derive(Args)]
pub(crate) struct Cli {
    /// Scene file (TOML) whose markers have a size.
    #[arg(long, default_value = "ipc/scene/scenes/tags-robot.toml")]
    scene: PathBuf,
    /// Start poses: a file, or COUNT@SEED: so many that `vpc-memory starts` draws by this seed.
    #[arg(long, default_value = "100@1501")]
    starts: Source,
    /// Memory of motion: a file, or COUNT@SEED: of so many trajectories, built by this seed.
    #[arg(long, default_value = "50@1")]
    memory: Source,
    /// The errors at level 1.
    #[arg(long, default_value = "tests/laboratory.toml")]
    flaws: PathBuf,
    /// Level of the row with all errors.
    #[arg(long, default_value_t = 1.0)]
    level: f64,
    /// Adds rows of each error alone at these levels, such as 1,2,3.
    #[arg(long, value_delimiter = ',')]
    each: Vec<f64>,
    /// Only the errors of these names.
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// Times the scene's limits of speed.
    #[arg(long, default_value_t = 1.0)]
    speed: f64,
    /// The arm that the law is told of (TOML).
    #[arg(long, default_value = "ipc/scene/scenes/panda.toml")]
    arm: PathBuf,
    /// Tell the law of no arm: it takes the camera for a free one.
    #[arg(long)]
    free: bool,
    /// A key of `[law]` that goes over controller/vpcd-tags.toml, such as margin_px=6; may be given
    /// several times.
    #[arg(long, value_name = "KEY=VALUE")]
    law: Vec<String>,
    /// How the box moves.
    #[arg(long, value_name = "KIND:NUMBERS", help = HELP)]
    motion: Vec<MotionKeys>,
    /// From a second after the arrival, measure for so long how well the camera follows.
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    follow_s: f64,
    /// Seed of the first laboratory.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Laboratories at work at a time, 1 to 4.
    #[arg(long, default_value_t = 2)]
    jobs: usize,
    /// Write a film of the first start with all errors to this file (GIF).
    #[arg(long)]
    film: Option<PathBuf>,
    /// Write the rows to this file (JSON).
    #[arg(long)]
    json: Option<PathBuf>,
}

/// Runs all rows.
pub(crate) fn laboratory(children: &Children, cli: &Cli) -> anyhow::Result<ExitCode> {
    check("--follow-s", cli.follow_s, 0.0, 3600.0)?;
    let flaws = chosen(flaw::read(&cli.flaws)?, &cli.only)?;
    let place = laboratory::place();
    let _place = children.place(place.clone());
    fs::create_dir_all(&place)?;
    let scene = told(cli, &place)?;
    let programs = children.build(&["vpcd", "hw-sim", "vpc-memory", "vpc-camera"])?;
    let starts = cli.starts.file(children, &scene, Product::Starts, &place)?;
    let memory = cli.memory.file(children, &scene, Product::Memory, &place)?;
    let starts = fs::read_to_string(&starts).with_context(|| starts.display().to_string())?;
    let mut lines = starts.lines().filter(|line| !line.trim().is_empty());
    let head = lines.next().context("a file of starts without a line")?;
    let starts: Vec<String> = lines.map(str::to_owned).collect();
    let law = law(&cli.law)?;
    let setup = Setup {
        children,
        programs: &programs,
        place: &place,
        scene: &scene,
        starts: &starts,
        head,
        memory: &memory,
        law: &law,
        motion: &cli.motion,
        follow_s: cli.follow_s,
        seed: cli.seed,
        jobs: cli.jobs,
        film: None,
    };
    let all: Vec<(&Flaw, f64)> = flaws.iter().map(|flaw| (flaw, cli.level)).collect();
    if let Some(film) = &cli.film {
        let filmed = Setup {
            starts: &starts[..starts.len().min(1)],
            film: Some(&film.with_extension("")),
            ..setup
        };
        laboratory::row(&filmed, "film", &all)?;
    }
    let mut rows = Vec::new();
    let mut add = |name: &str, levels: &[(&Flaw, f64)]| -> anyhow::Result<()> {
        let row = laboratory::row(&setup, name, levels)?;
        eprintln!(
            "{name}: {} of {} arrived",
            row.summary.arrived, row.summary.runs
        );
        rows.push(row);
        Ok(())
    };
    add("none", &[])?;
    add(&format!("all, level {}", cli.level), &all)?;
    for flaw in &flaws {
        for &level in &cli.each {
            add(&format!("{}, level {level}", flaw.name), &[(flaw, level)])?;
        }
    }
    tell(&flaws, &rows, cli.json.as_deref())?;
    Ok(ExitCode::SUCCESS)
}

/// The errors of these names, or all.
fn chosen(mut flaws: Vec<Flaw>, only: &[String]) -> anyhow::Result<Vec<Flaw>> {
    for name in only {
        if !flaws.iter().any(|flaw| flaw.name == *name) {
            let names: Vec<&str> = flaws.iter().map(|flaw| flaw.name.as_str()).collect();
            bail!("--only {name}; allowed: {}", names.join(", "));
        }
    }
    flaws.retain(|flaw| only.is_empty() || only.contains(&flaw.name));
    Ok(flaws)
}

/// The scene with other limits of speed and an arm, in a directory; its masks stay where they are.
fn told(cli: &Cli, place: &Path) -> anyhow::Result<PathBuf> {
    let (scene, factor) = (&cli.scene, cli.speed);
    if factor == 1.0 && cli.free {
        return Ok(scene.to_owned());
    }
    let mut keys: Table = toml::from_str(&fs::read_to_string(scene)?)?;
    let limits = keys.get_mut("limits").and_then(Value::as_table_mut);
    let limits = limits.with_context(|| format!("{}: no [limits]", scene.display()))?;
    for key in ["linear", "angular"] {
        let value = limits.get(key).and_then(Value::as_float);
        let value = value.with_context(|| format!("{}: limits.{key}", scene.display()))?;
        limits.insert(key.to_owned(), (value * factor).into());
    }
    if !cli.free {
        keys.insert("arm".to_owned(), carried(&cli.arm, place)?.into());
    }
    let path = place.join("scene.toml");
    fs::write(&path, toml::to_string(&keys)?)?;
    Ok(path)
}

/// Copies the file of an arm and its URDF into a directory; returns the file's name there.
fn carried(arm: &Path, place: &Path) -> anyhow::Result<String> {
    let text = fs::read_to_string(arm).with_context(|| arm.display().to_string())?;
    let mut keys: Table = toml::from_str(&text).with_context(|| arm.display().to_string())?;
    let urdf = keys.get("urdf").and_then(Value::as_str);
    let urdf = urdf.with_context(|| format!("{}: no urdf", arm.display()))?;
    let urdf = arm.parent().unwrap_or(Path::new("")).join(urdf);
    fs::copy(&urdf, place.join("arm.urdf")).with_context(|| urdf.display().to_string())?;
    keys.insert("urdf".to_owned(), "arm.urdf".into());
    fs::write(place.join("arm.toml"), toml::to_string(&keys)?)?;
    Ok("arm.toml".to_owned())
}

/// Keys of the law, from KEY=VALUE.
fn law(words: &[String]) -> anyhow::Result<Table> {
    let text = words.join("\n");
    toml::from_str(&text).with_context(|| format!("--law {}", words.join(" --law ")))
}

fn tell(flaws: &[Flaw], rows: &[Row], json: Option<&Path>) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", laboratory::markdown(rows))?;
    for flaw in flaws {
        writeln!(out, "{} at level 1: {}", flaw.name, flaw.what)?;
    }
    if let Some(path) = json {
        crate::write(path, &serde_json::to_vec_pretty(rows)?)?;
    }
    Ok(())
}
