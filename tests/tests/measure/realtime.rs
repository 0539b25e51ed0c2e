//! Who has the right to real time gets all of it.

use std::process::Stdio;

use serde_json::Value;

use crate::fixture::{Place, ended, program, scene_file};
use crate::machine::may_be_real_time;
use crate::sheet::Sheet;

/// Measures.
pub fn measure(sheet: &mut Sheet) {
    if !may_be_real_time() {
        return sheet.lacks("no right to real time (vpcd --preflight)");
    }
    let place = Place::new();
    let scene = scene_file();
    let text = format!(
        "scene = '{}'\n[realtime]\npriority = 10\ncpu = 0\n",
        scene.display()
    );
    let report = place.path("report.json");
    let mut command = testkit::command(program("vpcd"));
    command.arg("--config").arg(place.file("v.toml", text));
    command.arg("--domain").arg(place.domain());
    command.args(["--cycles", "3", "--report"]).arg(&report);
    let said = ended(command.stdout(Stdio::null()));
    assert_eq!(said.code, Some(0), "{said:?}");
    let degraded = said.stderr.matches("DEGRADED").count();
    sheet.check(degraded == 0, || said.stderr.clone());
    let text = std::fs::read_to_string(report).unwrap();
    let report: Value = serde_json::from_str(&text).unwrap();
    let number = |name: &str| report[name].as_u64().unwrap();
    let [bits, locked, stack] = ["realtime", "locked_kib", "stack_used_bytes"].map(number);
    sheet.figure("locked", locked as f64, "KiB");
    sheet.figure("stack used", stack as f64, "bytes");
    sheet.check(bits == 1, || format!("real time is {bits}"));
    sheet.check(locked > 10_000, || format!("{locked} KiB locked"));
    let most = controller::stack::SIZE as u64;
    sheet.check((4096..most).contains(&stack), || {
        format!("{stack} bytes of stack")
    });
}
