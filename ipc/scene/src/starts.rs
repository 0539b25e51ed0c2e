//! Files of start poses: CSV with the header `tx,ty,tz,rx,ry,rz`, a pose of the object in the
//! camera frame in each row, translation (m) and rotation vector (rad).

use std::path::Path;

use toml_schema::FileError;

use crate::Pose;

const HEADER: &str = "tx,ty,tz,rx,ry,rz";

/// Reads a file of starts.
///
/// # Errors
/// [`FileError`] names the file, the line and what is allowed.
pub fn read_starts(path: &Path) -> Result<Vec<Pose>, FileError> {
    parse_starts(&toml_schema::read_text(path)?, &path.display().to_string())
}

/// Returns the text of a file of starts, which [`parse_starts`] reads back to the bit.
pub fn starts_csv(starts: &[Pose]) -> String {
    let row = |start: &Pose| {
        let ([tx, ty, tz], [rx, ry, rz]) = (start.translation, start.rotation);
        format!("{tx},{ty},{tz},{rx},{ry},{rz}\n")
    };
    format!("{HEADER}\n") + &starts.iter().map(row).collect::<String>()
}

/// Parses the text of a file of starts; `path` is for messages.
///
/// # Errors
/// As [`read_starts`].
pub fn parse_starts(text: &str, path: &str) -> Result<Vec<Pose>, FileError> {
    let refuse = |message: String| FileError::Syntax {
        path: path.to_owned(),
        message,
    };
    let lines = text.lines().map(str::trim).zip(1..);
    let mut lines = lines.filter(|(line, _)| !line.is_empty() && !line.starts_with('#'));
    let (header, _) = lines.next().unwrap_or_default();
    if header.replace(' ', "") != HEADER {
        return Err(refuse(format!(
            "the first line is `{header}`; allowed: `{HEADER}`"
        )));
    }
    let starts: Result<Vec<_>, _> = lines
        .map(|(line, number)| {
            pose(line).map_err(|found| {
                let allowed = "six finite numbers tx,ty,tz (m), rx,ry,rz (rad), tz > 0";
                refuse(format!("line {number}: {found}; allowed: {allowed}"))
            })
        })
        .collect();
    match starts?.as_slice() {
        [] => Err(refuse(
            "no start; allowed: one row or more below the header".to_owned(),
        )),
        starts => Ok(starts.to_vec()),
    }
}

/// Parses a row; the error is what is wrong with it.
fn pose(line: &str) -> Result<Pose, String> {
    let number = |field: &str| match field.trim().parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("`{}` is not a finite number", field.trim())),
    };
    let numbers = line.split(',').map(number).collect::<Result<Vec<_>, _>>()?;
    let [tx, ty, tz, rx, ry, rz] = *numbers else {
        return Err(format!("{} fields", numbers.len()));
    };
    if tz <= 0.0 {
        return Err(format!("tz = {tz} is behind the camera"));
    }
    Ok(Pose {
        translation: [tx, ty, tz],
        rotation: [rx, ry, rz],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_back() {
        let starts = parse_starts(crate::PAPER_SIM_STARTS, "starts").unwrap();
        let again = parse_starts(&starts_csv(&starts), "again").unwrap();
        assert_eq!(starts, again);
    }

    #[test]
    fn the_papers_starts_are_a_hundred_each() {
        assert_eq!(
            parse_starts(crate::PAPER_SIM_STARTS, "sim").unwrap().len(),
            100
        );
        assert_eq!(
            parse_starts(crate::PAPER_ROBOT_STARTS, "robot")
                .unwrap()
                .len(),
            100
        );
        assert_eq!(
            parse_starts(crate::TAGS_ROBOT_STARTS, "tags")
                .unwrap()
                .len(),
            100
        );
    }

    #[test]
    fn a_missing_file_is_told_once() {
        use std::error::Error;
        let starts = crate::read_starts(Path::new("/none/starts.csv")).unwrap_err();
        let scene = crate::Scene::read(Path::new("/none/scene.toml")).unwrap_err();
        // Programs print the chain of causes: what is in the message must not follow it.
        assert!(starts.source().is_none() && scene.source().is_none());
        assert!(starts.to_string().contains("No such file"), "{starts}");
        assert!(scene.to_string().contains("No such file"), "{scene}");
    }

    #[test]
    fn a_bad_row_is_named_with_its_line() {
        let head = "tx,ty,tz,rx,ry,rz\n0,0,1,0,0,0\n";
        for (row, word) in [
            ("0,0,1,0,0", "5 fields"),
            ("0,0,1,0,0,NaN", "`NaN`"),
            ("0,0,-1,0,0,0", "behind the camera"),
        ] {
            let message = parse_starts(&format!("{head}{row}\n"), "s.csv")
                .unwrap_err()
                .to_string();
            assert!(
                message.contains("s.csv: line 3") && message.contains(word),
                "{message}"
            );
        }
    }

    #[test]
    fn a_wrong_header_and_an_empty_list_are_refused() {
        let refused = |text: &str| parse_starts(text, "s").unwrap_err().to_string();
        let header = refused("x,y\n1,2\n");
        assert!(
            header.contains("the first line is `x,y`; allowed: `tx,ty,tz,rx,ry,rz`"),
            "{header}"
        );
        let empty = refused("tx,ty,tz,rx,ry,rz\n");
        assert!(
            empty.contains("no start; allowed: one row or more"),
            "{empty}"
        );
    }
}
