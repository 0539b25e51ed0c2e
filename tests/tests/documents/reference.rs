//! `controller/CONFIGURATION.md` is made from the keys in the code, and each of them is what the programs really take:
//! its default, its range with both ends, the words of its refusal, and no key more or less.

use std::collections::BTreeSet;
use std::path::Path;

use controller::arguments::Arguments;
use controller::config::Config;
use memory_builder::settings::BuildSettings;
use scene::{Key, Kind, Scene};
use toml::{Table, Value};

use crate::root;

/// A program's configuration: its keys, a valid document, and what reads one.
struct Subject {
    name: &'static str,
    keys: &'static [Key],
    base: Table,
    read: fn(&str) -> Result<String, String>,
    /// Keys whose range depends on others: there the refusal is in words of its own.
    relative: &'static [&'static str],
}

fn scenes() -> std::path::PathBuf {
    root().join("ipc/scene/scenes")
}

fn vpcd() -> Subject {
    let scene = scenes().join("paper-sim.toml");
    Subject {
        name: "vpcd",
        keys: controller::config::KEYS,
        // A memory, that strategies may be changed; the longest window, for nc; a priority, for the processor.
        base: format!(
            "scene = '{}'\nmemory = 'm'\n[law]\nnp = 40\n[realtime]\npriority = 5",
            scene.display()
        )
        .parse()
        .unwrap(),
        read: |text| {
            let config = Config::parse(text, "t.toml", Path::new(""), &Arguments::default());
            config
                .map(|config| format!("{config:?}"))
                .map_err(|e| e.to_string())
        },
        relative: &[],
    }
}

fn scene_file() -> Subject {
    let mut base: Table = scene::PAPER_SIM.parse().unwrap();
    // The widest region, that either end can be moved.
    set(&mut base, "starts.translation_min", Value::Float(-100.0));
    set(&mut base, "starts.translation_max", Value::Float(100.0));
    Subject {
        name: "scene",
        keys: scene::KEYS,
        base,
        read: |text| {
            let scene = Scene::parse(text, "t.toml");
            scene
                .map(|scene| format!("{scene:?}"))
                .map_err(|e| e.to_string())
        },
        relative: &[],
    }
}

fn hw_sim() -> Subject {
    let scenes = scenes();
    let scenes = scenes.display();
    let text = format!(
        "scene = '{scenes}/paper-sim.toml'\nstarts = '{scenes}/paper-sim-starts.csv'\n[hand_eye]\n\
         translation = [0.0494974747, -0.0494974747, 0.04]\nrotation_deg = [0.0, 0.0, 45.0]"
    );
    Subject {
        name: "hw-sim",
        keys: hw_sim::keys::KEYS,
        base: text.parse().unwrap(),
        read: |text| {
            let directory = tempfile::tempdir().unwrap();
            let file = directory.path().join("t.toml");
            std::fs::write(&file, text).unwrap();
            let arguments = hw_sim::config::Arguments {
                config: Some(file),
                ..Default::default()
            };
            let config = hw_sim::config::Config::load(&arguments);
            config
                .map(|config| format!("{config:?}"))
                .map_err(|e| e.to_string())
        },
        relative: &["start", "jitter_ms"],
    }
}

fn builder() -> Subject {
    Subject {
        name: "vpc-memory",
        keys: memory_builder::keys::KEYS,
        base: Table::new(),
        read: |text| {
            let settings: BuildSettings = toml::from_str(text).map_err(|e| e.to_string())?;
            settings.check().map_err(|e| e.to_string())?;
            Ok(format!("{settings:?}"))
        },
        relative: &[],
    }
}

fn subjects() -> [Subject; 4] {
    [vpcd(), scene_file(), hw_sim(), builder()]
}

