//! Whether logind would remove our shared memory at the end of a session.

use std::path::Path;

use super::Finding;

/// The first number of an ordinary user, as systemd draws the line.
const ORDINARY: u32 = 1000;

pub(super) fn examine() -> Option<Finding> {
    let us = rustix::process::geteuid().as_raw();
    let has_systemd = Path::new("/run/systemd/system").is_dir();
    has_systemd.then(|| logind(us, Path::new("/")))
}

fn logind(us: u32, root: &Path) -> Finding {
    let what = "logind";
    if us < ORDINARY {
        return Finding::ok(what, "system user: its shared memory outlives sessions");
    }
    if !removes(root) {
        return Finding::ok(what, "RemoveIPC=no: shared memory outlives sessions");
    }
    let name = user(us, &root.join("etc/passwd")).unwrap_or_else(|| us.to_string());
    if root.join("var/lib/systemd/linger").join(&name).exists() {
        let words = format!("{name} lingers: shared memory outlives sessions");
        return Finding::ok(what, words);
    }
    let words = format!("shared memory of {name} is removed at the end of the last session");
    let remedy =
        format!("loginctl enable-linger {name}, or RemoveIPC=no in /etc/systemd/logind.conf");
    Finding::warn(what, words, remedy)
}

/// RemoveIPC of logind's configuration, yes by default. The last line wins, drop-ins after the
/// file.
fn removes(root: &Path) -> bool {
    let mut files = vec![root.join("etc/systemd/logind.conf")];
    for place in ["usr/lib", "run", "etc"] {
        let place = root.join(place).join("systemd/logind.conf.d");
        let entries = std::fs::read_dir(place).into_iter().flatten().flatten();
        let mut parts: Vec<_> = entries.map(|entry| entry.path()).collect();
        parts.sort();
        files.extend(parts);
    }
    let texts = files
        .iter()
        .filter_map(|file| std::fs::read_to_string(file).ok());
    let text = texts.collect::<Vec<_>>().join("\n");
    let mut words = text
        .lines()
        .filter_map(|line| line.trim().strip_prefix("RemoveIPC="));
    let last = words.next_back().map(str::trim);
    !matches!(last, Some("no" | "false" | "off" | "0"))
}

fn user(number: u32, passwd: &Path) -> Option<String> {
    let (text, number) = (std::fs::read_to_string(passwd).ok()?, number.to_string());
    let mut lines = text.lines().map(|line| line.split(':').collect::<Vec<_>>());
    let line = lines.find(|words| words.get(2) == Some(&number.as_str()))?;
    Some(line[0].to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::Tone;

    #[test]
    fn an_ordinary_user_must_linger() {
        let root = tempfile::tempdir().unwrap();
        let write = |path: &str, text: &str| {
            let path = root.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        write(
            "etc/passwd",
            "root:x:0:0::/:/bin/sh\nann:x:1000:1000::/home/ann:/bin/sh\n",
        );
        write("etc/systemd/logind.conf", "[Login]\n#RemoveIPC=no\n");
        let judged = |us| logind(us, root.path()).verdict;
        assert_eq!(judged(998), Tone::Good);
        assert_eq!(judged(1000), Tone::Warning);
        assert!(
            logind(1000, root.path())
                .remedy
                .starts_with("loginctl enable-linger ann,")
        );
        write("var/lib/systemd/linger/ann", "");
        assert_eq!(judged(1000), Tone::Good);
        assert_eq!(judged(1001), Tone::Warning);
        write(
            "etc/systemd/logind.conf.d/50-ipc.conf",
            "[Login]\nRemoveIPC=no\n",
        );
        assert_eq!(judged(1001), Tone::Good);
    }
}
