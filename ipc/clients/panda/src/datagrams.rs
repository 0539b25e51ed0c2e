//! The socket of the client library, which takes datagrams of anybody and answers the last sender.
//! Connected to the robot, the kernel keeps all others out.

use std::io::{Error, Result};
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::os::fd::BorrowedFd;

use rustix::net::sockopt::socket_type;
use rustix::net::{RecvFlags, SocketType, connect, getpeername, getsockname, recv, recvfrom};

/// Datagrams of others that are taken out, until one of the robot comes.
const MOST: usize = 10_000;

/// Connects the library's socket to the robot at `host`, and drops what waits there.
///
/// # Errors
/// There is no such socket, or the robot sends nothing to it.
pub fn of_robot_alone(host: &str) -> Result<()> {
    let robots: Vec<IpAddr> = match host.to_socket_addrs() {
        Ok(addresses) => addresses.map(|a| a.ip()).collect(),
        Err(_) => (host, 0).to_socket_addrs()?.map(|a| a.ip()).collect(),
    };
    // An emulator on this machine may answer from another of its addresses.
    let is_here = robots.iter().any(IpAddr::is_loopback);
    let is_robot = |ip: IpAddr| robots.contains(&ip) || is_here && ip.is_loopback();
    let socket = unconnected()?.ok_or_else(|| Error::other("there is none"))?;
    let mut byte = [0; 1];
    for _ in 0..MOST {
        // Waits for 1 s at most, as the library has set it.
        let (_, _, from) = recvfrom(socket, &mut byte, RecvFlags::PEEK)?;
        let from = from.and_then(|from| SocketAddr::try_from(from).ok());
        match from {
            Some(from) if is_robot(from.ip()) => {
                connect(socket, &from)?;
                while recv(socket, &mut byte, RecvFlags::DONTWAIT).is_ok() {}
                return Ok(());
            }
            _ => drop(recv(socket, &mut byte, RecvFlags::DONTWAIT)),
        }
    }
    Err(Error::other("only others send to it"))
}

/// The one UDP socket of this process that is bound and not connected.
#[expect(unsafe_code, reason = "the library does not lend its socket")]
fn unconnected() -> Result<Option<BorrowedFd<'static>>> {
    for entry in std::fs::read_dir("/proc/self/fd")? {
        let name = entry?.file_name();
        let Some(number) = name.to_str().and_then(|name| name.parse().ok()) else {
            continue;
        };
        // SAFETY: it is open, or the calls below fail. The library keeps its socket until the robot
        // is dropped, which outlives `of_robot_alone`.
        let socket = unsafe { BorrowedFd::borrow_raw(number) };
        let address = getsockname(socket).ok();
        let address = address.and_then(|address| SocketAddr::try_from(address).ok());
        if socket_type(socket) == Ok(SocketType::DGRAM)
            && address.is_some_and(|address| address.port() > 0)
            && getpeername(socket).is_err()
        {
            return Ok(Some(socket));
        }
    }
    Ok(None)
}
