//! `controller/systemd/NAME@.service`: the unit NAME for one of several arms, each with a domain, a
//! configuration and logs of its own.

use anyhow::{Context, ensure};

/// What an instance has of its own: in the unit, and in the template.
const OWN: [(&str, &str); 5] = [
    (
        " --config /etc/vpcd/",
        " --domain /run/vpcd-%i --config /etc/vpcd/%i/",
    ),
    ("\nRuntimeDirectory=vpcd\n", "\nRuntimeDirectory=vpcd-%i\n"),
    ("\nLogsDirectory=vpcd\n", "\nLogsDirectory=vpcd/%i\n"),
    ("\nWants=vpcd.service\n", "\nWants=vpcd@%i.service\n"),
    ("\nAfter=vpcd.service", "\nAfter=vpcd@%i.service"),
];

/// The template that is made of a unit.
///
/// # Errors
/// The unit cannot be read, or has no command with a configuration.
pub fn template(name: &str) -> anyhow::Result<String> {
    let path = crate::root().join(format!("controller/systemd/{name}.service"));
    let unit = std::fs::read_to_string(&path).with_context(|| format!("{}", path.display()))?;
    ensure!(unit.contains(OWN[0].0), "{name}.service: no `{}`", OWN[0].0);
    let text = OWN
        .iter()
        .fold(unit, |text, (plain, own)| text.replace(plain, own));
    let (head, described) = text.split_once("Description=").context("no Description=")?;
    let (description, rest) = described.split_once('\n').context("no end of line")?;
    let note = format!(
        "# Made from {name}.service by `cargo xtask codegen`: for the arm %i of several, systemctl start {name}@NAME."
    );
    Ok(format!(
        "{note}\n{head}Description={description}, arm %i\n{rest}"
    ))
}
