//! Judges the detector by the pictures of a folder, beside AprilTag 3 and OpenCV:
//! `cargo run --release --example judge -- FOLDER --tags 0,1,2,3`, in `ipc/clients`

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Context, ensure};
use clap::Parser;
use markers::Family;
use scene::Scene;
use serde::{Deserialize, Serialize};
use testkit::python::{Environment, run, script};
use vpc_camera::config::Targets;
use vpc_camera::finder::Finder;
use vpc_camera::lens::Lens;
use vpc_camera::plane::{Homography, Point};
use vpc_camera::source::Replay;

/// Passes over the frames that learn where the tags lie on their plane.
const PASSES: usize = 5;

/// Finds tags of one plane in pictures, and tells how many, how exactly and how fast.
#[derive(Parser)]
struct Arguments {
    /// Consecutive pictures of one size, .png or .pgm, in the order of their names.
    folder: PathBuf,
    /// Family of the tags, by OpenCV's name.
    #[arg(long, default_value_t)]
    family: Family,
    /// Numbers of the tags: 4 to 8, on one plane.
    #[arg(long, value_delimiter = ',', default_value = "0,1,2,3")]
    tags: Vec<u32>,
    /// Run no other detectors.
    #[arg(long)]
    alone: bool,
    /// Print what each detector found, as JSON, a line each.
    #[arg(long)]
    json: bool,
}

/// What a detector finds.
#[derive(Deserialize, Serialize)]
struct Found {
    detector: String,
    frames: Vec<Frame>,
    #[serde(default)]
    summary: Summary,
}

/// All frames of a detector in short.
#[derive(Default, Deserialize, Serialize)]
struct Summary {
    /// Frames with all tags.
    whole: usize,
    /// Frames in which each tag was found.
    each: BTreeMap<u32, usize>,
    /// Distances of the centres from one homography a frame, px, in frames with all tags.
    rms: f64,
    most: f64,
    /// Time a frame: its median and the 99th percentile.
    ms: [f64; 2],
    /// By how much the centres differ from ours on the mean, px.
    beside: Point,
}

#[derive(Deserialize, Serialize)]
struct Frame {
    ms: f64,
    /// Centres by number, px.
    tags: BTreeMap<u32, Point>,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let mut all = vec![ours(&arguments)?];
    if !arguments.alone {
        all.extend(others(&arguments.folder, arguments.family)?);
    }
    for n in 0..all.len() {
        all[n].summary = summary(&all[n], &all[0], &arguments.tags);
    }
    if arguments.json {
        for found in &all {
            println!("{}", serde_json::to_string(found)?);
        }
        return Ok(());
    }
    println!(
        "detector       whole  RMS, max (px)  ms, p99       u, v beside ours (px)  frames by tag"
    );
    for found in &all {
        let Summary {
            whole,
            each,
            rms,
            most,
            ms: [ms, slow],
            beside: [u, v],
        } = &found.summary;
        let (name, each) = (&found.detector, each.values().collect::<Vec<_>>());
        println!(
            "{name:<14} {whole:>5}  {rms:.3}, {most:.3}   {ms:5.1}, {slow:5.1}  {u:+.3}, {v:+.3}         {each:?}"
        );
    }
    Ok(())
}

/// One thread, as in the program.
fn ours(arguments: &Arguments) -> anyhow::Result<Found> {
    let pool = rayon::ThreadPoolBuilder::new();
    let _pool = pool.num_threads(1).use_current_thread().build()?;
    let mut replay = Replay::open(&arguments.folder, None)?;
    let [width, height] = replay.size().map(f64::from);
    let mut scene = Scene::parse(scene::TAGS_ROBOT, "tags")?;
    scene.occlusions.clear();
    (scene.camera.width, scene.camera.height) = (width, height);
    // Of unknown size: the finder learns where they lie.
    scene.marker_size = 0.0;
    scene.pattern.clear();
    for number in &arguments.tags {
        let place = [f64::from(*number), 0.0, 0.0];
        ensure!(
            scene.pattern.push(place).is_ok(),
            "tags: {}; allowed: 4 to 8",
            arguments.tags.len()
        );
    }
    let targets = Targets::Centres(arguments.tags.clone());
    let lens = Lens::pinhole(&scene.camera);
    let mut finder = Finder::new(&scene, &lens, arguments.family, &targets)?;
    let mut frames = Vec::new();
    let stop = AtomicBool::new(false);
    while let Some(frame) = replay.next(&stop)? {
        let begin = Instant::now();
        let found = finder.find(&frame.image, frame.sequence)?;
        let ms = 1e3 * begin.elapsed().as_secs_f64();
        let seen = arguments.tags.iter().zip(found.points).enumerate();
        let seen = seen.filter(|(bit, _)| found.visible >> bit & 1 == 1);
        let tags = seen.map(|(_, (number, point))| (*number, point)).collect();
        frames.push(Frame { ms, tags });
    }
    let detector = "vpc-camera".to_owned();
    let summary = Summary::default();
    Ok(Found {
        detector,
        frames,
        summary,
    })
}

