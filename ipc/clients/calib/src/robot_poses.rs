//! Poses of the robot beside images: a CSV file.
//!
//! The first line names the columns: `image,x,y,z,qx,qy,qz,qw` (the flange in the base, m, and its
//! unit quaternion) or `image,q1,q2,q3,q4,q5,q6,q7` (joints of a Panda or FR3, rad).

use std::path::Path;

use arm::{Chain, Joints};
use nalgebra::UnitQuaternion;
use toml_schema::{FileError, read_text};
use vision_calibration_core::{Iso3, Vec3};

const POSE: [&str; 8] = ["image", "x", "y", "z", "qx", "qy", "qz", "qw"];
const JOINTS: [&str; 8] = ["image", "q1", "q2", "q3", "q4", "q5", "q6", "q7"];
/// Farthest that a flange is from its base, m: beyond it, units are mixed up.
const FARTHEST: f64 = 3.0;
/// Farthest that a joint turns, rad: beyond it, it is deg.
const TURN: f64 = 6.3;
/// By how much the length of a quaternion may miss 1.
const UNIT: f64 = 1e-3;

/// A line: the name of an image, and the flange in the base.
pub type RobotPose = (String, Iso3);

/// Reads a file.
///
/// # Errors
/// [`FileError`] names line, column, value and what is allowed.
pub fn read(path: &Path) -> Result<Vec<RobotPose>, FileError> {
    parse(&path.display().to_string(), &read_text(path)?)
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

fn parse(path: &str, text: &str) -> Result<Vec<RobotPose>, FileError> {
    let filled = |line: &(usize, &str)| !line.1.trim().is_empty() && !line.1.starts_with('#');
    let mut lines = text.lines().enumerate().filter(filled);
    let columns: Vec<_> = lines.next().map_or(vec![], |(_, line)| words(line));
    let allowed = || format!("{} or {}", POSE.join(","), JOINTS.join(","));
    let names = match columns.as_slice() {
        columns if columns == POSE => POSE,
        columns if columns == JOINTS => JOINTS,
        _ => {
            return Err(FileError::value(
                path,
                "the first line",
                columns.join(","),
                allowed(),
            ));
        }
    };
    let mut poses: Vec<RobotPose> = Vec::new();
    for (number, line) in lines {
        let place = |column: &str| format!("line {}, {column}", number + 1);
        let words = words(line);
        if words.len() != names.len() {
            let found = format!("{} columns", words.len());
            return Err(FileError::value(path, &place("columns"), found, "8"));
        }
        let mut numbers = [0.0; 7];
        for ((slot, word), column) in numbers.iter_mut().zip(&words[1..]).zip(&names[1..]) {
            let number: Option<f64> = word.parse().ok().filter(|x: &f64| x.is_finite());
            *slot = number
                .ok_or_else(|| FileError::value(path, &place(column), word, "a finite number"))?;
        }
        let image = words[0].to_owned();
        if poses.iter().any(|(known, _)| *known == image) {
            return Err(FileError::value(
                path,
                &place("image"),
                image,
                "each image once",
            ));
        }
        let pose = match names == JOINTS {
            true => of_joints(numbers),
            false => of_numbers(numbers),
        };
        let refuse =
            |(column, value, allowed)| FileError::value(path, &place(column), value, allowed);
        poses.push((image, pose.map_err(refuse)?));
    }
    Ok(poses)
}

/// Column, value, and what is allowed.
type Refused = (&'static str, String, String);

fn of_joints(q: [f64; 7]) -> Result<Iso3, Refused> {
    match q.iter().position(|x| x.abs() > TURN) {
        Some(joint) => {
            let allowed = format!("-{TURN} to {TURN} rad; is it in degrees?");
            Err((JOINTS[joint + 1], q[joint].to_string(), allowed))
        }
        None => Ok(flange(q)),
    }
}

fn of_numbers([x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Result<Iso3, Refused> {
    let at = Vec3::new(x, y, z);
    if at.norm() > FARTHEST {
        let allowed = format!("within {FARTHEST} m of the base; are the units metres?");
        return Err(("x,y,z", format!("{x},{y},{z}"), allowed));
    }
    let length = [qx, qy, qz, qw].iter().map(|q| q * q).sum::<f64>().sqrt();
    if (length - 1.0).abs() > UNIT {
        let found = format!("a quaternion of length {length:.4}");
        return Err(("qx,qy,qz,qw", found, "of length 1".to_owned()));
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

fn words(line: &str) -> Vec<&str> {
    line.split(',').map(str::trim).collect()
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
        let text = format!("{}\na.png,0.30689,0,0.59028,-1,0,0,0\n", POSE.join(","));
        let numbers = parse("b", &text).unwrap();
        let apart = joints[0].1.inverse() * numbers[0].1;
        assert_eq!(joints[0].0, "a.png");
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
                let read = of_numbers([0.0, 0.0, 0.0, x, y, z, w]).unwrap();
                assert!(pose.rotation.angle_to(&read.rotation) < 1e-9);
            }
        }
    }

    #[test]
    fn what_was_written_is_read() {
        let q = [0.1, -0.5, 0.3, -2.0, 0.4, 1.7, 0.8];
        let poses = parse("a", &format!("{HEADER}{}", line("00.png", &q))).unwrap();
        assert_eq!(poses[0].1, flange(q));
    }

    #[test]
    fn mistakes_are_named_with_line_and_column() {
        let pose = POSE.join(",");
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
        ] {
            let error = refused(text);
            assert!(error.contains(said), "{text}: {error}");
        }
    }
}
