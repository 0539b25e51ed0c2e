//! `controller/CONFIGURATION.md`, the reference of every configuration file.

use serde_json::Value;

const HEAD: &str = "# Configuration

Every key of the four kinds of configuration files, generated from the code by `cargo xtask codegen`. Ranges include their ends. A file
with an unknown key is refused; an error names file or flag, key, value and what is allowed. `vpcd --print-config` prints what
`vpcd` would run with.

Each kind has a JSON Schema. A file names it in its first line, for instance `#:schema ./vpcd.schema.json`; editors with a TOML
language server (taplo, Even Better TOML, tombi) complete and check keys from it.
";

/// Returns the page.
pub fn make() -> String {
    let section = |title: &str, command: &str, schema: &Value| {
        format!(
            "\n## {title}\n\n{command}\n{}",
            toml_schema::reference(schema)
        )
    };
    [
        HEAD.to_owned(),
        section(
            "vpcd",
            "`vpcd --config FILE`; [`vpcd.toml`](vpcd.toml) shows the defaults.",
            &controller::config::schema(),
        ),
        section(
            "The scene",
            "A scene file, for instance [`paper-sim.toml`](../ipc/scene/scenes/paper-sim.toml).",
            &scene::schema(),
        ),
        section(
            "hw-sim",
            "`hw-sim --config FILE`; [`hw-sim.toml`](../hw-sim/hw-sim.toml) shows the defaults.",
            &hw_sim::config::schema(),
        ),
        section(
            "vpc-memory build",
            "`vpc-memory build SCENE --output FILE --settings FILE`",
            &memory_builder::settings::schema(),
        ),
    ]
    .concat()
}
