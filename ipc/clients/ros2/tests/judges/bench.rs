//! `vpcd`, the gateway, and a peer in Python, which is camera and robot.

use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Stdio};
use std::sync::MutexGuard;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use testkit::python::{Environment, script};
use testkit::{
    PATIENCE, Place, Running, memory_file, not_run, program, root, scene_file, starts_file, within,
};

/// Who speaks ROS 2 at the other end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Via {
    /// CycloneDDS, with ROS 2's names and types.
    Dds,
    /// rclpy over Fast DDS, of the distribution Kilted.
    Kilted,
    /// The same of Jazzy, which has long-term support.
    Jazzy,
}

/// Wheels of ROS 2 itself: empy alone comes as source.
const KILTED: Environment = Environment {
    name: "ros2-kilted",
    requirements: &["ipc/clients/python/requirements.txt"],
    packages: &[
        "--no-binary=empy",
        "ros-rclpy==9.1.2",
        "ros-rmw-fastrtps-cpp==9.3.3",
        "ros-diagnostic-msgs==5.5.1",
        "ros-geometry-msgs==5.5.1",
        "ros-sensor-msgs==5.5.1",
        "ros-std-srvs==5.5.1",
        "ros-visualization-msgs==5.5.1",
    ],
};
const JAZZY: Environment = Environment {
    name: "ros2-jazzy",
    requirements: &["ipc/clients/python/requirements.txt"],
    packages: &[
        "--no-binary=empy",
        "ros-rclpy==7.1.6",
        "ros-rmw-fastrtps-cpp==8.4.3",
        "ros-diagnostic-msgs==5.3.6",
        "ros-geometry-msgs==5.3.6",
        "ros-sensor-msgs==5.3.6",
        "ros-std-srvs==5.3.6",
        "ros-visualization-msgs==5.3.6",
    ],
};

/// Longer than peer.py waits for any service: 10 s for its server and 240 s for a taught memory.
const LONGEST_ANSWER: Duration = Duration::from_secs(260);
/// What vpcd says where a machine is late.
const LATE: [&str; 3] = [
    "disarmed: overruns",
    "disarmed: standstill of the loop",
    "disarmed: robot silent",
];
/// For so long the camera may go on with one command: several of its ticks, s.
const LATE_S: f64 = 0.05;

/// A ROS domain for one test, which no other checkout's tests are in.
pub fn ros_domain_id() -> u16 {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    1 + ((std::process::id() % 10_000 * 16 + count) % 100) as u16
}

/// The peer.
pub struct Peer {
    child: Child,
    stdin: ChildStdin,
    answers: Receiver<String>,
}

