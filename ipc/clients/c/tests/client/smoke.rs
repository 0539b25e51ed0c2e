//! The compiler of C has the layouts of Rust, and a program in C talks to one in Rust.

use std::fmt::Write as _;
use std::mem::offset_of;

use messages::{Hold, Outcome, RealTime, RobotFaults, SERVICES, Stamp, Struct};
use testkit::{Ended, Place};
use vpcclient::camera::Sent;

use crate::program::{closes_the_loop, compiled, compiler, example};

/// `RobotState` as `robot_state`.
fn snake(name: &str) -> String {
    let letters = name.char_indices();
    let parts = letters.map(|(i, letter)| match (i, letter.is_uppercase()) {
        (0, _) | (_, false) => letter.to_lowercase().to_string(),
        (_, true) => format!("_{}", letter.to_lowercase()),
    });
    parts.collect()
}

#[test]
fn the_compiler_of_c_has_the_layouts_of_rust() {
    if !compiler("the_compiler_of_c_has_the_layouts_of_rust") {
        return;
    }
    let mut source =
        "#include <stdalign.h>\n#include <stdio.h>\n#include \"vpc.h\"\nint main(void) {\n"
            .to_owned();
    let mut expected = String::new();
    let messages = SERVICES.iter().map(|service| service.message);
    for message in messages.chain([Struct::of::<Stamp>()]) {
        let (name, size) = (format!("vpc_{}", snake(message.name)), message.size);
        let _ = writeln!(
            source,
            "printf(\"{name} %zu %zu\\n\", sizeof({name}), alignof({name}));"
        );
        // Every message has a field of eight bytes.
        let _ = writeln!(expected, "{name} {size} 8");
        for field in message.fields {
            let (field, offset, size) = (field.name, field.offset, field.size);
            let _ = writeln!(
                source,
                "printf(\"{field} %zu %zu\\n\", offsetof({name}, {field}), sizeof((({name} *)0)->{field}));"
            );
            let _ = writeln!(expected, "{field} {offset} {size}");
        }
    }
    source += "printf(\"sent %zu %zu %zu\\n\", sizeof(vpc_sent), offsetof(vpc_sent, sequence), \
               offsetof(vpc_sent, published_ns));\n";
    let (sequence, published_ns) = (offset_of!(Sent, sequence), offset_of!(Sent, published_ns));
    let _ = writeln!(
        expected,
        "sent {} {sequence} {published_ns}",
        size_of::<Sent>()
    );
    for (bits, expected_bits) in [
        ("VPC_ROBOT_FAULTS_PATTERN_LOST", RobotFaults::PATTERN_LOST.0),
        ("VPC_REALTIME_NO_LOCK", RealTime::NO_LOCK.0),
        ("VPC_HOLD_STANDSTILL", Hold::Standstill.code()),
        ("VPC_OUTCOME_SHUTDOWN", Outcome::Shutdown.code()),
    ] {
        let _ = writeln!(source, "printf(\"{bits} %d\\n\", (int){bits});");
        let _ = writeln!(expected, "{bits} {expected_bits}");
    }
    source += "return 0;\n}\n";
    let place = Place::new();
    let source = place.file("layouts.c", source);
    let Ended { code, stdout, .. } = testkit::ended(testkit::command(compiled(&place, &source)));
    assert_eq!(code, Some(0));
    for (found, expected) in stdout.lines().zip(expected.lines()) {
        assert_eq!(found, expected, "C first, then Rust");
    }
    assert_eq!(stdout.lines().count(), expected.lines().count());
}

#[test]
fn a_camera_in_c_closes_the_loop() {
    if !compiler("a_camera_in_c_closes_the_loop") {
        return;
    }
    let place = Place::new();
    let camera = testkit::command(example(&place, "camera.c"));
    // Straight to the goal, which is at 0.6 m: a twist held for a second.
    let start = [0.2, 0.0, 0.7, 0.0, 0.0, 0.0];
    closes_the_loop(&place, camera, start, [0.2, 0.0, 0.1, 0.0, 0.0, 0.0]);
}
