//! The guard: a process of its own that says zero when the gateway no longer can.
//!
//! The gateway parses the network by a library that one datagram can hang. The guard never reads
//! from a network. It gets, from the instant of sending, a copy of each twist as it left, with the
//! address and the socket. When the gateway ends, or a twist that is not zero has no successor in
//! time, it kills the gateway and sends zeros to the same addresses, in the name of the same
//! writer.

use std::io::{IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::fstat;
use rustix::net::{
    AddressFamily, RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer,
    SendAncillaryMessage, SendFlags, SocketFlags, SocketType, recvmsg, sendmsg, sendto, socketpair,
};
use rustix::process::{Pid, PidfdFlags, Signal, getppid, pidfd_open, pidfd_send_signal};

use crate::wire::{Guid, Sent};

/// The first word of the guard's command line.
pub const ROLE: &str = "--guard";
/// After a twist that is not zero the next one has left within this: vpcd's command ends after
/// 100 ms, and zeros follow.
const SILENCE: Duration = Duration::from_millis(200);
/// What the gateway gets when the guard itself was as late.
const GRACE: Duration = Duration::from_millis(50);
/// Between two zeros.
const PERIOD: Duration = Duration::from_millis(20);
/// Most places that twists go to, and how long one is kept to which none goes any more.
const PLACES: usize = 64;
const KEPT: Duration = Duration::from_secs(1);
/// Numbers that are left to what the gateway sends while it is killed.
const MARGIN: u64 = 100;
/// A twist with its address is shorter.
const MESSAGE: usize = 4096;

static GUARDED: OnceLock<Guarded> = OnceLock::new();

/// The gateway's side.
struct Guarded {
    guard: OwnedFd,
    writer: OnceLock<Guid>,
    /// Whether it has seen anything leave.
    sees: AtomicBool,
    is_gone: AtomicBool,
    _child: Child,
}

/// Starts the guard. Call it first of all: it inherits what is open.
///
/// # Errors
/// The system refuses.
#[expect(clippy::disallowed_methods, reason = "it must outlive this process")]
pub fn start(zeros: Duration) -> std::io::Result<()> {
    let (ours, theirs) = socketpair(
        AddressFamily::UNIX,
        SocketType::SEQPACKET,
        SocketFlags::CLOEXEC,
        None,
    )?;
    let child = Command::new(std::env::current_exe()?)
        .arg0("vpc-ros2-guard")
        .args([ROLE, &std::process::id().to_string()])
        .arg(zeros.as_millis().to_string())
        .stdin(Stdio::from(theirs))
        .stdout(Stdio::null())
        .spawn()?;
    let guarded = Guarded {
        guard: ours,
        writer: OnceLock::new(),
        sees: AtomicBool::new(false),
        is_gone: AtomicBool::new(false),
        _child: child,
    };
    let guarded = GUARDED.get_or_init(|| guarded);
    // To itself: whoever links this program otherwise learns it now.
    let probe = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    probe.send_to(&[0], probe.local_addr()?)?;
    match guarded.sees.load(Ordering::Relaxed) {
        true => Ok(()),
        false => Err(std::io::Error::other("it does not see what leaves")),
    }
}

/// Names the writer of twists.
pub fn writer(guid: Guid) {
    if let Some(guarded) = GUARDED.get() {
        let _ = guarded.writer.set(guid);
    }
}

/// Whether the guard has ended or takes no more: then nothing may move.
pub fn is_gone() -> bool {
    GUARDED.get().is_some_and(|guarded| {
        let mut polled = [PollFd::new(&guarded.guard, PollFlags::IN)];
        let is_closed = poll(&mut polled, Some(&Timespec::default())) != Ok(0);
        is_closed || guarded.is_gone.load(Ordering::Relaxed)
    })
}

/// A datagram left; the guard gets it if it is a twist.
pub fn sent(socket: BorrowedFd, datagram: &[u8], to: SocketAddr) {
    let Some(guarded) = GUARDED.get() else {
        return;
    };
    guarded.sees.store(true, Ordering::Relaxed);
    let writer = guarded.writer.get();
    if writer.is_some_and(|writer| Sent::read(datagram, writer).is_some()) {
        guarded.tell(&to.to_string(), datagram, Some(socket));
    }
}

/// No receiver is left: no twist goes out, though they are published.
pub fn nobody_listens() {
    if let Some(guarded) = GUARDED.get() {
        guarded.tell("", b"", None);
    }
}

impl Guarded {
    /// An address, the writer, and a datagram.
    fn tell(&self, to: &str, datagram: &[u8], socket: Option<BorrowedFd>) {
        let writer = self.writer.get().copied().unwrap_or_default();
        let parts = [to.as_bytes(), b"\n", &writer, datagram].map(IoSlice::new);
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
        let mut ancillary = SendAncillaryBuffer::new(&mut space);
        let sockets = socket.map(|socket| [socket]);
        if let Some(sockets) = &sockets {
            ancillary.push(SendAncillaryMessage::ScmRights(sockets));
        }
        let flags = SendFlags::DONTWAIT | SendFlags::NOSIGNAL;
        if sendmsg(&self.guard, &parts, &mut ancillary, flags).is_err() {
            self.is_gone.store(true, Ordering::Relaxed);
        }
    }
}

/// Where twists go.
struct Place {
    to: SocketAddr,
    /// The gateway's, never read from here; and its number in the system.
    socket: OwnedFd,
    inode: u64,
    sent: Sent,
    at: Instant,
}

/// The guard's side.
struct Guard {
    places: Vec<Place>,
    /// The newest twist that left, and when.
    number: u64,
    at: Instant,
    is_moving: bool,
}

/// The guard: `pid` and `zeros_ms` are the words behind [`ROLE`]. Returns when its gateway has
/// ended and zeros were sent.
///
/// # Errors
/// It was not started by a gateway, or the system refuses.
pub fn run(mut words: impl Iterator<Item = String>) -> std::io::Result<()> {
    let wrong = || std::io::Error::other("this is for the gateway to start");
    let mut number = || words.next()?.parse::<u32>().ok();
    let (pid, zeros_ms) = number().zip(number()).ok_or_else(wrong)?;
    let parent = getppid().ok_or_else(wrong)?;
    let gateway = pidfd_open(parent, PidfdFlags::empty())?;
    // It may have ended before, and another process be the parent.
    if getppid().map(Pid::as_raw_pid) != i32::try_from(pid).ok() {
        return Err(wrong());
    }
    let mut guard = Guard {
        places: Vec::new(),
        number: 0,
        at: Instant::now(),
        is_moving: false,
    };
    let has_ended = guard.watch(std::io::stdin().as_fd())?;
    if !guard.is_moving {
        return Ok(());
    }
    // First of all: its twists would contradict the zeros.
    let _ = pidfd_send_signal(&gateway, Signal::KILL);
    guard.finish(std::io::stdin().as_fd());
    let why = match has_ended {
        true => "the gateway ended while it moved the robot",
        false => "no twist left for 200 ms: the gateway is killed",
    };
    eprintln!("vpc-ros2: {why}; zeros are sent for {zeros_ms} ms");
    guard.stand(Duration::from_millis(zeros_ms.into()));
    Ok(())
}

impl Guard {
    /// Until the gateway ends, returns true; or until a twist has no successor.
    fn watch(&mut self, socket: BorrowedFd) -> std::io::Result<bool> {
        loop {
            let left = SILENCE.saturating_sub(self.at.elapsed());
            let left = Timespec::try_from(left).unwrap_or_default();
            let mut polled = [PollFd::new(&socket, PollFlags::IN)];
            match poll(&mut polled, self.is_moving.then_some(&left)) {
                Ok(0) => {
                    let late = self.at.elapsed().saturating_sub(SILENCE);
                    if late < GRACE {
                        return Ok(false);
                    }
                    // This machine stood still, and the gateway with it.
                    self.at += late + GRACE;
                }
                Ok(_) if !self.take(socket)? => return Ok(true),
                Ok(_) | Err(rustix::io::Errno::INTR) => (),
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Takes what left meanwhile.
    fn finish(&mut self, socket: BorrowedFd) {
        let now = Some(&Timespec::default());
        while poll(&mut [PollFd::new(&socket, PollFlags::IN)], now) == Ok(1)
            && self.take(socket).is_ok_and(|is_taken| is_taken)
        {}
        self.number += MARGIN;
    }

    /// Takes a message; returns whether there was one.
    fn take(&mut self, socket: BorrowedFd) -> std::io::Result<bool> {
        let mut buffer = [0; MESSAGE];
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
        let mut ancillary = RecvAncillaryBuffer::new(&mut space);
        let mut parts = [IoSliceMut::new(&mut buffer)];
        let taken = recvmsg(socket, &mut parts, &mut ancillary, RecvFlags::CMSG_CLOEXEC)?;
        let mut sockets = ancillary.drain().filter_map(|message| match message {
            RecvAncillaryMessage::ScmRights(mut sockets) => sockets.next(),
            _ => None,
        });
        match (sockets.next(), taken.bytes) {
            (_, 0) => return Ok(false),
            (Some(socket), length) => _ = self.note(&buffer[..length], socket),
            // Nobody listens any more.
            (None, _) => self.is_moving = false,
        }
        Ok(true)
    }

    fn note(&mut self, message: &[u8], socket: OwnedFd) -> Option<()> {
        let end = message.iter().position(|byte| *byte == b'\n')?;
        let to = str::from_utf8(&message[..end]).ok()?.parse().ok()?;
        let (writer, datagram) = message[end + 1..].split_first_chunk()?;
        let sent = Sent::read(datagram, writer)?;
        let (inode, at) = (fstat(&socket).ok()?.st_ino, Instant::now());
        // An older one is sent again to a receiver that missed it.
        if sent.number >= self.number {
            (self.number, self.at) = (sent.number, at);
            self.is_moving = !sent.is_zero();
        }
        let newest = self.at;
        self.places
            .retain(|p| (p.to, p.inode) != (to, inode) && newest - p.at < KEPT);
        self.places.truncate(PLACES - 1);
        self.places.push(Place {
            to,
            socket,
            inode,
            sent,
            at,
        });
        Some(())
    }

    /// Sends zeros for so long.
    fn stand(&mut self, zeros: Duration) {
        let begin = Instant::now();
        while begin.elapsed() < zeros {
            self.number += 1;
            let wall = SystemTime::now().duration_since(UNIX_EPOCH);
            let wall = wall.unwrap_or_default();
            for place in &self.places {
                let (seconds, nanoseconds) = (wall.as_secs() as u32, wall.subsec_nanos());
                let zero = place.sent.zero(self.number, seconds, nanoseconds);
                let _ = sendto(&place.socket, &zero, SendFlags::DONTWAIT, &place.to);
            }
            std::thread::sleep(PERIOD);
        }
    }
}
