//! `monitoring/`: rules and dashboard, judged by Prometheus itself.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Stdio;

use ipc::{Domain, RobotPorts};
use messages::{Encoding, ImageHeader, RobotMode, RobotState};
use serde_json::Value;
use testkit::python::run;
use testkit::{Running, are_installed, eventually};

use crate::server::Server;
use crate::stand_in::{Camera, StandIn};
use crate::vpcctl;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("monitoring")
        .join(name)
}

fn promtool(arguments: &[&str], name: &str) -> Result<String, String> {
    run(testkit::command("promtool").args(arguments).arg(file(name)))
}

#[test]
fn each_alert_fires_on_its_cause_and_on_nothing_else() {
    if !are_installed("alert rules", &["promtool=prometheus"]) {
        return;
    }
    promtool(&["check", "config"], "prometheus.yml").unwrap();
    promtool(&["test", "rules"], "alerts-test.yml").unwrap();
}

/// The metrics that an expression selects, each as a selector of any instance.
fn selectors(expression: &str) -> Vec<String> {
    let parts = expression.match_indices("vpc_");
    parts
        .map(|(begin, _)| {
            let rest = &expression[begin..];
            let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
            let end = rest.find(|c| !is_name(c)).unwrap_or(rest.len());
            let labels = match rest[end..].starts_with('{') {
                true => rest[end..].find('}').map_or(end, |close| end + close + 1),
                false => end,
            };
            rest[..labels].to_owned()
        })
        .collect()
}

/// A Prometheus at work.
struct Prometheus {
    address: String,
    _process: Running,
}

impl Prometheus {
    /// Starts it with the shipped files, for this target and in a hurry.
    fn start(directory: &Path, target: &str) -> Self {
        let shipped = std::fs::read_to_string(file("prometheus.yml")).unwrap();
        let config = shipped.replace("127.0.0.1:9469", target);
        let config = config.replace("interval: 5s", "interval: 1s");
        let rules = std::fs::read_to_string(file("alerts.yml")).unwrap();
        let rules = rules.replace("for: 10s", "for: 2s");
        std::fs::write(directory.join("alerts.yml"), rules).unwrap();
        let path = directory.join("prometheus.yml");
        std::fs::write(&path, config).unwrap();
        let free = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = free.local_addr().unwrap().to_string();
        drop(free);
        let mut command = testkit::command("prometheus");
        command.arg(format!("--config.file={}", path.display()));
        command.arg(format!("--web.listen-address={address}"));
        command.arg(format!(
            "--storage.tsdb.path={}",
            directory.join("series").display()
        ));
        command.stdout(Stdio::null()).stderr(Stdio::null());
        let process = Running::start(command);
        let prometheus = Self {
            address,
            _process: process,
        };
        eventually("Prometheus", || {
            let ready = prometheus.get("/-/ready")?;
            ready.starts_with("HTTP/1.0 200").then_some(())
        });
        prometheus
    }

    fn get(&self, path: &str) -> Option<String> {
        let mut stream = TcpStream::connect(&self.address).ok()?;
        let host = &self.address;
        write!(stream, "GET {path} HTTP/1.0\r\nHost: {host}\r\n\r\n").ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        Some(answer)
    }

    /// The samples of an expression.
    fn query(&self, expression: &str) -> Vec<Value> {
        let encoded: String = expression.bytes().map(|b| format!("%{b:02x}")).collect();
        let answer = self.get(&format!("/api/v1/query?query={encoded}")).unwrap();
        let (_, body) = answer.split_once("\r\n\r\n").unwrap();
        let body: Value = serde_json::from_str(body).unwrap();
        assert_eq!(body["status"], "success", "{expression}: {body}");
        body["data"]["result"].as_array().unwrap().clone()
    }
}

/// The expressions of the dashboard, with values for Grafana's variables.
fn dashboard() -> Vec<String> {
    let text = std::fs::read_to_string(file("grafana.json")).unwrap();
    let board: Value = serde_json::from_str(&text).unwrap();
    let panels = board["panels"].as_array().unwrap();
    let targets = panels
        .iter()
        .flat_map(|panel| panel["targets"].as_array().unwrap());
    let expressions: Vec<_> = targets
        .map(|target| {
            let expression = target["expr"].as_str().unwrap();
            let expression = expression.replace("$instance", ".+");
            expression
                .replace("$__rate_interval", "10s")
                .replace("$__range", "1m")
        })
        .collect();
    assert!(expressions.len() > 15 && expressions.iter().all(|text| !text.contains('$')));
    expressions
}

#[test]
fn prometheus_finds_all_that_rules_and_dashboard_ask_for() {
    if !are_installed("a Prometheus", &["prometheus"]) {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let daemon = StandIn::sound(directory.path());
    // Armed, so that it is missed when it ends.
    assert!(vpcctl(directory.path(), &["arm"]).status.success());
    let header = ImageHeader::new(4, 4, Encoding::Mono8, 1);
    let camera = Camera::start(directory.path(), header, |_, _| [7]);
    let domain = Domain::join(directory.path()).unwrap();
    let mut robot = RobotPorts::open(&domain).unwrap();
    let server = Server::start(directory.path(), &["metrics", "--listen", "127.0.0.1:0"]);
    let prometheus = Prometheus::start(directory.path(), &server.address);

    let rules: Value = {
        let answer = prometheus.get("/api/v1/rules").unwrap();
        serde_json::from_str(answer.split_once("\r\n\r\n").unwrap().1).unwrap()
    };
    let rules = rules["data"]["groups"][0]["rules"]
        .as_array()
        .unwrap()
        .clone();
    let alerts = rules
        .iter()
        .map(|rule| rule["query"].as_str().unwrap().to_owned());
    let expressions: Vec<_> = alerts.chain(dashboard()).collect();
    let asked: Vec<_> = expressions
        .iter()
        .flat_map(|text| selectors(text))
        .collect();
    assert!(asked.len() > 30, "{asked:?}");
    eventually("all that is asked for", || {
        let state = RobotState {
            mode: RobotMode::Moving.code(),
            ..RobotState::default()
        };
        robot.robot.publish(&state).unwrap();
        let mut asked = asked.iter();
        asked
            .all(|text| !prometheus.query(text).is_empty())
            .then_some(())
    });
    // Each expression is one that Prometheus computes.
    for expression in &expressions {
        prometheus.query(expression);
    }
    let up = prometheus.query("vpc_up");
    assert_eq!(up[0]["value"][1], "1", "{up:?}");

    // The daemon ends.
    drop((daemon, camera));
    eventually("an alarm", || {
        let alarms = prometheus.query("ALERTS{alertname=\"VpcdDown\",alertstate=\"firing\"}");
        (!alarms.is_empty()).then_some(())
    });
}
