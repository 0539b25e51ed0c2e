//! Masks learned from rendered images, against the shapes that were drawn.

use std::fs::{self, File};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Parser;
use ipc::Domain;
use messages::{Encoding, ImageHeader};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Occlusion, Pose, Scene};
use vision::{Image, Look, Renderer, Tag};
use vpc_camera::distance;
use vpc_camera::grey::Grey;
use vpc_camera::mask::{Arguments, Frames, LearnError, Learned, Settings, learn, run};

const IMAGES: usize = 60;

fn scene() -> Scene {
    Scene::parse(scene::TAGS_ROBOT, "tags").unwrap()
}

/// A smooth way of the camera over the table: two waves a component, by a seed; `reach` 1 sweeps
/// 9 cm and 0.4 rad.
fn way(seed: u64, reach: f64) -> impl Fn(usize) -> Pose {
    use std::f64::consts::TAU;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let phases: [f64; 12] = std::array::from_fn(|_| TAU * random.random::<f64>());
    move |image| {
        let turns = image as f64 / IMAGES as f64;
        let wave = |k: usize, most: f64| {
            let slow = (TAU * 1.3 * turns + phases[2 * k]).sin();
            let fast = (TAU * 2.9 * turns + phases[2 * k + 1]).sin();
            reach * most * (slow + 0.5 * fast) / 1.2
        };
        Pose {
            translation: [wave(0, 0.09), wave(1, 0.08), 0.42 + wave(2, 0.06)],
            rotation: [wave(3, 0.12), wave(4, 0.12), wave(5, 0.4)],
        }
    }
}

fn render(scene: &Scene, look: &Look, way: impl Fn(usize) -> Pose, mut each: impl FnMut(&Image)) {
    let tags = Tag::of_pattern(scene, 0.8 * scene.marker_size);
    let mut renderer = Renderer::with_tags(scene, look, &tags);
    (0..IMAGES).for_each(|image| each(renderer.render(&way(image))));
}

fn sequence(look: &Look, way: impl Fn(usize) -> Pose) -> Frames {
    let mut frames = Frames::new(640, 480).unwrap();
    render(&scene(), look, way, |image| {
        let image = Grey::new(image.pixels(), 640, 480, 640).unwrap();
        frames.push(image).unwrap();
    });
    frames
}

fn look(seed: u64) -> Look {
    Look {
        seed,
        ..Look::default()
    }
}

/// The pixels that an occlusion covers, by their centres.
fn truth(occlusion: &Occlusion) -> Vec<bool> {
    let covers = |k: usize| {
        let at = [(k % 640) as f64, (k / 640) as f64];
        occlusion.parts.iter().any(|part| {
            let term = |k: usize| ((at[k] - part.center[k]).abs() / part.half[k]).powf(part.p);
            term(0) + term(1) < 1.0
        })
    };
    (0..640 * 480).map(covers).collect()
}

/// Pixels of a set with a neighbour in the image that is not in it.
fn border(set: &[bool]) -> Vec<bool> {
    let outside: Vec<bool> = set.iter().map(|is| !is).collect();
    let distances = distance::to_set(&outside, 640);
    distances.iter().map(|px| *px > 0.0 && *px < 1.5).collect()
}

/// The share of a set's border that is at most `px` from another one's.
fn border_within(set: &[bool], of: &[bool], px: f32) -> f64 {
    let distances = distance::to_set(&border(of), 640);
    let border = border(set);
    let on: Vec<usize> = (0..set.len()).filter(|k| border[*k]).collect();
    let near = on.iter().filter(|k| distances[**k] <= px).count();
    near as f64 / on.len() as f64
}

/// How well a mask agrees with a shape.
#[derive(Debug)]
struct Score {
    iou: f64,
    within_3: f64,
    within_5: f64,
    covered: f64,
}

