//! Bad input: the real binary, its exit code, and the words that tell what to mend.

use std::process::{Command, Stdio};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scene::Scene;

use crate::fixture::{Place, ended, scene_file, vpcd, vpcd_in, write_memory};

/// Runs `vpcd --config` on this text.
fn with_config(place: &Place, text: &str) -> (i32, String) {
    let file = place.file("v.toml", text);
    let mut command = vpcd();
    command.arg("--check-only").arg("--config").arg(file);
    ended(command)
}

fn assert_refused(outcome: (i32, String), exit: i32, words: &[&str]) {
    let (code, message) = outcome;
    for word in words {
        assert!(message.contains(word), "{message}\nlacks: {word}");
    }
    assert_eq!(code, exit, "{message}");
}

#[test]
fn a_wrong_command_line_is_64() {
    let run = |arguments: &[&str]| {
        let mut command = vpcd();
        command.args(arguments);
        ended(command)
    };
    assert_refused(run(&["--configg", "x"]), 64, &["--configg", "--config"]);
    assert_refused(run(&["--cycles", "0"]), 64, &["--cycles"]);
    assert_refused(run(&["--np", "many"]), 64, &["--np", "many"]);
    assert_refused(run(&[]), 64, &["scene is missing", "--scene"]);
    assert_refused(
        run(&["--scene", "s", "--np", "41"]),
        64,
        &["command line: --np = 41; allowed: 1 to 40"],
    );
    assert_refused(
        run(&["--scene", "s", "--strategy", "magic"]),
        64,
        &["--strategy = magic", "previous, knn"],
    );
    assert_refused(
        run(&["--scene", "s", "--clock", "sun"]),
        64,
        &["--clock = sun; allowed: fixed, phase, lockstep"],
    );
}

#[test]
fn help_explains_itself() {
    let output = vpcd().arg("--help").output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0));
    for word in [
        "--config",
        "--scene",
        "--memory",
        "lockstep",
        "--check-only",
        "Exit codes",
        "/tmp/vpc-",
    ] {
        assert!(text.contains(word), "{text}\nlacks: {word}");
    }
}

#[test]
fn markers_of_unknown_size_without_a_margin_are_warned_of() {
    let place = Place::new();
    let tags = |name: &str, size: &str| {
        let text = scene::TAGS_ROBOT.replace("marker_size = 0.03", size);
        place.file(name, text).display().to_string()
    };
    let unknown = tags("unknown.toml", "");
    let known = tags("known.toml", "marker_size = 0.03");
    let points = tags("points.toml", "marker_size = 0.0");
    for (scene, margin, is_warned) in [
        (&unknown, 0.0, true),
        (&unknown, 40.0, false),
        (&known, 0.0, false),
        (&points, 0.0, false),
    ] {
        let text = format!("scene = '{scene}'\n[law]\nmargin_px = {margin:?}\n");
        let file = place.file("v.toml", text);
        for flags in [&["--check-only"][..], &["--cycles", "3"]] {
            let mut command = vpcd();
            command.arg("--config").arg(&file).args(flags);
            command.arg("--domain").arg(place.domain());
            command.stdout(Stdio::null()).stderr(Stdio::piped());
            let (code, said) = ended(command);
            assert_eq!(code, 0, "{said}");
            let words = "unknown.toml: pattern.marker_size is not given and law.margin_px is 0";
            assert_eq!(
                said.matches(words).count(),
                usize::from(is_warned),
                "{said}"
            );
        }
    }
}

#[test]
fn a_wrong_configuration_is_78() {
    let place = Place::new();
    let scene = scene_file();
    let scene = format!("scene = '{}'\n", scene.display());
    for (text, words) in [
        ("nonsense", vec!["v.toml", "line 2"]),
        (
            "[law]\nnpp = 3",
            vec!["v.toml", "line 3", "unknown field `npp`", "`np`"],
        ),
        ("[extra]\na = 1", vec!["unknown field `extra`"]),
        (
            "[law]\nnp = 0",
            vec!["v.toml: law.np = 0; allowed: 1 to 40"],
        ),
        (
            "[law]\nnp = -2",
            vec!["v.toml: law.np = -2; allowed: 1 to 40"],
        ),
        (
            "[law]\nnp = 'three'",
            vec!["line 3", "invalid type", "np = 'three'"],
        ),
        (
            "[law]\ntrigger_px = nan",
            vec!["law.trigger_px = NaN; allowed: 0 to 1e4 px"],
        ),
        (
            "[law]\nlambda = inf",
            vec!["law.lambda = inf; allowed: 1e-6 to 100"],
        ),
        (
            "[cycle]\nstale_periods = -1.0",
            vec!["cycle.stale_periods = -1; allowed: 2 to 1000"],
        ),
        (
            "[law]\nstrategy = 'knn'",
            vec!["v.toml: memory is missing", "--memory"],
        ),
    ] {
        assert_refused(with_config(&place, &format!("{scene}{text}")), 78, &words);
    }
    assert_refused(
        with_config(&place, ""),
        78,
        &["v.toml: scene is missing", "--scene"],
    );
}

#[test]
fn a_missing_file_is_66() {
    let place = Place::new();
    let mut command = vpcd();
    command.args(["--config", "/nowhere/v.toml"]);
    assert_refused(ended(command), 66, &["/nowhere/v.toml", "No such file"]);
    let outcome = with_config(&place, "scene = 'absent.toml'");
    assert_refused(outcome, 66, &["absent.toml", "No such file"]);
    let mut command = vpcd_in(&place);
    command.args(["--strategy", "gpr", "--memory", "/nowhere/m.vpcmem"]);
    assert_refused(ended(command), 66, &["/nowhere/m.vpcmem", "No such file"]);
}

