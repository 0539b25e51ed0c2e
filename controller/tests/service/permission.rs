//! No other user may read what travels, or command: by the modes of files. That the kernel then
//! refuses another user, the target `judges` shows as root.

use std::os::unix::fs::PermissionsExt;

use crate::fixture::{Manager, Place, files};

#[test]
fn directory_and_shared_memory_are_their_owners_alone() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let daemon = manager.manage(place.vpcd(), None);
    manager.until("READY=1");
    for path in files(&place.domain(), daemon.id()) {
        let mode = std::fs::symlink_metadata(&path)
            .unwrap()
            .permissions()
            .mode();
        // Below the directory, which is closed to the group, iceoryx2 has directories of mode 750.
        let is_below = path.starts_with(place.domain()) && path != place.domain();
        let closed = if is_below { 0o007 } else { 0o077 };
        assert_eq!(mode & closed, 0, "{}: {mode:o}", path.display());
    }
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
}