impl Peer {
    fn start(bench: &Plan) -> Self {
        let mut command = script(
            &bench.python,
            &root().join("ipc/clients/ros2/tests/judges/peer.py"),
        );
        command.arg(if bench.via == Via::Dds { "dds" } else { "rcl" });
        command.arg(bench.ros_domain_id.to_string());
        command.arg(scene_file()).arg(starts_file());
        if bench.is_in_base {
            command.arg("--base");
        }
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().expect("python");
        let (stdin, stdout) = (child.stdin.take(), child.stdout.take());
        let (sender, answers) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(stdout.unwrap())
                .lines()
                .map_while(Result::ok)
            {
                let _ = sender.send(line);
            }
        });
        Self {
            child,
            stdin: stdin.unwrap(),
            answers,
        }
    }

    /// Sends a command without waiting for its answer.
    pub fn send(&mut self, command: &str) {
        writeln!(self.stdin, "{command}").expect("the peer is there");
    }

    /// The next answer.
    pub fn answer(&mut self) -> Value {
        let line = self.answers.recv_timeout(LONGEST_ANSWER);
        let line = line.expect("the peer answers");
        // NaN is no JSON, and no answer has one.
        serde_json::from_str(&line).unwrap_or_else(|why| panic!("{why}: {line}"))
    }

    pub fn ask(&mut self, command: &str) -> Value {
        self.send(command);
        self.answer()
    }

    pub fn status(&mut self) -> Value {
        self.ask("status")
    }

    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).expect("our child");
    }

    /// Arms, as soon as vpcd lets it; after a stop by the second step that its refusal names.
    pub fn arm(&mut self) {
        let mut last = Value::Null;
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end {
            last = self.ask("call arm");
            let words = last["message"].as_str().unwrap_or_default();
            if words.contains("arm_despite") {
                last = self.ask("call arm_despite");
            }
            if last["success"] == json!(true) {
                return;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        panic!("arm: {last}");
    }

    /// From a start to its end, judged by the referee; `None`, after [`not_run`], where the machine
    /// was late: vpcd says so, or this camera went on with an old command.
    pub fn run(&mut self, start: usize) -> Option<Value> {
        self.place(start);
        let run = self.ask("run");
        let was_late = run["held_s"].as_f64().unwrap() > LATE_S;
        let is_late = was_late
            || run["reason"]
                .as_str()
                .is_some_and(|why| LATE.contains(&why));
        if run["arrived"] != json!(true) && is_late {
            not_run("a run", format_args!("the machine was late: {run}"));
            return None;
        }
        Some(run)
    }

    /// From a start to the goal, unless the machine is late.
    pub fn arrives(&mut self, start: usize) {
        if let Some(run) = self.run(start) {
            assert_eq!(run["arrived"], json!(true), "{run}");
        }
    }

    /// From a start until it moves; `false`, after [`not_run`], where the machine was late.
    pub fn set_off(&mut self, start: usize) -> bool {
        self.place(start);
        self.moves(0.05)
    }

    /// Waits until it is faster than `speed`, in m/s or rad/s; `false`, after [`not_run`], where the
    /// machine was late.
    pub fn moves(&mut self, speed: f64) -> bool {
        let mut last = Value::Null;
        let moves = within(PATIENCE, || {
            last = self.status();
            (last["speed"].as_f64()? > speed).then_some(())
        });
        if moves.is_some() {
            return true;
        }
        let said = last["diagnostics"]["/vpcd: vpcd"]["message"].as_str();
        assert!(
            said.is_some_and(|words| LATE.contains(&words)),
            "no motion: {last}"
        );
        not_run("a motion", format_args!("the machine was late: {last}"));
        false
    }

    /// At a start, armed.
    pub fn place(&mut self, start: usize) {
        self.ask("call disarm");
        self.ask(&format!("place {start}"));
        // Until the jump is over.
        std::thread::sleep(Duration::from_millis(100));
        self.arm();
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// How a bench is made.
pub struct Plan {
    pub via: Via,
    pub ros_domain_id: u16,
    pub is_in_base: bool,
    /// Whether vpcd guards what the peer wants.
    is_guarded: bool,
    python: PathBuf,
}

/// Everything at work.
pub struct Bench {
    pub peer: Peer,
    pub vpcd: Running,
    pub gateway: Running,
    pub plan: Plan,
    config: PathBuf,
    pub place: Place,
    _turn: MutexGuard<'static, ()>,
}

impl Bench {
    /// `None`, after `not_run`, where there is no Python with what is needed.
    pub fn new(test: &str, via: Via, is_in_base: bool) -> Option<Self> {
        Self::start(test, via, is_in_base, false)
    }

    /// The same where vpcd guards what the peer wants.
    pub fn guarded(test: &str) -> Option<Self> {
        Self::start(test, Via::Dds, false, true)
    }

    fn start(test: &str, via: Via, is_in_base: bool, is_guarded: bool) -> Option<Self> {
        let environment = match via {
            Via::Dds => Environment::JUDGES,
            Via::Kilted => KILTED,
            Via::Jazzy => JAZZY,
        };
        let python = environment.python(test)?;
        let turn = testkit::turn();
        let plan = Plan {
            via,
            ros_domain_id: ros_domain_id(),
            is_in_base,
            is_guarded,
            python,
        };
        let place = Place::new();
        let config = place.file("vpc-ros2.toml", plan.config());
        Some(Self {
            peer: Peer::start(&plan),
            vpcd: vpcd(&place, is_guarded),
            gateway: gateway(&place, &config),
            plan,
            config,
            place,
            _turn: turn,
        })
    }

    pub fn restart_gateway(&mut self) {
        self.replace_gateway();
    }

    /// Starts another; the one before.
    pub fn replace_gateway(&mut self) -> Running {
        std::mem::replace(&mut self.gateway, gateway(&self.place, &self.config))
    }

    pub fn restart_vpcd(&mut self) {
        self.vpcd = vpcd(&self.place, self.plan.is_guarded);
    }

    pub fn restart_peer(&mut self) {
        self.peer = Peer::start(&self.plan);
    }

    /// Waits until a status of /diagnostics is so; that status.
    pub fn diagnosed(&mut self, name: &str, is_so: impl Fn(&Value) -> bool) -> Value {
        let name = format!("/vpcd: {name}");
        let mut last = Value::Null;
        let found = within(PATIENCE, || {
            last = self.peer.status()["diagnostics"][&name].clone();
            std::thread::sleep(Duration::from_millis(50));
            is_so(&last).then(|| last.clone())
        });
        found.unwrap_or_else(|| panic!("{name}: {last}"))
    }
}

impl Plan {
    fn config(&self) -> String {
        let Self {
            via,
            ros_domain_id,
            is_in_base,
            is_guarded,
            ..
        } = self;
        let scene = scene_file();
        let (services, camera) = match via {
            Via::Dds => ("cyclonedds", "features = \"tags\""),
            Via::Kilted | Via::Jazzy => ("fastdds", "features = \"points\"\ntopic = \"/points\""),
        };
        let robot = match is_in_base {
            true => {
                "executed = \"pose\"\npose = \"/tool_pose\"\ncommand_frame = \"base\"\n\
                 [mount]\ntranslation = [0.05, -0.02, 0.08]\nrotation_deg = [5.0, -40.0, 90.0]\n"
            }
            false => "",
        };
        let policy = match is_guarded {
            true => "[policy]\ndesired = \"/wish\"\n",
            false => "",
        };
        format!(
            "scene = {scene:?}\nros_domain_id = {ros_domain_id}\ninterfaces = [\"127.0.0.1\"]\n\
             services = \"{services}\"\n[camera]\n{camera}\n[robot]\n\
             joints = [\"shoulder\", \"elbow\", \"wrist\"]\n{robot}{policy}"
        )
    }
}

fn vpcd(place: &Place, is_guarded: bool) -> Running {
    let mut command = testkit::command(program("vpcd"));
    let [scene, memory] = ["scene.toml", "memory.vpcmem"].map(|name| place.path(name));
    for (from, to) in [(scene_file(), &scene), (memory_file(), &memory)] {
        std::fs::copy(from, to).expect("a copy, which a goal may change");
    }
    command.arg("--scene").arg(scene);
    command.arg("--memory").arg(memory);
    command.arg("--domain").arg(place.domain());
    if is_guarded {
        command.args(["--strategy", "follow"]);
    }
    Running::start(command.stdout(Stdio::null()).stderr(Stdio::piped()))
}

fn gateway(place: &Place, config: &PathBuf) -> Running {
    let mut command = testkit::command(program("vpc-ros2"));
    command.arg("--config").arg(config);
    command.arg("--domain").arg(place.domain());
    Running::start(command.stdout(Stdio::piped()).stderr(Stdio::piped()))
}
