//! `include/vpc.h` from the sources: messages and codes of `ipc`, functions of this crate, by cbindgen; sizes and
//! offsets from the compiler.
//!
//! cbindgen reads declarations and evaluates nothing, neither `codes!` nor `2 * MAX_POINTS`. So it is given one file
//! in which both are written out.

use std::collections::HashMap;
use std::fmt::Write as _;

use crate::layout::{Layout, layouts};
use crate::source::{Kind, Source, root, snake};

/// The files of this crate whose functions the header declares.
const FILES: [&str; 7] = [
    "status.rs",
    "boundary.rs",
    "domain.rs",
    "camera.rs",
    "observer.rs",
    "operator.rs",
    "names.rs",
];

const HEAD: &str = "\
/* The shared-memory contract of vpcd for C: camera, observer, operator.
 *
 * Generated from the Rust sources, do not edit: VPC_BLESS=1 cargo test -p vpc-client-c
 * What the messages mean: ipc/CONTRACT.md. How to build with it, and examples: ipc/c/README.md.
 *
 * Threads. A handle (domain, camera, observer, operator) belongs to the thread that made it, and so do the ports opened
 * with it; from another one functions return VPC_STATUS_THREAD. A second thread joins for itself.
 * Pointers. Each may be NULL, which is refused with VPC_STATUS_ARGUMENT where it is needed; any other value must be
 * valid: a handle not yet closed, a place for the type. Nothing is kept after a function returns.
 * Order. Ports keep their domain: they may be closed before or after vpc_domain_leave.
 * Results. VPC_STATUS_OK is 0; below 0 is an error; vpc_message() has its words. No panic crosses the border.
 * Times are CLOCK_MONOTONIC in ns, image points px, twists m/s and rad/s in the camera frame.
 */";

const ASSERTS: &str = "
/* The layout, as the Rust compiler has it. */
#if defined(__cplusplus)
#define VPC_ASSERT(condition, words) static_assert(condition, words)
#else
#define VPC_ASSERT(condition, words) _Static_assert(condition, words)
#endif
";

/// `TwistState` as C has it. Codes lose what only Rust needs to tell them from their messages.
fn name(rust: &str) -> String {
    let short = match rust {
        "TwistState" => "State",
        "StrategyCode" => "Strategy",
        "PhaseCode" => "Phase",
        "RecallCode" => "Recall",
        "RealTime" => "Realtime",
        "SolverStatus" => "Solver",
        other => other,
    };
    format!("vpc_{}", snake(short))
}

/// Documentation, with the names that types have in C.
fn write_docs(text: &mut String, indent: &str, docs: &[String]) {
    for line in docs {
        let mut parts = line.split('`');
        let mut line = parts.next().unwrap_or_default().to_owned();
        for (i, part) in parts.enumerate() {
            let is_type = i % 2 == 0 && part.starts_with(char::is_uppercase) && !part.contains(':');
            line += &if is_type { name(part) } else { part.to_owned() };
        }
        let _ = writeln!(text, "{indent}/// {line}");
    }
}

/// Everything in one file of Rust that leaves nothing to evaluate.
fn plain(source: &Source) -> String {
    let mut text = format!("pub const VPC_MAX_POINTS: u32 = {};\n", ipc::MAX_POINTS);
    for message in &source.messages {
        write_docs(&mut text, "", &message.docs);
        let _ = writeln!(text, "#[repr(C)] pub struct {} {{", message.name);
        for field in &message.fields {
            write_docs(&mut text, "    ", &field.docs);
            let kind = match &field.kind {
                Kind::Plain(of) => of.clone(),
                Kind::Array(of, length) => format!("[{of}; {length}]"),
            };
            let _ = writeln!(text, "    pub {}: {kind},", field.name);
        }
        text += "}\n";
    }
    for bits in &source.bits {
        let name = name(&bits.name).to_uppercase();
        for (bit, value, docs) in &bits.values {
            write_docs(&mut text, "", docs);
            let _ = writeln!(text, "pub const {name}_{bit}: u32 = {value};");
        }
    }
    for codes in &source.codes {
        write_docs(&mut text, "", &codes.docs);
        let _ = writeln!(text, "#[repr(u32)] pub enum {} {{", codes.name);
        for (variant, code, _, docs) in &codes.values {
            write_docs(&mut text, "    ", docs);
            let _ = writeln!(text, "    {variant} = {code},");
        }
        text += "}\n";
    }
    for file in FILES {
        let ours = root().join("ipc/c/src").join(file);
        for line in std::fs::read_to_string(ours).unwrap().lines() {
            // Everything is in one module now.
            if !line.starts_with("use ") && !line.starts_with("//!") {
                text += line;
                text.push('\n');
            }
        }
    }
    text
}

fn asserts(layouts: &[Layout]) -> String {
    let mut text = ASSERTS.to_owned();
    for layout in layouts {
        let message = name(layout.name);
        let size = layout.size;
        let _ = writeln!(
            text,
            "VPC_ASSERT(sizeof({message}) == {size}, \"{message}\");"
        );
        for (field, offset, _) in &layout.fields {
            let _ = writeln!(
                text,
                "VPC_ASSERT(offsetof({message}, {field}) == {offset}, \"{message}.{field}\");"
            );
        }
    }
    text += "#undef VPC_ASSERT";
    text
}

/// The header.
pub fn generate(source: &Source) -> String {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("vpc.rs");
    std::fs::write(&path, plain(source)).unwrap();

    let enumerations = source.codes.iter().map(|codes| codes.name.as_str());
    let enumerations: Vec<&str> = enumerations.chain(["Status", "Take"]).collect();
    let messages = source.messages.iter().map(|message| message.name.as_str());
    let handles = ["Domain", "Camera", "Observer", "Operator", "Sent"];
    let all: Vec<&str> = messages.chain(handles).chain(enumerations).collect();
    let rename: HashMap<String, String> = all.iter().map(|n| ((*n).to_owned(), name(n))).collect();

    let mut config = cbindgen::Config {
        language: cbindgen::Language::C,
        header: Some(HEAD.to_owned()),
        trailer: Some(asserts(&layouts())),
        include_guard: Some("VPC_H".to_owned()),
        no_includes: true,
        sys_includes: ["stddef.h", "stdint.h"].map(str::to_owned).to_vec(),
        cpp_compat: true,
        line_length: 100,
        tab_width: 4,
        style: cbindgen::Style::Type,
        documentation_style: cbindgen::DocumentationStyle::C99,
        usize_is_size_t: true,
        ..cbindgen::Config::default()
    };
    config.export.include = all.iter().map(|name| (*name).to_owned()).collect();
    config.export.rename = rename;
    config.enumeration.rename_variants = cbindgen::RenameRule::QualifiedScreamingSnakeCase;
    let mut text = Vec::new();
    cbindgen::Builder::new()
        .with_config(config)
        .with_src(&path)
        .generate()
        .unwrap()
        .write(&mut text);
    String::from_utf8(text).unwrap()
}
