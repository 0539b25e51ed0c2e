//! Masks: what is read, what is refused and how, what the fingerprint sees.

use std::fs;
use std::path::Path;

use scene::{Fingerprint, Scene, write_mask};
use tempfile::TempDir;

/// The paper's simulated scene in a directory of its own, its occlusions replaced by these lines.
fn scene_with(directory: &TempDir, lines: &str) -> std::path::PathBuf {
    let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
    let path = directory.path().join("scene.toml");
    fs::write(&path, format!("{head}{lines}")).unwrap();
    path
}

const MASKED: &str = "[[occlusion]]\nname = \"painted\"\nmask = \"mask.png\"\n";

fn read(directory: &TempDir) -> Result<Scene, String> {
    Scene::read(&scene_with(directory, MASKED)).map_err(|e| e.to_string())
}

fn painted(is_white: impl Fn(u32, u32) -> bool) -> TempDir {
    let directory = TempDir::new().unwrap();
    write_mask(&directory.path().join("mask.png"), 1024, 1024, is_white).unwrap();
    directory
}

fn in_box(i: u32, j: u32) -> bool {
    (100..200).contains(&i) && (300..420).contains(&j)
}

/// A PNG of 1024 x 1024 px with this colour type and depth; each row is `row`.
fn encoded(path: &Path, color: png::ColorType, depth: png::BitDepth, row: &[u8]) {
    let file = fs::File::create(path).unwrap();
    let mut encoder = png::Encoder::new(file, 1024, 1024);
    encoder.set_color(color);
    encoder.set_depth(depth);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&row.repeat(1024)).unwrap();
}

#[test]
fn white_is_forbidden_and_black_is_free() {
    let scene = read(&painted(in_box)).unwrap();
    let mask = scene.masks().next().unwrap();
    assert_eq!((mask.width(), mask.height()), (1024, 1024));
    for (i, j) in [(100, 300), (199, 419), (99, 300), (200, 419), (150, 420)] {
        assert_eq!(mask.is_forbidden(i, j), in_box(i as u32, j as u32));
    }
    assert!(!mask.is_forbidden(5000, 0));
}

#[test]
fn rectangles_are_the_forbidden_pixels_each_once() {
    // Sums of distances: steps at the edges, a hole, and pieces that begin and end side by side.
    let ring = |i: u32, j: u32| (60..100).contains(&(i.abs_diff(400) + j.abs_diff(500)));
    let is_white = |i, j| ring(i, j) || in_box(i, j) || (i >= 1000 && j >= 900);
    let scene = read(&painted(is_white)).unwrap();
    let mut times = vec![0; 1024 * 1024];
    for [columns, rows] in scene.masks().next().unwrap().rectangles() {
        for (i, j) in rows.flat_map(|j| columns.clone().map(move |i| (i, j))) {
            times[j * 1024 + i] += 1;
        }
    }
    for (n, times) in times.into_iter().enumerate() {
        let (i, j) = ((n % 1024) as u32, (n / 1024) as u32);
        assert_eq!(times, i32::from(is_white(i, j)), "({i}, {j})");
    }
}

#[test]
fn masks_may_come_from_elsewhere_than_files() {
    let directory = painted(in_box);
    let png = fs::read(directory.path().join("mask.png")).unwrap();
    let text = fs::read_to_string(scene_with(&directory, MASKED)).unwrap();
    let given = |name: &str| match name {
        "mask.png" => Ok(png.clone()),
        _ => Err(std::io::Error::other("not given")),
    };
    let scene = Scene::parse_with(&text, "nowhere/scene.toml", &given).unwrap();
    assert_eq!(scene, read(&directory).unwrap());
    let text = text.replace("mask.png", "other.png");
    let refused = Scene::parse_with(&text, "nowhere/scene.toml", &given).unwrap_err();
    let words = "occlusion[0].mask = \"nowhere/other.png\": cannot read it: not given";
    assert!(refused.to_string().contains(words), "{refused}");
}

#[test]
fn every_kind_of_gray_is_read_alike() {
    use png::{BitDepth, ColorType};
    let directory = TempDir::new().unwrap();
    let path = directory.path().join("mask.png");
    let greys: Vec<u8> = (0..1024u32).map(|i| (i / 4) as u8).collect();
    let each = |channels: &dyn Fn(u8) -> Vec<u8>| -> Vec<u8> {
        greys.iter().flat_map(|grey| channels(*grey)).collect()
    };
    for (color, depth, row) in [
        (ColorType::Grayscale, BitDepth::Eight, greys.clone()),
        (
            ColorType::Grayscale,
            BitDepth::Sixteen,
            each(&|g| vec![g, 77]),
        ),
        (
            ColorType::GrayscaleAlpha,
            BitDepth::Eight,
            each(&|g| vec![g, 255]),
        ),
        (ColorType::Rgb, BitDepth::Eight, each(&|g| vec![g, g, g])),
        (
            ColorType::Rgba,
            BitDepth::Eight,
            each(&|g| vec![g, g, g, 255]),
        ),
    ] {
        encoded(&path, color, depth, &row);
        let scene = read(&directory).unwrap();
        let mask = scene.masks().next().unwrap();
        // Grey 128 begins at column 512.
        assert!(
            !mask.is_forbidden(511, 40) && mask.is_forbidden(512, 40),
            "{color:?}"
        );
    }
    let bits: Vec<u8> = (0..128).map(|i| if i < 64 { 0 } else { 0xff }).collect();
    encoded(&path, ColorType::Grayscale, BitDepth::One, &bits);
    let scene = read(&directory).unwrap();
    let mask = scene.masks().next().unwrap();
    assert!(!mask.is_forbidden(511, 40) && mask.is_forbidden(512, 40));
}

