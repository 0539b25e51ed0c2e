//! The messages of the contract as a recording holds them: their topics, their JSON schemas, their JSON.

use ipc::{
    Action, ClockMode, CycleRecord, Features, Hold, Outcome, PhaseCode, Reply, Request, RobotMode,
    RobotState, SolverStatus, StrategyCode, TwistCommand, TwistState,
};
use serde_json::{Map, Value, json};

use crate::field::{Field, FieldError, NON_FINITE, Object, Source};

/// Codes of an enumeration are looked for up to here.
const MOST_CODES: u32 = 64;

/// A message of the contract that recordings hold: each field under its own name, numbers exact.
pub trait Recorded: ipc::Message {
    /// Topic of its channel.
    const TOPIC: &'static str;
    /// Name of its schema.
    const SCHEMA: &'static str;

    /// Its JSON schema.
    fn schema() -> Value;

    /// The message as JSON.
    fn to_json(&self) -> String;

    /// The message of some JSON, equal to the one that was written (all NaN count as equal).
    ///
    /// # Errors
    /// [`FieldError`] names the field that is missing or of another type.
    fn from_json(json: &Value) -> Result<Self, FieldError>;
}

/// The schema of a field that is found in a message by `_`, which tells its type only.
fn schema_of<T, F: Field>(
    _: impl Fn(&T) -> &F,
    about: &str,
    codes: impl Fn(u32) -> Option<String>,
) -> Value {
    let known: Vec<Value> = (0..MOST_CODES)
        .filter_map(|code| Some(json!({ "title": constant(&codes(code)?), "const": code })))
        .collect();
    let mut schema = if known.is_empty() {
        F::schema()
    } else {
        json!({ "oneOf": known })
    };
    schema["description"] = about.into();
    schema
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

macro_rules! recorded {
    ($message:ident, $topic:literal, $schema:literal, $about:literal {
        $($field:ident $(($codes:ty))? => $text:literal,)+
    }) => {
        impl Recorded for $message {
            const TOPIC: &'static str = $topic;
            const SCHEMA: &'static str = $schema;

            fn schema() -> Value {
                let mut fields = Map::new();
                $(
                    let codes = |_code: u32| -> Option<String> {
                        $(if let Some(value) = <$codes>::from_code(_code) { return Some(value.to_string()); })?
                        None
                    };
                    let schema = schema_of(|message: &Self| &message.$field, $text, codes);
                    fields.insert(stringify!($field).to_owned(), schema);
                )+
                fields.insert(NON_FINITE.to_owned(), json!({
                    "type": "array",
                    "items": { "type": "string" },
                    "description": "Numbers that JSON cannot carry, as name=value",
                }));
                json!({ "title": $schema, "description": $about, "type": "object", "properties": fields })
            }

            fn to_json(&self) -> String {
                let mut object = Object::default();
                $(object.field(stringify!($field), &self.$field);)+
                object.finish()
            }

            fn from_json(json: &Value) -> Result<Self, FieldError> {
                let source = Source::of(json)?;
                Ok(Self { $($field: source.field(stringify!($field))?,)+ })
            }
        }
    };
}

recorded!(Features, "/vpc/features", "vpc.Features", "Image features of one frame" {
    stamp => "Head; data_ns is the middle of the exposure",
    exposure_ns => "Length of the exposure, ns; 0 where unknown",
    count => "Points, 1 to 8",
    visible => "Bit i: point i was measured in this frame",
    points => "u1 v1 u2 v2 ..., px; zero past the count",
});

recorded!(TwistCommand, "/vpc/twist", "vpc.TwistCommand", "Camera velocity command" {
    stamp => "Head; data_ns is that of the features answered",
    features_sequence => "Features answered, 0 for none",
    features_published_ns => "Their published_ns",
    valid_until_ns => "The camera stops from here on, CLOCK_MONOTONIC, ns; 2^64-1 in lockstep",
    state (TwistState) => "What the controller is about",
    reserved => "0",
    twist => "Camera frame: vx vy vz m/s, wx wy wz rad/s",
});

recorded!(RobotState, "/vpc/robot", "vpc.RobotState", "State of the robot that carries the camera" {
    stamp => "Head",
    features_sequence => "Features exposed at this instant, 0 for none",
    mode (RobotMode) => "What it does with commands",
    faults => "Bits: 0 stale command, 1 command limited, 2 reflex, 3 joint limit, 4 pattern lost",
    translation => "Object in the camera frame, m",
    rotation => "Object in the camera frame, rotation vector, rad",
    twist => "Velocity carried out, camera frame, m/s and rad/s",
    joints => "Valid entries of q and dq, 0 to 7",
    reserved => "0",
    q => "Joint positions, rad",
    dq => "Joint velocities, rad/s",
    room => "0",
});

recorded!(CycleRecord, "/vpc/cycles", "vpc.CycleRecord2", "Telemetry of one cycle of the controller" {
    stamp => "Head; data_ns is when the cycle woke up",
    cycle => "Number, from 1",
    clock (ClockMode) => "What starts a cycle",
    status (SolverStatus) => "How the solver ended",
    wake_latency_ns => "Wake-up after the release, ns",
    receive_ns => "Receiving and the gate, ns",
    step_ns => "The law, ns",
    send_ns => "Sending, ns",
    overruns => "Releases missed since the start",
    features_sequence => "Features used, 0 for none",
    features_age_ns => "Their age at wake-up, ns",
    lost_records => "Records lost in the daemon since the start",
    count => "Points used, 0 to 8",
    way_point_count => "Points of the way point, 0 where the goal is tracked",
    recalled => "what the memory had to say: 0 it was not asked, 1 followed, 2 out of range",
    strategy (StrategyCode) => "Strategy of the law",
    neighbours => "Neighbours of knn",
    np => "Steps previewed",
    iterations => "Iterations of the solver",
    qp_iterations => "Active-set changes in its quadratic programs",
    hold (Hold) => "Why the law's twist was not sent",
    state (TwistState) => "What the controller is about",
    points => "Features used, u1 v1 ..., px",
    way_point => "Way point tracked instead of the goal, u1 v1 ..., px",
    twist => "Sent: vx vy vz m/s, wx wy wz rad/s, camera frame",
    cost => "The paper's running cost of the command sent",
    violation_px => "Worst violation predicted, px",
    clearance_px => "Least clearance from an occlusion, px",
    error_px => "Largest component of s - s*, px",
    realtime => "Bits of what the loop's thread got of real time, as in CONTRACT.md",
    phase (PhaseCode) => "How the grid follows the camera",
    phase_error_ns => "This release after the one that the camera's phase asks for, ns",
    minor_faults => "Page faults from wake to send, without a disk",
    major_faults => "Page faults from wake to send that waited for a disk",
    blocked => "Times that a call blocked from wake to send",
    allocations => "Calls of the heap from wake to send, where they are counted",
    room => "0",
});

recorded!(Request, "/vpc/requests", "vpc.Request", "An operator's request" {
    stamp => "Head",
    id => "Chosen by the operator; the reply bears it",
    action (Action) => "What is asked for",
    strategy (StrategyCode) => "Of the action strategy",
    neighbours => "Of knn",
    reserved => "0",
});

recorded!(Reply, "/vpc/replies", "vpc.Reply", "The controller's answer to a request" {
    stamp => "Head; data_ns is the publication of the request",
    id => "The request's",
    action (Action) => "The request's",
    outcome (Outcome) => "What became of it",
    state (TwistState) => "State after the request",
    hold (Hold) => "Its cause",
    strategy (StrategyCode) => "Strategy after the request",
    neighbours => "Of knn",
});

#[cfg(test)]
mod tests {
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
}
