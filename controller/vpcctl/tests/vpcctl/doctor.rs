//! `doctor`, `completions` and `man`.

use crate::stand_in::{Manner, StandIn};
use crate::{stdout, vpcctl};

#[test]
fn doctor_tells_a_sound_daemon_from_a_hanging_one_and_from_none() {
    let directory = tempfile::tempdir().unwrap();
    let words = ["doctor", "--watch", "0.3"];
    let none = vpcctl(directory.path(), &words);
    assert!(
        stdout(&none).contains("warn  daemon      none is at work"),
        "{}",
        stdout(&none)
    );
    {
        let _daemon = StandIn::sound(directory.path());
        let text = stdout(&vpcctl(directory.path(), &words));
        assert!(text.contains("disarmed: not armed"), "{text}");
        assert!(text.contains("-> vpcctl arm"), "{text}");
        assert!(text.contains("2 overruns in"), "{text}");
        assert!(
            text.contains("ok    camera      4 points, 33.0 ms old"),
            "{text}"
        );
    }
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
fn bash_takes_the_completions_and_man_takes_the_pages() {
    let directory = tempfile::tempdir().unwrap();
    let script = directory.path().join("vpcctl.bash");
    let output = vpcctl(directory.path(), &["completions", "bash"]);
    std::fs::write(&script, &output.stdout).unwrap();
    // Completes a word as bash would.
    let probe = format!(
        "source {}; COMP_WORDS=(vpcctl dis); COMP_CWORD=1; _vpcctl vpcctl dis vpcctl; echo \"${{COMPREPLY[*]}}\"",
        script.display()
    );
    let bash = testkit::command("bash")
        .args(["-c", &probe])
        .output()
        .unwrap();
    assert_eq!(stdout(&bash).trim(), "disarm", "{bash:?}");
    let man = directory.path().join("man1");
    let output = vpcctl(directory.path(), &["man", man.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0));
    for name in stdout(&output).lines().filter(|name| name.ends_with(".1")) {
        let text = std::fs::read_to_string(man.join(name)).unwrap();
        assert!(text.contains(".SH NAME") && text.contains(".TH"), "{name}");
    }
}
