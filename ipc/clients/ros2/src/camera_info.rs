//! Whether the camera is that of the scene.

use scene::Camera;

use crate::message::CameraInfo;

/// How a camera differs from the scene's.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum Misfit {
    #[error("images of {found:?} px; the scene has {scene:?}")]
    Size { found: [u32; 2], scene: [f64; 2] },
    #[error("{name} = {found:.3} px; the scene has {scene:.3}, tolerance_px is {tolerance}")]
    Intrinsic {
        name: &'static str,
        found: f64,
        scene: f64,
        tolerance: f64,
    },
    #[error(
        "distortion {model} {d:?}, while the scene has a pinhole; give points of rectified images (image_rect), and rectified = true"
    )]
    Distorted { model: String, d: Vec<f64> },
    #[error(
        "it is skewed, or the second of a stereo pair: {matrix}[{index}] = {found}; allowed: 0"
    )]
    Skewed {
        matrix: char,
        index: usize,
        found: f64,
    },
    #[error("binning or a region of interest is set; the scene is about whole images")]
    Part,
}

/// Checks a camera against the scene's: P where images are rectified, else K without distortion.
///
/// # Errors
/// [`Misfit`] names what differs, and both values.
pub fn check(
    info: &CameraInfo,
    scene: &Camera,
    is_rectified: bool,
    tolerance: f64,
) -> Result<(), Misfit> {
    let size = [scene.width, scene.height];
    if [f64::from(info.width), f64::from(info.height)] != size {
        return Err(Misfit::Size {
            found: [info.width, info.height],
            scene: size,
        });
    }
    // Zeros mean the whole image.
    let roi = &info.roi;
    let is_whole = |part: u32, whole: u32| part == 0 || part == whole;
    let is_part = roi.x_offset != 0 || roi.y_offset != 0;
    let is_part = is_part || !is_whole(roi.width, info.width) || !is_whole(roi.height, info.height);
    if info.binning_x > 1 || info.binning_y > 1 || is_part {
        return Err(Misfit::Part);
    }
    if !is_rectified && info.d.iter().any(|d| *d != 0.0) {
        return Err(Misfit::Distorted {
            model: info.distortion_model.clone(),
            d: info.d.clone(),
        });
    }
    let (matrix, numbers, zeros, [fx, cx, fy, cy]) = match is_rectified {
        // P is 3 x 4: its last column is the second camera's distance.
        true => ('P', &info.p[..], &[1, 3, 4, 7, 8, 9, 11][..], [0, 2, 5, 6]),
        false => ('K', &info.k[..], &[1, 3, 6, 7][..], [0, 2, 4, 5]),
    };
    // Not a number is no zero, and not within a tolerance.
    if let Some(&index) = zeros.iter().find(|index| numbers[**index] != 0.0) {
        let found = numbers[index];
        return Err(Misfit::Skewed {
            matrix,
            index,
            found,
        });
    }
    for (name, index, expected) in [
        ("fx", fx, scene.fx),
        ("fy", fy, scene.fy),
        ("cx", cx, scene.cx),
        ("cy", cy, scene.cy),
    ] {
        let found = numbers[index];
        let is_near = (found - expected).abs() <= tolerance;
        if !is_near {
            return Err(Misfit::Intrinsic {
                name,
                found,
                scene: expected,
                tolerance,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use scene::Scene;

    use super::*;

    fn camera() -> Camera {
        Scene::parse(scene::PAPER_SIM, "paper-sim.toml")
            .unwrap()
            .camera
    }

    fn info(c: &Camera) -> CameraInfo {
        CameraInfo {
            width: c.width as u32,
            height: c.height as u32,
            distortion_model: "plumb_bob".to_owned(),
            d: vec![0.0; 5],
            k: [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0],
            p: [
                c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0,
            ],
            ..CameraInfo::default()
        }
    }

    #[test]
    fn the_scenes_camera_fits_and_each_difference_is_named() {
        let camera = camera();
        let fits = info(&camera);
        for is_rectified in [false, true] {
            assert_eq!(check(&fits, &camera, is_rectified, 2.0), Ok(()));
        }
        let words = |is_rectified: bool, change: fn(&mut CameraInfo)| {
            let mut info = fits.clone();
            change(&mut info);
            let misfit = check(&info, &camera, is_rectified, 2.0);
            misfit.map_or_else(|misfit| misfit.to_string(), |()| "fits".to_owned())
        };
        assert!(words(true, |i| i.width = 640).starts_with("images of [640, "));
        assert!(words(true, |i| i.p[0] += 2.1).starts_with("fx = "));
        assert!(words(true, |i| i.p[6] = f64::NAN).starts_with("cy = NaN"));
        assert_eq!(words(true, |i| i.p[0] += 1.9), "fits");
        assert!(words(true, |i| i.p[3] = -40.0).contains("P[3] = -40"));
        assert!(words(false, |i| i.k[1] = f64::NAN).contains("K[1] = NaN"));
        assert!(words(false, |i| i.d[0] = -0.1).contains("plumb_bob"));
        assert!(words(true, |i| i.binning_x = 2).contains("binning"));
        assert!(words(true, |i| i.roi.width = 100).contains("region"));
        // Where images are rectified, the lens and its K do not matter.
        let rectified = words(true, |i| {
            i.d[0] = -0.1;
            i.k[0] += 50.0;
        });
        assert_eq!(rectified, "fits");
    }
}
