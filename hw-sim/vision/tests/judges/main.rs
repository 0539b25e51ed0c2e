//! OpenCV judges rendered frames.

mod camera_client;
mod tags;

use std::fs::File;
use std::path::Path;

use vision::Image;

fn write(path: &Path, image: &Image) {
    let size = [image.width(), image.height()].map(|side| side as u32);
    let mut encoder = png::Encoder::new(File::create(path).unwrap(), size[0], size[1]);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(image.pixels()).unwrap();
}
