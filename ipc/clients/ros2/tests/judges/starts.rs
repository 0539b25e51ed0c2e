//! Runs from starts of the paper's scene, judged by a referee of the peer's own.

use rustix::process::Signal;
use serde_json::{Value, json};
use testkit::{eventually, program, tell};

use crate::bench::{Bench, Via};

/// Drives from the first starts; what the peer was told in the end.
fn arrive(bench: &mut Bench, starts: usize) -> Value {
    let mut seconds = Vec::new();
    for start in 0..starts {
        if let Some(run) = bench.peer.run(start) {
            assert_eq!(run["arrived"], json!(true), "start {start}: {run}");
            seconds.push(run["seconds"].as_f64().unwrap());
        }
    }
    let status = bench.peer.status();
    let mean = seconds.iter().sum::<f64>() / seconds.len() as f64;
    let via = bench.plan.via;
    tell(format_args!(
        "{via:?}: {} of {starts} starts arrive, after {mean:.2} s; twists {}, late {}",
        seconds.len(),
        status["twists"],
        status["late"]
    ));
    // Nothing came in a frame of which nobody spoke, and late only where the machine stood still;
    // both kinds of receivers heard it.
    assert_eq!(status["wrong_frame"], json!(0));
    let heard = |key: &str| status[key].as_u64().unwrap();
    assert!(100 * heard("late") <= heard("twists"), "{status}");
    assert!(heard("twists") > 100 && heard("best_effort_twists") > 100);
    // By the pose, the gateway wants no twist.
    let mut matched = status["matched"].as_object().unwrap().clone();
    let is_heard = matched.remove("executed_twists") != Some(json!(false));
    assert_eq!(is_heard, !bench.plan.is_in_base);
    assert!(matched.values().all(|is| *is == json!(true)), "{matched:?}");
    status
}

/// What is told beside the motion, of a camera that is at the goal.
fn check_told(bench: &mut Bench) {
    let vpcd = bench.diagnosed("vpcd", |status| status["message"] == "arrived");
    assert_eq!(vpcd["level"], json!(0));
    let cycle: u64 = vpcd["values"]["cycle"].as_str().unwrap().parse().unwrap();
    assert!(cycle > 100, "{vpcd}");
    let gateway = bench.diagnosed("gateway", |status| status["level"] == json!(0));
    assert_eq!(gateway["message"], "messages are coming");
    assert_eq!(gateway["values"]["twists not sent"], "0");
    let points = |overlay: &Value, word: &str| {
        let places = overlay[word].as_array().unwrap().iter();
        let place = |p: &Value| [p[0].as_f64().unwrap(), p[1].as_f64().unwrap()];
        places.map(place).collect::<Vec<_>>()
    };
    // The scene's goal, from the corner of the first pixel.
    let (corner, opposite) = ([312.5, 312.5], [712.5, 712.5]);
    // A cycle without features draws none of them, and the last drawing may be older than the arrival.
    eventually("a drawing of features at their goal", || {
        let overlay = bench.peer.status()["overlay"].clone();
        let (seen, goal) = (points(&overlay, "seen"), points(&overlay, "goal"));
        assert!(goal.is_empty() || (goal[0], goal[2]) == (corner, opposite));
        let near = |(seen, goal): (&[f64; 2], &[f64; 2])| {
            (seen[0] - goal[0]).abs().max((seen[1] - goal[1]).abs()) < 2.0
        };
        (seen.len() == 4 && goal.len() == 4 && seen.iter().zip(&goal).all(near)).then_some(())
    });
}

#[test]
#[ignore = "long: a run in real time beside another team's middleware"]
fn twenty_starts_arrive_beside_cyclonedds_with_tags() {
    let Some(mut bench) = Bench::new("twenty starts", Via::Dds, false) else {
        return;
    };
    arrive(&mut bench, 20);
    check_told(&mut bench);
    // Stopped, it says so, and moves no more.
    let stopped = bench.peer.ask("call stop");
    assert_eq!(
        (&stopped["success"], &stopped["message"]),
        (&json!(true), &json!("stopped"))
    );
    bench.diagnosed("vpcd", |status| status["message"] == "disarmed: operator");
    let disarmed = bench.peer.ask("call disarm");
    assert_eq!(disarmed["success"], json!(true), "{disarmed}");
}

#[test]
fn a_service_teaches_the_goal_that_the_camera_sees() {
    let Some(mut bench) = Bench::new("a taught goal", Via::Dds, false) else {
        return;
    };
    let _ = ["vpcctl", "vpc-memory"].map(program);
    bench.peer.ask("place 0");
    bench.diagnosed("vpcd", |status| status["message"] == "disarmed: not armed");
    let before = std::fs::read(bench.place.path("scene.toml")).unwrap();
    let taught = bench.peer.ask("call teach");
    assert_eq!(
        (&taught["success"], &taught["message"]),
        (&json!(true), &json!("taught; vpcd is disarmed"))
    );
    assert_ne!(
        std::fs::read(bench.place.path("scene.toml")).unwrap(),
        before
    );
    // Why not is told, too.
    std::fs::remove_file(bench.place.path("scene.toml")).unwrap();
    let taught = bench.peer.ask("call teach");
    assert_eq!(taught["success"], json!(false), "{taught}");
    let words = taught["message"].as_str().unwrap();
    assert!(words.contains("scene.toml"), "{words}");
}

#[test]
#[ignore = "long: a run in real time beside another team's middleware"]
fn starts_arrive_with_base_axes_and_the_pose_of_a_tool() {
    let Some(mut bench) = Bench::new("base axes", Via::Dds, true) else {
        return;
    };
    arrive(&mut bench, 5);
}

#[test]
#[ignore = "long: a run in real time beside another team's middleware"]
fn starts_arrive_beside_rclpy_and_fast_dds_with_a_polygon() {
    for via in [Via::Kilted, Via::Jazzy] {
        if let Some(bench) = Bench::new("rclpy", via, false) {
            arrive_beside_rclpy(bench);
        }
    }
}

fn arrive_beside_rclpy(mut bench: Bench) {
    let status = arrive(&mut bench, 5);
    check_told(&mut bench);
    // The graph of ROS 2 knows the node and who commands.
    let names = |key: &str| status[key].as_array().unwrap().clone();
    assert!(names("nodes").contains(&json!("/vpcd")), "{status}");
    assert_eq!(names("commanders"), [json!("vpcd")]);
    bench.gateway.signal(Signal::KILL);
    bench.restart_gateway();
    bench.peer.arrives(6);
    let stopped = bench.peer.ask("call stop");
    assert_eq!(stopped["message"], "stopped");
}
