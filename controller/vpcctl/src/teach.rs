//! `teach`: what the camera sees now is the goal of a new scene.
//!
//! Somebody holds the camera where it shall go, by hand or in the robot's guiding mode. The mean of
//! the features gives the goal by the law's own estimate of a pose; all else is that of the old
//! scene. A running daemon takes it up, if that is asked for.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Args;
use ipc::Subscriber;
use messages::{CycleRecord, Features, MAX_POINTS, TwistState};
use nalgebra::Rotation3;
use program::Exit;
use scene::{Scene, with_value};
use vpc::{Task, camera, pose};

use crate::clock::{Clock, ns};
use crate::failure::Failure;
use crate::presence;
use crate::take_up::{self, Daemon, with_suffix};
use crate::units::seconds;

/// Least images with the whole pattern.
const IMAGES: usize = 10;
/// How much longer a slow camera may take for them.
const LONGER: Duration = Duration::from_secs(10);
/// Greatest deviation of a coordinate, and greatest change of its mean from the first half of the
/// images to the second, px: more is a camera that moves.
const STILL_PX: f64 = 1.0;
/// Greatest distance of a point from where the pattern's pose has it, px: more is another pattern,
/// another order of its points, or a wrong calibration.
const FITS_PX: f64 = 2.0;
/// Between two looks.
const PAUSE: Duration = Duration::from_millis(2);
/// Silence after which no daemon is assumed.
const SILENCE: Duration = Duration::from_millis(300);
/// How long a daemon may brake.
const BRAKING: Duration = Duration::from_secs(5);
/// How long a daemon that has begun again is waited for.
const BEGINS: Duration = Duration::from_secs(3);
/// Images with the whole pattern, exposed since then, after which it can be armed.
const SEEN: usize = 3;

/// The command line of `teach`.
#[derive(Clone, Debug, Args)]
pub struct TeachArguments {
    /// The old scene: its camera, pattern, limits and occlusions stay. [default: the daemon's]
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,

    /// The scene to write; in the folder of the old one, if that names other files.
    #[arg(short, long, value_name = "FILE", required_unless_present = "replace")]
    pub output: Option<PathBuf>,

    /// Also build its memory of motion, NAME.vpcmem in the same folder.
    #[arg(long)]
    pub build: bool,

    /// Put the scene, and if the daemon has a memory a new one, in the places of the daemon's; those
    /// stay as *.before. The daemon begins again with the new ones, disarmed.
    #[arg(long, conflicts_with_all = ["output", "scene", "build", "force"])]
    pub replace: bool,

    /// With --replace: take up what the daemon's scene file says otherwise in this key or table
    /// than when the daemon read it; may be repeated.
    #[arg(long, value_name = "KEY", requires = "replace")]
    pub accept: Vec<String>,

    /// How long to look, 0.05 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = seconds)]
    pub watch: Duration,

    /// Overwrite the file.
    #[arg(long)]
    pub force: bool,
}

/// What was seen of a pattern that stands still.
struct Seen {
    /// Mean of each point, px.
    points: Vec<[f64; 2]>,
    images: usize,
    /// Greatest deviation of a coordinate, px.
    scatter_px: f64,
}

