//! `doctor` and `man`.

use crate::stand_in::{Manner, StandIn};
use crate::{stdout, vpcctl};

#[test]
fn doctor_tells_a_hanging_daemon_from_none() {
    let directory = tempfile::tempdir().unwrap();
    let words = ["doctor", "--watch", "0.1"];
    let none = vpcctl(directory.path(), &words);
    assert!(
        stdout(&none).contains("warn  daemon      none is at work"),
        "{}",
        stdout(&none)
    );
    let manner = Manner {
        answers: false,
        cycles: false,
    };
    let _daemon = StandIn::start(directory.path(), manner);
    let hanging = vpcctl(directory.path(), &words);
    assert_eq!(hanging.status.code(), Some(1), "{}", stdout(&hanging));
    assert!(stdout(&hanging).contains("FAIL  daemon      neither answers"));
}

#[test]
fn doctor_checks_files_without_a_domain_and_makes_none() {
    let directory = tempfile::tempdir().unwrap();
    let missing = directory.path().join("missing");
    let output = vpcctl(&missing, &["doctor", "--scene", "/nonexistent.toml"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stdout(&output).contains("/nonexistent.toml"),
        "{}",
        stdout(&output)
    );
    assert!(!missing.exists());
}

#[test]
fn the_pages_of_the_manual_are_written() {
    let directory = tempfile::tempdir().unwrap();
    let man = directory.path().join("man1");
    let output = vpcctl(directory.path(), &["man", man.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0));
    for name in stdout(&output).lines().filter(|name| name.ends_with(".1")) {
        let text = std::fs::read_to_string(man.join(name)).unwrap();
        assert!(text.contains(".SH NAME") && text.contains(".TH"), "{name}");
    }
}
