//! `vpc-memory preview`: a picture of a scene before a memory is built for it.

use std::fmt::Write;
use std::path::PathBuf;

use anyhow::bail;
use clap::Args;
use figures::Preview as Figure;
use memory_builder::reach::Reach;
use memory_builder::start;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scene::{Area, Pose, Scene};
use vpc::{Settings, Task, TaskError, constraint, field};

use super::seen::{offender, seen};
use super::workspace;

/// Side of the squares in which the zone round the occlusions is drawn, share of the image's longer
/// side.
const SQUARE: f64 = 1.0 / 256.0;
/// Places across an area of a mask at which its thickness is looked for.
const PLACES: usize = 64;
/// Draws among which starts are looked for.
const DRAWS: usize = 20_000;

/// What to draw.
#[derive(Args)]
pub struct Preview {
    /// Scene file (TOML).
    scene: PathBuf,
    /// The picture to write: FILE.png and FILE.svg, with or without either ending.
    #[arg(short, long)]
    output: PathBuf,
    /// Starts to draw.
    #[arg(long, default_value_t = 20)]
    starts: usize,
    /// Seed of the starts.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Starts that were looked for.
#[derive(Default)]
struct Drawn {
    /// How many are valid, and within the arm's reach.
    found: usize,
    drawn: usize,
    /// Valid but for the reach.
    beyond: usize,
}

impl Preview {
    /// Writes the picture; says what is in it.
    ///
    /// # Errors
    /// The scene cannot be read, is refused, or has no valid start; in the last two cases the picture
    /// is written all the same.
    pub fn run(&self) -> anyhow::Result<String> {
        let name = self.scene.display().to_string();
        let scene = Scene::read(&self.scene)?;
        let task = match Task::new(&scene) {
            Ok(task) => task,
            Err(error) => {
                let png = self.draw_refused(&scene, &error)?;
                bail!("{name}: {error}; look at {}", png.display());
            }
        };
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let reach = Reach::of(&scene);
        let (mut valid, mut count) = (Vec::<(Pose, bool)>::new(), Drawn::default());
        while count.found < self.starts && count.drawn < DRAWS {
            count.drawn += 1;
            let pose = start::draw(&scene, &mut rng);
            if start::features_if_valid(&scene, &task, &pose).is_none() {
                continue;
            }
            let reached = match &reach {
                Some(reach) => reach.nearest(&pose),
                None => Some(pose),
            };
            match reached {
                Some(_) => count.found += 1,
                None => count.beyond += 1,
            }
            if reached.is_some() || count.beyond <= self.starts {
                valid.push((reached.unwrap_or(pose), reached.is_some()));
            }
        }
        let starts = valid.iter().filter(|(_, is_reached)| *is_reached);
        let starts = starts.map(|(pose, _)| seen(&scene, pose)).collect();

        let trigger = Settings::default().trigger_px;
        let file = self.stem();
        let figure = Figure {
            scene: &scene,
            zone: zone(&task, trigger),
            goal: seen(&scene, &scene.goal),
            offender: None,
            starts,
            title: self.title(),
        };
        let mut said = describe(&task, &scene, trigger, &count);
        if reach.is_none() && scene.arm.is_some() {
            said += "note        the reach is not known: the arm file has no key `goal`\n";
        }
        let views = reach.map(|reach| workspace::views(&scene, &reach, &valid));
        let panels = views.iter().flatten().map(figures::Reach::canvas);
        let [svg, png] =
            figures::side_by_side([figure.canvas()].into_iter().chain(panels)).write(&file)?;
        if figure.starts.is_empty() {
            bail!(
                "{name}: starts: none of {DRAWS} draws is valid; look at {}; allowed: a region, `clearance_px` and \
                 `min_error_px` that leave room",
                png.display()
            );
        }
        Ok(format!(
            "{said}wrote {} and {}\n",
            svg.display(),
            png.display()
        ))
    }