/// Looks, writes the scene, builds its memory and lets the daemon take up both, as far as that is
/// asked for: what was taught.
///
/// # Errors
/// The file exists, no features come, the daemon is armed, the camera moves, the points are not
/// those of the pattern, or the goal is none, because a point would be in an occlusion. Also those
/// of [`Daemon`].
pub fn teach(
    directory: &Path,
    with: &TeachArguments,
    clock: &mut dyn Clock,
) -> Result<String, Failure> {
    let Some(output) = &with.output else {
        let stop = program::stop_on_signals()?;
        return replace(directory, with.watch, &with.accept, &stop, clock);
    };
    let name = output.display();
    if !with.force && output.symlink_metadata().is_ok() {
        let message = format!("{name}: exists; allowed: a new file, or --force");
        return Err(Failure::new(Exit::Refused, message));
    }
    let memory = output.with_extension("vpcmem");
    if with.build && memory == *output {
        let message = format!("{name}: the name of its memory; allowed: another, as NAME.toml");
        return Err(Failure::new(Exit::Refused, message));
    }
    if with.build && !with.force && memory.symlink_metadata().is_ok() {
        let message = format!(
            "{}: exists; allowed: a new file, or --force",
            memory.display()
        );
        return Err(Failure::new(Exit::Refused, message));
    }
    let of_daemon = || directory.join(ipc::SCENE_FILE);
    let old = with.scene.clone().unwrap_or_else(of_daemon);
    let mut text = write(directory, &old, output, with.watch, clock)?;
    let _ = writeln!(text, "wrote {name}");
    let next = format!("vpcd --scene {name} --memory {}", memory.display());
    let _ = match with.build {
        true => {
            take_up::build(output, &memory)?;
            writeln!(text, "next: {next}, which begins disarmed")
        }
        false => writeln!(
            text,
            "next: vpc-memory build {name} -o {}; then {next}, which begins disarmed",
            memory.display()
        ),
    };
    Ok(text)
}

/// Lets the daemon take up what is seen now: what was taught.
///
/// # Errors
/// As [`teach`].
pub fn replace(
    directory: &Path,
    watch: Duration,
    accepted: &[String],
    stop: &AtomicBool,
    clock: &mut dyn Clock,
) -> Result<String, Failure> {
    let _turn = take_up::turn(directory)?;
    let daemon = Daemon::of(directory)?;
    let scene = with_suffix(&daemon.scene, ".taught");
    let memory = daemon.memory.as_deref();
    let memory = memory.map(|memory| with_suffix(memory, ".taught"));
    // An earlier build that was interrupted had another goal.
    for left in memory.iter().map(|memory| with_suffix(memory, ".partial")) {
        if left.exists() {
            fs::remove_file(&left).map_err(Failure::write(&left))?;
        }
    }
    let mut text = write(directory, &daemon.scene, &scene, watch, clock)?;
    if let Some(memory) = &memory {
        take_up::build(&scene, memory)?;
    }
    let points = Scene::read(&scene)?.pattern.len();
    daemon.take_up(&scene, memory.as_deref(), true, accepted, stop)?;
    await_features(directory, points, stop, clock);
    let _ = writeln!(
        text,
        "the daemon has begun again with {}, disarmed\nnext: vpcctl arm",
        daemon.scene.display()
    );
    Ok(text)
}

/// Looks, and writes the scene: what was seen.
fn write(
    directory: &Path,
    path: &Path,
    output: &Path,
    watch: Duration,
    clock: &mut dyn Clock,
) -> Result<String, Failure> {
    let old = Scene::read(path)?;
    let domain = presence::join(directory)?;
    let mut cycles = domain.subscriber(usize::MAX)?;
    await_disarmed(&mut cycles, clock)?;
    let features = domain.subscriber(usize::MAX)?;
    let seen = look(features, old.pattern.len(), watch, clock);
    check_disarmed(cycles)?;
    let seen = seen?;
    let text = fs::read_to_string(path)?;
    let (text, fit_px) = taught(&text, path, &old, &seen)?;
    let new = Scene::parse(&text, &output.display().to_string())?;
    let of_task = |error| Failure::new(Exit::Refused, format!("the goal: {error}"));
    let task = Task::new(&new).map_err(of_task)?;
    let pairs = task.goal.iter().zip(&seen.points);
    let off_px = pairs.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
    // What is written was read again, and is what was seen.
    let off_px = off_px.fold(fit_px, f64::max);
    if off_px > FITS_PX {
        let name = output.display();
        let message = format!("{name}: the goal would be {off_px:.1} px off what was seen");
        return Err(Failure::new(Exit::Software, message));
    }
    fs::write(output, text).map_err(Failure::write(output))?;
    Ok(report(&new, &seen, off_px))
}

fn report(new: &Scene, seen: &Seen, off_px: f64) -> String {
    let [x, y, z] = new.goal.translation;
    let mut text = format!(
        "taught from {} images, which scatter by {:.2} px: the object at ({x:.3}, {y:.3}, {z:.3}) m, {off_px:.2} px off\n",
        seen.images, seen.scatter_px
    );
    if new.arm.as_ref().is_some_and(|arm| !arm.goal.is_empty()) {
        text += "the arm file has the joints of the old goal: change its `goal`, or take it out\n";
    }
    text
}

