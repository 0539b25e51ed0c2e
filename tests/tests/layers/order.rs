//! The order of modules: a README lists those of a crate, and each uses only those on one side of
//! it.

use std::fs;

use testkit::root;

use crate::circles::Sources;

/// Where the modules are that a module may use.
#[derive(Clone, Copy, PartialEq)]
enum Side {
    Above,
    Below,
}

/// The modules of `source` are those that `readme` lists as `PREFIX/NAME.rs`, and each uses only
/// those on this side of it; at least so many uses are found.
fn keeps_its_order(source: &str, readme: &str, prefix: &str, side: Side, least: usize) {
    let text = fs::read_to_string(root().join(readme)).unwrap();
    let lines = text.lines().filter_map(|line| line.strip_prefix(prefix));
    let listed: Vec<&str> = lines
        .filter_map(|line| Some(line.split_once(".rs ")?.0))
        .collect();
    let source = root().join(source);
    let files = fs::read_dir(&source).unwrap();
    let files = files.map(|file| file.unwrap().path().with_extension(""));
    let mut present: Vec<String> = files
        .map(|path| path.file_name().unwrap().to_str().unwrap().to_owned())
        .filter(|name| name != "lib")
        .collect();
    present.sort();
    let mut sorted = listed.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, present, "modules in {readme}, and in {source:?}");

    let place = |name: &str| listed.iter().position(|listed| *listed == name).unwrap();
    let uses = Sources::read(&source).uses();
    let (mut faults, mut count) = (Vec::new(), 0);
    for (user, used) in &uses[&Vec::new()] {
        for (used, words) in used.iter().filter(|(used, _)| *used != user) {
            count += 1;
            if (place(used) > place(user)) != (side == Side::Below) {
                faults.push(format!("{words}: the order in {readme}"));
            }
        }
    }
    assert!(count >= least, "only {count} uses were found");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn modules_use_only_those_on_one_side_of_them() {
    let (law, ipc, recording) = (
        "controller/vpc/README.md",
        "ipc/README.md",
        "ipc/recording/README.md",
    );
    keeps_its_order("controller/vpc/src", law, "src/", Side::Below, 100);
    keeps_its_order("ipc/messages/src", ipc, "messages/src/", Side::Above, 15);
    keeps_its_order("ipc/src", ipc, "src/", Side::Above, 15);
    keeps_its_order("ipc/recording/src", recording, "src/", Side::Above, 5);
}
