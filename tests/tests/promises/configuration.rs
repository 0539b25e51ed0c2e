//! Bad configuration and a second instance: an exit code of their own, and a message that names key,
//! value and what is allowed; the first instance goes on. The exit code of `vpcd` for a bad
//! configuration: `cargo test --test daemon refusal`.

use std::path::Path;
use std::process::Stdio;

use controller::arguments::Arguments;
use controller::config::{Config, ConfigError};
use controller::flight::Recorder;
use ipc::{CameraPorts, Domain};
use messages::{Features, Stamp};
use scene::Scene;

use crate::fixture::{PATIENCE, PERIOD_NS, Place, Running, ended, program, root, scene_file, tell};

/// Memory of a machine, bytes.
const MEMORY: u64 = 8 << 30;

/// A key of the daemon's configuration.
struct Key {
    table: String,
    name: String,
    schema: serde_json::Value,
}

/// Every key that the schema knows.
fn keys() -> Vec<Key> {
    let schema = controller::config::schema();
    let mut keys = Vec::new();
    for (name, value) in schema["properties"].as_object().unwrap() {
        let key = |table: &str, name: &String, schema: &serde_json::Value| Key {
            table: table.to_owned(),
            name: name.clone(),
            schema: schema.clone(),
        };
        match value["properties"].as_object() {
            Some(inner) => keys.extend(inner.iter().map(|(last, schema)| key(name, last, schema))),
            None => keys.push(key("", name, value)),
        }
    }
    keys
}

/// What the daemon says of a configuration before it begins.
fn judged(scene: &Scene, text: &str) -> Result<(), ConfigError> {
    let path = "bad.toml";
    let config = Config::parse(text, path, Path::new(""), &Arguments::default())?;
    config.rules(scene, path)?;
    Recorder::check_room(
        &config.flight,
        scene.camera.rate_hz,
        MEMORY,
        path.to_owned(),
    )
}

#[test]
fn every_wrong_key_is_refused_by_name() {
    let read = Scene::read(&scene_file()).unwrap();
    let scene = scene_file();
    let scene = scene.display();
    let keys = keys();
    let number = |key: &&Key| key.schema["type"] == "integer" || key.schema["type"] == "number";
    assert!(keys.len() > 20 && keys.iter().filter(number).count() > 10);
    let mut count = 0;
    let mut check = |text: String, words: &[&str]| {
        let refused = judged(&read, &text).map(|()| text.clone());
        let message = refused.unwrap_err().to_string();
        count += 1;
        assert!(message.contains("bad.toml"), "{text}\n{message}");
        for word in words {
            assert!(message.contains(word), "{text}\n{message}\nlacks {word}");
        }
    };
    check(String::new(), &["scene is missing"]);
    for Key {
        table,
        name,
        schema,
    } in &keys
    {
        let with = |value: &str| match &**table {
            "" if name == "scene" => format!("scene = {value}"),
            "" => format!("scene = '{scene}'\n{name} = {value}"),
            _ => format!("scene = '{scene}'\n[{table}]\n{name} = {value}"),
        };
        let full = if table.is_empty() {
            name.clone()
        } else {
            format!("{table}.{name}")
        };
        let form = schema["anyOf"].get(0).unwrap_or(schema);
        let is_words = form["enum"].is_array() || form["oneOf"].is_array();
        // A wrong type is shown in its line, or with the words that are allowed.
        match is_words {
            true => check(with("[1, 2]"), &[&format!("{full} = [1, 2]; allowed: ")]),
            false => check(with("[1, 2]"), &["invalid type", name]),
        }
        // An unknown key beside it, as well.
        check(
            with("1").replace(&format!("{name} = "), "unheard_of = "),
            &["unheard_of"],
        );
        match schema["type"].as_str() {
            Some("integer") => {
                for bad in ["-1", "99999999999"] {
                    check(with(bad), &[&format!("{full} = {bad}; allowed: ")]);
                }
                check(with("nan"), &["invalid type", name]);
            }
            Some("number") => {
                for (bad, shown) in [
                    ("nan", "NaN"),
                    ("-1.0", "-1"),
                    ("1e30", "1"),
                    ("inf", "inf"),
                ] {
                    check(with(bad), &[&format!("{full} = {shown}"), "; allowed: "]);
                }
            }
            _ if is_words => {
                check(
                    with("'no such word'"),
                    &[&format!("{full} = no such word; allowed: ")],
                );
            }
            _ => (),
        }
    }
    tell(format!("{count} wrong configurations refused"));
}

#[test]
fn every_key_may_be_missing_but_the_scene() {
    let read = Scene::read(&scene_file()).unwrap();
    let text = std::fs::read_to_string(root().join("controller/vpcd.toml")).unwrap();
    let scene = format!("scene = '{}'", scene_file().display());
    let text = text.replace("scene = \"../ipc/scene/scenes/paper-sim.toml\"", &scene);
    let lines: Vec<&str> = text.lines().collect();
    let has_key = |line: &&str| {
        line.parse::<toml::Table>()
            .is_ok_and(|pair| pair.len() == 1)
    };
    let is_key = |at: &usize| has_key(&lines[*at]) && !lines[*at].starts_with('[');
    let keys: Vec<usize> = (0..lines.len()).filter(is_key).collect();
    assert!(keys.len() > 15, "{text}");
    for missing in keys {
        let rest = [&lines[..missing], &lines[missing + 1..]].concat();
        let refused = judged(&read, &rest.join("\n")).err();
        let refused = refused.map_or(String::new(), |error| error.to_string());
        let is_scene = lines[missing] == scene;
        assert_eq!(
            !refused.is_empty(),
            is_scene,
            "{}: {refused}",
            lines[missing]
        );
        assert_eq!(refused.contains("scene is missing"), is_scene, "{refused}");
    }
}

#[test]
fn a_second_instance_is_refused_and_the_first_goes_on() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let vpcd = || {
        let mut command = testkit::command(program("vpcd"));
        command.arg("--scene").arg(scene_file());
        command.args(["--strategy", "previous", "--clock", "lockstep"]);
        command.arg("--domain").arg(place.domain());
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        command
    };
    let first = Running::start(vpcd());
    let mut answer = |sequence| {
        let points = [
            [400.0, 400.0],
            [500.0, 400.0],
            [500.0, 500.0],
            [400.0, 500.0],
        ];
        let at_ns = sequence * PERIOD_NS;
        let mut features = Features::new(&points, at_ns);
        features.stamp = Stamp {
            sequence,
            published_ns: at_ns,
            data_ns: at_ns,
        };
        let sent = camera.features.publish_verbatim(&features).unwrap();
        let answer = camera.wait_for_answer(&sent, PATIENCE).unwrap();
        answer.expect("an answer").message.stamp.sequence
    };
    let before = answer(1);
    let said = ended(vpcd());
    assert_eq!(said.code, Some(69), "{said:?}");
    let process = format!("process {}", first.id());
    assert!(said.stderr.contains(&process), "{said:?}");
    assert_eq!(answer(2), before + 1);
}
