//! The vendor's interface, judged by the vendor's own library (libfranka 0.9.2, as `panda-python`
//! has it): it takes `hw-sim --fci` for a Panda. `panda.py` acts and sees, the tests here judge.
//! [`fr3`] has the judges of version 10, [`others`] clients of other teams.

mod fr3;
mod others;
mod robot;

use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::{Value, json};
use testkit::{Running, tell};

use robot::{PORT, Robot, seen};

/// Lost commands in a row after which a motion ends.
const ABORT: u64 = 20;
/// How far the motion of `panda.py` goes before it comes back: its top speed times 4/3 / pi, which
/// is the mean of a cubed sine over its half second, and 1 s. m or rad.
const WAY: f64 = 0.05 * 4.0 / 3.0 / std::f64::consts::PI;

fn number(value: &Value) -> f64 {
    value
        .as_f64()
        .unwrap_or_else(|| panic!("no number: {value}"))
}

/// The names or the message in a value contain this.
fn contains(value: &Value, part: &str) -> bool {
    match value {
        Value::Array(names) => names.iter().any(|name| name == part),
        _ => value.as_str().is_some_and(|text| text.contains(part)),
    }
}

fn assert_near(value: &Value, expected: &[f64], tolerance: f64) {
    let numbers: Vec<f64> = value.as_array().unwrap().iter().map(number).collect();
    assert_eq!(numbers.len(), expected.len());
    let near = |(a, b): (&f64, &f64)| (a - b).abs() <= tolerance;
    assert!(
        numbers.iter().zip(expected).all(near),
        "{numbers:?}, expected {expected:?}"
    );
}

/// A motion ended as it should, came where it should, and its states echoed what was sent.
fn assert_moved(what: &str, motion: &Value) {
    tell(format_args!("{what}: {motion}"));
    assert_eq!(motion["error"], Value::Null, "{motion}");
    assert!((number(&motion["way"]) - WAY).abs() < 1e-3, "{motion}");
    assert!(number(&motion["miss"]).abs() < 1e-3, "{motion}");
    assert_echoed(motion);
}

/// Every state echoes the command, or what the robot puts in the place of a lost one; the command,
/// if none was lost.
fn assert_echoed(motion: &Value) {
    let echo = &motion["echo"];
    assert_eq!((&echo["other"], &echo["denied"]), (&json!(0), &json!(0)));
    let count = |name: &str| echo[name].as_u64().unwrap();
    // How many are lost is the machine's matter.
    assert!(count("commanded") > 100, "{motion}");
    assert!(count("commanded") > count("extrapolated"), "{motion}");
}

/// The robot's own referee saw no command that breaks the tables, and so many reflexes.
fn assert_clean(robot: Robot, reflexes: u64) {
    let arm = robot.stopped();
    let counts = ["reflexes", "limit_violations", "discontinuities"].map(|name| arm[name].clone());
    assert_eq!(counts, [json!(reflexes), json!(0), json!(0)], "{arm}");
}

#[test]
fn the_library_connects_and_sees_a_panda_with_its_hand() {
    let Some(robot) = Robot::start("the handshake") else {
        return;
    };
    let seen = robot.seen("handshake");
    assert_eq!(seen["connection"], Value::Null);
    assert_eq!(seen["version"], 5);
    assert_eq!(seen["rises"], true);
    let state = &seen["state"];
    assert_eq!(state["robot_mode"], "Idle");
    assert_eq!(state["current_errors"], json!([]));
    // 45 degrees and 103.4 mm, column by column.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let hand = [
        half, -half, 0.0, 0.0, half, half, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1034, 1.0,
    ];
    let unit = std::array::from_fn::<f64, 16, _>(|k| f64::from(u8::from(k % 5 == 0)));
    assert_near(&state["F_T_NE"], &hand, 1e-6);
    assert_near(&state["NE_T_EE"], &unit, 0.0);
    assert_near(&state["F_T_EE"], &hand, 1e-6);
    // O_T_EE is where panda-python's kinematics, with the same hand, see these joints.
    let differ = number(&seen["kinematics_differ"]);
    tell(format_args!("the handshake: kinematics differ by {differ}"));
    assert!(differ < 1e-9, "{differ}");
    assert_clean(robot, 0);
}