impl Score {
    fn of(learned: &Learned, truth: &[bool], is_here: impl Fn(usize) -> bool) -> Self {
        let still: Vec<bool> = (0..truth.len())
            .map(|k| learned.still.holds(k) && is_here(k))
            .collect();
        let count = |holds: &dyn Fn(usize) -> bool| (0..truth.len()).filter(|k| holds(*k)).count();
        let both = count(&|k| still[k] && truth[k]) as f64;
        Self {
            iou: both / count(&|k| still[k] || truth[k]) as f64,
            within_3: border_within(&still, truth, 3.0),
            within_5: border_within(&still, truth, 5.0),
            covered: count(&|k| learned.mask.holds(k) && truth[k]) as f64
                / count(&|k| truth[k]) as f64,
        }
    }
}

fn scores(learned: &Learned) -> [Score; 2] {
    let scene = scene();
    // The spot is above row 320, the object below.
    let [spot, object] = [0, 1].map(|k| truth(&scene.occlusions[k]));
    [
        Score::of(learned, &spot, |k| k / 640 < 320),
        Score::of(learned, &object, |k| k / 640 >= 320),
    ]
}

/// The spot acts over 7 px inwards from its border, where nothing changes yet: its mask is about 4
/// px too small all round before it grows.
#[test]
fn spot_and_object_are_learned_from_images_of_a_moving_camera() {
    for seed in 0..testkit::repeats("masks", 2, 6) as u64 {
        let frames = sequence(&look(seed), way(seed, 1.0));
        let learned = learn(&frames, &Settings::default()).unwrap();
        let [spot, object] = scores(&learned);
        println!(
            "seed {seed}: spot {spot:.3?}, object {object:.3?}, sure {:.4}",
            learned.sure
        );
        for area in &learned.areas {
            println!("  {area}, {} px, seen {:.3}", area.pixels, area.seen);
        }
        assert_eq!(learned.areas.len(), 2, "{:?}", learned.areas);
        assert!(spot.iou >= 0.8 && object.iou >= 0.95);
        assert!(object.within_3 >= 0.9 && spot.within_5 >= 0.9);
        assert!(spot.covered >= 0.99 && object.covered >= 0.99);
        assert!((learned.noise - 2.0).abs() < 0.1);
        assert!(learned.sure > 0.98);
    }
}

/// With a border of 2 px, as of dirt on a window in front of the lens, the spot is as exact as the
/// object.
#[test]
fn a_spot_with_a_sharper_border_is_within_three_pixels() {
    for seed in 0..testkit::repeats("masks of a sharper spot", 1, 3) as u64 {
        let mut look = look(seed);
        look.spot.softness_px = 2.0;
        let learned = learn(&sequence(&look, way(seed, 1.0)), &Settings::default()).unwrap();
        let [spot, _] = scores(&learned);
        println!("seed {seed}: {spot:.3?}");
        assert!(spot.iou >= 0.9 && spot.within_3 >= 0.9);
    }
}

/// A camera whose exposure changes by a fifth.
#[test]
fn slow_changes_of_exposure_do_not_matter() {
    for seed in 0..testkit::repeats("masks under changes of exposure", 1, 3) as u64 {
        let mut frames = Frames::new(640, 480).unwrap();
        let mut index = 0;
        render(&scene(), &look(seed), way(seed, 1.0), |image| {
            let gain = 1.0 + 0.2 * (0.15 * f64::from(index)).sin();
            index += 1;
            let pixels = image.pixels().iter();
            let pixels: Vec<u8> = pixels
                .map(|x| (gain * f64::from(*x)).round() as u8)
                .collect();
            let image = Grey::new(&pixels, 640, 480, 640).unwrap();
            frames.push(image).unwrap();
        });
        let learned = learn(&frames, &Settings::default()).unwrap();
        let scores = scores(&learned);
        println!("seed {seed}: {scores:.3?}");
        assert_eq!(learned.areas.len(), 2, "{:?}", learned.areas);
        assert!(
            scores
                .iter()
                .all(|score| score.iou >= 0.8 && score.covered >= 0.99)
        );
    }
}

