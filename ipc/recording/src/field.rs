//! How one field of a message becomes JSON, and comes back bit for bit.
//!
//! JSON carries finite numbers only. A field that is NaN or infinite is left out (an element of an array becomes 0) and
//! the message's list `non_finite` names it with its value: `clearance_px=inf`, `points[3]=NaN`. Schemas then need no
//! unions of types, which Foxglove refuses.

use std::fmt::Write;

use ipc::Stamp;
use serde_json::{Map, Value, json};

/// Name of the list of numbers that JSON cannot carry.
pub(crate) const NON_FINITE: &str = "non_finite";

/// Why a message could not be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} = {found}; allowed: {allowed}")]
pub struct FieldError {
    /// The field.
    pub field: String,
    /// What was found.
    pub found: String,
    /// What is allowed.
    pub allowed: &'static str,
}

/// A JSON object under construction.
#[derive(Debug, Default)]
pub(crate) struct Object {
    text: String,
    non_finite: Vec<String>,
}

impl Object {
    pub(crate) fn field<F: Field>(&mut self, name: &str, field: &F) {
        field.write(name, self);
    }

    pub(crate) fn finish(mut self) -> String {
        if !self.non_finite.is_empty() {
            let list = Value::from(std::mem::take(&mut self.non_finite));
            self.begin(NON_FINITE);
            self.put(format_args!("{list}"));
        }
        if self.text.is_empty() {
            self.text.push('{');
        }
        self.text.push('}');
        self.text
    }

    fn begin(&mut self, name: &str) {
        let head = if self.text.is_empty() { '{' } else { ',' };
        self.put(format_args!("{head}\"{name}\":"));
    }

    /// Formatting into a string cannot fail.
    fn put(&mut self, text: std::fmt::Arguments<'_>) {
        let _ = self.text.write_fmt(text);
    }
}

/// A JSON object that is being read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Source<'a> {
    object: &'a Map<String, Value>,
}

impl<'a> Source<'a> {
    pub(crate) fn of(value: &'a Value) -> Result<Self, FieldError> {
        match value.as_object() {
            Some(object) => Ok(Self { object }),
            None => Err(wrong("message", Some(value), "an object")),
        }
    }

    pub(crate) fn field<F: Field>(self, name: &str) -> Result<F, FieldError> {
        F::read(name, self)
    }

    fn get(self, name: &str) -> Option<&'a Value> {
        self.object.get(name)
    }

    /// The value of a number that JSON could not carry.
    fn non_finite(self, place: &str) -> Option<f64> {
        let list = self.get(NON_FINITE)?.as_array()?;
        list.iter()
            .filter_map(Value::as_str)
            .filter_map(|entry| entry.split_once('='))
            .find(|(name, _)| *name == place)
            .and_then(|(_, value)| value.parse().ok())
    }
}

fn wrong(field: &str, found: Option<&Value>, allowed: &'static str) -> FieldError {
    let found = found.map_or_else(|| "nothing".to_owned(), Value::to_string);
    FieldError {
        field: field.to_owned(),
        found: found.chars().take(80).collect(),
        allowed,
    }
}

/// A type of field.
pub(crate) trait Field: Sized {
    /// Its JSON schema, without a description.
    fn schema() -> Value;
    fn write(&self, name: &str, to: &mut Object);
    fn read(name: &str, from: Source<'_>) -> Result<Self, FieldError>;
}

impl Field for u64 {
    fn schema() -> Value {
        json!({ "type": "integer", "minimum": 0 })
    }

    fn write(&self, name: &str, to: &mut Object) {
        to.begin(name);
        to.put(format_args!("{self}"));
    }

    fn read(name: &str, from: Source<'_>) -> Result<Self, FieldError> {
        let found = from.get(name);
        let number = found.and_then(Value::as_u64);
        number.ok_or_else(|| wrong(name, found, "0 to 2^64-1"))
    }
}

impl Field for u32 {
    fn schema() -> Value {
        u64::schema()
    }

    fn write(&self, name: &str, to: &mut Object) {
        u64::from(*self).write(name, to);
    }

    fn read(name: &str, from: Source<'_>) -> Result<Self, FieldError> {
        let number = u64::read(name, from)?;
        Self::try_from(number).map_err(|_| wrong(name, from.get(name), "0 to 2^32-1"))
    }
}

impl Field for i64 {
    fn schema() -> Value {
        json!({ "type": "integer" })
    }

    fn write(&self, name: &str, to: &mut Object) {
        to.begin(name);
        to.put(format_args!("{self}"));
    }