/// Takes the images with the whole pattern: those of `watch`, and of a slow camera as many as are
/// needed.
fn look(
    mut features: Subscriber<Features>,
    points: usize,
    watch: Duration,
    clock: &mut dyn Clock,
) -> Result<Seen, Failure> {
    let begin_ns = clock.now_ns();
    let end_ns = begin_ns.saturating_add(ns(watch));
    let latest_ns = end_ns.saturating_add(ns(LONGER));
    let (mut images, mut others) = (Vec::new(), 0);
    let is_short = |images: &[_]| (1..IMAGES).contains(&images.len());
    while clock.now_ns() < end_ns || (is_short(&images) && clock.now_ns() < latest_ns) {
        while let Some(message) = features.oldest()? {
            let whole = (1_u32 << points.min(MAX_POINTS)) - 1;
            match message.count as usize == points && message.visible & whole == whole {
                true => images.push(message.pairs().collect::<Vec<_>>()),
                false => others += 1,
            }
        }
        clock.pause(PAUSE);
    }
    let seconds = clock.now_ns().saturating_sub(begin_ns) as f64 * 1e-9;
    if images.is_empty() && others == 0 {
        let message =
            format!("nothing on vpc/features within {seconds:.1} s; is a camera at work?");
        return Err(Failure::new(Exit::NoAnswer, message));
    }
    if images.len() < IMAGES {
        let message = format!(
            "{} images in {seconds:.1} s show all {points} points, {others} do not; allowed: {IMAGES} at least",
            images.len()
        );
        return Err(Failure::new(Exit::Refused, message));
    }
    still(&images)
}

/// Waits until a daemon that was just disarmed stands: an armed one would pull against the hand.
fn await_disarmed(
    cycles: &mut Subscriber<CycleRecord>,
    clock: &mut dyn Clock,
) -> Result<(), Failure> {
    let (begin_ns, mut newest) = (clock.now_ns(), None);
    loop {
        while let Some(record) = cycles.oldest()? {
            newest = TwistState::from_code(record.state);
        }
        let waited = Duration::from_nanos(clock.now_ns() - begin_ns);
        match newest {
            Some(TwistState::Disarmed | TwistState::Stopped) => return Ok(()),
            Some(TwistState::Braking) if waited < BRAKING => (),
            None if waited < SILENCE => (),
            None => return Ok(()),
            Some(_) => return Err(is_armed()),
        }
        clock.pause(PAUSE);
    }
}

/// Refuses what was seen if the daemon was armed meanwhile.
fn check_disarmed(mut cycles: Subscriber<CycleRecord>) -> Result<(), Failure> {
    while let Some(record) = cycles.oldest()? {
        let state = TwistState::from_code(record.state);
        if !matches!(state, Some(TwistState::Disarmed | TwistState::Stopped)) {
            return Err(is_armed());
        }
    }
    Ok(())
}

fn is_armed() -> Failure {
    let message = "the daemon is armed; allowed: disarmed, by vpcctl disarm";
    Failure::new(Exit::Refused, message)
}

/// Waits until a daemon that has begun again sees a pattern of so many points, so that it can be
/// armed. Not for long, as the pattern may be hidden by now: the goal is taken up all the same.
fn await_features(directory: &Path, points: usize, stop: &AtomicBool, clock: &mut dyn Clock) {
    let Ok(domain) = presence::join(directory) else {
        return;
    };
    let Ok(mut cycles) = domain.subscriber::<CycleRecord>(usize::MAX) else {
        return;
    };
    let is_whole = |record: &CycleRecord| {
        record.count as usize == points && (0..points).all(|point| record.sees(point))
    };
    let (begin_ns, mut seen) = (clock.now_ns(), 0);
    let end_ns = begin_ns + ns(BEGINS);
    while seen < SEEN && clock.now_ns() < end_ns && !stop.load(Ordering::Relaxed) {
        while let Ok(Some(record)) = cycles.oldest() {
            // It refuses an earlier one: what moved the camera since then is not known.
            let is_new = record.features_seen.data_ns > begin_ns;
            seen += usize::from(is_new && is_whole(&record));
        }
        clock.pause(PAUSE);
    }
}

