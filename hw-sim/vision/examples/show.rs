//! Draws a frame of the scene `tags-robot` and writes it to a PNG:
//!
//! ```sh
//! cargo run --release -p vision --example show -- /tmp/frame.png 0
//! cargo run --release -p vision --example show -- --flaws /tmp/frame.png 0
//! ```
//! The second argument is the row of `tags-robot-starts.csv`, or six numbers tx ty tz (m) rx ry rz
//! (rad). With `--flaws` the lens distorts, the picture is out of focus, blurred by 10 cm/s and half
//! a radian a second in 20 ms and sheared as much, brighter or darker, of a mosaic and sharpened,
//! tags mirror a light, and others lie about.

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;

use scene::{Pose, Scene};
use vision::{Look, Renderer, truth};

const USAGE: &str = "usage: show [--flaws] FILE.png [START | TX TY TZ RX RY RZ]";

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let has_flaws = arguments.first().is_some_and(|word| word == "--flaws");
    if has_flaws {
        arguments.remove(0);
    }
    let (path, numbers) = arguments.split_first().ok_or(USAGE)?;
    let scene = Scene::parse(scene::TAGS_ROBOT, "tags-robot.toml")?;
    let pose = pose(numbers, &scene)?;
    let mut look = Look::default();
    let mut ends = [pose; 2];
    if has_flaws {
        look.distortion = [-0.25, 0.08, 0.001, -0.001, 0.0];
        (look.defocus_px, look.gain, look.clutter) = (0.8, 0.4, 6);
        (look.demosaic, look.sharpening, look.gloss) = (true, 1.0, 60.0);
        // Within 20 ms.
        ends[1].translation[0] += 0.002;
        ends[1].rotation[2] += 0.01;
    }
    let mut renderer = Renderer::new(&scene, &look);
    let image = renderer.render_moving(&ends, &ends);
    for (i, truth) in truth(&scene, &pose, scene.marker_size, |_| true)
        .iter()
        .enumerate()
    {
        let [u, v] = truth.pixel;
        println!(
            "tag {i}: ({u:.3}, {v:.3}) px, {:.0} % covered",
            100.0 * truth.covered
        );
    }
    let file = BufWriter::new(File::create(path)?);
    let mut encoder = png::Encoder::new(file, image.width() as u32, image.height() as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header()?.write_image_data(image.pixels())?;
    Ok(())
}

fn pose(numbers: &[String], scene: &Scene) -> Result<Pose, Box<dyn Error>> {
    let numbers: Vec<f64> = numbers
        .iter()
        .map(|word| word.parse())
        .collect::<Result<_, _>>()?;
    match numbers.as_slice() {
        [] => Ok(scene.goal),
        [row] => {
            let starts = scene::parse_starts(scene::TAGS_ROBOT_STARTS, "starts")?;
            let start = starts.get(*row as usize).ok_or("there is no such start")?;
            Ok(*start)
        }
        [tx, ty, tz, rx, ry, rz] => Ok(Pose {
            translation: [*tx, *ty, *tz],
            rotation: [*rx, *ry, *rz],
        }),
        _ => Err(USAGE.into()),
    }
}
