//! Programs judge configuration files as their schemas say.

use std::path::Path;

use clap::CommandFactory;
use controller::arguments::Arguments;
use controller::config::Config;
use memory_builder::settings::BuildSettings;
use scene::Scene;
use serde_json::{Value as Json, json};
use testkit::root;
use toml::{Table, Value};

/// A kind of configuration file.
struct Subject {
    schema: Json,
    /// The file of the schema.
    file: &'static str,
    /// A valid file in which each key can be anything in its range.
    base: Table,
    read: fn(&str) -> Result<(), String>,
    /// Keys with a range that depends on other keys.
    relative: &'static [&'static str],
    /// Files that ship.
    shipped: &'static [&'static str],
}

fn subjects() -> [Subject; 4] {
    let scenes = root().join("ipc/scene/scenes");
    let scenes = scenes.display();
    let table = |text: String| text.parse::<Table>().unwrap();
    let mut scene = table(scene::PAPER_SIM.to_owned());
    // The widest region, in which either end can be moved.
    let widest = |x: f64| Value::Array(vec![x.into(), x.into(), x.abs().into()]);
    scene["starts"]["translation_min"] =
        Value::Array(vec![(-100.0).into(), (-100.0).into(), 0.001.into()]);
    scene["starts"]["translation_max"] = widest(100.0);
    [
        Subject {
            schema: controller::config::schema(),
            file: "controller/vpcd.schema.json",
            // A memory, for all strategies; the longest preview, for nc; a priority, for the
            // processor.
            base: table(format!(
                "scene = '{scenes}/paper-sim.toml'\nmemory = 'm'\n[law]\nnp = 40\n[realtime]\npriority = 5"
            )),
            read: |text| {
                let config = Config::parse(text, "t.toml", Path::new(""), &Arguments::default());
                config.map(|_| ()).map_err(|error| error.to_string())
            },
            relative: &[],
            shipped: &[
                "controller/vpcd.toml",
                "controller/vpcd-robot.toml",
                "controller/vpcd-tags.toml",
                "controller/systemd/vpcd.toml",
            ],
        },
        Subject {
            schema: scene::schema(),
            file: "ipc/scene/scene.schema.json",
            base: scene,
            read: |text| {
                Scene::parse(text, "t.toml")
                    .map(|_| ())
                    .map_err(|error| error.to_string())
            },
            relative: &[
                "camera.width",
                "camera.height",
                "camera.cx",
                "camera.cy",
                "goal.translation",
                "starts.translation_min",
                "starts.translation_max",
                "limits.linear_acceleration",
                "limits.angular_acceleration",
            ],
            shipped: &[
                "ipc/scene/scenes/paper-sim.toml",
                "ipc/scene/scenes/paper-robot.toml",
                "ipc/scene/scenes/tags-robot.toml",
            ],
        },
        Subject {
            schema: hw_sim::config::schema(),
            file: "hw-sim/hw-sim.schema.json",
            base: table(format!(
                "scene = '{scenes}/paper-sim.toml'\nstarts = '{scenes}/paper-sim-starts.csv'\nlatency_ms = 900.0\n\
                 motion = [{{ kind = 'conveyor' }}]"
            )),
            read: |text| {
                let directory = tempfile::tempdir().unwrap();
                let file = directory.path().join("t.toml");
                std::fs::write(&file, text).unwrap();
                let flags = ["hw-sim", "--config", file.to_str().unwrap()];
                let matches = hw_sim::config::Arguments::command().get_matches_from(flags);
                hw_sim::config::Config::load(&matches)
                    .map(|_| ())
                    .map_err(|error| error.to_string())
            },
            relative: &[
                "start",
                "robot",
                "camera",
                "truth.distortion",
                "motion.radius_m",
                "motion.speed_m_s",
                "motion.bandwidth_hz",
                "motion.seed",
                "motion.by_m",
                "motion.over_s",
            ],
            shipped: &[
                "hw-sim/hw-sim.toml",
                "hw-sim/hw-sim-robot.toml",
                "hw-sim/hw-sim-tags.toml",
                "controller/systemd/hw-sim.toml",
            ],
        },
        Subject {
            schema: memory_builder::settings::schema(),
            file: "memory-blob/builder/memory.schema.json",
            base: Table::new(),
            read: |text| {
                let document = toml_schema::Document::parse(text, "t.toml").unwrap();
                document
                    .check::<BuildSettings>()
                    .map(|_| ())
                    .map_err(|error| error.to_string())
            },
            relative: &[],
            shipped: &[],
        },
    ]
}