/// The mean of images; refused where the camera or the pattern moves.
fn still(images: &[Vec<[f64; 2]>]) -> Result<Seen, Failure> {
    let mean = |images: &[Vec<[f64; 2]>], at: (usize, usize)| {
        let sum: f64 = images.iter().map(|points| points[at.0][at.1]).sum();
        sum / images.len() as f64
    };
    let count = images.first().map_or(0, Vec::len);
    let (earlier, later) = images.split_at(images.len() / 2);
    let (mut points, mut scatter_px, mut moved_px) = (vec![[0.0; 2]; count], 0.0_f64, 0.0_f64);
    for at in (0..count).flat_map(|point| [(point, 0), (point, 1)]) {
        let middle = mean(images, at);
        let squares = images
            .iter()
            .map(|points| (points[at.0][at.1] - middle).powi(2));
        scatter_px = scatter_px.max((squares.sum::<f64>() / images.len() as f64).sqrt());
        moved_px = moved_px.max((mean(later, at) - mean(earlier, at)).abs());
        points[at.0][at.1] = middle;
    }
    if scatter_px.max(moved_px) > STILL_PX {
        let message = format!(
            "the points scatter by {scatter_px:.1} px and moved by {moved_px:.1} px; allowed: {STILL_PX} px: hold the camera still"
        );
        return Err(Failure::new(Exit::Refused, message));
    }
    Ok(Seen {
        points,
        images: images.len(),
        scatter_px,
    })
}

/// The text of the scene with this goal, and how far a point is from it at most, px.
fn taught(text: &str, path: &Path, old: &Scene, seen: &Seen) -> Result<(String, f64), Failure> {
    let normalised: Vec<_> = seen
        .points
        .iter()
        .map(|&pixel| camera::normalise(&old.camera, pixel))
        .collect();
    let refused = |message: String| Failure::new(Exit::Refused, message);
    let found = pose::estimate(&old.pattern, &normalised, None);
    let (pose, _) = found.ok_or_else(|| refused("the points fix no pose of the pattern".into()))?;
    let focal = old.camera.fx.max(old.camera.fy);
    let off = old.pattern.iter().zip(&normalised).map(|(point, image)| {
        let x = pose.apply(point);
        (x.x / x.z - image[0]).hypot(x.y / x.z - image[1])
    });
    let off_px = focal * off.fold(0.0, f64::max);
    if off_px > FITS_PX {
        return Err(refused(format!(
            "the points are up to {off_px:.1} px off every view of the scene's pattern; allowed: {FITS_PX} px: \
             compare pattern.points and their order with the tags, and the calibration with the camera"
        )));
    }
    let translation: [f64; 3] = pose.translation.into();
    let rotation = Rotation3::from_matrix_unchecked(pose.rotation).scaled_axis();
    // Starts keep their places beside the goal; depths keep their proportion to its depth.
    let [x, y, z] = old.goal.translation;
    let moved = |[u, v, w]: [f64; 3]| {
        let [to_x, to_y, to_z] = translation;
        [u + to_x - x, v + to_y - y, w * to_z / z]
    };
    let region = &old.starts;
    let mut text = text.to_owned();
    for (table, key, value) in [
        ("goal", "translation", translation),
        ("goal", "rotation", rotation.into()),
        ("starts", "translation_min", moved(region.translation_min)),
        ("starts", "translation_max", moved(region.translation_max)),
    ] {
        let [a, b, c] = value;
        let value = format!("[{a:.6}, {b:.6}, {c:.6}]");
        text = with_value(&text, table, key, &value).ok_or_else(|| {
            let path = path.display();
            let message =
                format!("{path}: {table}.{key} has no line of its own in a table [{table}]");
            Failure::new(Exit::Data, message)
        })?;
    }
    Ok((text, off_px))
}
