//! Files of fixed start poses.

use std::path::Path;

use crate::Pose;

/// Why a file of starts was refused.
#[derive(Debug, thiserror::Error)]
pub enum StartsError {
    /// The file could not be read.
    #[error("{path}: cannot read the starts: {source}")]
    Read {
        /// The file.
        path: String,
        /// The operating system's reason.
        r#source: std::io::Error,
    },
    /// The header is not the documented one.
    #[error("{path}: the first line is `{found}`; allowed: `tx,ty,tz,rx,ry,rz`")]
    Header {
        /// The file.
        path: String,
        /// What stands there.
        found: String,
    },
    /// A row is not six finite numbers.
    #[error(
        "{path}: line {line}: {found}; allowed: six finite numbers tx,ty,tz (m), rx,ry,rz (rad), tz > 0"
    )]
    Row {
        /// The file.
        path: String,
        /// Line number, from 1.
        line: u64,
        /// What is wrong with the row.
        found: String,
    },
    /// There is no row.
    #[error("{path}: no start; allowed: one row or more below the header")]
    Empty {
        /// The file.
        path: String,
    },
}

/// Reads a file of starts: CSV with the header `tx,ty,tz,rx,ry,rz`, one pose of the object in the camera frame a row
/// (m and rotation vector in rad).
///
/// # Errors
/// [`StartsError`] names the file, the line and what is allowed.
pub fn read_starts(path: &Path) -> Result<Vec<Pose>, StartsError> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|source| StartsError::Read {
        path: name.clone(),
        source,
    })?;
    parse_starts(&text, &name)
}

/// The text of a file of starts, which [`parse_starts`] reads back to the bit.
pub fn starts_csv(starts: &[Pose]) -> String {
    let rows = starts.iter().map(|start| {
        let [tx, ty, tz] = start.translation;
        let [rx, ry, rz] = start.rotation;
        format!("{tx},{ty},{tz},{rx},{ry},{rz}\n")
    });
    std::iter::once("tx,ty,tz,rx,ry,rz\n".to_owned())
        .chain(rows)
        .collect()
}

/// Parses the text of a file of starts; `path` is for messages.
///
/// # Errors
/// As [`read_starts`].
pub fn parse_starts(text: &str, path: &str) -> Result<Vec<Pose>, StartsError> {
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .flexible(true)
        .from_reader(text.as_bytes());
    let row_error = |line: u64, found: String| StartsError::Row {
        path: path.to_owned(),
        line,
        found,
    };

    let header = reader.headers().map_err(|e| row_error(1, e.to_string()))?;
    if header.iter().ne(["tx", "ty", "tz", "rx", "ry", "rz"]) {
        let found = header.iter().collect::<Vec<_>>().join(",");
        return Err(StartsError::Header {
            path: path.to_owned(),
            found,
        });
    }

    let mut starts = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| row_error(0, e.to_string()))?;
        let line = record.position().map_or(0, csv::Position::line);
        if record.len() != 6 {
            return Err(row_error(line, format!("{} fields", record.len())));
        }
        let mut row = [0.0; 6];
        for (number, field) in row.iter_mut().zip(&record) {
            *number = match field.parse::<f64>() {
                Ok(x) if x.is_finite() => x,
                _ => return Err(row_error(line, format!("`{field}` is not a finite number"))),
            };
        }
        let [tx, ty, tz, rx, ry, rz] = row;
        if tz <= 0.0 {
            return Err(row_error(line, format!("tz = {tz} is behind the camera")));
        }
        starts.push(Pose {
            translation: [tx, ty, tz],
            rotation: [rx, ry, rz],
        });
    }
    if starts.is_empty() {
        return Err(StartsError::Empty {
            path: path.to_owned(),
        });
    }
    Ok(starts)
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
        assert!(matches!(
            parse_starts("x,y\n1,2\n", "s"),
            Err(StartsError::Header { .. })
        ));
        assert!(matches!(
            parse_starts("tx,ty,tz,rx,ry,rz\n", "s"),
            Err(StartsError::Empty { .. })
        ));
    }
}