/// Every key of a schema that is no table, with its path.
fn keys<'a>(schema: &'a Json, path: &str, found: &mut Vec<(String, &'a Json)>) {
    for (name, key) in schema["properties"].as_object().unwrap() {
        let path = format!("{path}{name}");
        let items = &key["items"];
        let inner = [key, items]
            .into_iter()
            .find(|inner| inner["properties"].is_object());
        if inner.is_none_or(|_| key["type"] == "array") {
            found.push((path.clone(), key));
        }
        if let Some(inner) = inner {
            keys(inner, &format!("{path}."), found);
        }
    }
}

/// Values of a key, and whether they are allowed.
fn probes(key: &Json) -> Vec<(Value, bool)> {
    let bounds = |of: &Json| [of["minimum"].as_f64(), of["maximum"].as_f64()];
    let beyond = |x: f64, sign: f64| x + sign * (x.abs() * 1e-6).max(1e-9);
    let words = || {
        let consts = key["oneOf"]
            .as_array()
            .into_iter()
            .flatten()
            .map(|one| &one["const"]);
        let words = key["enum"].as_array().into_iter().flatten().chain(consts);
        words
            .filter_map(Json::as_str)
            .map(|word| (Value::from(word), true))
            .collect::<Vec<_>>()
    };
    let mut probes = words();
    if !probes.is_empty() {
        probes.push(("no such word".into(), false));
    }
    match key["type"].as_str() {
        Some("integer") => {
            let ends = bounds(key).into_iter().zip([-1, 1]);
            for (end, sign) in ends.filter_map(|(end, sign)| Some((end? as i64, sign))) {
                probes.extend([(end.into(), true), ((end + sign).into(), false)]);
            }
        }
        Some("number") => {
            for (end, sign) in bounds(key).into_iter().zip([-1.0, 1.0]) {
                let end = end.unwrap();
                // Whole numbers of pixels.
                let step = if key["multipleOf"] == 1 {
                    end + sign
                } else {
                    beyond(end, sign)
                };
                probes.extend([(end.into(), true), (step.into(), false)]);
            }
        }
        Some("boolean") => probes.extend([(true.into(), true), (false.into(), true)]),
        Some("array") if key["items"]["type"] == "number" => {
            let count = key["minItems"].as_u64().unwrap() as usize;
            for (end, sign) in bounds(&key["items"]).into_iter().zip([-1.0, 1.0]) {
                let end = end.unwrap();
                let list = |last: f64| {
                    let mut list = vec![Value::from(end); count - 1];
                    list.push(last.into());
                    Value::Array(list)
                };
                probes.extend([(list(end), true), (list(beyond(end, sign)), false)]);
            }
        }
        _ => (),
    }
    probes
}

/// Lists that are too short or too long by one, of the first item of a list.
fn lengths(key: &Json, path: &str, base: &Table) -> Vec<(Value, bool)> {
    let parts = path.split('.').collect::<Vec<_>>();
    let mut value = Some(Value::Table(base.clone()));
    for part in parts {
        value = value.and_then(|value| match value {
            Value::Array(list) => list[0].get(part).cloned(),
            other => other.get(part).cloned(),
        });
    }
    let Some(Value::Array(list)) = value else {
        return Vec::new();
    };
    let of = |count: u64| (Value::Array(vec![list[0].clone(); count as usize]), false);
    let least = key["minItems"].as_u64().filter(|least| *least > 0);
    let most = key["maxItems"].as_u64();
    let ends = [least.map(|least| least - 1), most.map(|most| most + 1)];
    ends.into_iter().flatten().map(of).collect()
}

