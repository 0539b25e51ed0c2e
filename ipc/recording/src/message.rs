//! The messages of the contract in a recording: JSON schemas and JSON.

use messages::{Field, Kind, Meaning, Message, Stamp, Wire};
use serde_json::{Map, Value, json};

use crate::error::FieldError;
use crate::field::{self, NON_FINITE};

/// How the messages of a topic are encoded.
#[derive(Clone, Debug)]
pub struct Encoding {
    /// Name, encoding and data of the schema.
    pub schema: (String, String, Vec<u8>),
    /// Encoding of the messages.
    pub message: String,
}

/// A message of the contract as JSON: each field under its own name, numbers exact.
pub trait Recorded: Message {
    /// Name of its schema.
    fn schema_name() -> String {
        schema_name::<Self>()
    }

    /// Its JSON schema.
    fn schema() -> Value {
        let mut schema = object_schema::<Self>();
        schema["properties"][NON_FINITE] = json!({
            "type": "array",
            "items": { "type": "string" },
            "description": "Numbers that JSON does not have, as name=value",
        });
        schema
    }

    /// Its schema and encoding.
    fn encoding() -> Encoding {
        let schema = Self::schema().to_string().into_bytes();
        Encoding {
            schema: (Self::schema_name(), "jsonschema".to_owned(), schema),
            message: "json".to_owned(),
        }
    }

    /// The message as JSON.
    fn to_json(&self) -> String {
        field::write(self)
    }

    /// The message of some JSON, equal to the one that was written (all NaN count as equal).
    ///
    /// # Errors
    /// [`FieldError`] names the field that is missing or of another type.
    fn from_json(json: &Value) -> Result<Self, FieldError> {
        field::read(json)
    }
}

impl<T: Message> Recorded for T {}

/// `vpc.CycleRecord.` and the layout of the message.
fn schema_name<T: Wire>() -> String {
    T::TYPE_NAME.replace('/', ".")
}

fn object_schema<T: Wire>() -> Value {
    let mut properties = Map::new();
    for field in T::FIELDS {
        properties.insert(field.name.to_owned(), field_schema(field));
        if let Some(key) = field::name_key(field) {
            let description = format!("Name of `{}`.", field.name);
            let schema = json!({ "type": "string", "description": description });
            properties.insert(key, schema);
        }
    }
    json!({
        "title": schema_name::<T>(),
        "description": plain(T::DOC),
        "type": "object",
        "properties": properties,
    })
}

fn field_schema(field: &Field) -> Value {
    let number = match field.kind {
        Kind::U8 => json!({ "type": "string", "contentEncoding": "base64" }),
        Kind::U32 | Kind::U64 => json!({ "type": "integer", "minimum": 0 }),
        Kind::I64 => json!({ "type": "integer" }),
        Kind::F64 => json!({ "type": "number" }),
        Kind::Stamp => object_schema::<Stamp>(),
    };
    let mut schema = match (field.kind, field.count, field.meaning) {
        (.., Meaning::Code(table) | Meaning::AnyCode(table)) => {
            let names = table.names.iter();
            let known: Vec<Value> = names
                .map(|name| json!({ "title": constant(name.text), "const": name.number }))
                .collect();
            json!({ "oneOf": known })
        }
        (Kind::U8, ..) | (_, 1, _) => number,
        (_, count, _) => {
            json!({ "type": "array", "items": number, "minItems": count, "maxItems": count })
        }
    };
    schema["description"] = description(field).into();
    schema
}

/// Documentation with unit and bits.
fn description(field: &Field) -> String {
    let mut text = plain(field.doc);
    if !field.unit.is_empty() {
        text += &format!(" Unit: {}.", field.unit);
    }
    if let Meaning::Bits(table) = field.meaning {
        let bits = table.names.iter();
        let bits: Vec<String> = bits
            .map(|bit| format!("{} {}", bit.number, bit.text))
            .collect();
        text += &format!(" Sum of bits: {}.", bits.join(", "));
    }
    text
}

