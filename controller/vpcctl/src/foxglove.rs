//! `serve --foxglove`: a domain live in Foxglove.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use recorder::live::{self, LiveOptions};
use scene::SceneFiles;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::arguments::ServeArguments;
use crate::exit::{Exit, Failure};
use crate::output;
use crate::record;
use crate::server;

/// Serves until a signal comes.
///
/// # Errors
/// [`Failure`].
pub fn run(domain: &Path, arguments: &ServeArguments) -> Result<Exit, Failure> {
    let Some(address) = arguments.foxglove else {
        return Ok(Exit::Ok);
    };
    server::allow(address, arguments.expose, false)?;
    let scene = arguments
        .scene
        .as_deref()
        .map(SceneFiles::read)
        .transpose()?;
    let mount = arguments
        .hand_eye
        .as_deref()
        .map(record::mount)
        .transpose()?;
    let stop = Arc::new(AtomicBool::new(false));
    // Until the server is there the signals end the program, which may wait for the domain's lock.
    let is_starting = Arc::new(AtomicBool::new(true));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register_conditional_default(signal, Arc::clone(&is_starting))?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    let options = LiveOptions {
        domain: domain.to_owned(),
        scene,
        mount,
        address,
        origins: arguments.origin.clone(),
    };
    if !address.ip().is_loopback() {
        eprintln!(
            "vpcctl: no password and no encryption: whoever reaches {address} sees all that is sent"
        );
    }
    let begun = |address| {
        is_starting.store(false, Ordering::Relaxed);
        // Nobody reads it any more: the server goes on.
        let _ = output::write(&format!("Foxglove: open a connection to ws://{address}\n"));
    };
    live::serve(&options, &stop, begun, |notice| {
        eprintln!("vpcctl: {notice}")
    })?;
    Ok(Exit::Ok)
}
