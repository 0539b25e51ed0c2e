//! The emulated robot as a process.

use std::net::Ipv4Addr;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

use ipc::{Domain, Subscriber};
use messages::Features;
use testkit::{Place, Running, eventually, program, root};

/// The emulated robot in a domain of its own, with an address of its own.
pub struct Robot {
    running: Running,
    /// Where it listens, on the port of the interface.
    pub address: Ipv4Addr,
    /// Its directory.
    pub place: Place,
}

impl Robot {
    /// A robot whose time goes by this clock. `truth` is TOML: how the world differs from what scene
    /// and hand-eye file say.
    pub fn start(clock: &str, version: u8, truth: &str) -> Self {
        let (address, place) = (own_address(), Place::new());
        let scenes = root().join("ipc/scene/scenes");
        let scenes = scenes.display();
        let text = format!(
            "scene = '{scenes}/paper-robot.toml'\nstarts = '{scenes}/paper-robot-starts.csv'\n\
             robot = 'panda'\nfci = '{address}:1337'\nfci_version = {version}\nnoise_px = 0.2\n\
             clock = '{clock}'\n[truth]\n{truth}\n"
        );
        let mut hw_sim = testkit::command(program("hw-sim"));
        hw_sim.arg("--config").arg(place.file("hw-sim.toml", text));
        hw_sim.arg("--domain").arg(place.domain());
        let running = Running::start(hw_sim.stdout(Stdio::piped()).stderr(Stdio::piped()));
        let domain = Domain::join(&place.domain()).unwrap();
        let mut features: Subscriber<Features> = domain.subscriber(1).unwrap();
        eventually("a frame", || features.latest().unwrap());
        Self {
            running,
            address,
            place,
        }
    }

    /// The bridge to it, with the hand-eye file of the emulated camera.
    pub fn bridge(&self, robot: &str) -> Command {
        self.bridge_with(robot, &root().join("ipc/clients/panda/hand-eye.toml"))
    }

    /// The bridge to it.
    pub fn bridge_with(&self, robot: &str, hand_eye: &Path) -> Command {
        let mut bridge = testkit::command(env!("CARGO_BIN_EXE_vpc-panda"));
        bridge.args(["--robot", &format!("{robot}:{}", self.address)]);
        bridge.arg("--hand-eye").arg(hand_eye).arg("--scene");
        bridge.arg(root().join("ipc/scene/scenes/paper-robot.toml"));
        bridge.arg("--domain").arg(self.place.domain());
        bridge
    }

    /// What its referee reports at the end.
    pub fn report(self) -> String {
        self.running.terminated().stdout
    }
}

/// A loopback address that no other test of this machine has, as clients of the interface connect to
/// one port: 127, then 16 bits of the process, then one of 254.
pub fn own_address() -> Ipv4Addr {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    let process = std::process::id() & 0xffff;
    Ipv4Addr::from(127 << 24 | process << 8 | (1 + count % 254))
}
