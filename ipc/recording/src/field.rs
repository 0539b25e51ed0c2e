//! How the fields of a message become JSON, and come back bit for bit.
//!
//! JSON has finite numbers only. A number that is NaN or infinite is left out (an element of an
//! array becomes 0), and the message's list `non_finite` has its name and value:
//! `clearance_px=inf`, `points[3]=NaN`. Schemas then need no unions of types, which Foxglove
//! refuses. Bytes become base64 without the zeros at their end. Beside each code or sum of bits
//! stands its name: `"hold":2,"hold_name":"stale features"`.

use std::fmt::{Display, Write};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use messages::{Field, Meaning, Values, ValuesMut, Wire};
use serde_json::{Map, Value};

use crate::error::FieldError;

/// Name of the list of numbers that JSON does not have.
pub(crate) const NON_FINITE: &str = "non_finite";

/// The fields as a JSON object.
pub(crate) fn write(message: &impl Wire) -> String {
    let mut text = String::new();
    let mut non_finite = Vec::new();
    for (field, values) in message.fields() {
        match values {
            Values::Stamp(stamp) => put(&mut text, field, [write(stamp)]),
            Values::U8(bytes) => {
                let used = bytes.iter().rposition(|&byte| byte != 0);
                let used = &bytes[..used.map_or(0, |last| last + 1)];
                let quoted = format!("\"{}\"", STANDARD.encode(used));
                entry(&mut text, field.name, quoted);
            }
            Values::U32(numbers) => {
                put(&mut text, field, numbers);
                if let (Some(key), [number]) = (name_key(field), numbers) {
                    entry(&mut text, &key, Value::from(name(field.meaning, *number)));
                }
            }
            Values::U64(numbers) => put(&mut text, field, numbers),
            Values::I64(numbers) => put(&mut text, field, numbers),
            Values::F64(numbers) => write_reals(&mut text, &mut non_finite, field, numbers),
        }
    }
    if !non_finite.is_empty() {
        entry(&mut text, NON_FINITE, Value::from(non_finite));
    }
    text.push('}');
    text
}

fn write_reals(text: &mut String, non_finite: &mut Vec<String>, field: &Field, numbers: &[f64]) {
    for (i, x) in numbers.iter().enumerate().filter(|(_, x)| !x.is_finite()) {
        non_finite.push(format!("{}={x}", element(field, i)));
    }
    if field.count > 1 || numbers.iter().all(|x| x.is_finite()) {
        let finite = numbers.iter().map(|x| if x.is_finite() { *x } else { 0.0 });
        // The shortest digits that give the same number back.
        put(text, field, finite.map(|x| format!("{x:?}")));
    }
}

/// Key of the name of a code or of a sum of bits; `None` where the numbers have no names.
pub(crate) fn name_key(field: &Field) -> Option<String> {
    field
        .meaning
        .table()
        .map(|_| format!("{}_name", field.name))
}

/// The name of a code, or the names of all bits; "unknown" where the table has none.
fn name(meaning: Meaning, number: u32) -> String {
    let known = meaning.table().map_or(&[][..], |table| table.names);
    match meaning {
        Meaning::Bits(_) => {
            let set = known.iter().filter(|bit| number & bit.number != 0);
            let set: Vec<_> = set.map(|bit| bit.text).collect();
            match (set.is_empty(), number) {
                (true, 0) => "none".to_owned(),
                (true, _) => "unknown".to_owned(),
                (false, _) => set.join(", "),
            }
        }
        _ => {
            let found = known.iter().find(|name| name.number == number);
            found.map_or("unknown", |name| name.text).to_owned()
        }
    }
}

/// Name of a number: `points[3]`, `cost`.
fn element(field: &Field, index: usize) -> String {
    match field.count {
        1 => field.name.to_owned(),
        _ => format!("{}[{index}]", field.name),
    }
}

/// Writes a number, or an array of them.
fn put(text: &mut String, field: &Field, numbers: impl IntoIterator<Item: Display>) {
    let mut list = String::new();
    for number in numbers {
        let comma = if list.is_empty() { "" } else { "," };
        // Formatting into a string cannot fail.
        let _ = write!(list, "{comma}{number}");
    }
    match field.count {
        1 => entry(text, field.name, list),
        _ => entry(text, field.name, format_args!("[{list}]")),
    }
}

