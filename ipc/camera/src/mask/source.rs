//! Images to learn from: a folder of PNG files, or `vpc/image`.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use ipc::{Domain, Encoding};

use super::frames::Frames;
use crate::grey::Grey;

/// How long an image is waited for.
const PATIENCE: Duration = Duration::from_secs(10);

/// Reads the PNG images of a folder in the order of their names; coloured ones become grey.
///
/// # Errors
/// Which file cannot be read, and why; a folder without images.
pub fn read_folder(folder: &Path) -> anyhow::Result<Frames> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let paths: Result<Vec<PathBuf>, _> = entries.map(|entry| entry.map(|e| e.path())).collect();
    let mut paths = paths.with_context(|| folder.display().to_string())?;
    paths.retain(|path| {
        path.extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("png"))
    });
    paths.sort();
    let mut frames = None;
    for path in &paths {
        let name = || path.display().to_string();
        let (pixels, width, height) = read_png(path).with_context(name)?;
        add(&mut frames, &pixels, width, height).with_context(name)?;
    }
    frames.with_context(|| format!("{}: no images; allowed: PNG files", folder.display()))
}

fn add(
    frames: &mut Option<Frames>,
    pixels: &[u8],
    width: usize,
    height: usize,
) -> anyhow::Result<()> {
    let frames = match frames {
        Some(frames) => frames,
        None => frames.insert(Frames::new(width, height)?),
    };
    let image = Grey::new(pixels, width, height, width).context("an image without pixels")?;
    Ok(frames.push(image)?)
}

/// The levels of a PNG image, its width and height.
fn read_png(path: &Path) -> anyhow::Result<(Vec<u8>, usize, usize)> {
    let mut decoder = png::Decoder::new(BufReader::new(File::open(path)?));
    // Palettes and 1, 2, 4 and 16 bits become 8 bits a channel.
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info()?;
    let (width, height) = reader.info().size();
    let channels = reader.output_color_type().0.samples();
    let mut bytes = vec![0; channels * width as usize * height as usize];
    reader.next_frame(&mut bytes)?;
    let levels = bytes.chunks_exact(channels).map(|pixel| match *pixel {
        [red, green, blue, ..] => luma(red, green, blue),
        [level, ..] => level,
        [] => 0,
    });
    Ok((levels.collect(), width as usize, height as usize))
}

/// Takes images from `vpc/image`, `every` s apart or more.
///
/// # Errors
/// No domain, or no image for 10 s.
pub fn receive(domain: Option<&Path>, count: usize, every: f64) -> anyhow::Result<Frames> {
    let directory = domain.map_or_else(ipc::default_directory, Path::to_owned);
    let domain = Domain::join(&directory)?;
    let mut images = domain.image_subscriber()?;
    let mut frames = None;
    for taken in 0..count {
        let wanted = Instant::now() + Duration::from_secs_f64(if taken == 0 { 0.0 } else { every });
        let image = loop {
            let image = images.latest()?;
            match image {
                Some(image) if Instant::now() >= wanted => break image,
                _ if Instant::now() > wanted + PATIENCE => bail!(
                    "vpc/image: no image for {} s after {taken} of {count}, in domain {}; allowed: a camera that sends",
                    PATIENCE.as_secs(),
                    directory.display()
                ),
                _ => std::thread::sleep(Duration::from_millis(2)),
            }
        };
        let header = image.header();
        let encoding = header.encoding().context("vpc/image: unknown encoding")?;
        let pixels: Vec<u8> = image.rows().flat_map(|row| levels(row, encoding)).collect();
        add(
            &mut frames,
            &pixels,
            header.width as usize,
            header.height as usize,
        )?;
    }
    frames.context("--count 0; allowed: at least 30")
}

/// The levels of a row.
fn levels(row: &[u8], encoding: Encoding) -> Vec<u8> {
    let pixels = row.chunks_exact(encoding.bytes_per_pixel());
    let level = |pixel: &[u8]| match pixel {
        [red, green, blue] if encoding == Encoding::Rgb8 => luma(*red, *green, *blue),
        [blue, green, red] => luma(*red, *green, *blue),
        // Grey, or luma and then chroma.
        [level, ..] => *level,
        [] => 0,
    };
    pixels.map(level).collect()
}

/// ITU-R BT.601.
fn luma(red: u8, green: u8, blue: u8) -> u8 {
    let [red, green, blue] = [red, green, blue].map(u32::from);
    ((299 * red + 587 * green + 114 * blue + 500) / 1000) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_encoding_gives_its_grey() {
        assert_eq!(levels(&[7, 8], Encoding::Mono8), [7, 8]);
        assert_eq!(levels(&[7, 1, 9, 2], Encoding::Yuyv), [7, 9]);
        assert_eq!(levels(&[255, 0, 0], Encoding::Rgb8), [76]);
        assert_eq!(levels(&[255, 0, 0], Encoding::Bgr8), [29]);
    }
}
