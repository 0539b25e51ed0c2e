//! What leaves by UDP, seen in the instant in which it leaves.
//!
//! The DDS library tells neither whether nor where to it has sent something. Its calls of `sendto`
//! end here, as the linker takes this function before that of the C library.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV6};
use std::os::fd::BorrowedFd;

use libc::{c_int, c_void, size_t, sockaddr, socklen_t, ssize_t};
use vpc_ros2::guard;

/// As `sendto(2)`.
///
/// # Safety
/// As for that of the C library.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sendto(
    socket: c_int,
    buffer: *const c_void,
    length: size_t,
    flags: c_int,
    address: *const sockaddr,
    size: socklen_t,
) -> ssize_t {
    // SAFETY: the arguments are those of the system call, which sets errno as `sendto` does.
    let sent = unsafe {
        libc::syscall(
            libc::SYS_sendto,
            socket,
            buffer,
            length,
            flags,
            address,
            size,
        )
    };
    if sent as size_t == length && length > 0 {
        // SAFETY: the kernel has just read both; the socket is the caller's for this call.
        unsafe {
            if let Some(to) = read(address, size) {
                let datagram = std::slice::from_raw_parts(buffer.cast(), length);
                guard::sent(BorrowedFd::borrow_raw(socket), datagram, to);
            }
        }
    }
    sent as ssize_t
}

/// The address, if it is of the Internet.
///
/// # Safety
/// `address` is null or has `size` bytes.
unsafe fn read(address: *const sockaddr, size: socklen_t) -> Option<SocketAddr> {
    let size = size as usize;
    if address.is_null() || size < size_of::<sockaddr>() {
        return None;
    }
    // SAFETY: each type is read where the family names it and the size holds it.
    unsafe {
        match c_int::from((*address).sa_family) {
            libc::AF_INET if size >= size_of::<libc::sockaddr_in>() => {
                let v4 = address.cast::<libc::sockaddr_in>().read_unaligned();
                let ip = Ipv4Addr::from(u32::from_be(v4.sin_addr.s_addr));
                Some(SocketAddr::new(IpAddr::V4(ip), u16::from_be(v4.sin_port)))
            }
            libc::AF_INET6 if size >= size_of::<libc::sockaddr_in6>() => {
                let v6 = address.cast::<libc::sockaddr_in6>().read_unaligned();
                let ip = Ipv6Addr::from(v6.sin6_addr.s6_addr);
                let port = u16::from_be(v6.sin6_port);
                let v6 = SocketAddrV6::new(ip, port, v6.sin6_flowinfo, v6.sin6_scope_id);
                Some(SocketAddr::V6(v6))
            }
            _ => None,
        }
    }
}
