//! A reload under real-time scheduling (root only).

use std::path::Path;

use rustix::process::Signal;

use crate::fixture::{Manager, Place, is_root, thread, vpcd};

#[test]
fn threads_are_scheduled_as_before() {
    if !is_root("scheduling after a hang-up") {
        return;
    }
    let place = Place::new();
    let manager = Manager::new(&place);
    place.file("own.toml", scene::PAPER_SIM);
    let text = "scene = 'own.toml'\n[realtime]\npriority = 70\ncpu = 0\n";
    let mut command = vpcd();
    command.arg("--config").arg(place.file("vpcd.toml", text));
    command.arg("--domain").arg(place.domain());
    let daemon = manager.manage(command, None);
    manager.until("READY=1");
    let scheduled = |name: &str| {
        let path = format!("/proc/{}/task/{}", daemon.id(), thread(daemon.id(), name));
        scheduling(Path::new(&path))
    };
    let before = ["vpcd", "recorder"].map(scheduled);
    daemon.signal(Signal::USR2);
    manager.until("RELOADING=1");
    manager.until("READY=1");
    assert_eq!(["vpcd", "recorder"].map(scheduled), before);
    let [(policy, priority, alone), (ordinary, ..)] = &before;
    assert_eq!((&**policy, &**priority, &**alone), ("1", "70", "0"));
    assert_eq!(ordinary, "0");
    assert_eq!(daemon.terminated().log().0, 0);
}

/// Policy (1: SCHED_FIFO), priority and processors of a thread.
fn scheduling(task: &Path) -> (String, String, String) {
    let stat = std::fs::read_to_string(task.join("stat")).unwrap();
    let (_, fields) = stat.rsplit_once(") ").unwrap();
    // Fields 40 and 41 of proc(5); the first after the name is 3.
    let field = |number: usize| fields.split(' ').nth(number - 3).unwrap().to_owned();
    let status = std::fs::read_to_string(task.join("status")).unwrap();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("Cpus_allowed_list:"));
    (field(41), field(40), line.unwrap().trim().to_owned())
}
