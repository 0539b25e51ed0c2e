//! What the programs begin with: command line, log, signals; how they end; and what they say of the
//! kernel.

#![forbid(unsafe_code)]

pub mod kernel;

use std::io::IsTerminal;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::{ArgMatches, CommandFactory};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use tracing_subscriber::EnvFilter;

/// Between two looks for a signal.
const LOOK: Duration = Duration::from_millis(20);

/// Done, and something wants attention: a finding, a result that was not written.
pub const ATTENTION: u8 = 1;
/// The command line is wrong. This code and the following ones are those of `sysexits.h`.
pub const USAGE: u8 = 64;
/// Something outside cannot be used: a camera, a robot, the shared memory.
pub const UNAVAILABLE: u8 = 69;
/// A defect of the program.
pub const SOFTWARE: u8 = 70;
/// The configuration is wrong.
pub const CONFIG: u8 = 78;

/// Reads the command line.
///
/// # Errors
/// Help, version, or what is wrong were printed; the exit code.
pub fn arguments<A: CommandFactory>() -> Result<ArgMatches, ExitCode> {
    A::command().try_get_matches().map_err(|error| {
        // Help and version are not errors.
        let code = if error.use_stderr() { USAGE } else { 0 };
        let _ = error.print();
        ExitCode::from(code)
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

/// A flag that SIGINT and SIGTERM set, and SIGHUP unless `nohup` began the program. Repeating them
/// changes nothing: an impatient operator must not cut short how a robot is stopped. SIGQUIT and
/// SIGKILL end a program that does not stop.
///
/// # Errors
/// The system refuses; that was printed under the program's `name`. The exit code.
pub fn stop_on_signals(name: &str) -> Result<Arc<AtomicBool>, ExitCode> {
    let stop = Arc::new(AtomicBool::new(false));
    let hangup = (!is_hangup_ignored()).then_some(SIGHUP);
    for signal in [SIGINT, SIGTERM].into_iter().chain(hangup) {
        let registered = signal_hook::flag::register(signal, Arc::clone(&stop));
        registered.map_err(|error| {
            eprintln!("{name}: signal {signal}: {error}");
            ExitCode::from(UNAVAILABLE)
        })?;
    }
    Ok(stop)
}

/// Ends the process where it is, with the exit code [`ATTENTION`], if it has not ended by itself
/// within `patience` after `stop` was set. It starts a thread for that, so that nothing that hangs
/// keeps a signal from ending the program.
///
/// # Errors
/// There is no thread; that was printed under the program's `name`. The exit code.
pub fn end_within(
    patience: Duration,
    stop: &Arc<AtomicBool>,
    name: &'static str,
) -> Result<(), ExitCode> {
    let stop = Arc::clone(stop);
    let watch = move || {
        while !stop.load(Ordering::Relaxed) {
            std::thread::sleep(LOOK);
        }
        std::thread::sleep(patience);
        eprintln!("{name}: not stopped within {patience:?}: ended where it is");
        std::process::exit(ATTENTION.into());
    };
    let thread = std::thread::Builder::new().name("end".to_owned());
    thread.spawn(watch).map(drop).map_err(|error| {
        eprintln!("{name}: no thread: {error}");
        ExitCode::from(UNAVAILABLE)
    })
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

/// Whether the process was begun with SIGHUP ignored.
fn is_hangup_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    ignored.is_some_and(|mask| mask >> (SIGHUP - 1) & 1 == 1)
}
