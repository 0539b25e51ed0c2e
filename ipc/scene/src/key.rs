//! A key of a configuration file: what its checks go by and what its readers are told, in one place.

use std::fmt::Write;

/// What a key takes. Ranges include their ends and are in the unit that [`Key::allowed`] names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// A file or directory.
    Path,
    /// Any text.
    Text,
    /// `true` or `false`.
    Switch,
    /// One of the words that [`Key::allowed`] lists.
    Word,
    /// A whole number.
    Integer {
        /// The least one.
        least: f64,
        /// The largest one.
        most: f64,
    },
    /// A number.
    Number {
        /// The least one.
        least: f64,
        /// The largest one.
        most: f64,
    },
    /// So many numbers, each in the range.
    Numbers {
        /// How many.
        count: usize,
        /// The least one.
        least: f64,
        /// The largest one.
        most: f64,
    },
    /// A list of what the text says.
    List {
        /// The shortest one.
        least: usize,
        /// The longest one.
        most: usize,
    },
    /// A table whose form the text tells.
    Table,
}

/// A key of a configuration file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key {
    /// Its name with its tables: `law.np`.
    pub name: &'static str,
    /// What it takes.
    pub kind: Kind,
    /// Its default as TOML, or in words where it depends on something; empty where it must be given.
    pub default: &'static str,
    /// What is allowed, with the unit, as refusals say it.
    pub allowed: &'static str,
    /// What it means.
    pub meaning: &'static str,
}

impl Key {
    /// A key that takes something else than a number.
    pub const fn new(
        name: &'static str,
        kind: Kind,
        default: &'static str,
        allowed: &'static str,
        meaning: &'static str,
    ) -> Self {
        Self {
            name,
            kind,
            default,
            allowed,
            meaning,
        }
    }

    /// A key that takes a whole number from `range.0` to `range.1`.
    pub const fn integer(
        name: &'static str,
        default: &'static str,
        range: (f64, f64),
        allowed: &'static str,
        meaning: &'static str,
    ) -> Self {
        let (least, most) = range;
        Self::new(
            name,
            Kind::Integer { least, most },
            default,
            allowed,
            meaning,
        )
    }

    /// A key that takes a number from `range.0` to `range.1`.
    pub const fn number(
        name: &'static str,
        default: &'static str,
        range: (f64, f64),
        allowed: &'static str,
        meaning: &'static str,
    ) -> Self {
        let (least, most) = range;
        Self::new(
            name,
            Kind::Number { least, most },
            default,
            allowed,
            meaning,
        )
    }

    /// The table that it stands in; empty at the top.
    pub fn table(&self) -> &'static str {
        self.name.rsplit_once('.').map_or("", |(table, _)| table)
    }

    /// Its name in its table.
    pub fn last(&self) -> &'static str {
        self.name
            .rsplit_once('.')
            .map_or(self.name, |(_, last)| last)
    }

    /// Least and largest number that it takes, where it takes numbers.
    pub fn range(&self) -> Option<(f64, f64)> {
        match self.kind {
            Kind::Integer { least, most }
            | Kind::Number { least, most }
            | Kind::Numbers { least, most, .. } => Some((least, most)),
            _ => None,
        }
    }

    /// Whether a number is in its range; not a number never is.
    pub fn admits(&self, value: f64) -> bool {
        self.range()
            .is_none_or(|(least, most)| (least..=most).contains(&value))
    }

    fn kind_name(&self) -> String {
        match self.kind {
            Kind::Path => "path".into(),
            Kind::Text => "text".into(),
            Kind::Switch => "true or false".into(),
            Kind::Word => "word".into(),
            Kind::Integer { .. } => "integer".into(),
            Kind::Number { .. } => "number".into(),
            Kind::Numbers { count, .. } => format!("{count} numbers"),
            Kind::List { .. } => "list".into(),
            Kind::Table => "table".into(),
        }
    }

    /// Keys as tables of Markdown, one for each table of the file, in their order.
    pub fn reference(keys: &[Self]) -> String {
        let mut text = String::new();
        let mut table = None;
        for key in keys {
            if table != Some(key.table()) {
                let is_list = keys
                    .iter()
                    .any(|k| k.name == key.table() && matches!(k.kind, Kind::List { .. }));
                let _ = match (key.table(), table) {
                    ("", None) => Ok(()),
                    ("", Some(_)) => writeln!(text, "\n### At the top"),
                    (name, _) if is_list => writeln!(text, "\n### `[[{name}]]`"),
                    (name, _) => writeln!(text, "\n### `[{name}]`"),
                };
                table = Some(key.table());
                text += "\n| key | takes | default | allowed | meaning |\n|---|---|---|---|---|\n";
            }
            let is_toml = |text: &str| format!("x = {text}").parse::<toml::Table>().is_ok();
            let default = match key.default {
                "" => "must be given".to_owned(),
                value if is_toml(value) => format!("`{value}`"),
                words => words.to_owned(),
            };
            let _ = writeln!(
                text,
                "| `{}` | {} | {default} | {} | {} |",
                key.last(),
                key.kind_name(),
                key.allowed.replace('|', "\\|"),
                key.meaning.replace('|', "\\|"),
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_admits_its_range_with_its_ends_and_nothing_else() {
        let key = Key::number("a.b.c", "1.0", (0.5, 2.0), "0.5 to 2 m", "a length");
        for (value, good) in [(0.5, true), (2.0, true), (0.4, false), (2.1, false)] {
            assert_eq!(key.admits(value), good, "{value}");
        }
        assert!(!key.admits(f64::NAN) && !key.admits(f64::INFINITY));
        assert_eq!((key.table(), key.last()), ("a.b", "c"));
    }

    #[test]
    fn the_reference_has_a_row_a_key_under_its_table() {
        let text = Key::reference(&[
            Key::new("scene", Kind::Path, "", "a file", "the scene"),
            Key::integer("law.np", "3", (1.0, 40.0), "1 to 40", "steps"),
        ]);
        assert!(text.contains("| `scene` | path | must be given | a file | the scene |"));
        assert!(text.contains("### `[law]`"));
        assert!(text.contains("| `np` | integer | `3` | 1 to 40 | steps |"));
    }
}
