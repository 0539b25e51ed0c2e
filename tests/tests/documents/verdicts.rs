//! What becomes of each command of the documents. A command without a verdict fails the test, and so does a verdict
//! without a command.

/// How a command is changed before it is run.
#[derive(Clone, Copy, Debug)]
pub enum Change {
    /// Words are added.
    Add(&'static str),
    /// A word is replaced.
    Put(&'static str, &'static str),
}

/// What becomes of a command.
#[derive(Clone, Copy, Debug)]
pub enum Verdict {
    /// It is run, and ends with one of these exit codes.
    Runs(&'static [i32], &'static [Change]),
    /// It is started, and stopped when the document's commands are through; a camera has judged its run by then.
    Stays(&'static [Change]),
    /// It is not run, for this reason (never empty); package, target, flags and files are looked up.
    Checked(&'static str),
}

use Change::{Add, Put};
use Verdict::{Checked, Runs, Stays};

const OK: &[i32] = &[0];

/// A document, its command as the test reads it, and the verdict.
pub type Row = (&'static str, &'static str, Verdict);

/// Commands that run while those of a document do: a camera that never arrives, so that there is always something to
/// see.
pub const MEANWHILE: &[(&str, &[&str])] = &[
    ("ipc/vpcctl/README.md", AT_WORK),
    ("ipc/recording/README.md", AT_WORK),
];

const AT_WORK: &[&str] = &[
    "vpcd --scene ipc/scene/scenes/paper-sim.toml --arm",
    "hw-sim --config hw-sim/hw-sim.toml --start 82 --time-limit 600",
];

const BUILD_ONCE: &str = "the test has built it, in its own profile";
const BENCH: &str = "a benchmark: minutes, and figures that only a quiet machine gives";
const CARGO_TEST: &str = "cargo test runs it";
const MACHINE: &str =
    "changes the machine; `cargo test -p controller --test service` installs and runs the units";
const PYTHON: &str = "needs packages of Python; cargo test runs it where they are installed";

/// The verdicts, document by document.
pub const VERDICTS: &[Row] = &[
    ("README.md", "cargo demo", Checked("CI runs it (.ci/run)")),
    ("README.md", "cargo test", Checked("it is what runs this")),
    (
        "README.md",
        "cargo table -- --scene ipc/scene/scenes/paper-sim.toml --starts ipc/scene/scenes/paper-sim-starts.csv",
        // Without a paper-size memory and three of the strategies it takes seconds.
        Runs(
            OK,
            &[Add(
                "--memory memory-blob/default/paper-sim.vpcmem --strategies gpr:3 --repeats 1",
            )],
        ),
    ),
    (
        "README.md",
        "cargo demo -- --scene paper-robot",
        Checked("minutes of a robot in real time"),
    ),
    (
        "README.md",
        "cargo run --release -p memory-builder --bin vpc-memory -- build SCENE.toml -o FILE",
        Runs(
            OK,
            &[
                Put("SCENE.toml", "ipc/scene/scenes/paper-sim.toml"),
                Put("FILE", "small.vpcmem"),
                Add(SMALL),
            ],
        ),
    ),
    (
        "README.md",
        "cargo run --release -p memory-builder --bin vpc-memory -- inspect FILE",
        Runs(OK, &[Put("FILE", "small.vpcmem")]),
    ),
    (
        "README.md",
        "cargo run --release -p memory-builder --bin vpc-memory -- verify FILE --scene SCENE.toml",
        Runs(
            OK,
            &[
                Put("FILE", "small.vpcmem"),
                Put("SCENE.toml", "ipc/scene/scenes/paper-sim.toml"),
            ],
        ),
    ),
    (
        "README.md",
        "cargo run --release -p memory-builder --bin vpc-memory -- build ipc/scene/scenes/paper-sim.toml -o memory-blob/default/paper-sim.vpcmem --trajectories 400",
        Runs(
            OK,
            &[
                Put("memory-blob/default/paper-sim.vpcmem", "default.vpcmem"),
                Put("400", "6"),
                Add("--gpr-samples 40"),
            ],
        ),
    ),
    (
        "README.md",
        "cargo run --release -p controller --bin vpcd -- --config controller/vpcd.toml",
        Stays(&[]),
    ),
    (
        "README.md",
        "cargo run --release -p hw-sim --bin hw-sim -- --config hw-sim/hw-sim.toml",
        Stays(&[]),
    ),
    (
        "README.md",
        "cargo run --release -p vpcctl -- arm",
        Runs(OK, &[]),
    ),
    // Its standard output is no terminal here.
    (
        "README.md",
        "cargo run --release -p vpcctl -- watch",
        Runs(&[64], &[]),
    ),
    (
        "controller/systemd/README.md",
        "cargo build --workspace --bins --tests && cargo test --workspace --test service -- --nocapture package",
        Checked("CI runs it (.ci/run)"),
    ),
    (
        "controller/systemd/README.md",
        "cargo install cargo-deb --version '^3' --locked",
        Checked(MACHINE),
    ),
    (
        "controller/systemd/README.md",
        "cargo deb -p controller --dbgsym",
        Checked("needs cargo-deb"),
    ),
    (
        "controller/systemd/README.md",
        "sudo apt install ./target/debian/vpcd_*_amd64.deb",
        Checked(MACHINE),
    ),
    (
        "controller/systemd/README.md",
        "sudoedit /etc/vpcd/vpcd.toml",
        Checked(MACHINE),
    ),
    (
        "controller/systemd/README.md",
        "vpcd --check-only --config /etc/vpcd/vpcd.toml",
        Checked(MACHINE),
    ),
    (
        "controller/systemd/README.md",
        "sudo systemctl start vpcd",
        Checked(MACHINE),
    ),
    (
        "controller/systemd/README.md",
        "sudo systemctl start hw-sim",
        Checked(MACHINE),
    ),
    (
        "controller/systemd/README.md",
        "sudo systemctl enable vpcd",
        Checked(MACHINE),
    ),
    (
        "controller/systemd/README.md",
        "systemctl status vpcd",
        Checked(MACHINE),
    ),
    (
        "controller/systemd/README.md",
        "sudo -u vpcd vpcctl --domain /run/vpcd status",
        Checked(MACHINE),
    ),
    (
        "controller/systemd/README.md",
        "journalctl -u vpcd -f",
        Checked(MACHINE),
    ),
    (
        "controller/systemd/README.md",
        "journalctl -u vpcd -p warning -o json",
        Checked(MACHINE),
    ),
    (
        "controller/vpc/README.md",
        "cargo table -- --scene ipc/scene/scenes/paper-sim.toml --starts ipc/scene/scenes/paper-sim-starts.csv --strategies previous:3,gpr:3 --delay 4",
        Checked("minutes; tests/tests/delay.rs runs its like"),
    ),
    (
        "controller/vpc/README.md",
        "python3 -m venv venv && venv/bin/pip install -r controller/vpc/fixtures/requirements.txt",
        Checked(PYTHON),
    ),
    (
        "controller/vpc/README.md",
        "venv/bin/python controller/vpc/fixtures/subproblems.py",
        Checked(PYTHON),
    ),
    (
        "controller/vpc/README.md",
        "cargo test -p vpc --test subproblems -- --nocapture --include-ignored",
        Checked(CARGO_TEST),
    ),
    (
        "hw-sim/README.md",
        "cargo build --release -p controller -p hw-sim",
        Checked(BUILD_ONCE),
    ),
    (
        "hw-sim/README.md",
        "target/release/vpcd --scene ipc/scene/scenes/paper-sim.toml --clock lockstep --strategy gpr --memory memory-blob/default/paper-sim.vpcmem &",
        Stays(&[]),
    ),
    (
        "hw-sim/README.md",
        "target/release/hw-sim --config hw-sim/hw-sim.toml --clock lockstep --start 0",
        Runs(OK, &[]),
    ),
    (
        "hw-sim/README.md",
        "kill %1",
        Checked("the test stops what it started"),
    ),
    (
        "hw-sim/README.md",
        "cargo demo -- --scene paper-robot",
        Checked("minutes of a robot in real time"),
    ),
    (
        "hw-sim/README.md",
        "cargo table -- --robot panda --scene ipc/scene/scenes/paper-robot.toml --starts ipc/scene/scenes/paper-robot-starts.csv --memory memory-blob/default/paper-robot.vpcmem --strategies previous:3,gpr:3 --delay-ms 110 --noise 0.3 --drop 0.01",
        // One start of one strategy instead of 200 runs.
        Runs(OK, &[Put("previous:3,gpr:3", "gpr:3"), Add("--only 0")]),
    ),
    (
        "hw-sim/README.md",
        "cargo run --release -p system-tests --bin processes -- --jobs 6",
        Checked("an hour of two processes in real time from every start"),
    ),
    (
        "hw-sim/vision/README.md",
        "cargo run --release -p vision --example show -- /tmp/frame.png 17",
        Checked("an example, which cargo test builds"),
    ),
    (
        "hw-sim/vision/README.md",
        "cargo test -p vision",
        Checked(CARGO_TEST),
    ),
    (
        "hw-sim/vision/README.md",
        "cargo bench -p vision",
        Checked(BENCH),
    ),
    (
        "ipc/c/README.md",
        "cargo build --release -p vpc-client-c",
        Checked(BUILD_ONCE),
    ),
    (
        "ipc/c/README.md",
        "cc -std=c11 -I ipc/c/include ipc/c/examples/camera.c -o camera -L target/release -lvpcclient -lm -Wl,-rpath,$PWD/target/release",
        Checked(
            "needs a C compiler; `cargo test -p vpc-client-c` compiles and runs it where there is one",
        ),
    ),
    (
        "ipc/c/README.md",
        "vpcd --scene ipc/scene/scenes/paper-sim.toml --clock lockstep &",
        Checked("runs with the line that follows it"),
    ),
    (
        "ipc/c/README.md",
        "./camera",
        Checked("`cargo test -p vpc-client-c` runs it"),
    ),
    (
        "ipc/python/README.md",
        "pip install ./ipc/python",
        Checked(PYTHON),
    ),
    (
        "ipc/python/README.md",
        "pip install -r ipc/python/requirements.txt",
        Checked(PYTHON),
    ),
    (
        "ipc/python/README.md",
        "vpcd --scene ipc/scene/scenes/paper-sim.toml --clock lockstep &",
        Checked(PYTHON),
    ),
    (
        "ipc/python/README.md",
        "python3 ipc/python/camera.py --scene ipc/scene/scenes/paper-sim.toml",
        Checked(PYTHON),
    ),
    (
        "ipc/python/README.md",
        "vpcd --scene ipc/scene/scenes/paper-sim.toml --clock lockstep --strategy gpr --memory memory-blob/default/paper-sim.vpcmem &",
        Checked(PYTHON),
    ),
    (
        "ipc/python/README.md",
        "python3 ipc/python/camera.py --scene ipc/scene/scenes/paper-sim.toml --starts ipc/scene/scenes/paper-sim-starts.csv --all",
        Checked(PYTHON),
    ),
    (
        "ipc/python/README.md",
        "cargo table -- --scene ipc/scene/scenes/paper-sim.toml --starts ipc/scene/scenes/paper-sim-starts.csv --memory memory-blob/default/paper-sim.vpcmem --strategies gpr:3,previous:3,ibvs",
        Checked("the README's table above is run"),
    ),
    (
        "ipc/recording/README.md",
        "vpcctl record run.mcap --config controller/vpcd.toml",
        Runs(OK, &[Add("--duration 1")]),
    ),
    (
        "ipc/recording/README.md",
        "vpcctl plot run.mcap",
        Runs(OK, &[]),
    ),
    (
        "ipc/recording/README.md",
        "vpcctl plot run.mcap -o out/plots",
        Runs(OK, &[]),
    ),
    (
        "ipc/recording/README.md",
        "vpcctl replay run.mcap --memory FILE.vpcmem",
        // Recorded in mid-run: it does not know what came before, and says so.
        Runs(
            &[0, 1],
            &[Put("FILE.vpcmem", "memory-blob/default/paper-sim.vpcmem")],
        ),
    ),
    (
        "ipc/scene/README.md",
        "cargo test -p scene",
        Checked(CARGO_TEST),
    ),
    // In front of the occlusion the camera stands; it may still be on its way.
    (
        "ipc/vpcctl/README.md",
        "cargo run --release -p vpcctl -- status",
        Runs(&[0, 1], &[]),
    ),
    (
        "ipc/vpcctl/README.md",
        "cargo run --release -p vpcctl -- watch --scene SCENE.toml",
        Runs(
            &[64],
            &[Put("SCENE.toml", "ipc/scene/scenes/paper-sim.toml")],
        ),
    ),
    (
        "ipc/vpcctl/README.md",
        "cargo run --release -p vpcctl -- serve --scene SCENE.toml",
        Stays(&[
            Put("SCENE.toml", "ipc/scene/scenes/paper-sim.toml"),
            Add("--listen 127.0.0.1:0"),
        ]),
    ),
    (
        "ipc/vpcctl/README.md",
        "cargo run --release -p vpcctl -- arm",
        Runs(OK, &[]),
    ),
    // What it finds is the machine's.
    (
        "ipc/vpcctl/README.md",
        "cargo run --release -p vpcctl -- doctor",
        Runs(&[0, 1], &[]),
    ),
    (
        "ipc/vpcctl/README.md",
        "cargo run --release -p vpcctl -- metrics",
        Runs(OK, &[Add("--once")]),
    ),
    (
        "ipc/vpcctl/README.md",
        "cargo run --release -p vpcctl -- completions bash",
        Runs(OK, &[]),
    ),
    (
        "ipc/vpcctl/README.md",
        "cargo run --release -p vpcctl -- record run.mcap --config controller/vpcd.toml",
        Runs(OK, &[Add("--duration 1")]),
    ),
    (
        "ipc/vpcctl/README.md",
        "cargo run --release -p vpcctl -- plot run.mcap -o out/plots",
        Runs(OK, &[]),
    ),
    (
        "memory-blob/GUIDE.md",
        "git clone URL vpcd && cd vpcd",
        Checked("the reader's copy is this one"),
    ),
    (
        "memory-blob/GUIDE.md",
        "alias vpc-memory='cargo run --release -p memory-builder --bin vpc-memory --'",
        Checked("the test does as it says"),
    ),
    ("memory-blob/GUIDE.md", "mkdir -p own", Runs(OK, &[])),
    (
        "memory-blob/GUIDE.md",
        "vpc-memory new own/scene.toml --image 640x480 --focal 610 --pattern 0.12 --goal 0.4 --limits 0.3,0.8",
        // Something to go round.
        Runs(OK, &[Add("--ellipse 480,330,40,30 --box 150,90,60,20")]),
    ),
    (
        "memory-blob/GUIDE.md",
        "vpc-memory mask own/scene.toml -o own/areas.png --scene-out own/painted.toml",
        Runs(OK, &[]),
    ),
    (
        "memory-blob/GUIDE.md",
        "vpc-memory preview own/painted.toml -o own/preview.png",
        Runs(OK, &[]),
    ),
    (
        "memory-blob/GUIDE.md",
        "vpc-memory build own/painted.toml -o own/task.vpcmem --trajectories 300",
        Runs(
            OK,
            &[Put("300", "12"), Add("--gpr-samples 60 --iterations 30")],
        ),
    ),
    (
        "memory-blob/GUIDE.md",
        "vpc-memory verify own/task.vpcmem --scene own/painted.toml",
        Runs(OK, &[]),
    ),
    (
        "memory-blob/GUIDE.md",
        "vpc-memory starts own/painted.toml -o own/starts.csv --count 50",
        Runs(OK, &[Put("50", "5")]),
    ),
    (
        "memory-blob/GUIDE.md",
        "cargo table -- --scene own/painted.toml --starts own/starts.csv --memory own/task.vpcmem --strategies previous:3,gpr:3 --plots own/plots",
        Runs(OK, &[Add("--repeats 1")]),
    ),
    (
        "memory-blob/GUIDE.md",
        "cargo run --release -p controller --bin vpcd -- --config own/vpcd.toml --arm",
        Stays(&[]),
    ),
    (
        "memory-blob/GUIDE.md",
        "cargo run --release -p hw-sim --bin hw-sim -- --scene own/painted.toml --starts own/starts.csv",
        Stays(&[]),
    ),
    (
        "memory-blob/README.md",
        "python3 -m venv venv && venv/bin/pip install -r memory-blob/python/requirements.txt",
        Checked(PYTHON),
    ),
    (
        "memory-blob/README.md",
        "venv/bin/python memory-blob/python/fit_gpr.py memory-blob/default/paper-sim.vpcmem refit.vpcmem",
        Checked(PYTHON),
    ),
    (
        "memory-blob/README.md",
        "cargo run -p memory-blob --example check -- refit.vpcmem",
        Runs(
            OK,
            &[Put("refit.vpcmem", "memory-blob/default/paper-sim.vpcmem")],
        ),
    ),
    (
        "memory-blob/builder/README.md",
        "cargo run --release -p memory-builder --bin vpc-memory -- build ipc/scene/scenes/paper-sim.toml -o paper.vpcmem",
        Runs(OK, &[Add(SMALL)]),
    ),
    (
        "ipc/figures/README.md",
        "cargo table -- --scene ipc/scene/scenes/paper-sim.toml --starts ipc/scene/scenes/paper-sim-starts.csv --plots out/plots",
        Checked("minutes; the guide's table draws the same figures, and is run"),
    ),
];

/// A memory in seconds.
const SMALL: &str = "--trajectories 6 --iterations 20 --gpr-samples 40";
