//! The first value that differs, with its bits.

use messages::{Values, Wire};
use serde::Serialize;
use serde_json::Value;

use decision::control::State;

/// The first value that differs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, thiserror::Error)]
#[error(
    "cycle {cycle}: {field} differs: recorded {recorded} ({recorded_bits}), replayed {replayed} ({replayed_bits})"
)]
#[allow(missing_docs)]
pub struct Difference {
    pub cycle: u64,
    /// Of the cycle's record; of a reply (`reply.`); of the state before the cycle (`snapshot.`).
    pub field: String,
    pub recorded: String,
    /// Hexadecimal.
    pub recorded_bits: String,
    pub replayed: String,
    /// Hexadecimal.
    pub replayed_bits: String,
}

/// Compares all fields of two messages. All NaN are equal: a recording does not keep their bits.
///
/// # Errors
/// The first [`Difference`]; its field begins with `part`.
pub fn compare_messages<T: Wire>(
    cycle: u64,
    part: &str,
    recorded: &T,
    replayed: &T,
) -> Result<(), Box<Difference>> {
    for ((field, recorded), (_, replayed)) in recorded.fields().zip(replayed.fields()) {
        let (recorded, replayed) = (words(recorded), words(replayed));
        let pairs = recorded.iter().zip(&replayed).enumerate();
        for (index, (recorded, replayed)) in pairs {
            if recorded.1 != replayed.1 {
                let index = match field.count {
                    1 => String::new(),
                    _ => format!("[{index}]"),
                };
                return Err(Box::new(Difference {
                    cycle,
                    field: format!("{part}{}{index}", field.name),
                    recorded: recorded.0.clone(),
                    recorded_bits: format!("{:#018x}", recorded.1),
                    replayed: replayed.0.clone(),
                    replayed_bits: format!("{:#018x}", replayed.1),
                }));
            }
        }
    }
    Ok(())
}

/// Each number for people, and its bits.
fn words(values: Values<'_>) -> Vec<(String, u64)> {
    fn each<T: Copy + ToString>(numbers: &[T], bits: fn(T) -> u64) -> Vec<(String, u64)> {
        let word = |&number: &T| (number.to_string(), bits(number));
        numbers.iter().map(word).collect()
    }
    match values {
        Values::U8(numbers) => each(numbers, u64::from),
        Values::U32(numbers) => each(numbers, u64::from),
        Values::U64(numbers) => each(numbers, |number| number),
        Values::I64(numbers) => each(numbers, |number| number as u64),
        Values::F64(numbers) => each(numbers, |number| match number.is_nan() {
            true => f64::NAN.to_bits(),
            false => number.to_bits(),
        }),
        Values::Stamp(stamp) => stamp
            .fields()
            .flat_map(|(_, values)| words(values))
            .collect(),
    }
}

/// Compares two states, bit for bit.
///
/// # Errors
/// The first [`Difference`].
pub fn compare_states(
    cycle: u64,
    recorded: &State,
    replayed: &State,
) -> Result<(), Box<Difference>> {
    let bytes = |state| postcard::to_stdvec(state).unwrap_or_default();
    let (a, b) = (bytes(recorded), bytes(replayed));
    if a == b {
        return Ok(());
    }
    let json = |state| serde_json::to_value(state).unwrap_or_default();
    let found = first_difference("snapshot", &json(recorded), &json(replayed));
    let (field, recorded, replayed) = found.unwrap_or_else(|| {
        // JSON has no NaN, and no bits.
        let at = a.iter().zip(&b).position(|(a, b)| a != b).unwrap_or(0);
        let byte = |bytes: &[u8]| Value::from(bytes.get(at).copied());
        (
            format!("snapshot: byte {at} of the state"),
            byte(&a),
            byte(&b),
        )
    });
    Err(Box::new(Difference {
        cycle,
        field,
        recorded: recorded.to_string(),
        recorded_bits: bits(&recorded),
        replayed: replayed.to_string(),
        replayed_bits: bits(&replayed),
    }))
}

/// Path and values of the first leaf that differs.
fn first_difference(path: &str, a: &Value, b: &Value) -> Option<(String, Value, Value)> {
    match (a, b) {
        (Value::Object(a), Value::Object(b)) if a.len() == b.len() => a
            .iter()
            .zip(b.values())
            .find_map(|((name, a), b)| first_difference(&format!("{path}.{name}"), a, b)),
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            let mut pairs = a.iter().zip(b).enumerate();
            pairs.find_map(|(index, (a, b))| first_difference(&format!("{path}[{index}]"), a, b))
        }
        _ => (a != b).then(|| (path.to_owned(), a.clone(), b.clone())),
    }
}

fn bits(value: &Value) -> String {
    let bits = match value {
        Value::Number(number) => number.as_u64().or_else(|| Some(number.as_f64()?.to_bits())),
        _ => None,
    };
    bits.map_or("no number".to_owned(), |bits| format!("{bits:#018x}"))
}