/// Documentation in one line.
fn plain(doc: &str) -> String {
    doc.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A name as constants have it: `FEATURES_OUT_OF_ORDER`.
fn constant(name: &str) -> String {
    let name = name.to_uppercase();
    let words = name.split(|c: char| !c.is_ascii_alphanumeric());
    words
        .filter(|word| !word.is_empty())
        .collect::<Vec<_>>()
        .join("_")
}

#[cfg(test)]
mod tests {
    use messages::{CycleRecord, Features, Snapshot};

    use super::*;

    fn back<T: Recorded>(message: &T) -> T {
        let json: Value = serde_json::from_str(&message.to_json()).unwrap();
        T::from_json(&json).unwrap()
    }

    #[test]
    fn numbers_come_back_bit_for_bit() {
        let mut record = CycleRecord {
            cycle: u64::MAX,
            np: u32::MAX,
            cost: 1.0 / 3.0,
            violation_px: -0.0,
            clearance_px: f64::NEG_INFINITY,
            error_px: f64::MIN_POSITIVE / 4.0,
            arrival_s: 0.1,
            lag_s: 0.3,
            ..CycleRecord::default()
        };
        record.points = std::array::from_fn(|i| (i as f64).exp() * 1e-7);
        record.twist[5] = f64::MAX;
        record.way_point[3] = f64::NAN;
        record.way_point[4] = f64::INFINITY;
        let read = back(&record);
        assert_eq!(read.violation_px.to_bits(), (-0.0_f64).to_bits());
        assert!(read.way_point[3].is_nan());
        // NaN is not equal to itself: out of the way.
        let (mut read, mut record) = (read, record);
        (read.way_point[3], record.way_point[3]) = (0.0, 0.0);
        assert_eq!(read, record);
    }

    #[test]
    fn a_number_that_is_missing_is_not_taken_for_nan() {
        let json = Features::new(&[[1.0, 2.0]; 4], 3).to_json();
        let mut json: Value = serde_json::from_str(&json).unwrap();
        let object = json.as_object_mut().unwrap();
        object.remove("exposure_ns");
        let error = Features::from_json(&json).unwrap_err().to_string();
        assert_eq!(error, "exposure_ns = nothing; allowed: 0 to 2^64-1");

        let cycle = CycleRecord::default()
            .to_json()
            .replace("cost=NaN", "cots=NaN");
        let cycle: Value = serde_json::from_str(&cycle).unwrap();
        let error = CycleRecord::from_json(&cycle).unwrap_err().to_string();
        assert!(error.starts_with("cost = nothing"), "{error}");
    }

    #[test]
    fn codes_stand_in_the_schema_by_name() {
        let schema = CycleRecord::schema();
        let hold = &schema["properties"]["hold"]["oneOf"][10];
        assert_eq!(
            hold,
            &json!({ "title": "FEATURES_OUT_OF_ORDER", "const": 10 })
        );
        assert_eq!(schema["properties"]["twist"]["maxItems"], 6);
        assert_eq!(schema["properties"]["cycle"]["type"], "integer");
    }

    #[test]
    fn codes_and_bits_have_their_names_beside_them() {
        let record = CycleRecord {
            hold: messages::Hold::Stale.code(),
            flags: 5,
            ..CycleRecord::default()
        };
        let json: Value = serde_json::from_str(&record.to_json()).unwrap();
        assert_eq!(json["hold_name"], "stale features");
        assert_eq!(json["flags_name"], "sent, suspended");
        assert_eq!(json["realtime_name"], "none");
        let schema = CycleRecord::schema();
        for key in json.as_object().unwrap().keys() {
            assert!(schema["properties"].get(key).is_some(), "{key}");
        }
        let unknown = CycleRecord {
            hold: 999,
            ..record
        };
        assert!(unknown.to_json().contains("\"hold_name\":\"unknown\""));
    }

    #[test]
    fn bytes_come_back_without_their_zeros_at_the_end() {
        let snapshot = Snapshot::new(7, 1, &[1, 0, 255, 0]).unwrap();
        let text = snapshot.to_json();
        assert!(text.contains("\"state\":\"AQD/\""), "{text}");
        assert_eq!(back(&snapshot), snapshot);
    }
}
