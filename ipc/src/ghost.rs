//! Ports of nobody: places in a service that a dead process holds for ever.
//!
//! Who cleans up after a dead node removes, port by port, first a small file (the port's tag) and then the port's place
//! in the service. iceoryx2 0.9.3 skips a port whose tag is missing: where the cleaner itself was killed between the
//! two, the next one leaves the place taken, forgets the node, and nobody ever comes back to it. Here such places are
//! found, as ports whose node is neither alive nor dead but unknown, their tags are made again, and they are cleaned up
//! once more.

use std::fs::{DirBuilder, File};
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::node::{Node, NodeState, NodeView};
use iceoryx2::prelude::{CallbackProgression, Config, PortFactory, SemanticString};
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2::service::ipc::Service;

use crate::domain::Factory;
use crate::message::Message;

/// Frees the places of one service that nobody holds. Only for who holds the right to start up: then no node is just
/// being made. Where something stands against it the places stay taken, as before.
pub(crate) fn lay<T: Message>(factory: &Factory<T>, config: &Config) {
    let mut ports: Vec<(UniqueNodeId, u128)> = Vec::new();
    let dynamic = factory.dynamic_config();
    dynamic.list_publishers(|port| {
        ports.push((port.node_id, port.publisher_id.value()));
        CallbackProgression::Continue
    });
    dynamic.list_subscribers(|port| {
        ports.push((port.node_id, port.subscriber_id.value()));
        CallbackProgression::Continue
    });
    let Some(known) = known(config) else {
        return;
    };
    ports.retain(|(node, _)| !known.contains(node));
    for (node, port) in ports {
        let details = details(config, node);
        if tag(&details, config, port).is_ok() {
            // Its failures are those of every other cleaning: nobody to tell them to.
            let _ =
                Service::__internal_remove_node_from_service(&node, factory.service_hash(), config);
        }
        let _ = std::fs::remove_dir_all(details);
    }
}

/// All nodes that iceoryx2 knows, dead ones included; `None` where it cannot tell.
fn known(config: &Config) -> Option<Vec<UniqueNodeId>> {
    let mut known = Vec::new();
    let listed = Node::<Service>::list(config, |state| {
        known.push(match state {
            NodeState::Alive(node) => *node.id(),
            NodeState::Dead(node) => *node.id(),
            NodeState::Inaccessible(id) | NodeState::Undefined(id) => id,
        });
        CallbackProgression::Continue
    });
    listed.is_ok().then_some(known)
}

/// The directory of what a node has noted of itself.
fn details(config: &Config, node: UniqueNodeId) -> PathBuf {
    let nodes = config.global.node_dir();
    let nodes = Path::new(std::ffi::OsStr::from_bytes(nodes.as_bytes()));
    nodes.join(node.value().to_string())
}

/// Makes the tag of a port.
fn tag(details: &Path, config: &Config, port: u128) -> io::Result<()> {
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(details)?;
    let global = &config.global;
    let (prefix, suffix) = (&global.prefix, &global.node.port_tag_suffix);
    File::create(details.join(format!("{prefix}{port}{suffix}"))).map(|_| ())
}
