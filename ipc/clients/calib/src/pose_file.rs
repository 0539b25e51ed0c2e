//! Poses from a CSV file; its first line names the columns.
//!
//! Beside images or instead of them: `image`, a name, then the flange in the base:
//! `x,y,z,qx,qy,qz,qw` (m, and its unit quaternion) or `q1,q2,q3,q4,q5,q6,q7` (joints of a Panda or
//! FR3, rad), then, optionally, the board in the camera:
//! `board_x,board_y,board_z,board_qx,board_qy,board_qz,board_qw`. As a function of time:
//! `time,x,y,z,qx,qy,qz,qw` (s).

use std::path::Path;

use arm::{Chain, Joints};
use nalgebra::UnitQuaternion;
use toml_schema::{FileError, read_text};
use vision_calibration_core::{Iso3, Vec3};

type Columns = [&'static str; 7];
const POSE: Columns = ["x", "y", "z", "qx", "qy", "qz", "qw"];
const JOINTS: Columns = ["q1", "q2", "q3", "q4", "q5", "q6", "q7"];
const BOARD: Columns = [
    "board_x", "board_y", "board_z", "board_qx", "board_qy", "board_qz", "board_qw",
];
/// Farthest that a flange is from its base, and a board from the camera, m: beyond it, units are
/// mixed up.
const FARTHEST: [f64; 2] = [3.0, 10.0];
/// Farthest that a joint turns, rad: beyond it, it is deg.
const TURN: f64 = 6.3;
/// By how much the length of a quaternion may miss 1.
const UNIT: f64 = 1e-3;

/// A line beside an image or instead of one.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotPose {
    /// The name of the image.
    pub image: String,
    /// The flange in the base.
    pub flange: Iso3,
    /// The board in the camera, where the file has it.
    pub board: Option<Iso3>,
}

/// Reads a file of poses beside images, or instead of them.
///
/// # Errors
/// [`FileError`] names line, column, value and what is allowed.
pub fn read(path: &Path) -> Result<Vec<RobotPose>, FileError> {
    parse(&path.display().to_string(), &read_text(path)?)
}

/// Reads a file of poses at instants, s, each later than the one before.
///
/// # Errors
/// As [`read`].
pub fn read_timed(path: &Path) -> Result<Vec<(f64, Iso3)>, FileError> {
    parse_timed(&path.display().to_string(), &read_text(path)?)
}

/// The flange in the base, from the joints.
pub fn flange(q: [f64; 7]) -> Iso3 {
    let pose = Chain::FRANKA.flange(&Joints::from(q));
    let [x, y, z] = pose.translation.vector.into();
    let turn = UnitQuaternion::from_rotation_matrix(&pose.rotation).scaled_axis();
    Iso3::new(Vec3::new(x, y, z), Vec3::new(turn.x, turn.y, turn.z))
}

/// A line of joints that is read as exactly these; the header is [`HEADER`].
pub fn line(image: &str, q: &[f64; 7]) -> String {
    let numbers = q.map(|x| x.to_string());
    format!("{image},{}\n", numbers.join(","))
}

/// The first line of files that this program writes.
pub const HEADER: &str = "image,q1,q2,q3,q4,q5,q6,q7\n";

/// A line of a file.
struct Line<'a> {
    path: &'a str,
    number: usize,
    columns: &'a [&'static str],
    words: Vec<&'a str>,
}

impl Line<'_> {
    fn refuse(&self, column: &str, value: &str, allowed: &str) -> FileError {
        let place = format!("line {}, {column}", self.number);
        FileError::value(self.path, &place, value, allowed)
    }

    fn number(&self, column: usize) -> Result<f64, FileError> {
        let word = self.words[column];
        let number: Option<f64> = word.parse().ok().filter(|x: &f64| x.is_finite());
        number.ok_or_else(|| self.refuse(self.columns[column], word, "a finite number"))
    }

    /// The pose in seven columns.
    fn pose(&self, first: usize) -> Result<Iso3, FileError> {
        let mut numbers = [0.0; 7];
        for (k, slot) in numbers.iter_mut().enumerate() {
            *slot = self.number(first + k)?;
        }
        let pose = match self.columns.get(first) {
            Some(&"q1") => of_joints(numbers),
            Some(&"x") => of_numbers(numbers, &POSE, "base"),
            _ => of_numbers(numbers, &BOARD, "camera"),
        };
        pose.map_err(|(column, value, allowed)| self.refuse(&column, &value, &allowed))
    }
}

