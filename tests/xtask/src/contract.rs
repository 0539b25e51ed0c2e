//! `ipc/CONTRACT.md`: the tables of services, messages and codes, between markers.

use std::fmt::Write as _;

use anyhow::Context;
use messages::{Payload, SERVICES};

use crate::doc::{self, structs, tables};

fn services() -> String {
    let mut text = "\
| Service | Payload type name | User header type name | Bytes of payload | Its alignment | `history_size` | `subscriber_max_buffer_size` | `max_subscribers` | Publishers | `subscriber_max_borrowed_samples` | Who publishes |
|---|---|---|---|---|---|---|---|---|---|---|
"
    .to_owned();
    for service in SERVICES {
        let (name, message) = (service.name, service.message);
        let (type_name, size) = (message.type_name, message.size);
        let payload = match service.payload {
            Payload::Message => format!("`{type_name}` | none | {size} | 8"),
            Payload::Bytes { alignment } => {
                format!("`u8`, a slice | `{type_name}` | as the header says | {alignment}")
            }
        };
        let (queues, publisher) = (doc::queues(service.qos, " | "), service.publisher);
        let borrowed = service.payload.borrowed();
        let _ = writeln!(
            text,
            "| `{name}` | {payload} | {queues} | {borrowed} | {publisher} |"
        );
    }
    text
}

/// Messages of observers, operators and image streams: the C header alone has their fields.
const IN_THE_HEADER: [&str; 5] = ["CycleRecord", "Snapshot", "Request", "Reply", "ImageHeader"];

fn messages() -> String {
    let mut text = String::new();
    for message in structs() {
        let (name, size, about) = (message.name, message.size, doc::one_line(message.doc));
        let _ = writeln!(text, "**{name}** ({size} bytes). {about}\n");
        if IN_THE_HEADER.contains(&name) {
            text += "Fields and offsets: [`vpc.h`](clients/c/include/vpc.h).\n\n";
            continue;
        }
        text += "| Offset | Type | Field | Meaning |\n|---|---|---|---|\n";
        for field in message.fields {
            let kind = doc::kind(field, str::to_owned, |length| format!("[{length}]"));
            let about = doc::of_field(field, |table| format!("`{}`", table.name));
            let _ = writeln!(
                text,
                "| {} | {kind} | {} | {about} |",
                field.offset, field.name
            );
        }
        text += "\n";
    }
    text
}

fn codes() -> String {
    let mut text = "| Codes | Values |\n|---|---|\n".to_owned();
    for table in [tables(false), tables(true)].concat() {
        let values = table.names.iter();
        let values = values.map(|value| format!("{} {}", value.number, value.text));
        let values = values.collect::<Vec<_>>().join(", ");
        let _ = writeln!(text, "| `{}` | {values} |", table.name);
    }
    text
}

/// Replaces what stands between the markers of `part`.
fn replaced(text: &str, part: &str, new: &str) -> anyhow::Result<String> {
    let (begin, end) = (
        format!("<!-- begin {part} -->\n"),
        format!("<!-- end {part} -->"),
    );
    let place = || format!("no {begin}... {end}");
    let (head, rest) = text.split_once(&begin).with_context(place)?;
    let (_, tail) = rest.split_once(&end).with_context(place)?;
    Ok(format!("{head}{begin}{}\n{end}{tail}", new.trim_end()))
}

/// The page with new tables.
pub fn make(present: &str) -> anyhow::Result<String> {
    let text = replaced(present, "services", &services())?;
    let text = replaced(&text, "messages", &messages())?;
    replaced(&text, "codes", &codes())
}
