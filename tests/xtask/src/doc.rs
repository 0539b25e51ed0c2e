//! Documentation of messages as text.

use ipc::{Field, Kind, Meaning, SERVICES, Stamp, Table, Wire};

/// A struct on the wire.
pub struct Struct {
    /// Name in Rust.
    pub name: &'static str,
    /// Name that iceoryx2 compares.
    pub type_name: &'static str,
    /// Documentation in one line.
    pub doc: String,
    pub size: usize,
    pub fields: &'static [Field],
}

/// All structs on the wire, parts first.
pub fn structs() -> Vec<Struct> {
    let head = Struct {
        name: Stamp::NAME,
        type_name: Stamp::TYPE_NAME,
        doc: one_line(Stamp::DOC),
        size: size_of::<Stamp>(),
        fields: Stamp::FIELDS,
    };
    let messages = SERVICES.iter().map(|service| Struct {
        name: service.message,
        type_name: service.type_name,
        doc: one_line(service.doc),
        size: service.size,
        fields: service.fields,
    });
    std::iter::once(head).chain(messages).collect()
}

/// All tables of codes (`false`) or bits (`true`) that fields refer to, each once.
pub fn tables(bits: bool) -> Vec<&'static Table> {
    let mut tables: Vec<&Table> = Vec::new();
    for field in structs().iter().flat_map(|message| message.fields) {
        let is_bits = matches!(field.meaning, Meaning::Bits(_));
        if let Some(table) = field.meaning.table().filter(|_| is_bits == bits)
            && tables.iter().all(|known| known.name != table.name)
        {
            tables.push(table);
        }
    }
    tables
}

/// Documentation of a field in one line: with its range, its codes as `named`, and its unit.
pub fn of_field(field: &Field, named: impl Fn(&Table) -> String) -> String {
    let mut text = one_line(field.doc);
    match field.meaning {
        Meaning::Range(least, most) => text += &format!(" {least} to {most}."),
        Meaning::Code(table) | Meaning::AnyCode(table) => text += &format!(" A {}.", named(table)),
        Meaning::Bits(table) => text += &format!(" Sum of {} bits.", named(table)),
        Meaning::Any | Meaning::Finite | Meaning::FinitePairs => (),
    }
    if !field.unit.is_empty() {
        text += &format!(" Unit: {}.", field.unit);
    }
    text
}

/// `f64[16]`, with the names that a language has for numbers.
pub fn kind(field: &Field) -> &'static str {
    match field.kind {
        Kind::U8 => "u8",
        Kind::U32 => "u32",
        Kind::U64 => "u64",
        Kind::I64 => "i64",
        Kind::F64 => "f64",
        Kind::Stamp => Stamp::NAME,
    }
}

/// Documentation in one line.
pub fn one_line(doc: &str) -> String {
    doc.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Text in lines of at most 100 columns, each with this head.
pub fn wrapped(head: &str, text: &str) -> String {
    let mut lines = String::new();
    let mut line = head.to_owned();
    for word in text.split(' ') {
        if line.len() + 1 + word.len() > 100 && line.len() > head.len() {
            lines += line.trim_end();
            lines += "\n";
            line = head.to_owned();
        }
        line += word;
        line += " ";
    }
    lines + line.trim_end() + "\n"
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
