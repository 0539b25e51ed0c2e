//! The text of a scene file, with other occlusions.

/// The text of a scene file with its occlusions replaced by one mask; every other table stays as it
/// is written.
pub fn with_mask(text: &str, mask: &str) -> String {
    let mut kept: Vec<&str> = Vec::new();
    let mut in_occlusion = false;
    for line in text.lines() {
        if let Some(table) = header(line) {
            in_occlusion = table == "occlusion";
            if in_occlusion {
                // What is said about the first of them goes with it.
                while kept
                    .last()
                    .is_some_and(|line| line.starts_with('#') || line.trim().is_empty())
                {
                    kept.pop();
                }
            }
        }
        if !in_occlusion {
            kept.push(line);
        }
    }
    // A string of JSON is one of TOML, too.
    let name = serde_json::Value::from(mask);
    let head = kept.join("\n");
    let head = head.trim_end();
    format!(
        "{head}\n\n# White pixels are forbidden, black ones free; the image is as large as the camera's.\n\
         [[occlusion]]\nname = \"mask\"\nmask = {name}\n"
    )
}

/// The name in the header of a table or of an array of tables.
fn header(line: &str) -> Option<&str> {
    let line = line.split_once('#').map_or(line, |(code, _)| code).trim();
    let name = line.strip_prefix('[')?.strip_suffix(']')?;
    let name = name
        .strip_prefix('[')
        .and_then(|name| name.strip_suffix(']'))
        .unwrap_or(name)
        .trim();
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    (name.starts_with(|c: char| c.is_ascii_alphabetic()) && name.chars().all(is_word))
        .then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_other_tables_stay_as_they_are_written() {
        let text = with_mask(crate::PAPER_SIM, "areas.png");
        let (head, _) = crate::PAPER_SIM
            .split_once("\n# An occlusion is the union")
            .unwrap();
        let (kept, tail) = text.split_once("\n# White pixels").unwrap();
        assert_eq!(kept.trim_end(), head.trim_end());
        assert_eq!(tail.matches("[[occlusion]]").count(), 1);
        assert!(tail.ends_with("mask = \"areas.png\"\n"));
    }

    #[test]
    fn a_table_after_the_occlusions_is_kept() {
        let text =
            "[camera] # here\nfx = 1\n[[occlusion]]\nparts = [\n  [1, 2]\n]\n[cost]\nk_q = 1\n";
        let kept = with_mask(text, "m.png");
        assert!(
            kept.starts_with("[camera] # here\nfx = 1\n[cost]\nk_q = 1\n"),
            "{kept}"
        );
    }
}
