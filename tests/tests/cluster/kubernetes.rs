//! The Job of Kubernetes agrees with its API's schema and with the programs' flags. No cluster runs it.

use testkit::python::{Environment, run};
use testkit::{ended, program, root};

const FILE: &str = "memory-blob/cluster/memory.yaml";

const JUDGE: Environment = Environment {
    name: "kubernetes",
    requirements: &[],
    packages: &["kubernetes-validate>=1.29", "pyyaml"],
};

/// Validates each document against the schema of the newest version of the API that the package has,
/// then prints the command of each container, a line each, with the variables put in for index 3.
const SCRIPT: &str = r#"
import re, sys, yaml, kubernetes_validate
jobs = list(yaml.safe_load_all(open(sys.argv[1])))
for job in jobs:
    kubernetes_validate.validate(job, kubernetes_validate.latest_version(), strict=True)
    spec = job["spec"]["template"]["spec"]
    container, = spec["containers"]
    claims = {volume["name"]: volume["persistentVolumeClaim"]["claimName"] for volume in spec["volumes"]}
    assert [claims[mount["name"]] for mount in container["volumeMounts"]] == ["vpc"], claims
    values = {entry["name"]: entry["value"] for entry in container.get("env", [])}
    if job["spec"].get("completionMode") == "Indexed":
        values["JOB_COMPLETION_INDEX"] = "3"
        assert int(values["PARTS"]) == job["spec"]["completions"], values
    words = container["command"] + container.get("args", [])
    print(" ".join(re.sub(r"\$\((\w+)\)", lambda name: values[name[1]], word) for word in words))
"#;

#[test]
fn the_job_is_valid_and_its_commands_are_the_programs() {
    let Some(python) = JUDGE.python("the Job of Kubernetes") else {
        return;
    };
    let said = run(testkit::command(python)
        .args(["-c", SCRIPT])
        .arg(root().join(FILE)))
    .unwrap();
    let commands: Vec<_> = said.lines().collect();
    assert_eq!(
        commands,
        [
            "vpc-memory build /vpc/scene.toml --part 3/4 -o /vpc/parts/3 --trajectories 900 --threads 1",
            "/bin/sh -c exec vpc-memory merge /vpc/parts/* -o /vpc/memory.vpcmem",
        ]
    );
    // The program takes these flags: what it refuses are the files, which are not there.
    let programs = program("vpc-memory").parent().unwrap().to_owned();
    for (command, file) in commands.iter().zip(["/vpc/scene.toml", "/vpc/parts/*"]) {
        let script = command.strip_prefix("/bin/sh -c ").unwrap_or(command);
        let mut shell = testkit::command("/bin/sh");
        let ended = ended(shell.args(["-c", script]).env("PATH", &programs));
        let words = format!("vpc-memory: {file}: ");
        assert!(ended.stderr.contains(&words), "{command}: {}", ended.stderr);
    }
}
