//! Bad configuration and a second instance: an exit code of their own, in time, a message that
//! names key, value and what is allowed; the first instance goes on.

use std::time::{Duration, Instant};

use anyhow::ensure;

use crate::fixture::{Place, Stage, ended, program, root, scene_file, tell, turn};
use crate::stall::fairly;

const BAR: Duration = Duration::from_millis(200);
/// Attempts, of which the fastest counts: the limit is for the program, not for a busy machine.
const TRIES: usize = 4;

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

/// Runs the daemon on a configuration: exit code, message, and how long the fastest of some tries
/// took.
fn judged(place: &Place, text: &str) -> (Option<i32>, String, Duration) {
    let mut fastest = Duration::MAX;
    let mut command = testkit::command(program("vpcd"));
    command.arg("--config").arg(place.file("bad.toml", text));
    command.arg("--domain").arg(place.domain());
    command.arg("--check-only");
    let mut tries = 0;
    loop {
        let born = Instant::now();
        let said = ended(&mut command);
        fastest = fastest.min(born.elapsed());
        tries += 1;
        if fastest <= BAR || tries == TRIES {
            return (said.code, said.stderr, fastest);
        }
    }
}

#[test]
fn every_wrong_key_is_refused_by_name_in_time() {
    let _turn = turn();
    let place = Place::new();
    let scene = scene_file();
    let scene = scene.display();
    let keys = keys();
    let number = |key: &&Key| key.schema["type"] == "integer" || key.schema["type"] == "number";
    assert!(keys.len() > 20 && keys.iter().filter(number).count() > 10);
    let mut count = 0;
    let mut check = |text: String, words: &[&str]| {
        let (code, message, took) = judged(&place, &text);
        count += 1;
        assert_eq!(code, Some(78), "{text}\n{message}");
        assert!(message.contains("bad.toml"), "{text}\n{message}");
        for word in words {
            assert!(message.contains(word), "{text}\n{message}\nlacks {word}");
        }
        assert!(took <= BAR, "{text}: {took:?}");
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
    let _turn = turn();
    let place = Place::new();
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
        let (code, message, _) = judged(&place, &rest.join("\n"));
        let is_scene = lines[missing] == scene;
        let expected = if is_scene { 78 } else { 0 };
        assert_eq!(
            code,
            Some(expected),
            "without {}: {message}",
            lines[missing]
        );
        assert_eq!(message.contains("scene is missing"), is_scene, "{message}");
    }
}

#[test]
fn a_second_instance_is_refused_in_time_and_the_first_goes_on() {
    let _turn = turn();
    fairly("a second instance", second);
}

fn second() -> anyhow::Result<()> {
    let Stage {
        place,
        mut witness,
        daemon: first,
        camera: _camera,
    } = Stage::in_motion(0);
    witness.commands();
    witness.records();
    let mut fastest = Duration::MAX;
    for _ in 0..TRIES {
        let born = Instant::now();
        let said = ended(place.vpcd(""));
        fastest = fastest.min(born.elapsed());
        assert_eq!(said.code, Some(69), "{said:?}");
        let process = format!("process {}", first.id());
        assert!(said.stderr.contains(&process), "{said:?}");
    }
    ensure!(fastest <= BAR, "{fastest:?}");
    std::thread::sleep(Duration::from_millis(200));
    let commands = witness.commands();
    let gaps = commands
        .windows(2)
        .map(|pair| pair[1].stamp.sequence - pair[0].stamp.sequence);
    assert!(commands.len() > 3 && gaps.max() == Some(1), "{commands:?}");
    let records = witness.records();
    let missed = records[records.len() - 1].overruns - records[0].overruns;
    ensure!(missed == 0, "{missed} releases missed");
    Ok(())
}