#[test]
fn what_is_no_mask_is_refused_with_file_key_and_reason() {
    use png::{BitDepth, ColorType};
    let refused = |directory: &TempDir, words: &[&str]| {
        let message = read(directory).unwrap_err();
        assert!(
            message.contains("scene.toml: occlusion[0].mask = \""),
            "{message}"
        );
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    };
    let none = TempDir::new().unwrap();
    refused(&none, &["mask.png\": cannot read it: No such file"]);
    refused(
        &painted(|_, _| true),
        &["every pixel is white; allowed: white where no feature"],
    );
    refused(
        &painted(|_, _| false),
        &["every pixel is black; allowed: white where no feature"],
    );
    let dots = painted(|i, j| i % 64 == 7 && j % 64 < 2);
    refused(
        &dots,
        &[
            "256 separate white areas, the smallest of 2 px",
            "at most 32 in a scene",
        ],
    );

    let file = none.path().join("mask.png");
    write_mask(&file, 640, 480, in_box).unwrap();
    refused(&none, &["640x480 px; allowed: 1024x1024", "camera"]);
    let mut row = [0, 0, 0].repeat(1024);
    row[3 * 17..3 * 17 + 3].copy_from_slice(&[255, 0, 3]);
    encoded(&file, ColorType::Rgb, BitDepth::Eight, &row);
    refused(
        &none,
        &["pixel (17, 0) is coloured, [255, 0, 3]; allowed: white, black and greys"],
    );
    let mut row = [0, 255].repeat(1024);
    row[2 * 21 + 1] = 254;
    encoded(&file, ColorType::GrayscaleAlpha, BitDepth::Eight, &row);
    refused(
        &none,
        &["pixel (21, 0) is transparent; allowed: opaque pixels"],
    );
    fs::write(&file, "P1 2 2\n").unwrap();
    refused(&none, &["not a PNG image"]);
}

#[test]
fn an_occlusion_without_parts_and_without_a_mask_is_refused() {
    let directory = TempDir::new().unwrap();
    let path = scene_with(&directory, "[[occlusion]]\nname = \"nothing\"\n");
    let message = Scene::read(&path).unwrap_err().to_string();
    assert!(message.contains("occlusion[0].parts"), "{message}");
    assert!(message.contains("1 to 8 parts, or a mask"), "{message}");
}

#[test]
fn the_areas_of_all_masks_count_together() {
    let directory = painted(|i, j| i % 64 == 7 && j % 512 < 4);
    let path = scene_with(&directory, &MASKED.repeat(2));
    let message = Scene::read(&path).unwrap_err().to_string();
    assert!(message.contains("occlusion[1].mask = 64"), "{message}");
    assert!(
        message.contains("at most 32 areas in all masks together"),
        "{message}"
    );
}

fn fingerprint(is_white: impl Fn(u32, u32) -> bool) -> Fingerprint {
    read(&painted(is_white)).unwrap().fingerprint()
}

#[test]
fn one_pixel_is_another_task() {
    let base = fingerprint(in_box);
    assert_eq!(base, fingerprint(in_box));
    assert_ne!(
        base,
        fingerprint(|i, j| in_box(i, j) || (i, j) == (900, 900))
    );
    assert_ne!(
        base,
        fingerprint(|i, j| in_box(i, j) && (i, j) != (150, 350))
    );
    assert_ne!(base, fingerprint(|i, j| in_box(j, i)));
}

#[test]
fn the_default_memory_still_belongs_to_the_papers_scene() {
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let known = "be3ffdbcfd4fc02e09a53a30c779f317a824252f76a7a1495d758143eedc050d";
    assert_eq!(scene.fingerprint().to_string(), known);
}

/// How many areas cover what is painted.
fn areas(is_white: impl Fn(u32, u32) -> bool) -> usize {
    read(&painted(is_white)).unwrap().areas().count()
}

#[test]
fn a_corner_inwards_parts_areas_and_a_round_hollow_does_not() {
    let arms = |i: u32, j: u32| {
        let up = (200..300).contains(&i) && (200..700).contains(&j);
        up || ((200..800).contains(&i) && (600..700).contains(&j))
    };
    assert_eq!(areas(in_box), 1);
    assert_eq!(areas(arms), 2);
    assert_eq!(
        areas(|i, j| arms(i, j) || ((750..900).contains(&i) && j < 300)),
        3
    );
    let round = |i: u32, j: u32| (f64::from(i) - 512.0).hypot(f64::from(j) - 512.0) > 480.0;
    assert_eq!(areas(round), 1);
}

#[test]
fn a_shape_of_very_many_corners_is_one_area_rather_than_refused() {
    let comb = |i: u32, j: u32| (100..924).contains(&i) && (j > 900 || (j > 500 && i % 20 < 10));
    assert!((1..=32).contains(&areas(comb)));
}