#[test]
fn what_is_no_plain_file_is_refused_without_waiting() {
    let place = Place::new();
    let made = testkit::command("mkfifo").arg(place.path("pipe")).status();
    assert!(made.unwrap().success());
    let pipe = place.path("pipe").display().to_string();
    for (path, what) in [("/dev/zero", "is a device"), (&*pipe, "is a pipe")] {
        let words = [path, what, "allowed: a plain file"];
        let with_flags = |flags: &[&str]| {
            let mut command = vpcd_in(&place);
            command.arg("--check-only").args(flags);
            ended(command)
        };
        let mut config = vpcd();
        config.args(["--check-only", "--config", path]);
        assert_refused(ended(config), 66, &words);
        let mut scene = vpcd();
        scene.args(["--check-only", "--scene", path]);
        assert_refused(ended(scene), 66, &words);
        let memory = ["--strategy", "gpr", "--memory", path];
        assert_refused(with_flags(&memory), 66, &words);
        let (head, occlusions) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
        let mask = format!("{head}[[occlusion]]\nname = 'm'\nmask = '{path}'\n");
        let arm = format!("arm = '{path}'\n{head}[[occlusion]]{occlusions}");
        for (text, exit) in [(mask, 65), (arm, 66)] {
            place.file("s.toml", text);
            let outcome = with_config(&place, "scene = 's.toml'");
            assert_refused(outcome, exit, &words);
        }
        let mut replay = vpcd();
        replay.args(["replay", path]);
        assert_refused(ended(replay), 66, &words);
    }
}

#[test]
fn a_stack_that_is_too_small_is_told_and_the_least_suffices() {
    let place = Place::new();
    let limited = |kib: u32, flags: &[&str]| {
        let mut shell = testkit::command("sh");
        shell.args(["-c", &format!("ulimit -s {kib}; exec \"$@\""), "sh"]);
        let vpcd = vpcd_in(&place);
        shell
            .arg(vpcd.get_program())
            .args(vpcd.get_args())
            .args(flags);
        ended(shell)
    };
    let words = ["a stack of at most 128 KiB; allowed: 1024 KiB and more"];
    assert_refused(limited(128, &[]), 78, &words);
    let (code, said) = limited(1024, &["--cycles", "3"]);
    assert_eq!(code, 0, "{said}");
}

#[test]
fn a_wrong_scene_is_65() {
    let place = Place::new();
    let check = |from: &str, to: &str| {
        assert!(scene::PAPER_SIM.contains(from), "{from}");
        place.file("s.toml", scene::PAPER_SIM.replacen(from, to, 1));
        with_config(&place, "scene = 's.toml'")
    };
    assert_refused(
        check("fx = 800.0", "fx = nan"),
        65,
        &["s.toml", "camera.fx = NaN", "10 to 1e5"],
    );
    assert_refused(
        check("fx = 800.0", "fx = -800.0"),
        65,
        &["camera.fx = -800"],
    );
    assert_refused(
        check("fx = 800.0", "fx = 800.0\nfz = 1"),
        65,
        &["unknown field `fz`"],
    );
    assert_refused(
        check("fx = 800.0", "fx = 'long'"),
        65,
        &["invalid type", "line"],
    );
}

fn with_memory(place: &Place, name: &str) -> Command {
    let mut command = vpcd_in(place);
    command
        .args(["--strategy", "gpr", "--check-only", "--memory"])
        .arg(place.path(name));
    command
}

#[test]
fn a_damaged_memory_is_65() {
    let place = Place::new();
    let scene = Scene::read(&scene_file()).unwrap();
    write_memory(
        &scene,
        &place.path("good"),
        &mut ChaCha8Rng::seed_from_u64(1),
    );
    let (code, message) = ended(with_memory(&place, "good"));
    assert_eq!(code, 0, "{message}");

    let good = std::fs::read(place.path("good")).unwrap();
    place.file("truncated", &good[..good.len() - 8]);
    assert_refused(
        ended(with_memory(&place, "truncated")),
        65,
        &["truncated", "not an intact memory"],
    );
    place.file("empty", "");
    assert_refused(
        ended(with_memory(&place, "empty")),
        65,
        &["empty", "not an intact memory"],
    );
    for share in [0.001, 0.3, 0.6, 0.999] {
        let mut flipped = good.clone();
        let at = (good.len() as f64 * share) as usize;
        flipped[at] ^= 0x10;
        place.file("flipped", flipped);
        assert_refused(ended(with_memory(&place, "flipped")), 65, &["flipped: "]);
    }
}

#[test]
fn a_memory_of_another_task_is_65() {
    let place = Place::new();
    let other = scene::PAPER_SIM.replacen("fx = 800.0", "fx = 801.0", 1);
    let other = Scene::parse(&other, "other").unwrap();
    write_memory(
        &other,
        &place.path("other"),
        &mut ChaCha8Rng::seed_from_u64(1),
    );
    let words = ["other", "built for another task", "vpc-memory build"];
    assert_refused(ended(with_memory(&place, "other")), 65, &words);
}

#[test]
fn the_configuration_that_ships_is_valid_and_is_the_default() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/vpcd.toml");
    let mut command = vpcd();
    command.args(["--check-only", "--config", file]);
    assert_eq!(ended(command).0, 0);

    let arguments = controller::arguments::Arguments::default();
    let parse = |text: &str| {
        let directory = std::path::Path::new("");
        controller::config::Config::parse(text, "v.toml", directory, &arguments).unwrap()
    };
    let shipped = parse(&std::fs::read_to_string(file).unwrap());
    assert_eq!(
        shipped,
        parse("scene = '../ipc/scene/scenes/paper-sim.toml'")
    );
}