    /// Draws a scene that gives no task: the goal with what it is refused for, without starts.
    fn draw_refused(&self, scene: &Scene, error: &TaskError) -> anyhow::Result<PathBuf> {
        let figure = Figure {
            scene,
            zone: Vec::new(),
            goal: seen(scene, &scene.goal),
            offender: offender(error),
            starts: Vec::new(),
            title: format!("{}, refused", self.title()),
        };
        let [_, png] = figure.canvas().write(&self.stem())?;
        Ok(png)
    }

    /// The scene's file name.
    fn title(&self) -> String {
        let name = self.scene.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    /// The picture's path without its ending.
    fn stem(&self) -> PathBuf {
        match self.output.extension() {
            Some(end) if end == "png" || end == "svg" => self.output.with_extension(""),
            _ => self.output.clone(),
        }
    }
}

/// Where a feature, or the edge of a marker as large as at the goal, is nearer to an occlusion than
/// the trigger distance: rows of squares, joined along each row.
fn zone(task: &Task, trigger: f64) -> Vec<[f64; 4]> {
    let trigger = trigger + goal_radius(task);
    let (width, height) = (task.camera.width, task.camera.height);
    let side = (SQUARE * width.max(height)).max(1.0);
    let mut zone: Vec<[f64; 4]> = Vec::new();
    for j in 0..(height / side).ceil() as usize {
        let (top, bottom) = (j as f64 * side, ((j + 1) as f64 * side).min(height));
        for i in 0..(width / side).ceil() as usize {
            let (left, right) = (i as f64 * side, ((i + 1) as f64 * side).min(width));
            let middle = [0.5 * (left + right), 0.5 * (top + bottom)];
            if !(0.0..trigger).contains(&constraint::least_clearance(task, middle)) {
                continue;
            }
            match zone.last_mut() {
                Some(last) if last[2] == left && last[1] == top => last[2] = right,
                _ => zone.push([left, top, right, bottom]),
            }
        }
    }
    zone
}

/// The radius of the largest marker at the goal, px.
fn goal_radius(task: &Task) -> f64 {
    let radii = task.goal_depth.iter().map(|&depth| task.radius(depth));
    radii.fold(0.0, f64::max)
}

/// The scene in words.
fn describe(task: &Task, scene: &Scene, trigger: f64, starts: &Drawn) -> String {
    let mut said = String::new();
    let places: Vec<String> = task
        .goal
        .iter()
        .map(|[u, v]| format!("({u:.0}, {v:.0})"))
        .collect();
    let least = |clearance: fn(&Task, [f64; 2]) -> f64| {
        let each = task.goal.iter().map(|p| clearance(task, *p));
        each.fold(f64::INFINITY, f64::min)
    };
    let radius = goal_radius(task);
    let border = least(constraint::border_clearance) - radius;
    let occlusion = least(constraint::least_clearance) - radius;
    let _ = writeln!(said, "goal        {} px", places.join(" "));
    if task.has_markers() {
        let size = 1e3 * scene.marker_size;
        let _ = writeln!(
            said,
            "markers     {size:.0} mm: at the goal the law keeps each point {radius:.0} px clear"
        );
    }
    let _ = write!(
        said,
        "clearance   goal {border:.0} px from the image border"
    );
    if occlusion.is_finite() {
        let _ = write!(said, ", {occlusion:.0} px from the occlusions");
    }
    let parts = counted(scene.parts().count(), "part");
    let masks = counted(scene.masks().count(), "mask");
    let areas = counted(scene.areas().count(), "area");
    let _ = writeln!(
        said,
        "\nocclusions  {parts}, {masks} of {areas}; the memory is asked below {trigger:.0} px (orange)"
    );
    let Drawn {
        found,
        drawn,
        beyond,
    } = starts;
    let share = 100.0 * *found as f64 / (*drawn).max(1) as f64;
    let _ = write!(
        said,
        "starts      {found} of {drawn} draws are valid ({share:.0} %)"
    );
    if *beyond > 0 {
        let _ = write!(said, "; {beyond} are beyond the arm's reach");
    }
    said.push('\n');
    if occlusion < trigger {
        let _ = writeln!(
            said,
            "note        the goal lies in the zone round the occlusions: the memory is asked up to the end"
        );
    }
    let stride = stride(task);
    for (name, thickness) in thin(scene, stride) {
        let _ = writeln!(
            said,
            "note        {name} is {thickness:.0} px thick, and at these limits a feature moves up to {stride:.0} px in \
             a period: it can jump over"
        );
    }
    said
}

/// A count with its noun.
fn counted(count: usize, noun: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {noun}{plural}")
}

/// How far the camera's translation across the image can move a feature in one period near the
/// goal, px.
fn stride(task: &Task) -> f64 {
    let nearest = task
        .goal_depth
        .iter()
        .copied()
        .fold(f64::INFINITY, f64::min);
    let [vx, vy, ..] = task.limits;
    (task.camera.fx * vx).hypot(task.camera.fy * vy) / nearest * task.ts
}

/// Occlusions with a part or an area that is thinner than this, px: name and thickness of the
/// thinnest.
fn thin(scene: &Scene, stride: f64) -> Vec<(&str, f64)> {
    let thinnest = scene.occlusions.iter().map(|occlusion| {
        let parts = occlusion.parts.iter();
        let parts = parts.map(|part| {
            let [low, high] = part.bounds();
            (high[0] - low[0]).min(high[1] - low[1])
        });
        let areas = occlusion.mask.iter().flat_map(|mask| mask.areas());
        let thickness = parts
            .chain(areas.map(thickness))
            .fold(f64::INFINITY, f64::min);
        (occlusion.name.as_str(), thickness)
    });
    thinnest
        .filter(|(_, thickness)| *thickness < stride)
        .collect()
}

/// Twice the greatest depth that a point in an area can have, px.
fn thickness(area: &Area) -> f64 {
    let (low, high) = (area.low, area.high);
    let share = |k: usize| (k as f64 + 0.5) / PLACES as f64;
    let depths = (0..PLACES * PLACES).map(|k| {
        let place = [share(k % PLACES), share(k / PLACES)];
        let pixel = std::array::from_fn(|c| low[c] + place[c] * (high[c] - low[c]));
        -field::clearance(area, pixel).distance
    });
    2.0 * depths.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_zone_has_the_area_of_a_band_round_the_occlusions() {
        let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
        let spot = "[[occlusion]]\nname = \"spot\"\nparts = [{ center = [850.0, 560.0], half = [75.0, 75.0], p = 2.0 }]";
        let scene = Scene::parse(&format!("{head}{spot}"), "spot").unwrap();
        let task = Task::new(&scene).unwrap();
        let area: f64 = zone(&task, 20.0)
            .iter()
            .map(|[left, top, right, bottom]| (right - left) * (bottom - top))
            .sum();
        let band = std::f64::consts::PI * (95.0f64.powi(2) - 75.0f64.powi(2));
        assert!((area / band - 1.0).abs() < 0.03, "{area} {band}");
    }

    #[test]
    fn an_occlusion_that_features_can_jump_over_is_named() {
        let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
        let bar = |half: f64| {
            let bar = format!(
                "[[occlusion]]\nname = \"bar\"\nparts = [{{ center = [850.0, 560.0], half = [200.0, {half}], p = 8.0 }}]"
            );
            Scene::parse(&format!("{head}{bar}"), "bar").unwrap()
        };
        let (narrow, broad) = (bar(5.0), bar(60.0));
        let task = Task::new(&narrow).unwrap();
        let stride = stride(&task);
        assert!((10.0..120.0).contains(&stride), "{stride}");
        assert_eq!(thin(&narrow, stride), [("bar", 10.0)]);
        assert_eq!(thin(&broad, stride), []);
        let count = Drawn {
            found: 1,
            drawn: 4,
            beyond: 2,
        };
        let said = describe(&task, &narrow, 20.0, &count);
        for words in [
            "bar is 10 px thick",
            "1 of 4",
            "2 are beyond the arm's reach",
        ] {
            assert!(said.contains(words), "{said}");
        }
    }
}
