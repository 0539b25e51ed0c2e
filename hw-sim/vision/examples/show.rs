//! Draws a frame of the scene `tags-robot` and writes it to a PNG:
//!
//! ```sh
//! cargo run --release -p vision --example show -- /tmp/frame.png 0
//! ```
//! The second argument is the row of `tags-robot-starts.csv`, or six numbers tx ty tz (m) rx ry rz
//! (rad).

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;

use scene::{Pose, Scene};
use vision::{Look, Renderer, truth};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (path, numbers) = arguments
        .split_first()
        .ok_or("usage: show FILE.png [START]")?;
    let scene = Scene::parse(scene::TAGS_ROBOT, "tags-robot.toml")?;
    let pose = pose(numbers, &scene)?;
    let mut renderer = Renderer::new(&scene, &Look::default());
    let image = renderer.render(&pose);
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
        _ => Err("usage: show FILE.png [START | TX TY TZ RX RY RZ]".into()),
    }
}