fn entry(text: &mut String, name: &str, value: impl Display) {
    let head = if text.is_empty() { '{' } else { ',' };
    let _ = write!(text, "{head}\"{name}\":{value}");
}

/// The message of a JSON object.
///
/// # Errors
/// [`FieldError`] names the field that is missing or of another type.
pub(crate) fn read<T: Wire>(json: &Value) -> Result<T, FieldError> {
    let object = json.as_object();
    let object = object.ok_or_else(|| wrong("message", Some(json), "an object"))?;
    let mut message = T::default();
    for (field, values) in message.fields_mut() {
        let found = object.get(field.name);
        match values {
            ValuesMut::Stamp(stamp) => *stamp = read(found.unwrap_or(&Value::Null))?,
            ValuesMut::U8(bytes) => read_bytes(field, found, bytes)?,
            ValuesMut::U32(to) => {
                let number = |value: &Value| u32::try_from(value.as_u64()?).ok();
                fill(field, found, to, number, "0 to 2^32-1")?;
            }
            ValuesMut::U64(to) => fill(field, found, to, Value::as_u64, "0 to 2^64-1")?,
            ValuesMut::I64(to) => fill(field, found, to, Value::as_i64, "-2^63 to 2^63-1")?,
            ValuesMut::F64(to) => read_reals(field, object, to)?,
        }
    }
    Ok(message)
}

fn read_bytes(field: &Field, found: Option<&Value>, to: &mut [u8]) -> Result<(), FieldError> {
    let bytes = found.and_then(Value::as_str);
    let bytes = bytes.and_then(|text| STANDARD.decode(text).ok());
    let bytes = bytes.filter(|bytes| bytes.len() <= to.len());
    let bytes = bytes.ok_or_else(|| {
        let allowed = format!("base64 of at most {} bytes", to.len());
        wrong(field.name, found, allowed)
    })?;
    to[..bytes.len()].copy_from_slice(&bytes);
    Ok(())
}

fn read_reals(
    field: &Field,
    object: &Map<String, Value>,
    to: &mut [f64],
) -> Result<(), FieldError> {
    let non_finite = |index| {
        let name = element(field, index);
        let list = object.get(NON_FINITE)?.as_array()?.iter();
        list.filter_map(|entry| entry.as_str()?.split_once('='))
            .find(|(entry, _)| *entry == name)
            .and_then(|(_, value)| value.parse().ok())
    };
    let found = object.get(field.name);
    if let ([to], None, Some(value)) = (&mut *to, found, non_finite(0)) {
        *to = value;
        return Ok(());
    }
    let allowed = "a number, or an entry in non_finite";
    fill(field, found, to, Value::as_f64, allowed)?;
    if object.contains_key(NON_FINITE) && field.count > 1 {
        for (index, to) in to.iter_mut().enumerate() {
            *to = non_finite(index).unwrap_or(*to);
        }
    }
    Ok(())
}

/// Reads a number, or an array of exactly as many as there are.
fn fill<N>(
    field: &Field,
    found: Option<&Value>,
    to: &mut [N],
    number: impl Fn(&Value) -> Option<N>,
    allowed: &str,
) -> Result<(), FieldError> {
    let given = match (found, field.count) {
        (Some(value), 1) => std::slice::from_ref(value),
        (Some(Value::Array(list)), _) => list,
        _ => &[],
    };
    let refuse = || match field.count {
        1 => wrong(field.name, found, allowed),
        count => wrong(field.name, found, format!("an array of {count}: {allowed}")),
    };
    if given.len() != to.len() {
        return Err(refuse());
    }
    for (to, value) in to.iter_mut().zip(given) {
        *to = number(value).ok_or_else(refuse)?;
    }
    Ok(())
}

fn wrong(field: &str, found: Option<&Value>, allowed: impl Into<String>) -> FieldError {
    let found = found.map_or_else(|| "nothing".to_owned(), Value::to_string);
    FieldError {
        field: field.to_owned(),
        found: found.chars().take(80).collect(),
        allowed: allowed.into(),
    }
}