#[test]
fn cartesian_velocities_are_followed_and_echoed_as_sent() {
    let Some(robot) = Robot::start("Cartesian velocities") else {
        return;
    };
    let seen = robot.seen("waves");
    assert_moved("Cartesian, stock", &seen["stock"]);
    assert_moved("Cartesian, unfiltered", &seen["raw"]);
    assert_clean(robot, 0);
}

#[test]
fn joint_velocities_are_followed_and_echoed_as_sent() {
    let Some(robot) = Robot::start("joint velocities") else {
        return;
    };
    let seen = robot.seen("joints");
    assert_moved("joint 7, stock", &seen["stock"]);
    assert_moved("joint 7, unfiltered", &seen["raw"]);
    assert_clean(robot, 0);
}

#[test]
fn a_step_is_a_reflex_until_recovery() {
    let Some(robot) = Robot::start("a step") else {
        return;
    };
    let seen = robot.seen("reflex");
    let name = "cartesian_motion_generator_acceleration_discontinuity";
    let words = "motion aborted by reflex!";
    tell(format_args!("a step: {}", seen["step"]));
    assert!(
        contains(&seen["step"], words) && contains(&seen["step"], name),
        "{seen}"
    );
    for errors in ["now", "last_motion"] {
        assert!(contains(&seen["errors"][errors], name), "{seen}");
    }
    assert_eq!(seen["mode"], "kReflex");
    let words = "Move command rejected: command not possible in the current mode (\"Reflex\")!";
    assert!(contains(&seen["refused"], words), "{seen}");
    assert_eq!(seen["recovery"], Value::Null);
    assert_eq!(seen["recovered_mode"], "kIdle");
    assert_eq!(seen["recovered_errors"]["now"], json!([]));
    assert_moved("after a reflex", &seen["wave"]);
    assert_clean(robot, 1);
}

#[test]
fn a_motion_that_is_finished_while_it_moves_is_a_reflex() {
    let Some(robot) = Robot::start("finishing in motion") else {
        return;
    };
    let seen = robot.seen("finish_in_motion");
    tell(format_args!("finishing in motion: {}", seen["error"]));
    for words in [
        "Motion finished commanded, but the robot is still moving!",
        "cartesian_motion_generator_acceleration_discontinuity",
    ] {
        assert!(contains(&seen["error"], words), "{seen}");
    }
    assert_eq!(seen["recovery"], Value::Null);
    assert_eq!(seen["mode"], "kIdle");
    assert_moved("after finishing in motion", &seen["wave"]);
    assert_clean(robot, 1);
}

/// Stops a client in motion for so long, or for longer, as the machine likes; what it saw.
fn stopped_for(robot: &Robot, asked: Duration) -> Value {
    let mut client = robot.client("one_wave");
    client.line("moving");
    client.signal(Signal::STOP);
    std::thread::sleep(asked);
    client.signal(Signal::CONT);
    let seen = seen(client);
    let motion = seen["wave"].clone();
    tell(format_args!("a client stopped for {asked:?}: {motion}"));
    motion
}

