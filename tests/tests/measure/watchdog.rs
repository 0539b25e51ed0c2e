//! Two periods after the loop hangs nothing vouches for it any more, heard at a service manager's
//! socket. When what is said, the unit tests of `controller::service` show with a clock that is
//! moved by hand; what systemd does then, the target `judges` of `controller`.

use std::io::ErrorKind;
use std::os::unix::net::UnixDatagram;
use std::process::Stdio;
use std::time::{Duration, Instant};

use ipc::now_ns;
use rustix::process::Signal;

use crate::fixture::{
    PERIOD_NS, Place, Running, WAKE_NS, classes, eventually, program, scene_file,
};
use crate::frozen::{Frozen, thread};
use crate::judge::{Miss, NotShown, in_time};
use crate::reference::Class;
use crate::sheet::Sheet;
use crate::spin::spin;

/// 15 periods of the loop.
const WATCHDOG: Duration = Duration::from_millis(500);
/// Phases of the cycle at which it hangs.
const PHASES: u32 = 2;
/// How long it is listened to: the stillness is told once a second, when it is half a second old.
const HEARD: Duration = Duration::from_millis(2000);
/// From the hang to the last feed, ns.
const FED_NS: u64 = 2 * PERIOD_NS + WAKE_NS;

/// What the daemon is put into.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hang {
    /// The loop's thread stands still.
    Still,
    /// The loop's thread is in an endless loop.
    Endless,
    /// SIGSTOP.
    Stopped,
}

/// All of them.
pub const HANGS: [Hang; 3] = [Hang::Still, Hang::Endless, Hang::Stopped];

impl Hang {
    /// The name of its measurement.
    pub fn name(self) -> &'static str {
        match self {
            Self::Still => "watchdog, loop stands still",
            Self::Endless => "watchdog, loop is endless",
            Self::Stopped => "watchdog, SIGSTOP",
        }
    }
}

/// A service manager's end of the talk.
struct Manager(UnixDatagram);

impl Manager {
    /// The next message that comes within this time.
    fn within(&self, patience: Duration) -> Option<String> {
        self.0.set_read_timeout(Some(patience)).unwrap();
        let mut buffer = [0; 4096];
        match self.0.recv(&mut buffer) {
            Ok(length) => Some(String::from_utf8_lossy(&buffer[..length]).into_owned()),
            // The second where we trace another process's threads.
            Err(error)
                if [ErrorKind::WouldBlock, ErrorKind::Interrupted].contains(&error.kind()) =>
            {
                None
            }
            Err(error) => panic!("{error}"),
        }
    }

    fn until(&self, words: &str) {
        eventually(words, || {
            let message = self.within(WATCHDOG)?;
            message.contains(words).then_some(())
        });
    }
}

/// How long after the hang began the last feed was heard, ns; zero if none was.
fn last_feed(hang: Hang, phase: u32) -> anyhow::Result<u64> {
    let place = Place::new();
    let path = place.path("notify");
    let manager = Manager(UnixDatagram::bind(&path)?);
    let mut command = testkit::command(program("vpcd"));
    command.arg("--scene").arg(scene_file()).arg("--arm");
    command.arg("--domain").arg(place.domain());
    command
        .env("NOTIFY_SOCKET", path)
        .env_remove("WATCHDOG_PID");
    command.env("WATCHDOG_USEC", WATCHDOG.as_micros().to_string());
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let daemon = Running::start(command);
    manager.until("READY=1");
    manager.until("WATCHDOG=1");
    // Shortly before the next feed.
    let period = Duration::from_nanos(PERIOD_NS);
    std::thread::sleep(WATCHDOG / 4 - period * phase / PHASES);
    let looping = thread(daemon.id(), "vpcd");
    while manager.within(Duration::from_millis(1)).is_some() {}
    let _frozen = match hang {
        Hang::Still => Some(Frozen::freeze(looping)),
        Hang::Endless => {
            if !spin(looping) {
                let why = "not known how to make a loop endless on this processor";
                return Err(NotShown(why.to_owned()).into());
            }
            None
        }
        Hang::Stopped => {
            daemon.halt(Signal::STOP);
            None
        }
    };
    let (begun, hung_ns) = (Instant::now(), now_ns());
    let (mut last_ns, mut told) = (hung_ns, 0);
    while begun.elapsed() < HEARD {
        if let Some(message) = manager.within(WATCHDOG / 8) {
            if message.lines().any(|line| line == "WATCHDOG=1") {
                last_ns = now_ns();
            }
            told += usize::from(message.contains("STATUS=LOOP STANDS STILL"));
        }
    }
    let fed = in_time("the last feed", Class::Ordinary, hung_ns, last_ns, FED_NS)?;
    // Silence is not for want of somebody to talk.
    let is_right = (told > 0) == (hang != Hang::Stopped);
    let what = || format!("its stillness is told {told} times");
    Miss::unless(is_right, what, Class::Ordinary, hung_ns)?;
    Ok(fed)
}

/// Measures this hang, at several phases of the cycle.
pub fn measure(hang: Hang, sheet: &mut Sheet) {
    for phase in 0..PHASES {
        let what = format!("phase {phase}");
        if let Some(ns) = sheet.round(&classes(), &what, || last_feed(hang, phase)) {
            sheet.longest("fed for", ns, FED_NS);
        }
    }
}
