//! The clients: what is generated is up to date, C has the layouts of Rust, and programs in C play their parts against
//! this crate's peers in domains of their own. One executable: each that links iceoryx2 takes up to a minute to build.

mod header;
mod layout;
mod library;
mod process;
mod python;
mod source;

use std::path::Path;

/// Compares a committed file with what the sources make of it; writes it where `VPC_BLESS` is set.
fn assert_fresh(path: &Path, fresh: &str) {
    if std::env::var_os("VPC_BLESS").is_some() {
        std::fs::write(path, fresh).unwrap();
        return;
    }
    let found = std::fs::read_to_string(path).unwrap_or_default();
    let lines = || found.lines().zip(fresh.lines()).enumerate();
    let place = lines().find(|(_, (found, fresh))| found != fresh);
    assert!(
        found == fresh,
        "{} is stale from line {}: run VPC_BLESS=1 cargo test -p vpc-client-c",
        path.display(),
        place.map_or(found.lines().count(), |(line, _)| line + 1)
    );
}

#[test]
fn the_header_is_what_the_sources_make_of_it() {
    let source = source::read();
    layout::assert_complete(&source);
    let fresh = header::generate(&source);
    assert_fresh(&source::root().join("ipc/c/include/vpc.h"), &fresh);
}

#[test]
fn the_messages_in_python_are_what_the_sources_make_of_them() {
    let source = source::read();
    assert_fresh(
        &source::root().join("ipc/python/vpc_client/messages.py"),
        &python::generate(&source),
    );
}
