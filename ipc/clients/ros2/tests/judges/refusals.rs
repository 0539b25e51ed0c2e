//! What is wrong on purpose is refused, counted, and told in words.

use std::time::Duration;

use serde_json::json;
use testkit::tell;

use crate::bench::{Bench, Via};

const TAGS: &str = "/detections";
const INFO: &str = "/camera/camera_info";
const TWIST: &str = "/vpcd/executed_twist";
const JOINTS: &str = "/joint_states";

#[test]
fn bad_messages_are_refused_and_named() {
    let Some(mut bench) = Bench::new("refusals", Via::Dds, false) else {
        return;
    };
    bench.diagnosed("gateway", |status| status["level"] == json!(0));
    for (fault, topic, kind, words) in [
        (
            json!({"camera_stamp_ms": -500}),
            TAGS,
            "stamp too old",
            "its stamp is 5",
        ),
        (
            json!({"camera_stamp_ms": 50}),
            TAGS,
            "stamp in the future",
            "its stamp is 4",
        ),
        (
            json!({"robot_stamp_ms": -500}),
            TWIST,
            "stamp too old",
            "its stamp is 5",
        ),
        (
            json!({"camera": {"fx": 900.0}}),
            INFO,
            "other camera",
            "the camera is not the scene's: fx = 900.000 px; the scene has 800.000",
        ),
        (
            json!({"camera": {"width": 640}}),
            TAGS,
            "other camera",
            "the camera is not the scene's: images of [640, 1024] px",
        ),
        (
            json!({"camera_frame": "map"}),
            TAGS,
            "other frame_id",
            "frame_id = \"map\"; allowed: camera_optical_frame",
        ),
        (
            json!({"robot_frame": "map"}),
            TWIST,
            "other frame_id",
            "frame_id = \"map\"; allowed: camera_optical_frame, tool0 or base_link",
        ),
        (
            json!({"nan": 2}),
            TAGS,
            "bad number",
            "a coordinate is not finite",
        ),
        (
            json!({"twice": 1}),
            TAGS,
            "name twice",
            "tag 1 is there twice",
        ),
        (
            json!({"joint_names": ["a", "b", "elbow", "wrist"]}),
            JOINTS,
            "joints missing",
            "joint \"shoulder\" is not in it",
        ),
        (
            json!({"joint_names": ["shoulder"]}),
            JOINTS,
            "wrong length",
            "1 names, 4 positions",
        ),
        (
            json!({"joint_names": ["a", "b", "c", "d"]}),
            TWIST,
            "joints missing",
            "no fresh JointState on /joint_states",
        ),
    ] {
        bench.peer.ask(&format!("fault {fault}"));
        let key = format!("{topic}, refused: {kind}");
        let status = bench.diagnosed("gateway", |status| {
            status["values"][&key].is_string() && status["level"] == json!(1)
        });
        let message = status["message"].as_str().unwrap();
        assert!(message.contains(topic), "{fault}: {message}");
        let line = bench.gateway.line(&format!("{topic}: refused: {words}"));
        tell(line.trim_start_matches(|c: char| c != '/'));
        bench.peer.ask("fault {}");
        bench.diagnosed("gateway", |status| status["level"] == json!(0));
    }

    // Tags that are none of ours are passed over; one that is hidden is told as such.
    bench.peer.ask(r#"fault {"foreign": true}"#);
    bench.diagnosed("gateway", |status| {
        status["values"]["foreign tags"] != "0" && status["level"] == json!(0)
    });
    // Joints of others, too.
    let others = format!("{JOINTS}, of others");
    bench.diagnosed("gateway", |status| status["values"][&others].is_string());
    bench.peer.ask("fault {}");
    bench.peer.arm();
    bench.peer.ask(r#"fault {"hidden": 2}"#);
    let hidden = [
        "braking: hidden point",
        "holding: hidden point",
        "disarmed: features lost",
    ];
    bench.diagnosed("vpcd", |status| {
        hidden.iter().any(|words| status["message"] == *words)
    });
    bench.diagnosed("gateway", |status| status["level"] == json!(0));

    // Bytes that are no message: the program lives, and works on.
    bench.peer.ask("fault {}");
    bench.peer.ask("raw");
    std::thread::sleep(Duration::from_millis(500));
    let status = bench.diagnosed("gateway", |status| {
        status["values"][format!("{TAGS}, refused: unreadable")].is_string()
    });
    tell(status["message"].as_str().unwrap());
    assert!(bench.gateway.is_running());
    bench.peer.arrives(0);
}
