//! `vpc-camera pattern`: where printed tags lie on their plane, from what the camera sees and the
//! width of their black squares: the pattern of a scene.

use std::fs;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use anyhow::{Context, bail, ensure};
use clap::CommandFactory;
use ipc::Domain;
use nalgebra::{DMatrix, DVector, Isometry3, Point3, Rotation3, Translation3, Vector3};
use scene::with_value;

use crate::config::{self, Config, PatternArguments, Targets};
use crate::lens::Lens;
use crate::plane::{Homography, Point};
use crate::run::open;
use crate::source::Next;
use crate::tags::{Tag, TagFinder, Templates};
use crate::tracker::Corners;

/// Images with all tags, and how long to wait for them.
const IMAGES: usize = 20;
const WAIT: Duration = Duration::from_secs(10);
/// Greatest distance of a corner from its mean, px: more is a camera that moves.
const STILL_PX: f64 = 1.0;
/// Greatest error of the fit, px RMS: more are tags that are not in one plane or of another size,
/// or a wrong calibration.
const FITS_PX: f64 = 0.5;
/// Greatest turn of a tag from the others' axes, deg.
const UPRIGHT_DEG: f64 = 5.0;
/// Steps of the fit, its first damping, and the change of a parameter for its derivatives.
const STEPS: usize = 60;
const DAMPING: f64 = 1e-3;
const CHANGE: f64 = 1e-7;

/// Where tags lie.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Their centers on the plane, about the middle of all, x along their rows, m.
    pub centers: Vec<Point>,
    /// Their turns from the mean of all, rad.
    pub turns: Vec<f64>,
    /// Error of the fit, px RMS.
    pub rms_px: f64,
}

/// Looks, and writes the scene.
///
/// # Errors
/// What was refused, with what is allowed.
pub fn run(arguments: &PatternArguments) -> anyhow::Result<String> {
    let (file, black) = (arguments.output.display(), arguments.black);
    ensure!(
        (1e-3..=1.0).contains(&black),
        "--black = {black}; allowed: 0.001 to 1 m"
    );
    if arguments.output.exists() && !arguments.force {
        bail!("{file}: exists; allowed: a new file, or --force to overwrite");
    }
    let words = [
        "vpc-camera".as_ref(),
        "--config".as_ref(),
        arguments.config.as_os_str(),
    ];
    let config = Config::load(&config::Arguments::command().try_get_matches_from(words)?)?;
    let Targets::Centres(numbers) = &config.targets else {
        bail!("corners_of: given; allowed: tags, whose centers are the pattern");
    };
    let corners = look(&config, numbers)?;
    let layout = lay_out(&config.lens, &corners, black).context("the tags fix no plane")?;
    let fit = layout.rms_px;
    ensure!(
        fit <= FITS_PX,
        "the tags are {fit:.2} px RMS off a plane of squares {} mm wide; allowed: {FITS_PX} px: are they flat, of one size, \
         and the calibration of this camera?",
        1e3 * black
    );
    for (number, turn) in numbers.iter().zip(&layout.turns) {
        let turn = turn.to_degrees();
        ensure!(
            turn.abs() <= UPRIGHT_DEG,
            "tag {number} is turned by {turn:.1} deg from the others' mean; allowed: {UPRIGHT_DEG} deg"
        );
    }
    let whole = black / config.family.black_share();
    let text = toml_schema::read_text(&config.scene_path)?;
    let points = layout.centers.iter();
    let points = Vec::from_iter(points.map(|[x, y]| format!("[{x:.6}, {y:.6}, 0.0]")));
    let values = [
        ("points", format!("[{}]", points.join(", "))),
        ("marker_size", format!("{whole:.6}")),
    ];
    let text = values.into_iter().try_fold(text, |text, (key, value)| {
        let path = config.scene_path.display();
        let lacks = || format!("{path}: pattern.{key} has no line of its own in a table [pattern]");
        with_value(&text, "pattern", key, &value).with_context(lacks)
    })?;
    fs::write(&arguments.output, text).with_context(|| format!("{file}: cannot write"))?;
    let places = numbers.iter().zip(&layout.centers);
    let places = places.map(|(number, [x, y])| {
        let [x, y] = [x, y].map(|x| 1e3 * x);
        format!("tag {number} at ({x:.1}, {y:.1}) mm\n")
    });
    let places: String = places.collect();
    Ok(format!(
        "{places}{fit:.2} px RMS off a plane\nwrote {file}\nnext: vpc-camera with this scene, the camera to the goal, vpcctl teach\n"
    ))
}

