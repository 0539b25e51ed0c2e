//! The camera client for OpenCV (`ipc/python/opencv_camera.py`) on a video of rendered frames: its points against the
//! truth. Needs python3 and, the first time, the network: without them the test says NOT RUN, or fails where
//! `VPC_REQUIRE_PYTHON` is set.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;

use scene::{Pose, Scene};
use vision::{Image, Look, Renderer, truth};

/// Frames of the video.
const FRAMES: usize = 40;

/// Runs a command; its last line of complaint where it fails.
fn run(command: &mut Command) -> Result<String, String> {
    let output = command.output().map_err(|error| error.to_string())?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let complaint = String::from_utf8_lossy(&output.stderr);
    let last = complaint.lines().rfind(|line| !line.trim().is_empty());
    Err(last.unwrap_or("no reason given").to_owned())
}

/// An interpreter with OpenCV: the machine's, or one of an environment that is made the first time.
fn python() -> Result<PathBuf, String> {
    let has_opencv = |python: &Path| {
        run(Command::new(python).args(["-c", "import cv2, numpy, tomllib"])).is_ok()
    };
    let system = PathBuf::from("python3");
    if has_opencv(&system) {
        return Ok(system);
    }
    let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python-opencv");
    let python = place.join("bin/python");
    if has_opencv(&python) {
        return Ok(python);
    }
    run(Command::new("python3")
        .args(["-m", "venv", "--clear"])
        .arg(&place))
    .map_err(|reason| format!("no virtual environment: {reason}"))?;
    let mut pip = Command::new(&python);
    pip.args([
        "-m",
        "pip",
        "install",
        "--disable-pip-version-check",
        "--quiet",
    ]);
    pip.args([
        "--only-binary",
        ":all:",
        "--timeout",
        "10",
        "--retries",
        "1",
    ]);
    run(pip.args(["numpy", "opencv-python-headless>=4.10,<6"]))
        .map_err(|reason| format!("pip cannot install OpenCV: {reason}"))?;
    Ok(python)
}

fn write(path: &Path, image: &Image) {
    let size = [image.width(), image.height()].map(|side| side as u32);
    let mut encoder = png::Encoder::new(File::create(path).unwrap(), size[0], size[1]);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(image.pixels()).unwrap();
}

/// The object beside the goal, down behind the grasped object until its lower markers are hidden, and back.
fn pose(scene: &Scene, frame: usize) -> Pose {
    let share = (std::f64::consts::PI * frame as f64 / (FRAMES - 1) as f64).sin();
    let mut pose = scene.goal;
    pose.translation[0] += 0.004 * share;
    pose.translation[1] += 0.07 * share;
    pose.rotation = [0.05 * share, -0.04 * share, 0.06 * share];
    pose
}

/// A line of `--print`: frame, stamp, then "(u, v)" with a question mark where a marker is not seen.
fn points(line: &str) -> Vec<([f64; 2], bool)> {
    let (_, rest) = line.split_once('(').unwrap();
    let each = rest.split('(').map(|text| {
        let (numbers, mark) = text.split_once(')').unwrap();
        let (u, v) = numbers.split_once(", ").unwrap();
        let pixel = [u, v].map(|x| x.parse().unwrap());
        (pixel, !mark.starts_with('?'))
    });
    each.collect()
}

#[test]
fn opencv_sees_rendered_markers_where_they_are_and_not_where_they_are_hidden() {
    let python = match python() {
        Ok(python) => python,
        Err(reason) if std::env::var_os("VPC_REQUIRE_PYTHON").is_some() => panic!("{reason}"),
        Err(reason) => {
            use std::io::Write;
            let said = format!("opencv_camera.py on rendered frames: NOT RUN: {reason}\n");
            let _ = std::io::stderr().write_all(said.as_bytes());
            return;
        }
    };
    let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
    let own = format!("opencv-{}", std::process::id());
    let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join(own);
    std::fs::create_dir_all(&place).unwrap();
    let mut renderer = Renderer::new(&scene, &Look::default()).unwrap();
    for frame in 0..FRAMES {
        let image = renderer.render(&pose(&scene, frame));
        write(&place.join(format!("{frame:03}.png")), image);
    }
    std::fs::write(place.join("scene.toml"), scene::PAPER_ROBOT).unwrap();

    let client = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../ipc/python/opencv_camera.py");
    let mut camera = Command::new(python);
    camera
        .arg(client)
        .arg("--scene")
        .arg(place.join("scene.toml"));
    camera.arg("--video").arg(place.join("%03d.png"));
    let printed = run(camera.args(["--dry", "--print"])).unwrap();
    std::fs::remove_dir_all(&place).unwrap();

    let lines: Vec<&str> = printed.lines().filter(|line| line.contains('(')).collect();
    assert_eq!(lines.len(), FRAMES, "{printed}");
    let (mut squares, mut seen, mut hidden, mut worst) = (0.0, 0, 0, 0.0f64);
    for (frame, line) in lines.into_iter().enumerate() {
        let truths = truth(&scene, &pose(&scene, frame), 0.006, |_| true);
        for (truth, (pixel, visible)) in truths.iter().zip(points(line)) {
            assert!(!(truth.occluded && visible), "frame {frame}: {line}");
            hidden += usize::from(truth.occluded);
            if visible {
                let off = (pixel[0] - truth.pixel[0]).hypot(pixel[1] - truth.pixel[1]);
                (squares, seen, worst) = (squares + off * off, seen + 1, worst.max(off));
            }
        }
    }
    let rms = (squares / f64::from(seen)).sqrt();
    println!("OpenCV: {rms:.3} px RMS, worst {worst:.2} px, {seen} markers seen, {hidden} hidden");
    assert!(rms < 0.15 && worst < 1.0, "{rms} {worst}");
    assert!(seen > 100 && hidden > 20, "{seen} {hidden}");
}
