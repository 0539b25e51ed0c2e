//! The README of each crate lists its modules; each uses only those above it.

use std::fs;
use std::path::Path;

/// The modules of the crate in `folder` (from `ipc`) are those that `readme` lists as
/// `PREFIX/NAME.rs`, in an order in which each uses only those above it.
fn each_uses_only_those_above_it(folder: &str, readme: &str, prefix: &str) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let source = root.join(folder).join("src");
    let readme = fs::read_to_string(root.join(readme)).unwrap();
    let listed: Vec<&str> = readme
        .lines()
        .filter_map(|line| line.strip_prefix(prefix)?.split_once(".rs "))
        .map(|(name, _)| name)
        .collect();
    let mut present: Vec<String> = fs::read_dir(&source)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned())
        .filter(|name| name != "lib")
        .collect();
    present.sort();
    let mut sorted = listed.clone();
    sorted.sort_unstable();
    assert_eq!(
        sorted, present,
        "{folder}: modules in the README and in src"
    );

    let lib = fs::read_to_string(source.join("lib.rs")).unwrap();
    for (place, module) in listed.iter().enumerate() {
        let text = fs::read_to_string(source.join(format!("{module}.rs"))).unwrap();
        for name in used(&text) {
            let used = home(&lib, &listed, name);
            assert!(
                listed[..=place].contains(&used),
                "{folder}: {module} uses {used} ({name}), which the README lists below it"
            );
        }
    }
}

/// What a module names of its crate: the words behind `crate::`, without tests.
fn used(text: &str) -> Vec<&str> {
    let (code, _) = text.split_once("#[cfg(test)]").unwrap_or((text, ""));
    let uses = code.split("crate::").skip(1);
    let names = uses.flat_map(|text| match text.strip_prefix('{') {
        Some(group) => group.split('}').next().unwrap().split(',').collect(),
        None => vec![text],
    });
    names
        .map(first_word)
        .filter(|name| !name.is_empty())
        .collect()
}

fn first_word(text: &str) -> &str {
    let text = text.trim_start();
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_');
    &text[..end.unwrap_or(text.len())]
}

/// The module of a name: itself, or the one from which `lib.rs` exports it.
fn home<'a>(lib: &'a str, modules: &[&'a str], name: &'a str) -> &'a str {
    if modules.contains(&name) {
        return name;
    }
    let exports = lib.split("pub use ").skip(1);
    let exports = exports.map(|rest| rest.split(';').next().unwrap());
    let is_name = |word: &str| word == name;
    let words = |export: &str| {
        export
            .split(|c: char| !c.is_alphanumeric() && c != '_')
            .any(is_name)
    };
    let export = exports.into_iter().find(|export| words(export));
    first_word(export.unwrap_or_else(|| panic!("{name}: of no module")))
}

#[test]
fn modules_use_only_those_above_them() {
    each_uses_only_those_above_it(".", "README.md", "src/");
    each_uses_only_those_above_it("messages", "README.md", "messages/src/");
    each_uses_only_those_above_it("recording", "recording/README.md", "src/");
}