/// The lines below the first, which must be one of `headers`.
fn lines<'a>(
    path: &'a str,
    text: &'a str,
    headers: &'a [Vec<&'static str>],
) -> Result<Vec<Line<'a>>, FileError> {
    let filled = |line: &(usize, &str)| !line.1.trim().is_empty() && !line.1.starts_with('#');
    let mut lines = text.lines().enumerate().filter(filled);
    let words = |line: &'a str| line.split(',').map(str::trim).collect::<Vec<_>>();
    let found = lines.next().map_or(vec![], |(_, line)| words(line));
    let Some(columns) = headers.iter().find(|header| **header == found) else {
        let allowed: Vec<_> = headers.iter().map(|header| header.join(",")).collect();
        let allowed = allowed.join(" or ");
        return Err(FileError::value(
            path,
            "the first line",
            found.join(","),
            allowed,
        ));
    };
    let line = |(number, line): (usize, &'a str)| {
        let line = Line {
            path,
            number: number + 1,
            columns,
            words: words(line),
        };
        if line.words.len() == columns.len() {
            return Ok(line);
        }
        let found = format!("{} columns", line.words.len());
        Err(line.refuse("columns", &found, &columns.len().to_string()))
    };
    lines.map(line).collect()
}

fn parse(path: &str, text: &str) -> Result<Vec<RobotPose>, FileError> {
    let image: &[&'static str] = &["image"];
    let headers = [
        [image, &POSE].concat(),
        [image, &JOINTS].concat(),
        [image, &POSE, &BOARD].concat(),
        [image, &JOINTS, &BOARD].concat(),
    ];
    let mut poses: Vec<RobotPose> = Vec::new();
    for line in lines(path, text, &headers)? {
        let image = line.words[0].to_owned();
        if poses.iter().any(|known| known.image == image) {
            return Err(line.refuse("image", &image, "each image once"));
        }
        let has_board = line.columns.len() > 1 + POSE.len();
        poses.push(RobotPose {
            image,
            flange: line.pose(1)?,
            board: has_board.then(|| line.pose(1 + POSE.len())).transpose()?,
        });
    }
    Ok(poses)
}

fn parse_timed(path: &str, text: &str) -> Result<Vec<(f64, Iso3)>, FileError> {
    let headers = [[&["time"][..], &POSE].concat()];
    let mut poses: Vec<(f64, Iso3)> = Vec::new();
    for line in lines(path, text, &headers)? {
        let time = line.number(0)?;
        if poses.last().is_some_and(|(before, _)| time <= *before) {
            return Err(line.refuse("time", line.words[0], "later than in the line before"));
        }
        poses.push((time, line.pose(1)?));
    }
    Ok(poses)
}

/// Column, value, and what is allowed.
type Refused = (String, String, String);

fn of_joints(q: [f64; 7]) -> Result<Iso3, Refused> {
    match q.iter().position(|x| x.abs() > TURN) {
        Some(joint) => {
            let allowed = format!("-{TURN} to {TURN} rad; is it in degrees?");
            Err((JOINTS[joint].to_owned(), q[joint].to_string(), allowed))
        }
        None => Ok(flange(q)),
    }
}

/// A pose in the base or the camera, as the columns have it.
fn of_numbers(numbers: [f64; 7], columns: &Columns, frame: &str) -> Result<Iso3, Refused> {
    let [x, y, z, qx, qy, qz, qw] = numbers;
    let at = Vec3::new(x, y, z);
    let farthest = FARTHEST[usize::from(frame == "camera")];
    if at.norm() > farthest {
        let allowed = format!("within {farthest} m of the {frame}; are the units metres?");
        return Err((columns[..3].join(","), format!("{x},{y},{z}"), allowed));
    }
    let length = [qx, qy, qz, qw].iter().map(|q| q * q).sum::<f64>().sqrt();
    if (length - 1.0).abs() > UNIT {
        let found = format!("a quaternion of length {length:.4}");
        return Err((columns[3..].join(","), found, "of length 1".to_owned()));
    }
    // The axis times the angle; the vector's length is the sine of its half.
    let vector = Vec3::new(qx, qy, qz);
    let (sine, cosine) = match qw < 0.0 {
        true => (-vector, -qw),
        false => (vector, qw),
    };
    let half = sine.norm().atan2(cosine);
    let turn = match sine.norm() > 1e-12 {
        true => sine * (2.0 * half / sine.norm()),
        false => Vec3::zeros(),
    };
    Ok(Iso3::new(at, turn))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        parse("poses.csv", text).unwrap_err().to_string()
    }

    #[test]
    fn joints_and_quaternions_give_the_same_flange() {
        let text =
            format!("# by hand\n{HEADER}a.png, 0,-0.785398163,0,-2.35619449,0,1.570796327,0\n");
        let joints = parse("a", &text).unwrap();
        let text = format!(
            "image,{}\na.png,0.30689,0,0.59028,-1,0,0,0\n",
            POSE.join(",")
        );
        let numbers = parse("b", &text).unwrap();
        let apart = joints[0].flange.inverse() * numbers[0].flange;
        assert_eq!(joints[0].image, "a.png");
        assert!(
            apart.translation.vector.norm() < 1e-4 && apart.rotation.angle() < 1e-6,
            "{apart}"
        );
    }

    #[test]
    fn every_quaternion_is_turned_into_its_rotation() {
        for turn in [
            [0.0, 0.0, 0.0],
            [0.3, -0.2, 0.5],
            [3.1, 0.0, 0.2],
            [0.0, 1e-9, 0.0],
        ] {
            let pose = Iso3::new(Vec3::zeros(), Vec3::from(turn));
            let q = pose.rotation.coords;
            for sign in [1.0, -1.0] {
                let [x, y, z, w] = [q.x, q.y, q.z, q.w].map(|part| sign * part);
                let read = of_numbers([0.0, 0.0, 0.0, x, y, z, w], &POSE, "base").unwrap();
                assert!(pose.rotation.angle_to(&read.rotation) < 1e-9);
            }
        }
    }

    #[test]
    fn what_was_written_is_read() {
        let q = [0.1, -0.5, 0.3, -2.0, 0.4, 1.7, 0.8];
        let poses = parse("a", &format!("{HEADER}{}", line("00.png", &q))).unwrap();
        assert_eq!(poses[0].flange, flange(q));
    }

    #[test]
    fn mistakes_are_named_with_line_and_column() {
        let pose = format!("image,{}", POSE.join(","));
        let both = format!("{pose},{}", BOARD.join(","));
        for (text, said) in [
            ("", "the first line = "),
            (
                "image,x,y,z\n",
                "allowed: image,x,y,z,qx,qy,qz,qw or image,q1",
            ),
            (
                &format!("{pose}\na,1,2\n"),
                "line 2, columns = 3 columns; allowed: 8",
            ),
            (
                &format!("{pose}\na,0.3,0,nan,0,0,0,1\n"),
                "line 2, z = nan; allowed: a finite number",
            ),
            (
                &format!("{pose}\na,306.9,0,590.3,0,0,0,1\n"),
                "are the units metres?",
            ),
            (
                &format!("{pose}\na,0.3,0,0.5,0,0,0,0.5\n"),
                "of length 0.5000; allowed: of length 1",
            ),
            (
                &format!("{HEADER}a,0,-45,0,-135,0,90,45\n"),
                "q2 = -45; allowed: -6.3 to 6.3 rad",
            ),
            (
                &format!("{HEADER}a,0,0,0,0,0,0,0\na,0,0,0,0,0,0,0\n"),
                "line 3, image = a; allowed: each image once",
            ),
            (
                &format!("{both}\na,0,0,0,0,0,0,1,0,0,400,0,0,0,1\n"),
                "board_x,board_y,board_z = 0,0,400; allowed: within 10 m of the camera",
            ),
            (
                &format!("{both}\na,0,0,0,0,0,0,1,0,0,0.4,0,0,0,2\n"),
                "board_qx,board_qy,board_qz,board_qw = a quaternion of length 2.0000",
            ),
            (
                &format!("{both}\na,0,0,0,0,0,0,1\n"),
                "columns = 8 columns; allowed: 15",
            ),
        ] {
            let error = refused(text);
            assert!(error.contains(said), "{text}: {error}");
        }
    }

    #[test]
    fn poses_at_instants_are_read_in_their_order() {
        let head = format!("time,{}\n", POSE.join(","));
        let line = |time: &str| format!("{time},0.1,0,0.5,0,0,0,1\n");
        let timed = |text: &str| parse_timed("poses.csv", text);
        let poses = timed(&format!(
            "{head}{}{}",
            line("1487321563.68"),
            line("1487321563.7")
        ));
        let poses = poses.unwrap();
        assert!((poses[1].0 - poses[0].0 - 0.02).abs() < 1e-6);
        assert_eq!(poses[0].1, Iso3::translation(0.1, 0.0, 0.5));
        let error = timed(&format!("{head}{}{}", line("2"), line("2"))).unwrap_err();
        let said = "line 3, time = 2; allowed: later than in the line before";
        assert!(error.to_string().contains(said), "{error}");
        assert!(
            timed("t,x\n")
                .unwrap_err()
                .to_string()
                .contains("allowed: time,x,y,z,qx")
        );
    }
}
