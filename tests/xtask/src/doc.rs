//! Documentation of messages as text.

use messages::{Field, Kind, Meaning, Qos, SERVICES, Stamp, Struct, Table};

/// All structs on the wire, parts first.
pub fn structs() -> impl Iterator<Item = Struct> {
    let messages = SERVICES.iter().map(|service| service.message);
    std::iter::once(Struct::of::<Stamp>()).chain(messages)
}

/// All tables of codes (`false`) or bits (`true`) that fields refer to, each once.
pub fn tables(bits: bool) -> Vec<&'static Table> {
    let mut tables: Vec<&Table> = Vec::new();
    for field in structs().flat_map(|message| message.fields) {
        let is_bits = matches!(field.meaning, Meaning::Bits(_));
        let table = field.meaning.table().filter(|_| is_bits == bits);
        tables.extend(table.filter(|table| !tables.contains(table)));
    }
    tables
}

/// Documentation of a field in one line: with its range, its codes as `named`, and its unit.
pub fn of_field(field: &Field, named: impl Fn(&Table) -> String) -> String {
    let mut text = one_line(field.doc);
    match field.meaning {
        Meaning::Range(least, most) => text += &format!(" {least} to {most}."),
        Meaning::Code(table) | Meaning::AnyCode(table) => {
            text += &format!(" Code: {}.", named(table))
        }
        Meaning::Bits(table) => text += &format!(" Sum of {} bits.", named(table)),
        Meaning::Any | Meaning::Finite | Meaning::FinitePairs => (),
    }
    if !field.unit.is_empty() {
        text += &format!(" Unit: {}.", field.unit);
    }
    text
}

/// Name of the type of one element, and `array` with the length if it is an array.
pub fn kind(
    field: &Field,
    name: impl Fn(&str) -> String,
    array: impl Fn(usize) -> String,
) -> String {
    let element = match field.kind {
        Kind::Stamp => "Stamp".to_owned(),
        number => format!("{number:?}").to_lowercase(),
    };
    let length = (field.count > 1).then(|| array(field.count));
    name(&element) + &length.unwrap_or_default()
}

/// The queues of a service, in the order of the contract.
pub fn queues(qos: Qos, between: &str) -> String {
    let queues = [qos.history, qos.buffer, qos.subscribers, qos.publishers];
    queues.map(|number| number.to_string()).join(between)
}

/// Documentation in one line.
pub fn one_line(doc: &str) -> String {
    doc.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Text in lines of at most 100 columns, each with this head.
pub fn wrapped(head: &str, text: &str) -> String {
    let mut lines = vec![head.to_owned()];
    for word in text.split_whitespace() {
        let last = lines.len() - 1;
        if lines[last].len() + word.len() > 100 && lines[last] != head {
            lines.push(head.to_owned());
        }
        let last = lines.len() - 1;
        lines[last] += &format!("{word} ");
    }
    lines
        .iter()
        .map(|line| format!("{}\n", line.trim_end()))
        .collect()
}

/// `RobotState` as `robot_state`.
pub fn snake(name: &str) -> String {
    let mut snake = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !snake.is_empty() {
            snake.push('_');
        }
        snake.extend(letter.to_lowercase());
    }
    snake
}

/// `NoFeatures` or `NO_FEATURES` as `NO_FEATURES`.
pub fn constant(name: &str) -> String {
    if name.contains(char::is_lowercase) {
        snake(name).to_uppercase()
    } else {
        name.to_owned()
    }
}
