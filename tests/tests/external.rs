//! Programs that are methods of `vpc-lab table`: what they do wrong ends the table, and is named.

use std::time::Duration;

use scene::{Pose, Scene};
use system_tests::external::{External, ExternalError, Method};
use system_tests::simulated::Simulated;
use system_tests::steering::Steering;
use testkit::{Place, command};
use vpc::Settings;

/// What is in front of a command, in a shell: two lines are read and answered.
const READY: &str = r#"read line; echo '"ready"'; read line; echo '"ready"'; read line; "#;

fn paper_sim() -> (Scene, Vec<Pose>) {
    let scene = Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "paper-sim-starts.csv").unwrap();
    (scene, starts.to_vec())
}

fn started(words: &str, scene: &Scene, patience_s: f64) -> Result<External, ExternalError> {
    let method = Method {
        name: "method".to_owned(),
        words: words.to_owned(),
    };
    let patience = Duration::from_secs_f64(patience_s);
    External::start(&method, scene, &Settings::default(), patience)
}

/// What the first cycle of a program in a shell says.
fn first_cycle(place: &Place, script: &str, patience_s: f64) -> String {
    let (scene, _) = paper_sim();
    place.file("method.sh", script);
    let words = format!("sh {}", place.path("method.sh").display());
    let answer = started(&words, &scene, patience_s).and_then(|mut method| {
        method.begin()?;
        method.answer(&Simulated::received(None, 0))
    });
    answer.unwrap_err().to_string()
}

#[test]
fn what_a_program_does_wrong_is_named_with_its_line_and_with_what_is_allowed() {
    let place = Place::new();
    let list = "allowed: one line [vx, vy, vz, wx, wy, wz], finite";
    let asked = r#"`{"exposed":null,"points":null,"time":0.0}`"#;
    for (script, words) in [
        ("echo hello", "answers `hello`"),
        ("echo '[1, 2, 3, 4, 5]'", "answers `[1, 2, 3, 4, 5]`"),
        (
            "echo '[0, 0, 0, 0, 0, 0, 0]'",
            "answers `[0, 0, 0, 0, 0, 0, 0]`",
        ),
        (
            "echo '[NaN, 0, 0, 0, 0, 0]'",
            "answers `[NaN, 0, 0, 0, 0, 0]`",
        ),
        (
            "echo '[1e999, 0, 0, 0, 0, 0]'",
            "answers `[1e999, 0, 0, 0, 0, 0]`",
        ),
        (
            "echo '[null, 0, 0, 0, 0, 0]'",
            "answers `[null, 0, 0, 0, 0, 0]`",
        ),
        (
            "printf '[0,0,0,0,0,0]\n[0,0,0,0,0,0]\n'",
            "answers `[0,0,0,0,0,0]`",
        ),
        ("exec yes | tr -d '\n'", "answers `yyyyyyyy"),
    ] {
        let said = first_cycle(
            &place,
            &format!("{READY}{script}; exec cat >/dev/null"),
            20.0,
        );
        assert!(said.starts_with(&format!("method: {words}")), "{said}");
        assert!(said.contains(asked) && said.ends_with(list), "{said}");
    }
    let said = first_cycle(&place, &format!("{READY}echo '[0,0,0,0,-1.25,0]'"), 20.0);
    assert_eq!(said, "method: commands wy = -1.25 rad/s; allowed: -1 to 1");
    let said = first_cycle(&place, &format!("{READY}exit 3"), 20.0);
    assert!(
        said.starts_with("method: ended (exit status: 3) at the line"),
        "{said}"
    );
    let said = first_cycle(&place, "read line; echo '\"ready\"'; exit 0", 20.0);
    assert!(
        said.contains("(exit status: 0) at the line `{\"run\":0}`"),
        "{said}"
    );
    let said = first_cycle(&place, "read line; echo ready; exec cat >/dev/null", 20.0);
    assert!(
        said.starts_with("method: answers `ready` to `{\"scene\":"),
        "{said}"
    );
    assert!(said.ends_with("allowed: one line \"ready\""), "{said}");
    let said = first_cycle(&place, &format!("{READY}sleep 100"), 0.5);
    assert!(
        said.starts_with("method: no answer to") && said.contains("after 500ms"),
        "{said}"
    );
    let (scene, _) = paper_sim();
    let error = started("/nowhere/peer --fast", &scene, 20.0)
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("method: /nowhere/peer cannot be started"),
        "{error}"
    );
}

#[test]
fn a_change_beyond_the_limit_of_acceleration_is_refused() {
    let place = Place::new();
    let (mut scene, _) = paper_sim();
    scene.limits.linear_acceleration = Some(3.0);
    place.file(
        "method.sh",
        format!("{READY}echo '[0.3,0,0,0,0,0]'; exec cat >/dev/null"),
    );
    let words = format!("sh {}", place.path("method.sh").display());
    let mut method = started(&words, &scene, 20.0).unwrap();
    method.begin().unwrap();
    let error = method.answer(&Simulated::received(None, 0)).unwrap_err();
    let allowed = "commands vx = 0.3 m/s; allowed: -0.1 to 0.1";
    assert_eq!(error.to_string(), format!("method: {allowed}"));
}

#[test]
fn a_table_with_a_program_that_hangs_ends_and_says_why() {
    let place = Place::new();
    place.file("method.sh", "read line; sleep 100");
    place.file("starts.csv", scene::PAPER_SIM_STARTS);
    let mut table = command(env!("CARGO_BIN_EXE_vpc-lab"));
    table.arg("table").arg("--scene").arg(testkit::scene_file());
    table.arg("--starts").arg(place.path("starts.csv"));
    table.args([
        "--strategies",
        "ibvs",
        "--repeats",
        "1",
        "--timeout-s",
        "0.5",
    ]);
    let method = format!("slow=sh {}", place.path("method.sh").display());
    let ended = testkit::ended(table.args(["--external", &method]));
    assert_eq!(ended.code, Some(1), "{}", ended.stderr);
    assert!(
        ended.stderr.contains("slow: no answer to `{\"scene\""),
        "{}",
        ended.stderr
    );
}
