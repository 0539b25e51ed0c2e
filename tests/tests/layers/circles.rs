//! No two sibling modules of any crate use each other, not by way of others either.
//!
//! A module and its own children may: the parent names the children, and they use what it declares.
//! Code of tests does not count.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};
use syn::{Item, UseTree};
use testkit::root;

use crate::crates::WORKSPACES;

/// Names from the crate's root to a module or an item.
pub type Names = Vec<String>;

/// Which child of a module uses which, with a place where it does.
pub type Uses = BTreeMap<String, BTreeMap<String, String>>;

#[test]
fn no_modules_use_each_other_in_a_circle() {
    let (mut faults, mut crates) = (Vec::new(), 0);
    for directory in sources() {
        let sources = Sources::read(&directory);
        crates += 1;
        for (parent, uses) in sources.uses() {
            let place = directory.strip_prefix(root()).unwrap_or(&directory);
            let place = place.display();
            for circle in circles(&uses) {
                faults.push(format!("{place}, {}: {circle}", parent.join("::")));
            }
        }
    }
    assert!(crates > 30, "only {crates} crates were found");
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

/// Where the sources of every crate of ours begin, and of its programs that have modules.
fn sources() -> Vec<PathBuf> {
    let members = WORKSPACES.iter().flat_map(|workspace| {
        let workspace = root().join(workspace);
        let manifest = fs::read_to_string(workspace.join("Cargo.toml")).unwrap();
        let manifest: toml::Table = manifest.parse().unwrap();
        let members = manifest["workspace"]["members"].as_array().unwrap().iter();
        let members = members.map(|member| workspace.join(member.as_str().unwrap()));
        members.collect::<Vec<_>>()
    });
    let directories = members.flat_map(|at| {
        let programs = fs::read_dir(at.join("src/bin")).into_iter().flatten();
        let programs = programs.map(|program| program.unwrap().path());
        [vec![at.join("src"), at], programs.collect()].concat()
    });
    let is_crate = |at: &PathBuf| at.join("lib.rs").exists() || at.join("main.rs").exists();
    let directories = directories.filter(is_crate);
    directories.map(|at| at.canonicalize().unwrap()).collect()
}

/// The modules of a crate.
pub struct Sources {
    modules: BTreeMap<Names, Module>,
}

/// What one module names.
#[derive(Default)]
struct Module {
    /// Paths from the crate's root, of what is used.
    paths: Vec<Names>,
    /// What a `use` gives a name in this module.
    names: BTreeMap<String, Names>,
}

impl Sources {
    pub fn read(directory: &Path) -> Self {
        let mut modules = BTreeMap::new();
        for file in files(directory) {
            let inside = file.strip_prefix(directory).unwrap().with_extension("");
            let mut at: Names = inside
                .iter()
                .map(|x| x.to_str().unwrap().to_owned())
                .collect();
            if at
                .last()
                .is_some_and(|last| ["lib", "main", "mod"].contains(&last.as_str()))
            {
                at.pop();
            }
            let text = fs::read_to_string(&file).unwrap();
            let syntax = syn::parse_file(&text).unwrap_or_else(|e| panic!("{file:?}: {e}"));
            let mut reader = Reader {
                modules: &mut modules,
                at,
            };
            reader.visit_file(&syntax);
        }
        Self { modules }
    }

    /// The uses among the children of each module.
    pub fn uses(&self) -> BTreeMap<Names, Uses> {
        let mut uses = BTreeMap::<Names, Uses>::new();
        for (at, module) in &self.modules {
            for path in &module.paths {
                let target = self.resolved(path);
                let shared = at.iter().zip(&target).take_while(|(a, b)| a == b).count();
                let (Some(user), Some(used)) = (at.get(shared), target.get(shared)) else {
                    continue;
                };
                let parent = &at[..shared];
                if self.is_module(&[parent, std::slice::from_ref(used)].concat()) {
                    let children = uses.entry(parent.to_vec()).or_default();
                    let places = children.entry(user.clone()).or_default();
                    let place = format!("{} uses {}", at.join("::"), target.join("::"));
                    places.entry(used.clone()).or_insert(place);
                }
            }
        }
        uses
    }

    fn is_module(&self, path: &[String]) -> bool {
        self.modules.contains_key(path)
    }

    /// Where a path leads to, through what modules export of others.
    fn resolved(&self, path: &Names) -> Names {
        let mut path = path.clone();
        // Bounded: exports of exports of exports are not seen here.
        for _ in 0..4 {
            let depth = (0..path.len())
                .rev()
                .find(|depth| self.is_module(&path[..*depth]));
            let Some(depth) = depth.filter(|_| !self.is_module(&path)) else {
                break;
            };
            let Some(export) = self.modules[&path[..depth]].names.get(&path[depth]) else {
                break;
            };
            path = [export.as_slice(), &path[depth + 1..]].concat();
        }
        path
    }
}

/// Every Rust file that is a module or a crate's root, without other programs and tests.
fn files(directory: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap();
        if path.is_dir() {
            if !["bin", "tests", "benches", "examples", "src"].contains(&name) {
                files.extend(self::files(&path));
            }
        } else if path.extension().is_some_and(|end| end == "rs") {
            // The package's build script, which is no module, is beside its Cargo.toml.
            let is_script = name == "build" && directory.join("Cargo.toml").exists();
            if name != "tests" && !is_script {
                files.push(path);
            }
        }
    }
    files
}

/// Collects what a file names.
struct Reader<'a> {
    modules: &'a mut BTreeMap<Names, Module>,
    at: Names,
}

