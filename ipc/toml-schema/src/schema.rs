//! The JSON Schema of a file, and its rules in words.

use schemars::generate::SchemaSettings;
use schemars::transform::{RecursiveTransform, transform_subschemas};
use schemars::{JsonSchema, Schema};
use serde_json::Value;

/// Returns the JSON Schema (draft 7, which TOML editors know) of a file that is read into a `T`,
/// without references.
pub fn schema<T: JsonSchema>() -> Value {
    let settings = SchemaSettings::draft07().with(|settings| settings.inline_subschemas = true);
    let settings = settings.with_transform(RecursiveTransform(for_toml));
    settings.into_generator().into_root_schema_for::<T>().into()
}

/// Returns the text of a `*.schema.json` file: a [`schema`], with what is allowed in the
/// descriptions that editors show.
pub fn schema_file(schema: Value) -> String {
    fn describe(schema: &mut Schema) {
        let words = allowed(schema.as_value());
        if let Some(Value::String(text)) = schema.get_mut("description")
            && !words.is_empty()
        {
            *text = format!("{text} Allowed: {words}.");
        }
        transform_subschemas(&mut describe, schema);
    }
    let mut schema = Schema::try_from(schema).unwrap_or_default();
    describe(&mut schema);
    format!("{:#}\n", schema.as_value())
}

/// Removes what TOML does not have (null) and what only Rust has (formats of integers), and lets
/// items know their unit.
fn for_toml(schema: &mut Schema) {
    schema.remove("format");
    if let Some(Value::Array(types)) = schema.get_mut("type") {
        types.retain(|name| name != "null");
        if let [only] = types.as_slice() {
            let only = only.clone();
            schema.insert("type".to_owned(), only);
        }
    }
    // The defaults of a table are those of its keys.
    let is_table = schema.get("properties").is_some();
    if is_table || schema.get("default").is_some_and(Value::is_null) {
        schema.remove("default");
    }
    if let Some(Value::String(text)) = schema.get_mut("description") {
        *text = text.replace('\n', " ");
    }
    if let (Some(unit), Some(Value::Object(items))) =
        (schema.get("x-unit").cloned(), schema.get_mut("items"))
    {
        items.insert("x-unit".to_owned(), unit);
    }
}

/// Returns the words that a string may be, if it is not free.
pub(crate) fn words(schema: &Value) -> Option<Vec<&str>> {
    // A key that may be missing: its own form, or null.
    if let Some(form) = schema["anyOf"].get(0) {
        return words(form);
    }
    if let Value::Array(words) = &schema["enum"] {
        return Some(words.iter().filter_map(Value::as_str).collect());
    }
    let mut found = Vec::new();
    for one in schema["oneOf"].as_array()? {
        match &one["const"] {
            Value::String(word) => found.push(word.as_str()),
            _ => found.extend(words(one)?),
        }
    }
    Some(found)
}

/// Returns what is allowed in words, for instance `0 to 20 ms`; nothing if everything of the
/// type is.
pub(crate) fn allowed(schema: &Value) -> String {
    if let Value::String(words) = &schema["x-allowed"] {
        return words.clone();
    }
    if let Some(words) = words(schema) {
        return words.join(", ");
    }
    let range = |low: &str, high: &str| match (number(&schema[low]), number(&schema[high])) {
        (Some(low), Some(high)) if low == high => low,
        (Some(low), Some(high)) => format!("{low} to {high}"),
        (Some(low), None) => format!("{low} or more"),
        (None, Some(high)) => format!("at most {high}"),
        (None, None) => String::new(),
    };
    let items = &schema["items"];
    match (schema["type"].as_str(), items["type"].as_str()) {
        (Some("array"), Some("number" | "integer")) => {
            let numbers = format!("{} numbers, ", range("minItems", "maxItems"));
            (numbers + &allowed(items))
                .trim_end_matches(", ")
                .trim_start()
                .to_owned()
        }
        (Some("array"), Some("string")) => format!("{} words", range("minItems", "maxItems")),
        (Some("array"), Some("array")) => {
            format!(
                "{} lists of {}",
                range("minItems", "maxItems"),
                allowed(items)
            )
        }
        (Some("array"), _) => format!("{} tables", range("minItems", "maxItems")),
        _ => {
            let unit = schema["x-unit"].as_str().unwrap_or_default();
            format!("{} {unit}", range("minimum", "maximum"))
                .trim()
                .to_owned()
        }
    }
}

/// Returns what is [`allowed`]; where all of the type is, the type, and of a table also the keys
/// that it needs.
pub(crate) fn needed(schema: &Value) -> String {
    let keys = |schema: &Value, by: &str| {
        let keys = schema["required"].as_array().into_iter().flatten();
        keys.filter_map(Value::as_str).collect::<Vec<_>>().join(by)
    };
    let words = allowed(schema);
    if !words.is_empty() {
        return words;
    }
    if let Some(forms) = schema["oneOf"].as_array() {
        let forms: Vec<_> = forms.iter().map(|form| keys(form, " and ")).collect();
        return format!("a table with {}", forms.join(", or "));
    }
    match schema["type"].as_str() {
        Some("object") => format!("a table with {}", keys(schema, ", ")),
        Some("integer") => "a whole number".to_owned(),
        Some("boolean") => "true, false".to_owned(),
        Some(name) => format!("a {name}"),
        None => "a value".to_owned(),
    }
}

/// Returns the shorter of `10000` and `1e4`.
fn number(value: &Value) -> Option<String> {
    let value = value.as_f64()?;
    if value.abs() == std::f64::consts::PI {
        return Some(format!("{}pi", if value < 0.0 { "-" } else { "" }));
    }
    let (plain, short) = (format!("{value}"), format!("{value:e}"));
    let is_plain = plain.len() <= short.len() + 1;
    Some(if is_plain { plain } else { short })
}
