//! How the picture looks: gray levels, noise.

use markers::Family;

/// How the picture looks. Levels are 0 (black) to 255 (white), before shading and noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Family of the tags.
    pub family: Family,
    /// Level of what is white of a tag.
    pub white_level: f64,
    /// Level of what is black of a tag.
    pub black_level: f64,
    /// Level of the box that carries them.
    pub box_level: f64,
    /// Level of what lies around the box.
    pub table_level: f64,
    /// Level of the grasped object.
    pub object_level: f64,
    /// Size of the textures, levels; 0 to 100.
    pub texture: f64,
    /// Loss of light in the corners of the image, share; 0 to 1.
    pub vignette: f64,
    /// Standard deviation of the noise of each pixel, levels; 0 to 50.
    pub noise: f64,
    /// The spots on the lens.
    pub spot: SpotLook,
    /// Distortion of the lens, as OpenCV has it: k1 k2 p1 p2 k3. Occlusions are distorted, too:
    /// the scene describes the pinhole's image.
    pub distortion: [f64; 5],
    /// Standard deviation of the blur of a picture that is out of focus, px; 0 to 20.
    pub defocus_px: f64,
    /// Share by which the brightness rises and falls, slowly and in steps; 0 to 1. Levels end at
    /// 255.
    pub gain: f64,
    /// Level of a light that tags mirror, in the middle of its highlight; 0 to 255. The highlight
    /// moves with the camera.
    pub gloss: f64,
    /// Whether the sensor sees one colour a pixel; the grey is interpolated (Bayer, bilinear).
    pub demosaic: bool,
    /// Gain of an unsharp mask of 1 px that the camera applies last; 0 to 5.
    pub sharpening: f64,
    /// Other tags that lie about on the table: of other numbers, the last a copy of the first tag.
    pub clutter: usize,
    /// Seed of textures, noise, brightness, clutter and the mirrored light.
    pub seed: u64,
}

/// How a spot on the lens looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpotLook {
    /// Standard deviation of the blur, px; 0 to 100.
    pub blur_px: f64,
    /// Share of the light that passes; 0 to 1.
    pub transmission: f64,
    /// Level of the stray light that is added.
    pub veil: f64,
    /// Width of the transition inside the spot's border, px; 0.1 to 100. Outside nothing changes.
    pub softness_px: f64,
}

impl Default for Look {
    fn default() -> Self {
        Self {
            family: Family::default(),
            white_level: 215.0,
            black_level: 22.0,
            box_level: 98.0,
            table_level: 58.0,
            object_level: 40.0,
            texture: 9.0,
            vignette: 0.3,
            noise: 2.0,
            spot: SpotLook {
                blur_px: 16.0,
                transmission: 0.5,
                veil: 27.0,
                softness_px: 7.0,
            },
            distortion: [0.0; 5],
            defocus_px: 0.0,
            gain: 0.0,
            gloss: 0.0,
            demosaic: false,
            sharpening: 0.0,
            clutter: 0,
            seed: 0,
        }
    }
}