/// The mean corners of each tag, over images that show all of them.
fn look(config: &Config, numbers: &[u32]) -> anyhow::Result<Vec<Corners>> {
    let domain = Domain::join(&config.domain)?;
    let mut source = open(config, &domain)?;
    let camera = &config.scene.camera;
    let (width, height) = (camera.width as usize, camera.height as usize);
    let mut finder = TagFinder::new(&Templates::new(config.family)?, width, height, 1)?;
    let (mut seen, mut images): (Vec<Vec<Corners>>, usize) = (Vec::new(), 0);
    let (end, stop) = (Instant::now() + WAIT, AtomicBool::new(false));
    while seen.len() < IMAGES && Instant::now() < end {
        let frame = match source.next(&stop)? {
            Next::End => break,
            Next::Nothing => continue,
            Next::Frame(frame) => frame,
        };
        images += 1;
        let found = finder.find_those(&frame.image, |number| numbers.contains(&number))?;
        seen.extend(all(&found, numbers));
    }
    ensure!(
        !seen.is_empty(),
        "of {images} images none shows each of the tags {numbers:?} once; allowed: one at least"
    );
    let mut means = vec![[[0.0; 2]; 4]; numbers.len()];
    for at in places(numbers.len()) {
        let [tag, corner, k] = at;
        let values = seen.iter().map(|tags| tags[tag][corner][k]);
        let mean = values.clone().sum::<f64>() / seen.len() as f64;
        let off = values.fold(0.0_f64, |most, value| most.max((value - mean).abs()));
        ensure!(
            off <= STILL_PX,
            "a corner of tag {} moves by {off:.1} px; allowed: {STILL_PX} px: hold the camera still",
            numbers[tag]
        );
        means[tag][corner][k] = mean;
    }
    Ok(means)
}

/// The corners of each tag, if each is there once.
fn all(found: &[Tag], numbers: &[u32]) -> Option<Vec<Corners>> {
    let one = |&number: &u32| {
        let mut those = found.iter().filter(|tag| tag.number == number);
        let first = those.next()?;
        those.next().is_none().then_some(first.corners)
    };
    numbers.iter().map(one).collect()
}

/// Tag, corner and coordinate.
fn places(tags: usize) -> impl Iterator<Item = [usize; 3]> {
    let corners = (0..tags).flat_map(|tag| (0..4).map(move |corner| [tag, corner]));
    corners.flat_map(|[tag, corner]| [[tag, corner, 0], [tag, corner, 1]])
}

/// The corners of a square about the origin, as those of a [`Tag`].
fn square(side: f64) -> Corners {
    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
        .map(|corner| corner.map(|x| x * side / 2.0))
}

/// Where tags with black squares of this width lie that show these corners, px; `None` where they
/// fix no plane. The best of the fits that begin with each tag's own plane.
pub fn lay_out(lens: &Lens, corners: &[Corners], black: f64) -> Option<Layout> {
    let fits = (0..corners.len()).filter_map(|first| fit(lens, corners, black, first));
    fits.min_by(|a, b| a.rms_px.total_cmp(&b.rms_px))
}

/// The plane's pose in the camera, and place and turn of each tag but the first on it, in the
/// first's frame, by Levenberg's and Marquardt's method.
struct Fit<'a> {
    lens: &'a Lens,
    corners: &'a [Corners],
    black: f64,
    first: usize,
}