/// Sets the value at a path; of lists, in the first table.
fn set(table: &mut Table, path: &str, value: Value) {
    let Some((head, rest)) = path.split_once('.') else {
        table.insert(path.to_owned(), value);
        return;
    };
    match table.entry(head).or_insert_with(|| Table::new().into()) {
        Value::Array(list) => set(list[0].as_table_mut().unwrap(), rest, value),
        inner => set(inner.as_table_mut().unwrap(), rest, value),
    }
}

/// Files with a value at, or just beyond, the end of a key's range, of which our readers agree that
/// they are good or not; with the schemas.
pub fn cases() -> Vec<Json> {
    let mut cases = Vec::new();
    for subject in subjects() {
        let schema = std::fs::read_to_string(root().join(subject.file)).unwrap();
        let schema: Json = serde_json::from_str(&schema).unwrap();
        let mut case = |text: &str, good: bool| {
            cases.push(
                json!({ "schema": schema, "name": subject.file, "text": text, "good": good }),
            );
        };
        for file in subject.shipped {
            case(&std::fs::read_to_string(root().join(file)).unwrap(), true);
        }
        let mut found = Vec::new();
        keys(&subject.schema, "", &mut found);
        for (path, key) in &found {
            for (value, good) in probes(key)
                .into_iter()
                .chain(lengths(key, path, &subject.base))
            {
                let mut document = subject.base.clone();
                set(&mut document, path, value.clone());
                let text = toml::to_string(&document).unwrap();
                case(&text, good);
                if good && subject.relative.contains(&path.as_str()) {
                    continue;
                }
                let outcome = (subject.read)(&text);
                let place = format!("{}: {path} = {value}: {outcome:?}", subject.file);
                assert_eq!(outcome.is_ok(), good, "{place}");
                if let Err(message) = outcome {
                    let last = path.rsplit('.').next().unwrap();
                    assert!(
                        message.contains(last) && message.contains("; allowed: "),
                        "{place}"
                    );
                }
            }
        }
        // A misspelt key, and a number that is none, which JSON does not have.
        let (path, _) = found
            .iter()
            .find(|(_, key)| key["type"] == "number")
            .unwrap();
        for (path, value, is_json) in [(&format!("{path}x"), 1.0, true), (path, f64::NAN, false)] {
            let mut document = subject.base.clone();
            set(&mut document, path, value.into());
            let text = toml::to_string(&document).unwrap();
            assert!((subject.read)(&text).is_err(), "{path} = {value}");
            if is_json {
                case(&text, false);
            }
        }
    }
    assert!(cases.len() > 300, "{}", cases.len());
    cases
}

/// Checks that files that ship show every key with its default.
pub fn check_shipped_files() {
    // A scene shows what it needs; the other files are where keys are explained.
    let is_scene = |subject: &&Subject| subject.file.ends_with("scene.schema.json");
    for subject in subjects()
        .iter()
        .filter(|subject| !is_scene(subject) && !subject.shipped.is_empty())
    {
        let file = subject.shipped[0];
        let text = std::fs::read_to_string(root().join(file)).unwrap();
        let mut table = String::new();
        let mut shown = Table::new();
        for line in text.lines() {
            let line = line.strip_prefix("# ").unwrap_or(line);
            if let Some(head) = line
                .strip_prefix('[')
                .and_then(|rest| rest.trim_start_matches('[').split(']').next())
            {
                table = format!("{head}.");
                continue;
            }
            for (name, value) in line.parse::<Table>().unwrap_or_default() {
                set(&mut shown, &format!("{table}{name}"), value);
            }
        }
        let shown = serde_json::to_value(&shown).unwrap();
        let mut found = Vec::new();
        keys(&subject.schema, "", &mut found);
        for (path, key) in found {
            let value = shown.pointer(&format!("/{}", path.replace('.', "/")));
            assert!(value.is_some(), "{file} does not show {path}");
            if let Some(default) = key.get("default") {
                assert_eq!(value, Some(default), "{file}: {path}");
            }
        }
    }
}
