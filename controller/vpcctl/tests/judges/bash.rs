//! Completions, judged by bash.

use testkit::are_installed;

use crate::{stdout, vpcctl};

#[test]
fn bash_takes_the_completions() {
    if !are_installed("completions", &["bash"]) {
        return;
    }
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
}