    fn read(name: &str, from: Source<'_>) -> Result<Self, FieldError> {
        let found = from.get(name);
        let number = found.and_then(Value::as_i64);
        number.ok_or_else(|| wrong(name, found, "-2^63 to 2^63-1"))
    }
}

impl<const N: usize> Field for [u64; N] {
    fn schema() -> Value {
        let items = u64::schema();
        json!({ "type": "array", "items": items, "minItems": N, "maxItems": N })
    }

    fn write(&self, name: &str, to: &mut Object) {
        to.begin(name);
        let list = Value::from(self.as_slice());
        to.put(format_args!("{list}"));
    }

    fn read(name: &str, from: Source<'_>) -> Result<Self, FieldError> {
        let found = from.get(name);
        let list = found.and_then(Value::as_array);
        let numbers: Option<Vec<u64>> =
            list.and_then(|list| list.iter().map(Value::as_u64).collect());
        numbers
            .and_then(|numbers| Self::try_from(numbers).ok())
            .ok_or_else(|| {
                wrong(
                    name,
                    found,
                    "an array of whole numbers of the schema's length",
                )
            })
    }
}

impl Field for f64 {
    fn schema() -> Value {
        json!({ "type": "number" })
    }

    fn write(&self, name: &str, to: &mut Object) {
        if self.is_finite() {
            to.begin(name);
            // The shortest digits that give the same number back.
            to.put(format_args!("{self:?}"));
        } else {
            to.non_finite.push(format!("{name}={self}"));
        }
    }

    fn read(name: &str, from: Source<'_>) -> Result<Self, FieldError> {
        let found = from.get(name);
        let number = found.and_then(Value::as_f64);
        number
            .or_else(|| from.non_finite(name))
            .ok_or_else(|| wrong(name, found, "a number, or an entry in non_finite"))
    }
}

impl<const N: usize> Field for [f64; N] {
    fn schema() -> Value {
        json!({ "type": "array", "items": { "type": "number" }, "minItems": N, "maxItems": N })
    }

    fn write(&self, name: &str, to: &mut Object) {
        to.begin(name);
        for (i, x) in self.iter().enumerate() {
            let head = if i == 0 { '[' } else { ',' };
            let carried = if x.is_finite() { *x } else { 0.0 };
            to.put(format_args!("{head}{carried:?}"));
            if !x.is_finite() {
                to.non_finite.push(format!("{name}[{i}]={x}"));
            }
        }
        to.put(format_args!("{}", if N == 0 { "[]" } else { "]" }));
    }

    fn read(name: &str, from: Source<'_>) -> Result<Self, FieldError> {
        let found = from.get(name);
        let refuse = || wrong(name, found, "an array of numbers of the schema's length");
        let list = found.and_then(Value::as_array).ok_or_else(refuse)?;
        if list.len() != N {
            return Err(refuse());
        }
        let mut numbers = [0.0; N];
        for (i, (to, value)) in numbers.iter_mut().zip(list).enumerate() {
            let carried = value.as_f64().ok_or_else(refuse)?;
            *to = from.non_finite(&format!("{name}[{i}]")).unwrap_or(carried);
        }
        Ok(numbers)
    }
}

impl Field for Stamp {
    fn schema() -> Value {
        let number = |about: &str| {
            let mut schema = u64::schema();
            schema["description"] = about.into();
            schema
        };
        json!({
            "type": "object",
            "title": "vpc.Stamp",
            "properties": {
                "sequence": number("Number of the message, from 1; a publisher that restarts begins again"),
                "published_ns": number("When it was published, CLOCK_MONOTONIC, ns"),
                "data_ns": number("The instant that it describes, CLOCK_MONOTONIC, ns"),
            },
            "required": ["sequence", "published_ns", "data_ns"],
        })
    }

    fn write(&self, name: &str, to: &mut Object) {
        let mut stamp = Object::default();
        stamp.field("sequence", &self.sequence);
        stamp.field("published_ns", &self.published_ns);
        stamp.field("data_ns", &self.data_ns);
        to.begin(name);
        to.text.push_str(&stamp.finish());
    }

    fn read(name: &str, from: Source<'_>) -> Result<Self, FieldError> {
        let found = from.get(name);
        let stamp = Source::of(found.ok_or_else(|| wrong(name, None, "a stamp"))?)?;
        Ok(Self {
            sequence: stamp.field("sequence")?,
            published_ns: stamp.field("published_ns")?,
            data_ns: stamp.field("data_ns")?,
        })
    }
}