/// Puts a value at the end of a path of tables, of which lists are entered at their first; a number that replaces a
/// list replaces its first.
fn set(table: &mut Table, path: &str, value: Value) {
    let (head, rest) = match path.split_once('.') {
        Some((head, rest)) => (head, Some(rest)),
        None => (path, None),
    };
    let Some(rest) = rest else {
        match table.get_mut(head) {
            Some(Value::Array(list)) if value.is_float() => list[0] = value,
            _ => {
                table.insert(head.to_owned(), value);
            }
        }
        return;
    };
    let inner = table
        .entry(head)
        .or_insert_with(|| Value::Table(Table::new()));
    match inner {
        Value::Table(inner) => set(inner, rest, value),
        Value::Array(list) => set(list[0].as_table_mut().unwrap(), rest, value),
        _ => panic!("{path} is no table"),
    }
}

fn get<'a>(table: &'a Table, path: &str) -> Option<&'a Value> {
    match path.split_once('.') {
        None => table.get(path),
        Some((head, rest)) => match table.get(head)? {
            Value::Table(inner) => get(inner, rest),
            Value::Array(list) => get(list[0].as_table()?, rest),
            _ => None,
        },
    }
}

fn remove(table: &mut Table, path: &str) {
    match path.split_once('.') {
        None => {
            table.remove(path);
        }
        Some((head, rest)) => match table.get_mut(head) {
            Some(Value::Table(inner)) => remove(inner, rest),
            Some(Value::Array(list)) => remove(list[0].as_table_mut().unwrap(), rest),
            _ => (),
        },
    }
}

/// Values of a key, and whether it takes them.
fn probes(key: &Key, base: &Table) -> Vec<(Value, bool)> {
    let beyond = |x: f64| (x.abs() * 1e-6).max(1e-9);
    match key.kind {
        Kind::Integer { least, most } => {
            let ends = [(least, true), (least - 1.0, false)];
            let upper = [(most, true), (most + 1.0, false)];
            let upper = upper.into_iter().filter(|_| most.is_finite());
            ends.into_iter()
                .chain(upper)
                .map(|(x, good)| (Value::Integer(x as i64), good))
                .collect()
        }
        Kind::Number { least, most } | Kind::Numbers { least, most, .. } => [
            (least, true),
            (most, true),
            (least - beyond(least), false),
            (most + beyond(most), false),
            (f64::NAN, false),
            (f64::INFINITY, false),
        ]
        .into_iter()
        .map(|(x, good)| (Value::Float(x), good))
        .collect(),
        Kind::Word => {
            let words = key.allowed.split(", ").flat_map(|word| word.split(" to "));
            let mut probes: Vec<_> = words
                .map(|word| (Value::String(word.to_owned()), true))
                .collect();
            probes.push((Value::String("no such word".into()), false));
            probes
        }
        Kind::Switch => vec![(Value::Boolean(true), true), (Value::Boolean(false), true)],
        Kind::List { least, most } => {
            let Some(Value::Array(list)) = get(base, key.name) else {
                panic!("{} is no list", key.name);
            };
            let of = |count: usize| Value::Array(vec![list[0].clone(); count]);
            let mut probes = vec![(of(most + 1), false)];
            if least > 0 {
                probes.push((of(least - 1), false));
            }
            probes
        }
        Kind::Path | Kind::Text | Kind::Table => Vec::new(),
    }
}

/// Whether a refusal is about this key: its name before the value, also inside a list or in the line of a wrong type.
fn is_about(message: &str, key: &Key) -> bool {
    let last = key.last();
    [" = ", "[0] = ", "="]
        .iter()
        .any(|sign| message.contains(&format!("{last}{sign}")))
}

