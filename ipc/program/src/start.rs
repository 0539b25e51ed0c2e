//! First steps, command line, log, and the service manager.

use std::io::IsTerminal;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::process::ExitCode;

use clap::{ArgMatches, CommandFactory};
use signal_hook::consts::SIGXFSZ;
use tracing_subscriber::EnvFilter;

use crate::{Exit, ignore};

/// What every program does first: a write beyond the limit on the size of files (`ulimit -f`)
/// fails, as on a full disk, instead of ending the program.
pub fn begin() {
    // There is such a signal, and it can be ignored.
    let _ = ignore(SIGXFSZ);
}

/// [`begin`]s, and reads the command line.
///
/// # Errors
/// Help, version, or what is wrong were printed; the exit code.
pub fn arguments<A: CommandFactory>() -> Result<ArgMatches, ExitCode> {
    begin();
    A::command().try_get_matches().map_err(|error| {
        // Help and version are not errors.
        let exit = if error.use_stderr() {
            Exit::Usage
        } else {
            Exit::Ok
        };
        let _ = error.print();
        exit.into()
    })
}

/// Logs to standard error. The environment's `VPC_LOG` replaces `filter`, in the words of
/// `tracing_subscriber::EnvFilter`.
pub fn log(filter: &str) {
    let filter = EnvFilter::try_from_env("VPC_LOG").unwrap_or_else(|_| EnvFilter::new(filter));
    let log = tracing_subscriber::fmt().with_env_filter(filter);
    log.with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .init();
}

/// Tells the service manager, if there is one, after `sd_notify(3)`: `READY=1`, `WATCHDOG=1`. What
/// it does not take is lost.
pub fn notify(words: &str) {
    let Some(path) = std::env::var_os("NOTIFY_SOCKET") else {
        return;
    };
    let address = match path.as_bytes().strip_prefix(b"@") {
        Some(name) => SocketAddr::from_abstract_name(name),
        None => SocketAddr::from_pathname(&path),
    };
    let socket = UnixDatagram::unbound().and_then(|socket| {
        socket.set_nonblocking(true)?;
        Ok(socket)
    });
    if let (Ok(address), Ok(socket)) = (address, socket) {
        let _ = socket.send_to_addr(words.as_bytes(), &address);
    }
}
