//! The launch file, with a stub of ROS's launch library; signals at any point of a start.

use std::process::Stdio;
use std::time::Duration;

use rustix::process::Signal;
use testkit::{Place, Running, ended, program, root, scene_file};

use crate::bench::ros_domain_id;

#[test]
fn the_launch_file_starts_the_programs_with_their_files() {
    let stub = root().join("ipc/clients/ros2/tests/judges/launch_stub.py");
    let file = root().join("ipc/clients/ros2/launch/vpcd.launch.py");
    let mut python = testkit::command("python3");
    let ended = ended(python.arg(stub).arg(file).env("ROS_DOMAIN_ID", "17"));
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    assert_eq!(
        ended.stdout,
        "setpriv --pdeathsig TERM vpcd --config /etc/vpcd/vpcd.toml --domain /run/x\n\
         setpriv --pdeathsig TERM vpc-ros2 --config /etc/vpcd/vpc-ros2.toml --domain /run/x --ros-domain-id 17\n"
    );
}

#[test]
fn a_signal_ends_it_at_whatever_point_of_its_start() {
    for ms in [0, 3, 10, 30, 60, 100, 200, 400] {
        let place = Place::new();
        let mut gateway = testkit::command(program("vpc-ros2"));
        let scene = scene_file();
        let text = format!(
            "scene = {scene:?}\nros_domain_id = {}\ninterfaces = [\"127.0.0.1\"]\n",
            ros_domain_id()
        );
        gateway
            .arg("--config")
            .arg(place.file("vpc-ros2.toml", text));
        gateway.arg("--domain").arg(place.domain());
        let gateway = Running::start(gateway.stderr(Stdio::piped()));
        std::thread::sleep(Duration::from_millis(ms));
        gateway.signal(Signal::TERM);
        // 2 s, and a loaded machine. At first there is none who handles it.
        let ended = gateway.ended_within(Duration::from_secs(4));
        let is_so = ended.code == Some(0) || ended.signal == Some(15);
        assert!(is_so, "after {ms} ms: {ended:?}");
    }
}
