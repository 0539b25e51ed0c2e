//! `controller/systemd/NAME@.service`: the unit NAME for one of several arms, each with a domain, a
//! configuration and logs of its own.

use anyhow::{Context, ensure};

/// Directives whose value is the same for all arms.
const SHARED: [&str; 5] = [
    "Description",
    "Documentation",
    "User",
    "Group",
    "StateDirectory",
];

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
/// The unit cannot be read, or its template would share something with other arms.
pub fn template(name: &str) -> anyhow::Result<String> {
    let path = crate::root().join(format!("controller/systemd/{name}.service"));
    let unit = std::fs::read_to_string(&path).with_context(|| format!("{}", path.display()))?;
    let text = OWN
        .iter()
        .fold(unit, |text, (plain, own)| text.replace(plain, own));
    is_of_one_arm(&text).with_context(|| format!("{name}.service as a template"))?;
    let (head, described) = text.split_once("Description=").context("no Description=")?;
    let (description, rest) = described.split_once('\n').context("no end of line")?;
    let note = format!(
        "# Made from {name}.service by `cargo xtask codegen`: for the arm %i of several, systemctl start {name}@NAME."
    );
    Ok(format!(
        "{note}\n{head}Description={description}, arm %i\n{rest}"
    ))
}

/// Checks that all that a template names of an arm, it names by the instance.
fn is_of_one_arm(template: &str) -> anyhow::Result<()> {
    for own in [OWN[0].1, OWN[1].1] {
        ensure!(template.contains(own), "no `{}`", own.trim());
    }
    let directives = template.lines().filter(|line| !line.starts_with('#'));
    for (key, value) in directives.filter_map(|line| line.split_once('=')) {
        let words = value.split_whitespace();
        let words = words.filter(|word| !SHARED.contains(&key) && *word != "/usr/bin/vpcd");
        for (_, rest) in words.filter_map(|word| word.split_once("vpcd")) {
            let is_own = ["-%i", "@%i.", "/%i"]
                .iter()
                .any(|own| rest.starts_with(own));
            ensure!(is_own, "`{key}={value}` is not of the arm %i");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::is_of_one_arm;

    #[test]
    fn a_template_that_shares_something_with_other_arms_is_refused() {
        let template = super::template("hw-sim").unwrap();
        for (own, shared) in [
            ("RuntimeDirectory=vpcd-%i", "RuntimeDirectory=vpcd"),
            ("RuntimeDirectory=vpcd-%i", "RuntimeDirectory=other vpcd"),
            ("RuntimeDirectory=vpcd-%i\n", ""),
            ("Wants=vpcd@%i.service", "Wants=vpcd.service"),
            ("After=vpcd@%i.service", "After=network.target vpcd.service"),
            (" --domain /run/vpcd-%i", ""),
            ("/etc/vpcd/%i/", "/etc/vpcd/"),
            ("[Service]", "[Service]\nLogsDirectory=vpcd"),
            ("[Service]", "[Service]\nReadWritePaths=/run/vpcd"),
        ] {
            let wrong = template.replace(own, shared);
            assert!(
                wrong != template && is_of_one_arm(&wrong).is_err(),
                "{shared}"
            );
        }
    }
}