fn fit(lens: &Lens, corners: &[Corners], black: f64, first: usize) -> Option<Layout> {
    let problem = Fit {
        lens,
        corners,
        black,
        first,
    };
    let mut x = problem.begin()?;
    let mut error = problem.errors(&x)?;
    let mut damping = DAMPING;
    for _ in 0..STEPS {
        let jacobian = problem.jacobian(&x, &error)?;
        let gradient = jacobian.transpose() * &error;
        let mut normal = jacobian.transpose() * &jacobian;
        for k in 0..x.len() {
            normal[(k, k)] *= 1.0 + damping;
        }
        let trial = &x - normal.cholesky()?.solve(&gradient);
        match problem
            .errors(&trial)
            .filter(|new| new.norm() < error.norm())
        {
            Some(new) => (x, error, damping) = (trial, new, damping / 10.0),
            None => damping *= 10.0,
        }
    }
    let rms_px = (error.norm_squared() / (error.len() / 2) as f64).sqrt();
    let placed: Vec<_> = (0..corners.len())
        .map(|tag| problem.placed(&x, tag))
        .collect();
    let count = placed.len() as f64;
    let mean = |k: usize| placed.iter().map(|place| place[k]).sum::<f64>() / count;
    let [x, y, turn] = [0, 1, 2].map(mean);
    let (sin, cos) = turn.sin_cos();
    let centers = placed.iter().map(|place| {
        let [dx, dy] = [place[0] - x, place[1] - y];
        [cos * dx + sin * dy, cos * dy - sin * dx]
    });
    Some(Layout {
        centers: centers.collect(),
        turns: placed.iter().map(|place| place[2] - turn).collect(),
        rms_px,
    })
}

