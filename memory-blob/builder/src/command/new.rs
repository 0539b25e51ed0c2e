//! `vpc-memory new`: a scene file from what a user knows of a task.

use std::fs;
use std::io::{BufRead, IsTerminal, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use memory_builder::template::Template;
use scene::{Camera, Scene};
use vpc::Task;

use super::mask::{beside, refuse_existing};

/// What is known; on a terminal the rest is asked for.
#[derive(Args)]
pub struct New {
    /// The scene file to write (TOML).
    scene: PathBuf,
    /// Image size, px: WIDTHxHEIGHT.
    #[arg(long)]
    image: Option<String>,
    /// Focal lengths, px: FX or FX,FY.
    #[arg(long)]
    focal: Option<String>,
    /// Principal point, px: CX,CY [default: the middle of the image].
    #[arg(long)]
    centre: Option<String>,
    /// Frame rate, Hz [default: 30].
    #[arg(long)]
    rate: Option<String>,
    /// The pattern, m: SIDE of a square, WIDTHxHEIGHT of a rectangle, or X,Y of each point between
    /// semicolons.
    #[arg(long)]
    pattern: Option<String>,
    /// Side of the square round each point that must stay in sight, m: of a tag with its white
    /// border; 0 for points.
    #[arg(long)]
    marker_size: Option<String>,
    /// Where the camera shall see the pattern, m and rad: depth Z, or X,Y,Z, or X,Y,Z,RX,RY,RZ.
    #[arg(long, allow_hyphen_values = true)]
    goal: Option<String>,
    /// Limits of the camera velocity, m/s and rad/s: LINEAR,ANGULAR [default: 0.5,1].
    #[arg(long)]
    limits: Option<String>,
    /// Depths between which starts lie, m: NEAR,FAR [default: 0.75 and 2 times that of the goal].
    #[arg(long)]
    depth: Option<String>,
    /// Greatest tilt and roll of starts, rad: TILT,ROLL [default: 0.5,1.5].
    #[arg(long)]
    turn: Option<String>,
    /// An image of the camera's size in which white is forbidden (PNG).
    #[arg(long)]
    mask: Option<PathBuf>,
    /// An elliptic occlusion, px: U,V,HALF_U,HALF_V; may be repeated.
    #[arg(long)]
    ellipse: Vec<String>,
    /// A rectangular occlusion, px: U,V,HALF_U,HALF_V; may be repeated.
    #[arg(long = "box")]
    boxes: Vec<String>,
    /// Overwrite what exists.
    #[arg(long)]
    force: bool,
}

impl New {
    /// Writes the scene once it is a valid one; says what was written and what comes next.
    pub fn run(&self) -> anyhow::Result<String> {
        refuse_existing(&self.scene, self.force)?;
        let template = self.template()?;
        let name = self.scene.display().to_string();
        let text = template.text();
        let scene = Scene::parse(&text, &name)?;
        Task::new(&scene).with_context(|| name.clone())?;
        fs::write(&self.scene, text).with_context(|| format!("{name}: cannot write"))?;
        Ok(format!(
            "wrote {name}; next: vpc-memory preview {name} -o preview.png\n"
        ))
    }

    fn template(&self) -> anyhow::Result<Template> {
        let [width, height] = IMAGE.ask(&self.image, None, exactly('x'))?;
        let either = one_of(&[1, 2], "FX or FX,FY");
        let focal = FOCAL.ask(&self.focal, None, either)?;
        let middle = format!("{},{}", 0.5 * width, 0.5 * height);
        let [cx, cy] = CENTRE.ask(&self.centre, Some(&middle), exactly(','))?;
        let [rate_hz] = RATE.ask(&self.rate, Some("30"), exactly(','))?;
        let pattern = PATTERN.ask(&self.pattern, None, points)?;
        let marker_size = MARKER_SIZE.ask(&self.marker_size, Some(""), |flag, text| {
            let read = |text| exactly(',')(flag, text).map(|[size]| size);
            (!text.is_empty()).then(|| read(text)).transpose()
        })?;
        let poses = one_of(&[1, 3, 6], "Z, or X,Y,Z, or X,Y,Z,RX,RY,RZ");
        let (goal, goal_rotation) = match GOAL.ask(&self.goal, None, poses)?[..] {
            [x, y, z, rx, ry, rz] => ([x, y, z], [rx, ry, rz]),
            [x, y, z] => ([x, y, z], [0.0; 3]),
            ref depth => ([0.0, 0.0, depth[0]], [0.0; 3]),
        };
        let [linear, angular] = LIMITS.ask(&self.limits, Some("0.5,1"), exactly(','))?;
        let reach = format!("{:.3},{:.3}", 0.75 * goal[2], 2.0 * goal[2]);
        let depth = DEPTH.ask(&self.depth, Some(&reach), exactly(','))?;
        let [tilt, roll] = TURN.ask(&self.turn, Some("0.5,1.5"), exactly(','))?;
        let shapes = |flag: &str, texts: &[String]| -> anyhow::Result<Vec<[f64; 4]>> {
            texts.iter().map(|text| exactly(',')(flag, text)).collect()
        };
        let (fx, fy) = (focal[0], focal[focal.len() - 1]);
        Ok(Template {
            camera: Camera {
                width,
                height,
                fx,
                fy,
                cx,
                cy,
                rate_hz,
            },
            pattern,
            marker_size,
            goal,
            goal_rotation,
            linear,
            angular,
            depth,
            tilt,
            roll,
            mask: self.mask_path()?,
            ellipses: shapes("--ellipse", &self.ellipse)?,
            boxes: shapes("--box", &self.boxes)?,
        })
    }

    /// The mask as the scene file names it; on a terminal it is asked for where no occlusion is
    /// given.
    fn mask_path(&self) -> anyhow::Result<Option<String>> {
        let mut mask = self.mask.clone();
        if mask.is_none() && self.ellipse.is_empty() && self.boxes.is_empty() {
            mask = MASK.ask(&None, Some(""), |flag, answer| match Path::new(answer) {
                _ if answer.is_empty() => Ok(None),
                path if path.exists() => Ok(Some(path.to_owned())),
                _ => bail!("{flag} = {answer}; allowed: a file that is there"),
            })?;
        }
        mask.map(|mask| beside(&self.scene, &mask)).transpose()
    }
}

/// What can be told by a flag, and what to ask where it is not.
struct Question(&'static str, &'static str);

const IMAGE: Question = Question("--image", "Image size, px (WIDTHxHEIGHT)");
const FOCAL: Question = Question("--focal", "Focal lengths, px (FX or FX,FY)");
const CENTRE: Question = Question("--centre", "Principal point, px (CX,CY)");
const RATE: Question = Question("--rate", "Frame rate, Hz");
const PATTERN: Question = Question(
    "--pattern",
    "Pattern, m (SIDE of a square, WIDTHxHEIGHT, or points X,Y;X,Y;...)",
);
const MARKER_SIZE: Question = Question(
    "--marker-size",
    "Side of a marker with its white border, m (0 for points; empty if unknown)",
);
const GOAL: Question = Question("--goal", "Goal, m and rad (Z, or X,Y,Z, or X,Y,Z,RX,RY,RZ)");
const LIMITS: Question = Question("--limits", "Limits, m/s and rad/s (LINEAR,ANGULAR)");
const DEPTH: Question = Question("--depth", "Depths of starts, m (NEAR,FAR)");
const TURN: Question = Question("--turn", "Tilt and roll of starts, rad (TILT,ROLL)");
const MASK: Question = Question("--mask", "Mask of the occlusions (PNG; empty for none)");

impl Question {
    /// What the flag's value means; else, on a terminal, the answer, which is asked for again until
    /// it means something; else the default. `read` takes the flag and the text.
    fn ask<T>(
        &self,
        given: &Option<String>,
        default: Option<&str>,
        read: impl Fn(&str, &str) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let Self(flag, question) = self;
        if let Some(given) = given {
            return read(flag, given);
        }
        let stdin = std::io::stdin();
        while stdin.is_terminal() {
            let shown = default.filter(|default| !default.is_empty());
            let hint = shown.map_or(String::new(), |default| format!(" [{default}]"));
            let mut out = std::io::stderr().lock();
            write!(out, "{question}{hint}: ").and_then(|()| out.flush())?;
            let mut line = String::new();
            if stdin.lock().read_line(&mut line).context("no answer")? == 0 {
                bail!("no answer to: {question}");
            }
            let answer = match (line.trim(), default) {
                ("", None) => continue,
                ("", Some(default)) => default,
                (answer, _) => answer,
            };
            match read(flag, answer) {
                Ok(value) => return Ok(value),
                Err(error) => writeln!(out, "{error}")?,
            }
        }
        match default {
            Some(default) => read(flag, default),
            None => bail!("{flag} is missing; {question}"),
        }
    }
}

/// Points of the pattern on z = 0, m.
fn points(flag: &str, text: &str) -> anyhow::Result<Vec<[f64; 3]>> {
    if text.contains(';') {
        let point = |point| exactly(',')(flag, point).map(|[x, y]| [x, y, 0.0]);
        return text.split(';').map(point).collect();
    }
    match numbers(flag, text, 'x')?[..] {
        [side] => Ok(Template::rectangle(side, side)),
        [width, height] => Ok(Template::rectangle(width, height)),
        _ => bail!("{flag} = {text}; allowed: SIDE, WIDTHxHEIGHT, or X,Y;X,Y;..."),
    }
}

/// Finite numbers between separators.
fn numbers(flag: &str, text: &str, separator: char) -> anyhow::Result<Vec<f64>> {
    text.split(separator)
        .map(|number| match number.trim().parse::<f64>() {
            Ok(x) if x.is_finite() => Ok(x),
            _ => bail!("{flag} = {text}; allowed: numbers with `{separator}` between them"),
        })
        .collect()
}

/// Reads `N` numbers.
fn exactly<const N: usize>(separator: char) -> impl Fn(&str, &str) -> anyhow::Result<[f64; N]> {
    move |flag, text| match numbers(flag, text, separator)?.try_into() {
        Ok(numbers) => Ok(numbers),
        Err(_) if N == 1 => bail!("{flag} = {text}; allowed: one number"),
        Err(_) => bail!("{flag} = {text}; allowed: {N} numbers with `{separator}` between them"),
    }
}

/// Reads as many numbers between commas as one of some counts.
fn one_of(
    counts: &'static [usize],
    allowed: &'static str,
) -> impl Fn(&str, &str) -> anyhow::Result<Vec<f64>> {
    move |flag, text| match numbers(flag, text, ',')? {
        numbers if counts.contains(&numbers.len()) => Ok(numbers),
        _ => bail!("{flag} = {text}; allowed: {allowed}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_is_a_square_a_rectangle_or_points() {
        assert_eq!(
            points("--pattern", "0.2").unwrap(),
            Template::rectangle(0.2, 0.2)
        );
        assert_eq!(points("--pattern", "0.2x0.1").unwrap()[2], [0.1, 0.05, 0.0]);
        let four = points("--pattern", "0,0; 1,0; 1,1; -0.5,1").unwrap();
        assert_eq!((four.len(), four[3]), (4, [-0.5, 1.0, 0.0]));
        let message = points("--pattern", "0.1x0.1x0.1").unwrap_err().to_string();
        assert!(
            message.contains("--pattern = 0.1x0.1x0.1; allowed: SIDE"),
            "{message}"
        );
    }

    #[test]
    fn a_wrong_count_names_flag_value_and_what_is_allowed() {
        let message = exactly::<2>('x')("--image", "640").unwrap_err().to_string();
        assert_eq!(
            message,
            "--image = 640; allowed: 2 numbers with `x` between them"
        );
        let message = exactly::<1>(',')("--rate", "30,60")
            .unwrap_err()
            .to_string();
        assert_eq!(message, "--rate = 30,60; allowed: one number");
        let message = exactly::<1>(',')("--rate", "fast").unwrap_err().to_string();
        assert!(message.contains("--rate = fast"), "{message}");
    }
}
