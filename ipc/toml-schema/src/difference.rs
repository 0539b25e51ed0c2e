//! What differs between two documents, key by key.

use std::collections::BTreeSet;
use std::fmt;

use toml::{Table, Value};

use crate::Document;

/// A key whose values differ.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The key with its tables: `limits.linear`, `occlusion[1].name`.
    pub key: String,
    /// The old value as TOML; `none` where there is none.
    pub old: String,
    /// The new one.
    pub new: String,
}

impl Difference {
    /// Whether its key is this one, or lies within a table or list of this name.
    pub fn is_within(&self, name: &str) -> bool {
        let rest = self.key.strip_prefix(name);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { key, old, new } = self;
        write!(f, "{key}: {old} -> {new}")
    }
}

impl Document {
    /// What is different in `new`, in the order of the keys. A key that is not given differs from
    /// one that is, also where it gives the default.
    pub fn differences(&self, new: &Self) -> Vec<Difference> {
        let mut found = Vec::new();
        compare_tables("", &self.table, &new.table, &mut found);
        found
    }
}

fn compare_tables(of: &str, old: &Table, new: &Table, found: &mut Vec<Difference>) {
    let names: BTreeSet<_> = old.keys().chain(new.keys()).collect();
    for name in names {
        let key = match of {
            "" => name.clone(),
            of => format!("{of}.{name}"),
        };
        compare(&key, old.get(name), new.get(name), found);
    }
}

fn compare(key: &str, old: Option<&Value>, new: Option<&Value>, found: &mut Vec<Difference>) {
    match (old, new) {
        (Some(Value::Table(old)), Some(Value::Table(new))) => {
            compare_tables(key, old, new, found);
        }
        (Some(Value::Array(old)), Some(Value::Array(new)))
            if old.len() == new.len() && old.iter().all(Value::is_table) =>
        {
            for (i, (old, new)) in old.iter().zip(new).enumerate() {
                compare(&format!("{key}[{i}]"), Some(old), Some(new), found);
            }
        }
        (Some(old), Some(new)) if is_same(old, new) => (),
        _ => found.push(Difference {
            key: key.to_owned(),
            old: words(old),
            new: words(new),
        }),
    }
}

/// 1 is 1.0.
fn is_same(old: &Value, new: &Value) -> bool {
    let number = |value: &Value| value.as_float().or(value.as_integer().map(|i| i as f64));
    match (old, new) {
        (Value::Array(old), Value::Array(new)) => {
            old.len() == new.len() && old.iter().zip(new).all(|(old, new)| is_same(old, new))
        }
        _ => number(old)
            .zip(number(new))
            .map_or(old == new, |(old, new)| old == new),
    }
}

fn words(value: Option<&Value>) -> String {
    match value {
        None => "none".to_owned(),
        Some(Value::Table(_)) => "a table".to_owned(),
        Some(Value::Array(tables)) if tables.iter().any(Value::is_table) => {
            format!("{} tables", tables.len())
        }
        Some(value) => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_key_that_differs_is_named_with_both_values() {
        let read = |text: &str| Document::parse(text, "a.toml").unwrap();
        let old = "arm = 'a'\nrate = 30\n[limits]\nlinear = 0.5\n[[part]]\nat = [1, 2]\n";
        let found = |new: &str| {
            let found = read(old).differences(&read(new));
            found.iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        assert_eq!(
            found(&format!("# The same.\n{old}").replace("30", "30.0")),
            [""; 0]
        );
        let new = "rate = 10\n[limits]\nlinear = 5\nangular = 1\n[[part]]\nat = [1.0, 3]\n";
        let named = [
            "arm: \"a\" -> none",
            "limits.angular: none -> 1",
            "limits.linear: 0.5 -> 5",
            "part[0].at: [1, 2] -> [1.0, 3]",
            "rate: 30 -> 10",
        ];
        assert_eq!(found(new), named);
        let more = found(&format!("{old}[[part]]\nat = [1, 2]\n"));
        assert_eq!(more, ["part: 1 tables -> 2 tables"]);
    }

    #[test]
    fn a_name_stands_for_what_is_in_it() {
        let of = |key: &str, name: &str| {
            let [old, new] = ["0", "1"].map(str::to_owned);
            let key = key.to_owned();
            Difference { key, old, new }.is_within(name)
        };
        assert!(of("limits.linear", "limits") && of("limits.linear", "limits.linear"));
        assert!(of("occlusion[1].name", "occlusion") && of("arm", "arm"));
        assert!(!of("limits.linear_acceleration", "limits.linear") && !of("arm", "limits"));
    }
}