#[test]
fn what_cannot_be_learned_is_refused_with_where() {
    let refused = |look: &Look, reach: f64| {
        let frames = sequence(look, way(2, reach));
        let error = learn(&frames, &Settings::default()).unwrap_err();
        println!("{error}");
        error
    };
    // The camera stands still.
    let error = refused(&look(2), 0.0);
    assert!(matches!(error, LearnError::Motionless { .. }), "{error}");
    assert!(
        error.to_string().contains("640x480 px about (320, 240)"),
        "{error}"
    );
    // It moves by two pixels.
    let error = refused(&look(2), 0.01);
    let is_slight = matches!(
        error,
        LearnError::Motionless { .. } | LearnError::Slight { .. }
    );
    assert!(is_slight, "{error}");
    // A table without texture: only the tags move.
    let bare = Look {
        texture: 0.0,
        ..look(2)
    };
    let error = refused(&bare, 1.0);
    let is_named = matches!(
        error,
        LearnError::Doubtful { .. } | LearnError::Motionless { .. }
    );
    assert!(is_named, "{error}");
}

#[derive(Parser)]
struct Program {
    #[command(flatten)]
    arguments: Arguments,
}

fn write_png(path: &Path, image: &Image) {
    let mut encoder = png::Encoder::new(File::create(path).unwrap(), 640, 480);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(image.pixels()).unwrap();
}

/// The same images by a camera with distortion: the mask that was found in `bent` pixels covers what
/// the scene's camera sees there.
fn a_lens_bends_the_mask(
    place: &Path,
    bent: &scene::Mask,
    said: impl Fn(&[&str]) -> Result<String, String>,
) {
    let file = place.join("calibration.toml");
    let numbers = "fx = 600.0\nfy = 610.0\ncx = 310.0\ncy = 250.0\nwidth = 640\nheight = 480\n\
                   distortion = [-0.2, 0.02, 0.001, 0.001, 0.0]\n";
    fs::write(&file, numbers).unwrap();
    said(&["--calibration", file.to_str().unwrap()]).unwrap();
    let written = Scene::read(&place.join("out/scene.toml")).unwrap();
    let straight = written.masks().next().unwrap();
    let lens = vpc_camera::lens::read(&file).unwrap();
    let (mut seen, mut same) = (0, 0);
    for (column, row) in (0..480).flat_map(|row| (0..640).map(move |column| (column, row))) {
        let pixel = [column as f64, row as f64];
        let [u, v] = lens.undistort(pixel, &written.camera).unwrap();
        if (0.0..639.0).contains(&u) && (0.0..479.0).contains(&v) {
            let [u, v] = [u, v].map(|x| x.round() as usize);
            seen += 1;
            same += usize::from(straight.is_forbidden(u, v) == bent.is_forbidden(column, row));
        }
    }
    assert!(
        seen > 200_000 && seen - same < seen / 300,
        "{same} of {seen}"
    );
    assert!(straight != bent);
}

