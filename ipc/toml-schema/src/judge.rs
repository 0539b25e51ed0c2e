//! Whether a schema allows a value.

use std::borrow::Cow;
use std::fmt;

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value as Json;
use toml::Value;

use crate::schema::{allowed, needed, schema, words};

/// Characters of the longest whole number, with its sign.
const LONG: usize = 20;

/// A key whose value is not allowed, or that is missing.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal {
    /// The key with its tables: `law.np`, `pattern.points[2]`.
    pub key: String,
    /// What was found, if anything.
    pub value: Option<String>,
    /// What is allowed.
    pub allowed: String,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.value {
            Some(value) => write!(f, "{} = {}; ", self.key, short(value))?,
            None => write!(f, "{} is missing; ", self.key)?,
        }
        write!(f, "allowed: {}", self.allowed)
    }
}

/// A number of many digits by its power of ten.
fn short(value: &str) -> Cow<'_, str> {
    match value.parse::<f64>() {
        Ok(number) if value.len() > LONG => Cow::Owned(format!("{number:e}")),
        _ => Cow::Borrowed(value),
    }
}

impl std::error::Error for Refusal {}

/// Checks a struct that did not come from a file.
///
/// # Errors
/// [`Refusal`] names the first key that is wrong.
pub fn check<T: Serialize + JsonSchema>(value: &T) -> Result<(), Refusal> {
    let judged = Value::try_from(value).map(|value| judge(&schema::<T>(), &value, ""));
    match judged {
        Ok(Err(Some(refusal))) => Err(refusal),
        _ => Ok(()),
    }
}

/// Checks the values of a table and all below it. `Err(None)` means that it stopped at an unknown
/// key or a wrong type, of which serde tells more.
pub(crate) fn judge(schema: &Json, value: &Value, key: &str) -> Result<(), Option<Refusal>> {
    let refuse = |value: String| {
        Err(Some(Refusal {
            key: key.to_owned(),
            value: Some(value),
            allowed: allowed(schema),
        }))
    };
    let within = |x: f64, low: &str, high: &str| {
        let is_above = schema[low].as_f64().is_none_or(|low| x >= low);
        is_above && schema[high].as_f64().is_none_or(|high| x <= high)
    };
    let is_multiple = |x: f64| schema["multipleOf"].as_f64().is_none_or(|of| x % of == 0.0);
    match value {
        // Of a word serde tells less: not which there are.
        _ if words(schema).is_some() && !value.is_str() => return refuse(value.to_string()),
        Value::Table(table) => return judge_table(schema, table, key),
        Value::Integer(_) | Value::Float(_) | Value::String(_) | Value::Boolean(_)
            if !is_of_type(value, schema) =>
        {
            return Err(None);
        }
        Value::Array(list) => {
            if schema["type"] != "array" {
                return Err(None);
            }
            if !within(list.len() as f64, "minItems", "maxItems") {
                return refuse(format!("a list of {}", list.len()));
            }
            for (index, item) in list.iter().enumerate() {
                judge(&schema["items"], item, &format!("{key}[{index}]"))?;
            }
        }
        Value::String(word)
            if words(schema).is_some_and(|words| !words.contains(&word.as_str())) =>
        {
            return refuse(word.clone());
        }
        // Bounds of whole numbers are far from where floating point rounds them.
        Value::Integer(number) if !within(*number as f64, "minimum", "maximum") => {
            return refuse(number.to_string());
        }
        // Not a number is in no range.
        Value::Float(number)
            if number.is_nan()
                || !within(*number, "minimum", "maximum")
                || !is_multiple(*number) =>
        {
            return refuse(number.to_string());
        }
        _ => (),
    }
    Ok(())
}

/// Returns whether a value that is no table and no list has the type that its schema names, if it
/// names one.
fn is_of_type(value: &Value, schema: &Json) -> bool {
    match schema["type"].as_str() {
        Some("integer") => value.is_integer(),
        Some("number") => value.is_integer() || value.is_float(),
        Some("string") => value.is_str(),
        Some("boolean") => value.is_bool(),
        Some(_) => false,
        None => true,
    }
}

fn judge_table(schema: &Json, table: &toml::Table, key: &str) -> Result<(), Option<Refusal>> {
    let full = |name: &str| match key {
        "" => name.to_owned(),
        _ => format!("{key}.{name}"),
    };
    // A table of one of several forms: the one that knows its keys.
    let knows = |schema: &&Json| {
        table
            .keys()
            .all(|name| !schema["properties"][name].is_null())
    };
    let forms = schema["oneOf"].as_array();
    let schema = forms
        .and_then(|forms| forms.iter().find(knows))
        .unwrap_or(schema);
    for (name, value) in table {
        let known = &schema["properties"][name];
        let other = &schema["additionalProperties"];
        match (known, other) {
            (Json::Object(_), _) => judge(known, value, &full(name))?,
            (_, Json::Object(_)) => judge(other, value, &full(name))?,
            _ => return Err(None),
        }
    }
    let required = schema["required"].as_array().into_iter().flatten();
    for name in required.filter_map(Json::as_str) {
        if !table.contains_key(name) {
            return Err(Some(Refusal {
                key: full(name),
                value: None,
                allowed: needed(&schema["properties"][name]),
            }));
        }
    }
    Ok(())
}
