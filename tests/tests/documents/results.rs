//! The table of README.md is the one that `cargo table` measured.

use system_tests::results::{FILE, Results};
use testkit::root;

#[test]
fn the_table_of_the_readme_is_the_one_that_was_measured() {
    let page = std::fs::read_to_string(root().join("README.md")).unwrap();
    let results = Results::read().unwrap();
    let quoted = results.quoted(&page).unwrap();
    assert!(
        quoted == page,
        "README.md differs from {FILE}: cargo xtask codegen writes\n{quoted}"
    );
}
