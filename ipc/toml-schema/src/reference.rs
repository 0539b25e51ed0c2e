//! The reference page of all keys.

use std::collections::HashMap;
use std::fmt::Write;

use serde_json::Value;

use crate::schema::allowed;

/// Returns every key of a schema as tables of Markdown, one for each table of the file. Keys come
/// in the order of `example`, a file that shows them, be it as comments; what it does not show
/// comes last, by name.
pub fn reference(schema: &Value, example: &str) -> String {
    let meaning = schema["description"].as_str().unwrap_or_default();
    let mut text = format!("\n{meaning}\n");
    section(&mut text, schema, "", &places(example));
    text
}

/// The number of the line in which a file first shows each of its keys and tables, by their paths.
fn places(example: &str) -> HashMap<String, usize> {
    let (mut places, mut table) = (HashMap::new(), String::new());
    for (number, line) in example.lines().enumerate() {
        let line = line.trim_start_matches(['#', ' ']);
        if let Some((name, _)) = line.split_once(']').filter(|_| line.starts_with('[')) {
            let name = name.trim_start_matches('[');
            places.entry(name.to_owned()).or_insert(number);
            table = format!("{name}.");
        } else if let Some((key, _)) = line.split_once('=') {
            let path = format!("{table}{}", key.trim_end());
            places.entry(path).or_insert(number);
        }
    }
    places
}

fn section(text: &mut String, schema: &Value, table: &str, places: &HashMap<String, usize>) {
    let properties = schema["properties"].as_object();
    let mut properties: Vec<_> = properties.into_iter().flatten().collect();
    properties.sort_by_key(|(name, _)| {
        let place = places.get(&format!("{table}{name}"));
        place.copied().unwrap_or(usize::MAX)
    });
    let is_table = |of: &Value| of["properties"].is_object();
    let mut rows = properties
        .iter()
        .filter(|(_, key)| !is_table(key))
        .peekable();
    if rows.peek().is_some() {
        *text += "\n| key | default; allowed | meaning |\n|---|---|---|\n";
    }
    for (name, key) in rows {
        let is_required = schema["required"]
            .as_array()
            .is_some_and(|list| list.contains(&name.as_str().into()));
        let _ = writeln!(
            text,
            "| `{name}` | {} |",
            cells(key, is_required)
                .map(|cell| cell.replace('|', "\\|"))
                .join(" | ")
        );
    }
    for (name, key) in properties {
        let table = format!("{table}{name}");
        let (inner, head) = match key["type"].as_str() {
            Some("array") => (&key["items"], format!("`[[{table}]]`")),
            _ => (key, format!("`[{table}]`")),
        };
        if is_table(inner) {
            let meaning = inner["description"].as_str().unwrap_or_default();
            let _ = write!(text, "\n### {head}\n\n{meaning}\n");
            section(text, inner, &format!("{table}."), places);
        }
    }
}

/// Default with what is allowed, and meaning.
fn cells(key: &Value, is_required: bool) -> [String; 2] {
    let string = |name: &str| key[name].as_str().unwrap_or_default().to_owned();
    let default = match (&key["default"], string("x-default")) {
        (Value::Null, words) if words.is_empty() => {
            if is_required { "required" } else { "none" }.to_owned()
        }
        (Value::Null, words) => words,
        (value, _) => format!("`{}`", toml(value)),
    };
    let (mut allowed, mut meaning) = (allowed(key), string("description"));
    // Words that have a meaning of their own say themselves what is allowed.
    for one in key["oneOf"].as_array().into_iter().flatten() {
        if let (Some(word), Some(words)) = (one["const"].as_str(), one["description"].as_str()) {
            let _ = write!(meaning, " `{word}`: {words}");
            allowed.clear();
        }
    }
    let value = match allowed.as_str() {
        "" => default,
        allowed => format!("{default}; {allowed}"),
    };
    [value, meaning.trim_start().to_owned()]
}

/// A value as TOML writes it.
fn toml(value: &Value) -> String {
    match value {
        Value::Object(table) => {
            let pairs: Vec<_> = table
                .iter()
                .map(|(key, value)| format!("{key} = {}", toml(value)))
                .collect();
            if pairs.is_empty() {
                "{}".to_owned()
            } else {
                format!("{{ {} }}", pairs.join(", "))
            }
        }
        Value::Array(list) => format!("[{}]", list.iter().map(toml).collect::<Vec<_>>().join(", ")),
        other => other.to_string(),
    }
}