#[test]
fn a_client_may_be_silent_for_15_ms_but_not_for_40() {
    let Some(robot) = Robot::start("a silent client") else {
        return;
    };
    // Nobody can tell the machine how long a stop shall last. The rule holds for whatever it came
    // to, and one of the tries shows what it is about.
    let tries = 10;
    let shows = |asked, is_shown: &dyn Fn(&Value) -> bool| {
        (0..tries).any(|_| {
            let motion = stopped_for(&robot, Duration::from_millis(asked));
            match motion["error"] {
                Value::Null => {
                    // The first state after `ABORT` - 1 lost answers is the last that may be
                    // answered.
                    assert!(motion["gap_ms"].as_u64().unwrap() <= ABORT, "{motion}");
                    assert_moved("a silent client", &motion);
                }
                _ => {
                    let words = "communication_constraints_violation";
                    assert!(contains(&motion["error"], words), "{motion}");
                    // Room for the lateness of two states.
                    let least = ABORT as f64 - 2.0;
                    assert!(number(&motion["silence_ms"]) >= least, "{motion}");
                }
            }
            is_shown(&motion)
        })
    };
    let goes_on = |motion: &Value| {
        motion["error"] == Value::Null && motion["gap_ms"].as_u64().unwrap() >= ABORT / 2
    };
    assert!(shows(15, &goes_on), "no stop of 15 ms in {tries} tries");
    let is_aborted = |motion: &Value| motion["error"] != Value::Null;
    assert!(shows(40, &is_aborted), "no stop of 40 ms in {tries} tries");
}

#[test]
fn one_client_at_a_time() {
    let Some(mut robot) = Robot::start("a second client") else {
        return;
    };
    let mut first = robot.client("one_wave");
    first.line("moving");
    let second = robot.seen("one_wave");
    let refused = "Connection to FCI refused.";
    assert!(contains(&second["connection"], refused), "{second}");
    assert_moved("the first client", &seen(first)["wave"]);
    // One that dies in motion leaves a robot that stops, and the next one finds out why.
    let mut first = robot.client("one_wave");
    first.line("moving");
    first.kill();
    robot.says("the client is gone");
    let third = robot.seen("one_wave");
    assert_eq!(third["connection"], Value::Null);
    assert_eq!(third["mode"], "kReflex");
    let violation = "communication_constraints_violation";
    assert!(contains(&third["errors"]["now"], violation), "{third}");
    assert_eq!(third["recovery"], Value::Null);
    assert_moved("the third client", &third["wave"]);
    assert_clean(robot, 1);
}

/// The robot's socket for the client's commands: the only one for datagrams at its address.
fn datagram_port(address: Ipv4Addr) -> u16 {
    let table = std::fs::read_to_string("/proc/net/udp").unwrap();
    // Addresses stand there as numbers of this machine, of network order.
    let address = format!("{:08X}:", u32::from_ne_bytes(address.octets()));
    let mut ports = table.lines().skip(1).filter_map(|line| {
        let local = line.split_whitespace().nth(1)?;
        u16::from_str_radix(local.strip_prefix(&address)?, 16).ok()
    });
    let port = ports.next().expect("the robot has a socket");
    assert_eq!(ports.next(), None, "it has one");
    port
}

/// A command of version 5 that would be a step: 0.1 m/s upwards, or 1 rad/s of each joint.
fn hostile(message_id: u64) -> [u8; 370] {
    let mut bytes = [0; 370];
    bytes[..8].copy_from_slice(&message_id.to_le_bytes());
    for joint in 0..7 {
        let at = 64 + 8 * joint;
        bytes[at..at + 8].copy_from_slice(&1_f64.to_le_bytes());
    }
    bytes[264..272].copy_from_slice(&0.1_f64.to_le_bytes());
    bytes
}

/// What raw bytes over TCP get: no answer, and the connection's end.
fn assert_sent_away(robot: &mut Robot, bytes: &[u8]) {
    let mut stream = TcpStream::connect((robot.address(), PORT)).unwrap();
    let patience = Some(Duration::from_secs(10));
    stream.set_read_timeout(patience).unwrap();
    stream.write_all(bytes).unwrap();
    match stream.read(&mut [0; 64]) {
        Ok(count) => assert_eq!(count, 0, "an answer to {bytes:?}"),
        Err(error) => assert_eq!(error.kind(), std::io::ErrorKind::ConnectionReset),
    }
    // The port is open again in the millisecond after that.
    std::thread::sleep(Duration::from_millis(20));
}

