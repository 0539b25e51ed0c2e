//! `controller/CONFIGURATION.md`, the reference of every configuration file.

use anyhow::Context;
use memory_builder::settings::BuildSettings;

use crate::root;

const HEAD: &str = "# Configuration

Every key of the eight kinds of configuration files, generated from the code by `cargo xtask codegen`. Ranges include their ends. A file
with an unknown key is refused; an error names file or flag, key, value and what is allowed. `vpcd --print-config` prints what
`vpcd` would run with.

Each kind has a JSON Schema. A file names it in its first line, for instance `#:schema ./vpcd.schema.json`; editors with a TOML
language server (taplo, Even Better TOML, tombi) complete and check keys from it.
";

/// Returns the page: each kind of file with what it is for, its schema, and a file that has its
/// keys in the order in which they are read best.
pub fn make() -> anyhow::Result<String> {
    let shipped = |path: &str| {
        std::fs::read_to_string(root().join(path)).with_context(|| format!("{path}: cannot read"))
    };
    let sections = [
        (
            "vpcd",
            "`vpcd --config FILE`; [`vpcd.toml`](vpcd.toml) shows the defaults.",
            controller::config::schema(),
            shipped("controller/vpcd.toml")?,
        ),
        (
            "The scene",
            "A scene file, for instance [`paper-sim.toml`](../ipc/scene/scenes/paper-sim.toml).",
            scene::schema(),
            shipped("ipc/scene/scenes/paper-sim.toml")?,
        ),
        (
            "hw-sim",
            "`hw-sim --config FILE`; [`hw-sim.toml`](../hw-sim/hw-sim.toml) shows the defaults.",
            hw_sim::config::schema(),
            shipped("hw-sim/hw-sim.toml")?,
        ),
        (
            "vpc-camera",
            "`vpc-camera --config FILE`; [`vpc-camera.toml`](../ipc/clients/camera/vpc-camera.toml) shows the defaults.",
            vpc_camera::config::schema(),
            shipped("ipc/clients/camera/vpc-camera.toml")?,
        ),
        (
            "The board of vpc-calib",
            "`vpc-calib board --board FILE`; [`board.toml`](../ipc/clients/calib/board/board.toml) shows the defaults.",
            tag_board::schema(),
            shipped("ipc/clients/calib/board/board.toml")?,
        ),
        (
            "vpc-panda",
            "`vpc-panda --config FILE`; [`vpc-panda.toml`](../ipc/clients/panda/vpc-panda.toml) shows the defaults.",
            vpc_panda::config::schema(),
            shipped("ipc/clients/panda/vpc-panda.toml")?,
        ),
        (
            "vpc-ros2",
            "`vpc-ros2 --config FILE`; [`vpc-ros2.toml`](../ipc/clients/ros2/vpc-ros2.toml) shows the defaults.",
            vpc_ros2::config::schema(),
            shipped("ipc/clients/ros2/vpc-ros2.toml")?,
        ),
        (
            "vpc-memory build",
            "`vpc-memory build SCENE --output FILE --settings FILE`",
            memory_builder::settings::schema(),
            toml::to_string(&BuildSettings::default())?,
        ),
    ];
    let mut page = HEAD.to_owned();
    for (title, command, schema, example) in &sections {
        let keys = toml_schema::reference(schema, example);
        page += &format!("\n## {title}\n\n{command}\n{keys}");
    }
    Ok(page)
}
