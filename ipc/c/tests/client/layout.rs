//! Sizes and offsets, as the compiler has them.

use std::mem::{align_of, offset_of, size_of};

use ipc::{CycleRecord, Features, Reply, Request, RobotState, Stamp, TwistCommand};
use vpcclient::camera::Sent;

use crate::source::Source;

/// Where a struct keeps what.
#[derive(Debug)]
pub struct Layout {
    pub name: &'static str,
    pub size: usize,
    pub align: usize,
    /// Name, offset, size.
    pub fields: Vec<(&'static str, usize, usize)>,
}

/// Size of a field.
fn size_of_field<T, F>(_: impl Fn(&T) -> &F) -> usize {
    size_of::<F>()
}

macro_rules! layouts {
    ($($message:ident { $($field:ident)* })*) => {
        vec![$(Layout {
            name: stringify!($message),
            size: size_of::<$message>(),
            align: align_of::<$message>(),
            fields: vec![$((
                stringify!($field),
                offset_of!($message, $field),
                size_of_field(|message: &$message| &message.$field),
            )),*],
        }),*]
    };
}

/// The layout of everything that C sees inside of.
pub fn layouts() -> Vec<Layout> {
    layouts! {
        Stamp { sequence published_ns data_ns }
        Features { stamp exposure_ns count visible points }
        TwistCommand {
            stamp features_sequence features_published_ns valid_until_ns state reserved twist
        }
        RobotState {
            stamp features_sequence mode faults translation rotation twist joints reserved q dq room
        }
        CycleRecord {
            stamp cycle clock status wake_latency_ns receive_ns step_ns send_ns overruns
            features_sequence features_age_ns lost_records count way_point_count recalled strategy
            neighbours np iterations qp_iterations hold state points way_point twist cost
            violation_px clearance_px error_px realtime phase phase_error_ns minor_faults
            major_faults blocked allocations room
        }
        Request { stamp id action strategy neighbours reserved }
        Reply { stamp id action outcome state hold strategy neighbours }
        Sent { sequence published_ns }
    }
}

/// Nothing that the sources declare may be missing above.
pub fn assert_complete(source: &Source) {
    let layouts = layouts();
    for message in &source.messages {
        let layout = layouts.iter().find(|layout| layout.name == message.name);
        let layout = layout.unwrap_or_else(|| panic!("layout.rs lacks {}", message.name));
        let ours: Vec<&str> = layout.fields.iter().map(|(name, ..)| *name).collect();
        let theirs: Vec<&str> = message.fields.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(ours, theirs, "layout.rs: {}", message.name);
    }
}
