//! The order of the modules: README.md lists them all, and each uses only those below it.

use std::collections::HashMap;
use std::fs;
use std::path::Path;

/// The modules of README.md, from the top.
fn listed() -> Vec<String> {
    let readme = Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md");
    let text = fs::read_to_string(readme).unwrap();
    let names = text.lines().filter_map(|line| line.strip_prefix("src/"));
    names
        .filter_map(|line| Some(line.split_once(".rs")?.0.to_owned()))
        .collect()
}

/// The code of every module, without comments and tests.
fn sources() -> HashMap<String, String> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let paths = fs::read_dir(source)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let read = |path: &Path| {
        let text = fs::read_to_string(path).unwrap();
        let code = text.split("#[cfg(test)]\nmod tests").next().unwrap();
        let lines = code
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"));
        lines.collect::<Vec<_>>().join("\n")
    };
    paths
        .map(|path| {
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            (name, read(&path))
        })
        .collect()
}

/// The first names of the paths that follow `prefix`: of `crate::{a::{b, c}, d}` a and d.
fn names_after<'a>(code: &'a str, prefix: &str) -> Vec<&'a str> {
    let word = |text: &'a str| {
        let end = text.find(|c: char| !c.is_alphanumeric() && c != '_');
        &text[..end.unwrap_or(text.len())]
    };
    let mut names = Vec::new();
    for (start, _) in code.match_indices(prefix) {
        let rest = &code[start + prefix.len()..];
        let Some(group) = rest.strip_prefix('{') else {
            names.push(word(rest));
            continue;
        };
        let mut depth = 1;
        names.push(word(group.trim_start()));
        for (at, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 1 => names.push(word(group[at + 1..].trim_start())),
                _ => (),
            }
            if depth == 0 {
                break;
            }
        }
    }
    names
}

#[test]
fn each_module_uses_only_those_listed_below_it() {
    let (listed, mut sources) = (listed(), sources());
    // What the root exports from a module stands for the module.
    let root = sources.remove("lib").unwrap();
    let mut exported = HashMap::new();
    for export in root
        .split(';')
        .filter_map(|item| item.trim().strip_prefix("pub use "))
    {
        let (module, names) = export.split_once("::").unwrap();
        for name in names.trim_matches(['{', '}']).split(',') {
            exported.insert(name.trim(), module);
        }
    }
    let place = |name: &str| listed.iter().position(|listed| listed == name);
    let mut uses = 0;
    for (module, code) in &sources {
        let from = place(module).unwrap_or_else(|| panic!("{module} is not listed"));
        assert!(!code.contains("super::"), "{module} uses `super::`");
        for name in names_after(code, "crate::") {
            let used = exported.get(name).copied().unwrap_or(name);
            if used == module || !sources.contains_key(used) {
                continue;
            }
            uses += 1;
            let to = place(used).unwrap_or_else(|| panic!("{used} is not listed"));
            assert!(from < to, "{module} uses {used}, which is listed above it");
        }
    }
    assert_eq!(listed.len(), sources.len(), "listed twice or not there");
    assert!(uses > 100, "{uses}");
}