#[test]
fn every_key_takes_its_range_and_refuses_what_is_beyond_in_these_words() {
    let mut count = 0;
    for subject in subjects() {
        for key in subject.keys {
            for (value, good) in probes(key, &subject.base) {
                let mut document = subject.base.clone();
                if let (Kind::Numbers { .. }, None) = (key.kind, get(&document, key.name)) {
                    // Of a list that is not there yet, the default's first number is replaced.
                    let default: Table = format!("x = {}", key.default).parse().unwrap();
                    set(&mut document, key.name, default["x"].clone());
                }
                set(&mut document, key.name, value.clone());
                let text = toml::to_string(&document).unwrap();
                let outcome = (subject.read)(&text);
                let place = format!("{}: {} = {value}", subject.name, key.name);
                let refused = outcome.as_ref().is_err_and(|e| is_about(e, key));
                assert_eq!(refused, !good, "{place}: {outcome:?}");
                count += 1;
                let Err(message) = outcome else { continue };
                // Wrong words of an enumeration are refused by the TOML's reader, which lists the right ones.
                let own = message.split_once("allowed: ").map(|(_, allowed)| allowed);
                if good || subject.relative.contains(&key.name) {
                    continue;
                }
                match own {
                    Some(allowed) => {
                        assert!(key.allowed.starts_with(allowed), "{place}: {message}")
                    }
                    None => assert!(
                        message.contains("invalid value") || message.contains("unknown variant"),
                        "{place}: {message}"
                    ),
                }
            }
        }
    }
    assert!(count > 200, "{count}");
}

#[test]
fn every_default_is_the_codes() {
    // What a program makes of nothing is what it makes of all defaults together.
    for subject in subjects() {
        let mut bare = subject.base.clone();
        for key in subject.keys.iter().filter(|key| !key.default.is_empty()) {
            remove(&mut bare, key.name);
        }
        let mut full = bare.clone();
        let mut count = 0;
        for key in subject.keys {
            let default = format!("x = {}", key.default).parse::<Table>();
            if let Ok(default) = default {
                set(&mut full, key.name, default["x"].clone());
                count += 1;
            }
        }
        let read = |table: &Table| (subject.read)(&toml::to_string(table).unwrap());
        match subject.name {
            // Ten digits of a length in the file are a bound of what can be compared.
            "hw-sim" => {
                bare.remove("hand_eye");
                let whole = read(&bare).unwrap();
                let exact = "0.04949747468305833";
                assert!(whole.contains(exact), "{whole}");
                let told = read(&full).unwrap().replace("0.0494974747", exact);
                assert_eq!(told, whole);
            }
            _ => assert_eq!(
                read(&full).unwrap(),
                read(&bare).unwrap(),
                "{}",
                subject.name
            ),
        }
        assert!(
            count > 10 || subject.name == "scene",
            "{}: {count}",
            subject.name
        );
        // Those without a default are asked for by name.
        for key in subject.keys.iter().filter(|key| key.default.is_empty()) {
            let mut without = subject.base.clone();
            remove(&mut without, key.name);
            let message = read(&without).unwrap_err();
            assert!(message.contains(key.last()), "{}: {message}", key.name);
        }
    }
}

#[test]
fn there_is_no_key_that_the_reference_does_not_know_and_none_too_many() {
    for subject in subjects() {
        let mut tables: BTreeSet<&str> = subject.keys.iter().map(Key::table).collect();
        tables.insert("");
        for table in &tables {
            let mut document = subject.base.clone();
            let path = match *table {
                "" => "unheard_of".to_owned(),
                table => format!("{table}.unheard_of"),
            };
            set(&mut document, &path, Value::Integer(1));
            let message = (subject.read)(&toml::to_string(&document).unwrap()).unwrap_err();
            let (_, expected) = message.split_once("expected").unwrap();
            let found: BTreeSet<&str> = expected.split('`').skip(1).step_by(2).collect();
            let below = |name: &'static str| match *table {
                "" => Some(name),
                table => name.strip_prefix(table)?.strip_prefix('.'),
            };
            let known: BTreeSet<&str> = subject
                .keys
                .iter()
                .filter_map(|key| below(key.name))
                .filter_map(|rest| rest.split('.').next())
                .collect();
            assert_eq!(found, known, "{}: [{table}]", subject.name);
        }
    }
}