impl Reader<'_> {
    fn module(&mut self) -> &mut Module {
        self.modules.entry(self.at.clone()).or_default()
    }

    /// A path from the crate's root, if it is one of this crate.
    fn absolute(&self, mut path: Names) -> Option<Names> {
        let mut at = match path.first()?.as_str() {
            "crate" => Vec::new(),
            "self" | "super" => self.at.clone(),
            _ => return None,
        };
        while let Some("crate" | "self" | "super") = path.first().map(String::as_str) {
            if path.remove(0) == "super" {
                at.pop();
            }
        }
        Some([at, path].concat())
    }

    fn use_tree(&mut self, tree: &UseTree, mut path: Names) {
        match tree {
            UseTree::Path(inner) => {
                path.push(inner.ident.to_string());
                self.use_tree(&inner.tree, path);
            }
            UseTree::Group(group) => {
                for inner in &group.items {
                    self.use_tree(inner, path.clone());
                }
            }
            UseTree::Name(name) if name.ident != "self" => {
                let name = name.ident.to_string();
                path.push(name.clone());
                self.bind(name, path);
            }
            UseTree::Rename(rename) => {
                path.push(rename.ident.to_string());
                self.bind(rename.rename.to_string(), path);
            }
            UseTree::Name(_) | UseTree::Glob(_) => self.name(path),
        }
    }

    fn name(&mut self, path: Names) {
        if let Some(path) = self.absolute(path) {
            self.module().paths.push(path);
        }
    }

    fn bind(&mut self, name: String, path: Names) {
        self.name(path.clone());
        // `use child::Item` names a child without `self`.
        let path = self
            .absolute(path.clone())
            .unwrap_or([self.at.clone(), path].concat());
        self.module().names.insert(name, path);
    }
}

impl Visit<'_> for Reader<'_> {
    fn visit_file(&mut self, file: &syn::File) {
        self.module();
        visit::visit_file(self, file);
    }

    fn visit_item(&mut self, item: &Item) {
        let attributes = match item {
            Item::Fn(item) => &item.attrs,
            Item::Impl(item) => &item.attrs,
            Item::Mod(item) => &item.attrs,
            Item::Struct(item) => &item.attrs,
            Item::Use(item) => &item.attrs,
            _ => return visit::visit_item(self, item),
        };
        let is_test =
            |meta: &syn::MetaList| meta.path.is_ident("cfg") && meta.tokens.to_string() == "test";
        if !attributes
            .iter()
            .any(|one| one.meta.require_list().is_ok_and(is_test))
        {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_mod(&mut self, item: &syn::ItemMod) {
        if item.content.is_some() {
            self.at.push(item.ident.to_string());
            self.module();
            visit::visit_item_mod(self, item);
            self.at.pop();
        }
    }

    fn visit_item_use(&mut self, item: &syn::ItemUse) {
        self.use_tree(&item.tree, Vec::new());
    }

    fn visit_path(&mut self, path: &syn::Path) {
        self.name(
            path.segments
                .iter()
                .map(|one| one.ident.to_string())
                .collect(),
        );
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, item: &syn::Macro) {
        let text = item.tokens.to_string();
        let mut words = text.split_whitespace().peekable();
        while let Some(word) = words.next() {
            let mut path = vec![word.to_owned()];
            while words.next_if_eq(&"::").is_some() {
                path.extend(words.next().map(str::to_owned));
            }
            self.name(path);
        }
    }
}

/// All that a child uses, by way of others too.
fn reached<'a>(uses: &'a Uses, from: &str) -> BTreeSet<&'a str> {
    let (mut reached, mut new) = (BTreeSet::new(), vec![from]);
    while let Some(one) = new.pop() {
        let used = uses.get(one).into_iter().flat_map(BTreeMap::keys);
        let used = used
            .map(String::as_str)
            .filter(|used| reached.insert(*used));
        new = [new, used.collect()].concat();
    }
    reached
}

/// Each circle in words: a use of each member by another one.
fn circles(uses: &Uses) -> Vec<String> {
    let mut found = BTreeSet::new();
    for child in uses.keys() {
        let mut members = reached(uses, child);
        members.retain(|one| reached(uses, one).contains(child.as_str()));
        let within = members.iter().flat_map(|one| &uses[*one]);
        let places = within.filter(|(used, _)| members.contains(used.as_str()));
        found.insert(
            places
                .map(|(_, place)| place.as_str())
                .collect::<Vec<_>>()
                .join("; "),
        );
    }
    found.remove("");
    found.into_iter().collect()
}

#[test]
fn a_circle_is_found_through_braces_exports_and_macros() {
    let directory = tempfile::tempdir().unwrap();
    for (name, text) in [
        (
            "lib.rs",
            "mod a; mod build; mod c; mod d; pub use build::B;",
        ),
        (
            "a.rs",
            "use super::{c, B}; #[cfg(test)] mod tests { use crate::d::D; }",
        ),
        (
            "build.rs",
            "pub struct B; fn say() { println!(\"{}\", crate::a::NAME); }",
        ),
        ("c.rs", "mod inner { fn f() { super::super::d::D; } }"),
        ("d.rs", "pub struct D; // crate::c::C"),
    ] {
        fs::write(directory.path().join(name), text).unwrap();
    }
    let uses = Sources::read(directory.path()).uses();
    let said = circles(&uses[&Vec::new()]);
    assert_eq!(said, ["a uses build::B; build uses a::NAME"]);
    assert!(uses[&Vec::new()]["c"].contains_key("d"));
}