/// Sends a moving client's robot what is no command of that client, for a second: the motion takes
/// half a second more. The number of datagrams.
fn disturb(client: &mut Running, robot: &Robot) -> u32 {
    let line = client.line("moving");
    let since = Instant::now();
    let robots_ms: u64 = line.rsplit(' ').next().unwrap().parse().unwrap();
    assert!(TcpStream::connect((robot.address(), PORT)).is_err());
    let to = SocketAddr::from((robot.address(), datagram_port(robot.address())));
    let stranger = UdpSocket::bind((robot.address(), 0)).unwrap();
    let mut sent = 0;
    let mut send = |bytes: &[u8]| {
        stranger.send_to(bytes, to).unwrap();
        sent += 1;
    };
    while since.elapsed() < Duration::from_secs(1) {
        // Whole commands for the states from now on, more than the robot takes in a millisecond,
        // and what is too short or too long for one.
        let now = robots_ms + since.elapsed().as_millis() as u64;
        for message_id in now - 3..now + 97 {
            send(&hostile(message_id));
        }
        for size in [0, 1, 100, 369, 371, 1500, 60_000] {
            send(&vec![0xff; size]);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    sent
}

#[test]
fn strangers_and_nonsense_change_nothing() {
    let Some(mut robot) = Robot::start("nonsense") else {
        return;
    };
    assert_sent_away(&mut robot, &[0xff; 2000]);
    assert_sent_away(&mut robot, b"GET / HTTP/1.1\r\n\r\n");
    // Half of a handshake, and nothing more.
    assert_sent_away(&mut robot, &[0, 0, 0, 0, 1, 0, 0, 0, 16, 0]);
    let mut client = robot.client("one_wave");
    let datagrams = disturb(&mut client, &robot);
    tell(format_args!("nonsense: {datagrams} datagrams"));
    let seen = seen(client);
    assert_eq!(seen["mode"], "kIdle");
    assert_moved("among nonsense", &seen["wave"]);
    assert!(datagrams > 10_000, "{datagrams}");
    assert_clean(robot, 0);
}

#[test]
fn what_is_not_emulated_is_refused_in_words_of_the_interface() {
    let Some(robot) = Robot::start("refusals") else {
        return;
    };
    let seen = robot.seen("refusals");
    let rejected = "Move command rejected: command not possible in the current mode";
    for (motion, words) in [
        ("torques", rejected),
        ("pose", rejected),
        ("positions", rejected),
        ("model", "Server reports error when loading model library."),
    ] {
        assert!(contains(&seen[motion], words), "{motion}: {seen}");
    }
    assert_eq!(seen["mode"], "kIdle");
    assert_eq!(seen["errors"]["now"], json!([]));
    assert_moved("after refusals", &seen["wave"]);
    assert_clean(robot, 0);
}

#[test]
fn the_end_effector_is_set_at_rest_only() {
    let Some(robot) = Robot::start("setEE") else {
        return;
    };
    let seen = robot.seen("end_effector");
    let words = "Set NE to EE command rejected: ";
    let moving = "command not possible in the current mode (\"Move\")!";
    assert!(
        contains(&seen["while_moving"], &format!("{words}{moving}")),
        "{seen}"
    );
    assert_eq!(seen["motion"], Value::Null);
    assert_eq!(seen["kept"], true);
    let invalid = format!("{words}invalid argument!");
    assert!(contains(&seen["no_pose"], &invalid), "{seen}");
    assert_eq!(seen["at_rest"], Value::Null);
    let longer = [
        0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.05, 1.0,
    ];
    assert_near(&seen["NE_T_EE"], &longer, 1e-6);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    // The hand's 45 degrees back, and these 90 on: 45 the other way.
    let both = [
        half, half, 0.0, 0.0, -half, half, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1534, 1.0,
    ];
    assert_near(&seen["F_T_EE"], &both, 1e-6);
    let out = number(&seen["out_m"]);
    assert!((out - 0.05).abs() < 1e-5, "{out}");
    assert_moved("with another end effector", &seen["wave"]);
    assert_clean(robot, 0);
}
