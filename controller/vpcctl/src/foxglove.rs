//! `serve --foxglove`: a domain live in Foxglove.

use std::path::Path;

use program::{Exit, StartUp};
use recorder::live::{self, LiveOptions};
use scene::SceneFiles;

use crate::arguments::ServeArguments;
use crate::failure::Failure;
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
    // Until the server is there the signals end the program, which may wait for the domain's lock.
    let start_up = StartUp::begin()?;
    let stop = program::stop_on_signals()?;
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
        drop(start_up);
        // Nobody reads it any more: the server goes on.
        let _ = output::write(&format!("Foxglove: open a connection to ws://{address}\n"));
    };
    live::serve(&options, &stop, begun, |notice| {
        eprintln!("vpcctl: {notice}")
    })?;
    Ok(Exit::Ok)
}
