//! Removes what killed processes leave behind and iceoryx2 0.9.3 cannot clean up: stale nodes, and
//! taken slots of services.
//!
//! Its own cleaning gives up for good in three cases, each of them a kill at the wrong moment:
//!
//! - A process died between creating the file that announces a port (its tag) and the port itself.
//!   The cleaner keeps such a tag, so it fails to remove the directory around it, but has already
//!   deleted the node's details. Without them later cleaners look for the node in the default
//!   domain and find nothing.
//! - A cleaner died between removing a port's tag and the port's slot in the service: later ones
//!   skip a port without a tag, and the slot stays taken.
//! - A cleaner died between removing two of the three files of a node's monitor: later ones cannot
//!   tell whether the node is alive.
//!
//! One rule covers these cases. Only the holder of the startup lock creates or removes nodes, so
//! **every node that is not alive can be removed**: from each service, after restoring the tags
//! that this needs, and then its files.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::{DirBuilder, File};
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::node::{DeadNodeView, Node, NodeDetails, NodeState, NodeView};
use iceoryx2::prelude::{CallbackProgression, Config, SemanticString};
use iceoryx2::service::ipc::Service;

use crate::service::OpenService;

/// The nodes of a domain.
struct Nodes {
    /// Alive, or not known to be dead.
    alive: BTreeSet<u128>,
    dead: Vec<UniqueNodeId>,
}

impl Nodes {
    /// `None` if iceoryx2 cannot tell.
    fn list(config: &Config) -> Option<Self> {
        let (mut alive, mut dead) = (BTreeSet::new(), Vec::new());
        let listed = Node::<Service>::list(config, |state| {
            match state {
                NodeState::Dead(node) => dead.push(*node.id()),
                NodeState::Alive(node) => _ = alive.insert(node.id().value()),
                NodeState::Inaccessible(id) | NodeState::Undefined(id)
                    if has_monitor(config, id) =>
                {
                    _ = alive.insert(id.value());
                }
                NodeState::Inaccessible(id) | NodeState::Undefined(id) => dead.push(id),
            }
            CallbackProgression::Continue
        });
        listed.is_ok().then_some(Self { alive, dead })
    }
}

/// Removes dead nodes as far as iceoryx2 can. Call this only while holding the startup lock.
pub(crate) fn clean(config: &Config) {
    for id in Nodes::list(config).map_or(Vec::new(), |nodes| nodes.dead) {
        let details = NodeDetails::__internal_new(&None, config);
        // What fails here is left to `reap`.
        let _ = DeadNodeView::<Service>::__internal_try_remove_stale_resources(id, details);
    }
}

/// Removes what [`clean`] has left. Call this only while holding the startup lock: then no node is
/// being created. What cannot be removed stays as before, and the next process that joins tries
/// again.
pub(crate) fn reap(services: &[Box<dyn OpenService>], config: &Config) {
    let Some(nodes) = Nodes::list(config) else {
        return;
    };
    for service in services {
        let mut stale = nodes.dead.clone();
        for (node, port) in service.ports() {
            if !nodes.alive.contains(&node.value()) {
                // iceoryx2 would skip a port without its tag.
                let _ = make_tag(config, node, port);
                stale.push(node);
            }
        }
        for node in stale {
            service.remove(&node, config);
        }
    }
    let _ = remove_files(&nodes, config);
}

/// Removes the files of all nodes that are not alive.
fn remove_files(nodes: &Nodes, config: &Config) -> io::Result<()> {
    let prefix = config.global.prefix.as_bytes();
    for entry in std::fs::read_dir(node_directory(config))? {
        let path = entry?.path();
        // A node's directory is its number; its monitor's files have a prefix before and a kind
        // behind it.
        let name = path.file_name().unwrap_or_default().as_bytes();
        let name = name.strip_prefix(prefix).unwrap_or(name);
        let digits = name.iter().take_while(|byte| byte.is_ascii_digit()).count();
        let number = std::str::from_utf8(&name[..digits]).unwrap_or_default();
        let Ok(node) = number.parse::<u128>() else {
            continue;
        };
        if nodes.alive.contains(&node) {
            continue;
        }
        if path.is_dir() {
            std::fs::remove_dir_all(path)?;
        } else {
            std::fs::remove_file(path)?;
        }
    }
    Ok(())
}

/// The directory in which the nodes of a domain list what they have.
fn node_directory(config: &Config) -> PathBuf {
    let nodes = config.global.node_dir();
    Path::new(OsStr::from_bytes(nodes.as_bytes())).to_path_buf()
}

/// Whether a node has all the files of its monitor, as every living one has.
fn has_monitor(config: &Config, node: UniqueNodeId) -> bool {
    let global = &config.global;
    let (prefix, suffix) = (&global.prefix, &global.node.monitor_suffix);
    ["", "_context", "_owner_lock"].iter().all(|part| {
        let name = format!("{prefix}{}{suffix}{part}", node.value());
        node_directory(config).join(name).exists()
    })
}

/// Makes the tag of a port.
fn make_tag(config: &Config, node: UniqueNodeId, port: u128) -> io::Result<()> {
    let directory = node_directory(config).join(node.value().to_string());
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(&directory)?;
    let global = &config.global;
    let (prefix, suffix) = (&global.prefix, &global.node.port_tag_suffix);
    File::create(directory.join(format!("{prefix}{port}{suffix}"))).map(drop)
}
