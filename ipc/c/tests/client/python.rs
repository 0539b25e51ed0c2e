//! `ipc/python/vpc_client/messages.py` from the sources: structures, codes and services.

use std::fmt::Write as _;

use ipc::{CycleRecord, Features, Message, Qos, Reply, Request, RobotState, TwistCommand};

use crate::layout::layouts;
use crate::source::{Kind, Source};

const HEAD: &str = r#""""What travels: messages, codes and services of the contract, in ctypes.

Generated from the Rust sources, do not edit: VPC_BLESS=1 cargo test -p vpc-client-c
"""

import ctypes
import enum
"#;

fn number(rust: &str) -> String {
    match rust {
        "u32" => "ctypes.c_uint32",
        "u64" => "ctypes.c_uint64",
        "i64" => "ctypes.c_int64",
        "f64" => "ctypes.c_double",
        other => other,
    }
    .to_owned()
}

/// `NoFeatures` as `NO_FEATURES`. `None` is a word of Python, but `NONE` is not.
fn constant(name: &str) -> String {
    crate::source::snake(name).to_uppercase()
}

/// Documentation as comments no longer than a line of this project.
fn comments(text: &mut String, indent: &str, docs: &[String]) {
    for line in docs {
        let _ = writeln!(text, "{indent}# {line}");
    }
}

fn docstring(docs: &[String]) -> String {
    format!("    \"\"\"{}\"\"\"\n", docs.join("\n    ").trim_end())
}

fn service<T: Message>(text: &mut String, message: &str) {
    let Qos {
        history,
        buffer,
        subscribers,
        publishers,
    } = T::QOS;
    let service = T::SERVICE;
    let _ = writeln!(
        text,
        "    \"{service}\": Service({message}, {history}, {buffer}, {subscribers}, {publishers}),"
    );
}

/// The module.
pub fn generate(source: &Source) -> String {
    let mut text = HEAD.to_owned();
    let _ = write!(
        text,
        "from typing import NamedTuple\n\nMAX_POINTS = {}\n",
        ipc::MAX_POINTS
    );
    for codes in &source.codes {
        let name = &codes.name;
        let _ = write!(
            text,
            "\n\nclass {name}(enum.IntEnum):\n{}\n",
            docstring(&codes.docs)
        );
        for (variant, code, _, docs) in &codes.values {
            comments(&mut text, "    ", docs);
            let _ = writeln!(text, "    {} = {code}", constant(variant));
        }
        text += "\n    @property\n    def words(self):\n        return _WORDS[type(self)][self]\n";
    }
    for bits in &source.bits {
        let name = &bits.name;
        let _ = write!(text, "\n\nclass {name}(enum.IntFlag):\n");
        for (bit, value, docs) in &bits.values {
            comments(&mut text, "    ", docs);
            let _ = writeln!(text, "    {bit} = {value}");
        }
    }
    text += "\n\n_WORDS = {\n";
    for codes in &source.codes {
        let _ = writeln!(text, "    {}: (", codes.name);
        for (_, _, words, _) in &codes.values {
            let _ = writeln!(text, "        \"{words}\",");
        }
        text += "    ),\n";
    }
    text += "}\n";
    for message in &source.messages {
        let _ = write!(
            text,
            "\n\nclass {}(ctypes.Structure):\n{}\n    _fields_ = [\n",
            message.name,
            docstring(&message.docs)
        );
        for field in &message.fields {
            comments(&mut text, "        ", &field.docs);
            let kind = match &field.kind {
                Kind::Plain(of) => number(of),
                Kind::Array(of, length) => format!("{} * {length}", number(of)),
            };
            let _ = writeln!(text, "        (\"{}\", {kind}),", field.name);
        }
        let _ = write!(
            text,
            "    ]\n\n    @staticmethod\n    def type_name():\n        return \"{}\"\n",
            message.type_name
        );
    }
    text += "\n\nfor _message, _size in (\n";
    for layout in layouts() {
        if source
            .messages
            .iter()
            .any(|message| message.name == layout.name)
        {
            let _ = writeln!(text, "    ({}, {}),", layout.name, layout.size);
        }
    }
    text += r#"):
    if ctypes.sizeof(_message) != _size:
        raise ImportError(f"{_message.__name__}: {ctypes.sizeof(_message)} bytes; allowed: {_size}")


class Service(NamedTuple):
    """A service and its queues; the same for everybody who opens it."""

    message: type
    history: int
    buffer: int
    subscribers: int
    publishers: int


SERVICES = {
"#;
    service::<Features>(&mut text, "Features");
    service::<TwistCommand>(&mut text, "TwistCommand");
    service::<RobotState>(&mut text, "RobotState");
    service::<CycleRecord>(&mut text, "CycleRecord");
    service::<Request>(&mut text, "Request");
    service::<Reply>(&mut text, "Reply");
    text += "}\n";
    text
}
