//! Draws a frame, detects the markers and writes both to a PNG:
//!
//! ```sh
//! cargo run --release -p vision --example show -- /tmp/frame.png 0
//! ```
//! The second argument is the row of `paper-robot-starts.csv`, or six numbers tx ty tz (m) rx ry rz
//! (rad). Crosses: green where a marker is visible, red where it is believed to be.

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;

use scene::{Pose, Scene};
use vision::{Detector, DetectorSettings, Look, Renderer, truth};

/// Magnification of the picture.
const ZOOM: usize = 2;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (path, numbers) = arguments
        .split_first()
        .ok_or("usage: show FILE.png [START]")?;
    let scene = Scene::parse(scene::PAPER_ROBOT, "paper-robot.toml")?;
    let pose = pose(numbers, &scene)?;

    let look = Look::default();
    let mut renderer = Renderer::new(&scene, &look);
    let mut detector = Detector::new(&scene, &DetectorSettings::default());
    detector.expect(&pose);
    detector.detect(renderer.render(&pose))?;

    let image = renderer.image();
    let (width, height) = (image.width() * ZOOM, image.height() * ZOOM);
    let mut colours: Vec<[u8; 3]> = (0..width * height)
        .map(|i| [image.at(i % width / ZOOM, i / width / ZOOM); 3])
        .collect();
    let truths = truth(&scene, &pose, look.marker_radius_m, |_| true);
    for (i, (found, truth)) in detector.sightings().iter().zip(&truths).enumerate() {
        let [u, v] = found.pixel;
        let error = (u - truth.pixel[0]).hypot(v - truth.pixel[1]);
        println!(
            "marker {i}: visible {}, ({u:.3}, {v:.3}) px, error {error:.3} px, covered {:.0} %",
            found.visible,
            100.0 * truth.covered
        );
        let colour = if found.visible {
            [0, 230, 0]
        } else {
            [240, 40, 40]
        };
        let centre = found.pixel.map(|x| ((x + 0.5) * ZOOM as f64) as i64);
        for k in -12i64..=12 {
            for (u, v) in [(centre[0] + k, centre[1]), (centre[0], centre[1] + k)] {
                if (0..width as i64).contains(&u) && (0..height as i64).contains(&v) && k.abs() > 2
                {
                    colours[v as usize * width + u as usize] = colour;
                }
            }
        }
    }
    let file = BufWriter::new(File::create(path)?);
    let mut encoder = png::Encoder::new(file, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder
        .write_header()?
        .write_image_data(colours.as_flattened())?;
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
            let starts = scene::parse_starts(scene::PAPER_ROBOT_STARTS, "starts")?;
            let start = starts.get(*row as usize).ok_or("there is no such start")?;
            Ok(*start)
        }
        [tx, ty, tz, rx, ry, rz] => Ok(Pose {
            translation: [*tx, *ty, *tz],
            rotation: [*rx, *ry, *rz],
        }),
        _ => Err("usage: show FILE.png [START | TX TY TZ RX RY RZ]".into()),
    }
}