fn others(folder: &Path, family: Family) -> anyhow::Result<Vec<Found>> {
    let Some(python) = Environment::JUDGES.python("other detectors") else {
        return Ok(Vec::new());
    };
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/judge.py");
    let said = run(script(&python, &program).arg(folder).arg(family.name()))
        .map_err(anyhow::Error::msg)?;
    let each = said.lines().map(serde_json::from_str);
    each.collect::<Result<_, _>>().context("judge.py")
}

fn summary(found: &Found, ours: &Found, tags: &[u32]) -> Summary {
    let frames = &found.frames;
    let has = |frame: &Frame| tags.iter().all(|tag| frame.tags.contains_key(tag));
    let whole: Vec<&Frame> = frames.iter().filter(|frame| has(frame)).collect();
    let count = |tag: &u32| {
        frames
            .iter()
            .filter(|frame| frame.tags.contains_key(tag))
            .count()
    };
    let (rms, most) = residuals(&whole, tags).unwrap_or_default();
    let mut ms: Vec<f64> = frames.iter().map(|frame| frame.ms).collect();
    ms.sort_unstable_by(f64::total_cmp);
    Summary {
        whole: whole.len(),
        each: tags.iter().map(|tag| (*tag, count(tag))).collect(),
        rms,
        most,
        ms: [0.5, 0.99].map(|share| ms[((ms.len() - 1) as f64 * share).round() as usize]),
        beside: beside(found, ours, tags),
    }
}

/// By how much centres differ from ours, on the mean.
fn beside(found: &Found, ours: &Found, tags: &[u32]) -> Point {
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for (frame, other) in found.frames.iter().zip(&ours.frames) {
        for tag in tags {
            if let (Some(a), Some(b)) = (frame.tags.get(tag), other.tags.get(tag)) {
                sum = [0, 1].map(|k| sum[k] + a[k] - b[k]);
                count += 1.0;
            }
        }
    }
    sum.map(|sum| sum / f64::max(count, 1.0))
}

/// Distances of the centres from one homography a frame, px: RMS and the largest. The places on the
/// plane are the means of all frames; `None` for too few tags.
fn residuals(frames: &[&Frame], tags: &[u32]) -> Option<(f64, f64)> {
    let seen = |frame: &Frame| tags.iter().map(|tag| frame.tags[tag]).collect::<Vec<_>>();
    let seen: Vec<Vec<Point>> = frames.iter().map(|frame| seen(frame)).collect();
    let mut plane = seen.first()?.clone();
    let fit = |plane: &[Point], seen: &[Point]| {
        let pairs: Vec<_> = plane.iter().copied().zip(seen.iter().copied()).collect();
        Homography::fit(&pairs)
    };
    for _ in 0..PASSES {
        let mut sums = vec![[0.0; 2]; tags.len()];
        for seen in &seen {
            let back = fit(&plane, seen)?.inverse()?;
            for (sum, point) in sums.iter_mut().zip(seen) {
                let at = back.apply(*point)?;
                *sum = [0, 1].map(|k| sum[k] + at[k]);
            }
        }
        plane = sums
            .iter()
            .map(|sum| sum.map(|x| x / seen.len() as f64))
            .collect();
    }
    let (mut squares, mut most) = (0.0, 0.0_f64);
    for seen in &seen {
        let h = fit(&plane, seen)?;
        for (place, point) in plane.iter().zip(seen) {
            let at = h.apply(*place)?;
            let off = (at[0] - point[0]).hypot(at[1] - point[1]);
            (squares, most) = (squares + off * off, most.max(off));
        }
    }
    let count = (seen.len() * tags.len()) as f64;
    Some(((squares / count).sqrt(), most))
}
