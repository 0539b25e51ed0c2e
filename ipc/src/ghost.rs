//! What iceoryx2 0.9.3 leaves of processes that were killed: nodes that it cannot clean up, and places in a service that
//! nobody holds.
//!
//! Its own cleaning gives up for good in three cases, each of them a kill at the wrong moment:
//!
//! - A process died between the file that announces a port (its tag) and the port itself. The cleaner keeps such a tag,
//!   fails to remove the directory around it, and has by then deleted the node's details, without which later cleaners
//!   look for the node in the default domain, and find nothing.
//! - A cleaner died between a port's tag and the port's place in the service: later ones skip a port without a tag, and
//!   the place stays taken.
//! - A cleaner died between two of the three files of a node's monitor: later ones cannot tell whether the node lives.
//!
//! Here one rule replaces them. Who holds the right to start up is the only one in the domain that makes or removes
//! nodes, so **what belongs to a node that is not alive belongs to nobody**: it is taken out of each service, the tags
//! that this needs are made again, and its files are removed.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::{DirBuilder, File};
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::node::{DeadNodeView, Node, NodeDetails, NodeState, NodeView};
use iceoryx2::prelude::{CallbackProgression, Config, PortFactory, SemanticString};
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2::service::ipc::Service;

use crate::domain::{Factories, Factory};
use crate::message::Message;

/// The nodes of a domain.
struct Nodes {
    /// At work, or not to be judged by us.
    alive: BTreeSet<u128>,
    dead: Vec<UniqueNodeId>,
}

impl Nodes {
    /// `None` where iceoryx2 cannot tell.
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

/// Cleans up after dead nodes as far as iceoryx2 can, given the domain that they were in. Only for who holds the right
/// to start up.
pub(crate) fn clean(config: &Config) {
    for id in Nodes::list(config).map_or(Vec::new(), |nodes| nodes.dead) {
        let details = NodeDetails::__internal_new(&None, config);
        // What stands against it is left to `lay`, and that to the next one.
        let _ = DeadNodeView::<Service>::__internal_try_remove_stale_resources(id, details);
    }
}

/// Frees all that nobody holds and [`clean`] has left. Only for who holds the right to start up: then no node is just
/// being made. Where something stands against it, it stays as before.
pub(crate) fn lay(services: &Factories, config: &Config) {
    let Some(nodes) = Nodes::list(config) else {
        return;
    };
    leave(&services.features, &nodes, config);
    leave(&services.twist, &nodes, config);
    leave(&services.robot, &nodes, config);
    leave(&services.cycles, &nodes, config);
    leave(&services.requests, &nodes, config);
    leave(&services.replies, &nodes, config);
    // The next one tries again.
    let _ = sweep(&nodes, config);
}

/// Takes the ports of nobody, and the nodes that are dead, out of a service.
fn leave<T: Message>(factory: &Factory<T>, nodes: &Nodes, config: &Config) {
    let mut ghosts = nodes.dead.clone();
    let mut haunt = |node: UniqueNodeId, port: u128| {
        if nodes.alive.contains(&node.value()) {
            return CallbackProgression::Continue;
        }
        // A port without its tag would be skipped.
        let _ = make_tag(config, node, port);
        if !ghosts.contains(&node) {
            ghosts.push(node);
        }
        CallbackProgression::Continue
    };
    let dynamic = factory.dynamic_config();
    dynamic.list_publishers(|port| haunt(port.node_id, port.publisher_id.value()));
    dynamic.list_subscribers(|port| haunt(port.node_id, port.subscriber_id.value()));
    for node in ghosts {
        let _ = Service::__internal_remove_node_from_service(&node, factory.service_hash(), config);
    }
}

/// Removes the files of all nodes that are not alive.
fn sweep(nodes: &Nodes, config: &Config) -> io::Result<()> {
    let prefix = config.global.prefix.as_bytes();
    for entry in std::fs::read_dir(node_directory(config))? {
        let path = entry?.path();
        // A node's directory is its number; its monitor's files have a prefix before and a kind behind it.
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

/// Where the nodes of a domain note what they have.
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
