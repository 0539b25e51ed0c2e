//! `flight`: has the daemon write its flight record, and says into which file.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use messages::Action;
use program::Exit;

use crate::failure::Failure;
use crate::request;
use crate::settings::Settings;

/// End of the names of files that were asked for.
const SUFFIX: &str = "-request.mcap";
/// Pause between two looks at the directory.
const PAUSE: Duration = Duration::from_millis(20);

/// Asks for the record, and waits until it is written: the answer, a line with the file, and the
/// exit code. A large record on a slow disk may take longer than `timeout`; the line then names the
/// directory.
///
/// # Errors
/// No daemon, no answer; the domain or its ports cannot be used.
pub fn flight(directory: &Path, timeout: Duration) -> Result<(String, Exit), Failure> {
    let end = Instant::now() + timeout;
    let store = Settings::of(directory).flight.directory;
    let before = store.as_deref().and_then(newest);
    let (mut text, exit) = request::ask(directory, &request::plain(Action::Record), timeout)?;
    let Some(store) = store.filter(|_| exit == Exit::Ok) else {
        return Ok((text, exit));
    };
    loop {
        if let Some(file) = newest(&store).filter(|file| before.as_ref() < Some(file)) {
            text += &format!("{}\n", file.display());
            return Ok((text, exit));
        }
        if Instant::now() >= end {
            text += &format!("{}: not written yet; see the log\n", store.display());
            return Ok((text, exit));
        }
        std::thread::sleep(PAUSE);
    }
}

/// The newest whole file that was asked for. Names begin with the time.
fn newest(store: &Path) -> Option<PathBuf> {
    let files = std::fs::read_dir(store).ok()?.flatten();
    let files = files.map(|entry| entry.path());
    let is_asked = |path: &PathBuf| path.to_string_lossy().ends_with(SUFFIX);
    files.filter(is_asked).max()
}
