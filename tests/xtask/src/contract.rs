//! `ipc/CONTRACT.md`: the tables of services, messages and codes, between markers.

use std::fmt::Write as _;

use anyhow::Context;
use ipc::{Qos, SERVICES, Table};

use crate::doc::{self, structs, tables};

fn services() -> String {
    let mut text = "\
| Service | Payload type name | Bytes | `history_size` | `subscriber_max_buffer_size` | `max_subscribers` | `max_publishers` | Publisher |
|---|---|---|---|---|---|---|---|
"
    .to_owned();
    for service in SERVICES {
        let Qos {
            history,
            buffer,
            subscribers,
            publishers,
        } = service.qos;
        let (name, type_name) = (service.name, service.type_name);
        let (size, publisher) = (service.size, service.publisher);
        let _ = writeln!(
            text,
            "| `{name}` | `{type_name}` | {size} | {history} | {buffer} | {subscribers} | {publishers} | {publisher} |"
        );
    }
    text
}

fn messages() -> String {
    let mut text = String::new();
    for message in structs() {
        let (name, size, doc) = (message.name, message.size, message.doc);
        let _ = writeln!(text, "**{name}** ({size} bytes). {doc}\n");
        text += "| Offset | Type | Field | Meaning |\n|---|---|---|---|\n";
        for field in message.fields {
            let mut kind = doc::kind(field).to_owned();
            if field.count > 1 {
                kind += &format!("[{}]", field.count);
            }
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
    let mut row = |table: &Table| {
        let values = table.names.iter();
        let values: Vec<String> = values
            .map(|value| format!("{} {}", value.number, value.text))
            .collect();
        let _ = writeln!(text, "| `{}` | {} |", table.name, values.join(", "));
    };
    tables(false).into_iter().for_each(&mut row);
    tables(true).into_iter().for_each(&mut row);
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
