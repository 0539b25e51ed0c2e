//! `metrics`, judged by the client library that Prometheus publishes for Python.

use std::io::Write;
use std::process::Stdio;

use testkit::python::Environment;

use crate::stand_in::StandIn;
use crate::{stderr, stdout, vpcctl};

/// Reads the text from standard input with the parser of PyPI's prometheus-client; prints what it
/// found.
const PARSER: &str = r#"
import sys
from prometheus_client.parser import text_string_to_metric_families as parse
names = {}
for family in parse(sys.stdin.read()):
    assert family.documentation and family.type != "unknown", family
    for sample in family.samples:
        names.setdefault(sample.name, 0)
        names[sample.name] += sample.value
for name in ("vpc_up", "vpc_cycles_total", "vpc_overruns_total", "vpc_cycle_duration_seconds_count"):
    print(name, float(names[name]))
"#;

#[test]
fn the_python_client_of_prometheus_reads_what_is_printed() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let output = vpcctl(directory.path(), &["metrics", "--once", "--watch", "0.5"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let Some(python) = Environment::JUDGES.python("the parser of Prometheus") else {
        return;
    };
    let mut parser = testkit::command(python)
        .args(["-c", PARSER])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = parser.stdin.take().unwrap();
    input.write_all(&output.stdout).unwrap();
    drop(input);
    let parsed = parser.wait_with_output().unwrap();
    assert!(
        parsed.status.success(),
        "{}\n{}",
        stderr(&parsed),
        stdout(&output)
    );
    let text = stdout(&parsed);
    assert!(
        text.contains("vpc_up 1.0\n") && text.contains("vpc_overruns_total 2.0\n"),
        "{text}"
    );
}