impl Fit<'_> {
    /// The first tag's plane by its own corners, and the others where that has them.
    fn begin(&self) -> Option<DVector<f64>> {
        let normalized = |corner: Point| self.lens.normalize(corner);
        let own = square(self.black).into_iter().zip(self.corners[self.first]);
        let pairs: Option<Vec<_>> = own
            .map(|(from, to)| Some((from, normalized(to)?)))
            .collect();
        let plane = Homography::fit(&pairs?)?;
        let pose = plane.pose()?;
        let mut x = vec![0.0; 6];
        x[..3].copy_from_slice(pose.rotation.scaled_axis().as_slice());
        x[3..].copy_from_slice(pose.translation.vector.as_slice());
        let back = plane.inverse()?;
        for tag in self.others() {
            let corners = self.corners[tag].map(|corner| back.apply(normalized(corner)?));
            let [a, b, c, d] = corners;
            let (a, b, c, d) = (a?, b?, c?, d?);
            x.extend([0, 1].map(|k| (a[k] + b[k] + c[k] + d[k]) / 4.0));
            x.push((b[1] - a[1]).atan2(b[0] - a[0]));
        }
        Some(DVector::from_vec(x))
    }

    fn others(&self) -> impl Iterator<Item = usize> {
        let first = self.first;
        (0..self.corners.len()).filter(move |&tag| tag != first)
    }

    /// Place, m, and turn, rad, of a tag.
    fn placed(&self, x: &DVector<f64>, tag: usize) -> [f64; 3] {
        let at = match tag {
            tag if tag == self.first => return [0.0; 3],
            tag if tag > self.first => tag - 1,
            tag => tag,
        };
        std::array::from_fn(|k| x[6 + 3 * at + k])
    }

    /// Of each coordinate of each corner, px; `None` where one is behind the camera.
    fn errors(&self, x: &DVector<f64>) -> Option<DVector<f64>> {
        let turn = Rotation3::new(Vector3::new(x[0], x[1], x[2]));
        let pose = Isometry3::from_parts(Translation3::new(x[3], x[4], x[5]), turn.into());
        let mut errors = Vec::with_capacity(8 * self.corners.len());
        for (tag, seen) in self.corners.iter().enumerate() {
            let [u, v, angle] = self.placed(x, tag);
            let (sin, cos) = angle.sin_cos();
            for ([a, b], seen) in square(self.black).into_iter().zip(seen) {
                let on_plane = Point3::new(u + cos * a - sin * b, v + sin * a + cos * b, 0.0);
                let at = pose * on_plane;
                let shown = (at.z > 0.0).then(|| self.lens.project([at.x / at.z, at.y / at.z]));
                let shown = shown.flatten()?;
                errors.extend([shown[0] - seen[0], shown[1] - seen[1]]);
            }
        }
        Some(DVector::from_vec(errors))
    }

    fn jacobian(&self, x: &DVector<f64>, error: &DVector<f64>) -> Option<DMatrix<f64>> {
        let mut jacobian = DMatrix::zeros(error.len(), x.len());
        for k in 0..x.len() {
            let mut near = x.clone();
            near[k] += CHANGE;
            jacobian.set_column(k, &((self.errors(&near)? - error) / CHANGE));
        }
        Some(jacobian)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use scene::Scene;

    use super::*;

    const BLACK: f64 = 0.024;

    /// What a camera sees of tags at these places, with noise of a fifth of a pixel at most.
    fn seen(lens: &Lens, placed: &[[f64; 3]], pose: &Isometry3<f64>, noise: f64) -> Vec<Corners> {
        let mut random = ChaCha8Rng::seed_from_u64(36);
        let mut noisy = |x: f64| x + noise * random.random_range(-1.0..1.0);
        let corners = placed.iter().map(|&[x, y, turn]| {
            let (sin, cos) = turn.sin_cos();
            square(BLACK).map(|[a, b]| {
                let at = pose * Point3::new(x + cos * a - sin * b, y + sin * a + cos * b, 0.0);
                lens.project([at.x / at.z, at.y / at.z])
                    .unwrap()
                    .map(&mut noisy)
            })
        });
        corners.collect()
    }

    #[test]
    fn tags_are_found_where_they_lie() {
        let scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        let lens = Lens::pinhole(&scene.camera);
        let placed = [
            [-0.06, -0.045, 0.01],
            [0.07, -0.04, -0.02],
            [0.06, 0.05, 0.0],
            [-0.05, 0.04, 0.01],
        ];
        for (tilt, noise, most) in [
            (0.0, 0.0, 1e-7),
            (0.4, 0.0, 1e-7),
            (0.4, 0.05, 2e-4),
            (-0.2, 0.05, 2e-4),
        ] {
            let turn = Rotation3::new(Vector3::new(tilt, 0.5 * tilt, 0.3));
            let pose = Isometry3::from_parts(Translation3::new(0.02, 0.0, 0.35), turn.into());
            let layout = lay_out(&lens, &seen(&lens, &placed, &pose, noise), BLACK).unwrap();
            assert!(layout.rms_px <= noise + 1e-6, "{layout:?}");
            // Distances do not depend on the frame.
            for (a, b) in [(0, 1), (0, 2), (1, 3), (2, 3)] {
                let far = |p: Point, q: Point| (p[0] - q[0]).hypot(p[1] - q[1]);
                let at = |n: usize| [placed[n][0], placed[n][1]];
                let off = far(layout.centers[a], layout.centers[b]) - far(at(a), at(b));
                assert!(
                    off.abs() <= most,
                    "{a} to {b} is {off} m off at {tilt} rad: {layout:?}"
                );
            }
        }
    }

    #[test]
    fn a_tag_that_is_off_the_plane_shows() {
        let scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
        let lens = Lens::pinhole(&scene.camera);
        let pose = Isometry3::translation(0.0, 0.0, 0.35);
        let placed = [
            [-0.06, -0.045, 0.0],
            [0.06, -0.045, 0.0],
            [0.06, 0.045, 0.0],
            [-0.06, 0.045, 0.0],
        ];
        let mut corners = seen(&lens, &placed, &pose, 0.0);
        // Twice as large, as printed at another scale.
        let middle = corners[2].map(|corner| corner.map(|x| x / 4.0)).into_iter();
        let middle = middle.fold([0.0; 2], |sum, c| [sum[0] + c[0], sum[1] + c[1]]);
        corners[2] = corners[2].map(|c| [0, 1].map(|k| middle[k] + 2.0 * (c[k] - middle[k])));
        assert!(lay_out(&lens, &corners, BLACK).unwrap().rms_px > 10.0 * FITS_PX);
    }
}
