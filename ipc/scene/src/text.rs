//! The text of a scene file, with other occlusions or other values.

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

/// The text of a scene file with another value of a key of a table; everything else stays as it is
/// written, comments too. `None` where the key has no line of its own in the table.
pub fn with_value(text: &str, table: &str, key: &str, value: &str) -> Option<String> {
    let mut lines = text.lines();
    let mut kept = Vec::new();
    let mut is_here = false;
    for line in lines.by_ref() {
        is_here = header(line).map_or(is_here, |name| name == table);
        let assigned = line.split_once('=').filter(|(name, _)| name.trim() == key);
        let Some((_, old)) = assigned.filter(|_| is_here) else {
            kept.push(line.to_owned());
            continue;
        };
        let (code, comment) = old.split_once('#').unwrap_or((old, ""));
        let mut new = format!("{key} = {value}");
        if !comment.is_empty() {
            new += &format!("  #{comment}");
        }
        kept.push(new);
        // An array may go on.
        let open = |code: &str| code.matches('[').count() as i64 - code.matches(']').count() as i64;
        let mut depth = open(code);
        while depth > 0 {
            let line = lines.next()?;
            depth += open(line.split_once('#').map_or(line, |(code, _)| code));
        }
        kept.extend(lines.map(str::to_owned));
        return Some(kept.join("\n") + "\n");
    }
    None
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
    fn a_value_is_replaced_and_nothing_else() {
        let text =
            "[a]\nx = 1\n[goal] # here\n# of old\nx = [1, # one\n  [2]]\ny = 3  # y\n[b]\nx = 4\n";
        let other = with_value(text, "goal", "x", "[7]").unwrap();
        assert_eq!(
            other,
            "[a]\nx = 1\n[goal] # here\n# of old\nx = [7]  # one\ny = 3  # y\n[b]\nx = 4\n"
        );
        let other = with_value(text, "goal", "y", "5").unwrap();
        assert!(other.contains("y = 5  # y\n[b]"), "{other}");
        assert_eq!(with_value(text, "goal", "z", "5"), None);
        assert_eq!(with_value(text, "c", "x", "5"), None);
        let scene = crate::PAPER_SIM;
        let same = with_value(scene, "goal", "translation", "[0.0, 0.0, 0.75]").unwrap();
        let changed = same.lines().zip(scene.lines()).filter(|(a, b)| a != b);
        assert!(changed.count() <= 1 && same.lines().count() == scene.lines().count());
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