#[test]
fn every_flag_that_a_meaning_names_is_one() {
    use clap::CommandFactory;
    let flags = |command: clap::Command| -> BTreeSet<String> {
        let names = command.get_arguments().filter_map(|flag| flag.get_long());
        names.map(str::to_owned).collect()
    };
    let known = [
        (vpcd(), flags(Arguments::command())),
        (hw_sim(), flags(hw_sim::config::Arguments::command())),
    ];
    for (subject, flags) in known {
        for key in subject.keys {
            if let Some((_, flag)) = key.meaning.rsplit_once("(--") {
                let flag = flag.trim_end_matches(')');
                assert!(flags.contains(flag), "{}: --{flag}", key.name);
            }
        }
    }
}

#[test]
fn the_files_that_ship_show_every_key_with_its_default() {
    for (file, subject) in [
        ("controller/vpcd.toml", vpcd()),
        ("hw-sim/hw-sim.toml", hw_sim()),
    ] {
        let text = std::fs::read_to_string(root().join(file)).unwrap();
        let mut table = String::new();
        let mut shown = Table::new();
        for line in text.lines() {
            let line = line.strip_prefix("# ").unwrap_or(line);
            if let Some(head) = line.strip_prefix('[').and_then(|l| l.split(']').next()) {
                table = format!("{head}.");
                continue;
            }
            for (name, value) in line.parse::<Table>().unwrap_or_default() {
                set(&mut shown, &format!("{table}{name}"), value);
            }
        }
        for key in subject.keys {
            let value = get(&shown, key.name);
            assert!(value.is_some(), "{file} does not show {}", key.name);
            if let Ok(default) = format!("x = {}", key.default).parse::<Table>() {
                assert_eq!(value, default.get("x"), "{file}: {}", key.name);
            }
        }
    }
}

fn document() -> String {
    let mut text = String::from(
        "# Configuration\n\n\
         Every key of the project's four kinds of files, made from the code: `cargo test -p system-tests --test documents`,\n\
         with `VPC_BLESS=1` to write this file anew. The test holds each default and range against what the programs take.\n\
         A file with an unknown key is refused; a refusal names file, key, value and what is allowed. Ranges include their\n\
         ends. What `vpcd` would run with, flags and defaults and all: `vpcd --print-config`.\n",
    );
    for (title, prose, subject) in [
        (
            "vpcd",
            "`vpcd --config FILE`; [`vpcd.toml`](vpcd.toml) shows the defaults. Paths are relative to the file. A \
             flag,\nin brackets, wins.",
            vpcd(),
        ),
        (
            "The scene",
            "What controller, builder and emulator must agree on; \
             [`paper-sim.toml`](../ipc/scene/scenes/paper-sim.toml) is one. A memory belongs to the scene\nit was \
             built for; only `success`, `starts`, names and the weights of `cost` may change under it.",
            scene_file(),
        ),
        (
            "hw-sim",
            "`hw-sim --config FILE`; [`hw-sim.toml`](../hw-sim/hw-sim.toml) shows the defaults. Paths of scene and\n\
             starts are relative to the file. A flag, in brackets, wins.",
            hw_sim(),
        ),
        (
            "vpc-memory build",
            "`vpc-memory build --settings FILE`; the defaults are the paper's where it has them. A flag, in brackets, \
             wins.",
            builder(),
        ),
    ] {
        text += &format!("\n## {title}\n{prose}\n{}", Key::reference(subject.keys));
    }
    text
}

#[test]
fn the_reference_is_made_from_the_code() {
    let file = root().join("controller/CONFIGURATION.md");
    let made = document();
    if std::env::var_os("VPC_BLESS").is_some() {
        std::fs::write(&file, &made).unwrap();
    }
    let stored = std::fs::read_to_string(&file).unwrap_or_default();
    assert!(
        stored == made,
        "controller/CONFIGURATION.md is not what the code says; VPC_BLESS=1 writes it anew"
    );
}
