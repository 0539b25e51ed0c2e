//! What was published comes back bit for bit.

use std::path::Path;

use recorder::Account;
use serde_json::Value;
use testkit::Place;

use crate::fixture::{FILE, MESSAGES, OF_AN_ARM, published_and_read, same};

#[test]
fn what_was_published_comes_back() {
    let place = Place::new();
    let (published, mut recording, ledger) = published_and_read(&place);
    // The replies by which the recorder was waited for.
    let first = published.replies[0].stamp.sequence;
    recording
        .replies
        .retain(|reply| reply.stamp.sequence >= first);
    assert_eq!(recording.cut, None);
    assert_eq!(recording.metadata["vpc.ledger"], ledger.to_map());
    assert_eq!(recording.scene_toml(), Some(scene::PAPER_SIM));
    assert!(recording.config().unwrap().contains("[law]"));
    layout_names_what_is_recorded(&place.path(FILE));
    same(&recording.features, &published.features);
    same(&recording.twist, &published.twist);
    same(&recording.robot, &published.robot);
    same(&recording.cycles, &published.cycles);
    same(&recording.requests, &published.requests);
    same(&recording.replies, &published.replies);
    assert_eq!(
        ledger.of("/vpc/cycles"),
        Account {
            recorded: MESSAGES as u64,
            ..Account::default()
        }
    );
}

/// Every topic in the layout for Foxglove is in the file, every field in the schema of its topic.
fn layout_names_what_is_recorded(file: &Path) {
    let summary = mcap::Summary::read(&std::fs::read(file).unwrap());
    let channels = summary.unwrap().unwrap().channels;
    let layout: Value = serde_json::from_str(include_str!(
        "../../../../ipc/recording/foxglove-layout.json"
    ))
    .unwrap();
    let mut found = Vec::new();
    texts(&layout, &mut found);
    let is_here = |text: &&String| text.starts_with('/') && *text != OF_AN_ARM;
    let paths: Vec<_> = found.iter().filter(is_here).collect();
    assert!(paths.len() > 15, "{paths:?}");
    for path in paths {
        let (topic, field) = path.split_once('.').unwrap_or((path, ""));
        let channel = channels.values().find(|channel| channel.topic == topic);
        let channel = channel.unwrap_or_else(|| panic!("{path}: no such topic"));
        let field = field.split('[').next().unwrap_or_default();
        if !field.is_empty() {
            let schema = &channel.schema.as_ref().unwrap().data;
            let schema: Value = serde_json::from_slice(schema).unwrap();
            assert!(schema["properties"].get(field).is_some(), "{path}");
        }
    }
}

/// Every text in some JSON, keys included.
fn texts(json: &Value, to: &mut Vec<String>) {
    match json {
        Value::String(text) => to.push(text.clone()),
        Value::Array(list) => list.iter().for_each(|value| texts(value, to)),
        Value::Object(map) => map.iter().for_each(|(key, value)| {
            to.push(key.clone());
            texts(value, to);
        }),
        _ => (),
    }
}