#[test]
fn the_command_writes_a_scene_that_loads_and_overwrites_nothing() {
    let place = tempfile::tempdir().unwrap();
    // Where `VPC_MASK_OUT` says, to be looked at.
    let kept = std::env::var_os("VPC_MASK_OUT").map(Into::into);
    let place = kept.unwrap_or_else(|| place.path().to_owned());
    let [images, output] = ["images", "out"].map(|name| place.join(name));
    fs::create_dir_all(&images).unwrap();
    let mut index = 0;
    render(&scene(), &look(1), way(1, 1.0), |image| {
        write_png(&images.join(format!("{index:03}.png")), image);
        index += 1;
    });
    let given = place.join("given.toml");
    fs::write(&given, scene::TAGS_ROBOT).unwrap();
    let said = |more: &[&str]| {
        let [frames, scene, output] = [&images, &given, &output].map(|path| path.to_str().unwrap());
        let words = ["mask", "--frames", frames, "--scene", scene, "-o", output];
        let program = Program::parse_from(words.iter().chain(more));
        run(&program.arguments).map_err(|error| format!("{error:#}"))
    };
    let words = said(&["--grow", "5"]).unwrap();
    print!("{words}");
    assert!(words.contains("60 images of 640x480 px, noise 2.0 levels, sure of "));
    let written = Scene::read(&output.join("scene.toml")).unwrap();
    assert_eq!(written.areas().count(), 2);
    let [centre, clear] = [[320, 222], [320, 330]];
    let mask = written.masks().next().unwrap();
    assert!(mask.is_forbidden(centre[0], centre[1]) && !mask.is_forbidden(clear[0], clear[1]));
    // Comments and other tables stay.
    let text = fs::read_to_string(output.join("scene.toml")).unwrap();
    assert!(text.contains("# Centres of the tags; side of a tag"));
    assert_eq!(written.marker_size, 0.03);

    let refusal = said(&[]).unwrap_err();
    assert!(
        refusal.contains("mask.png: exists; allowed: a new file, or --force"),
        "{refusal}"
    );
    a_lens_bends_the_mask(&place, mask, |more| said(&[&["--force"], more].concat()));
    assert_eq!(
        said(&["--force", "--grow=-1"]).unwrap_err(),
        "--grow -1; allowed: 0 to 200 px"
    );
    fs::remove_file(images.join("000.png")).unwrap();
    for index in 1..40 {
        fs::remove_file(images.join(format!("{index:03}.png"))).unwrap();
    }
    assert_eq!(
        said(&["--force"]).unwrap_err(),
        "20 images; allowed: at least 30"
    );
    fs::write(images.join("100.png"), "no image").unwrap();
    assert!(said(&["--force"]).unwrap_err().contains("100.png: "));
}

#[test]
fn the_command_takes_images_from_shared_memory() {
    let place = tempfile::tempdir().unwrap();
    let directory = place.path().join("domain");
    let given = place.path().join("given.toml");
    fs::write(&given, scene::TAGS_ROBOT).unwrap();
    let words = {
        let [scene, output] =
            [given.as_path(), place.path()].map(|path| path.to_str().unwrap().to_owned());
        let domain = directory.to_str().unwrap().to_owned();
        let mut words = ["mask", "--frames", "shm", "--count", "40", "--every", "0"]
            .map(str::to_owned)
            .to_vec();
        words.extend(["--scene".to_owned(), scene, "-o".to_owned(), output]);
        words.extend(["--domain".to_owned(), domain]);
        words
    };
    let is_done = Arc::new(AtomicBool::new(false));
    let camera = std::thread::spawn({
        let is_done = Arc::clone(&is_done);
        move || {
            let domain = Domain::join(&directory).unwrap();
            let mut images = domain.image_publisher(640 * 480).unwrap();
            while !is_done.load(Ordering::Relaxed) {
                render(&scene(), &look(4), way(4, 1.0), |image| {
                    let header = ImageHeader::new(640, 480, Encoding::Mono8, ipc::now_ns());
                    let mut loaned = images.loan(&header).unwrap();
                    loaned.copy_from_slice(image.pixels());
                    images.publish(loaned).unwrap();
                    // A frame of 100 Hz, of which most are taken.
                    std::thread::sleep(Duration::from_millis(10));
                });
            }
        }
    });
    let said = run(&Program::parse_from(words).arguments);
    is_done.store(true, Ordering::Relaxed);
    camera.join().unwrap();
    let said = said.unwrap();
    print!("{said}");
    assert!(said.starts_with("40 images of 640x480 px"), "{said}");
    let written = Scene::read(&place.path().join("scene.toml")).unwrap();
    assert!(written.masks().next().unwrap().is_forbidden(320, 222));
}
