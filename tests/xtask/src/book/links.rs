//! The links of a site of HTML pages.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};

/// Checks the links of these pages, which lie below `site`; how many there are. What git tracks is
/// copied where a page links to it: pictures as they are, other files and those of directories as
/// `NAME.txt`, which every browser shows. Links with a scheme (`https:`) are not followed.
///
/// # Errors
/// Each broken link, with its page and with what is allowed.
pub fn follow(
    site: &Path,
    pages: &[PathBuf],
    tracked: &BTreeSet<PathBuf>,
) -> anyhow::Result<usize> {
    let mut texts = BTreeMap::new();
    for page in pages {
        let text = std::fs::read_to_string(site.join(page));
        texts.insert(page, text.with_context(|| page.display().to_string())?);
    }
    let anchors = texts.iter().map(|(page, text)| (*page, anchors(text)));
    let anchors: BTreeMap<_, _> = anchors.collect();
    let mut copied = BTreeSet::new();
    let mut faults = Vec::new();
    let mut count = 0;
    for (page, text) in &texts {
        let mut changed = text.clone();
        let links = attributes(text, "href").map(|link| (link, ".txt"));
        let links = links.chain(attributes(text, "src").map(|link| (link, "")));
        for (link, end) in links.filter(|(link, _)| !link.contains(':')) {
            count += 1;
            let mut fault = |what: &str| {
                faults.push(format!("{}: {link}: {what}", page.display()));
            };
            let (path, anchor) = link.split_once('#').unwrap_or((link, ""));
            let Some(target) = target(page, path) else {
                fault("outside of the book; allowed: a path from the page");
                continue;
            };
            if let Some(anchors) = anchors.get(&target) {
                if !anchor.is_empty() && !anchors.contains(anchor) {
                    fault(&format!("no such heading; allowed: {anchors:?}"));
                }
                continue;
            }
            if !anchor.is_empty() {
                fault("no page; allowed with #: a page of the book");
            }
            if tracked.contains(&target) {
                let whole = |end| format!("href=\"{link}{end}\"");
                changed = changed.replace(&whole(""), &whole(end));
            }
            let below = tracked.iter().filter(|file| file.starts_with(&target));
            let below: Vec<_> = below.collect();
            if below.is_empty() && !site.join(&target).is_file() {
                fault("no such file; allowed: a page of the book or what git tracks");
            }
            for file in below {
                let to = site.join(format!("{}{end}", file.display()));
                if copied.insert(to.clone()) {
                    super::copy(file, &to)?;
                }
            }
        }
        if changed != *text {
            std::fs::write(site.join(page), changed)?;
        }
    }
    ensure!(
        faults.is_empty(),
        "{} broken links:\n{}",
        faults.len(),
        faults.join("\n")
    );
    Ok(count)
}

/// The headings of a page: its `id`s without those of mdBook's own.
fn anchors(html: &str) -> BTreeSet<&str> {
    let is_own = |id: &&str| id.starts_with("mdbook-") || id.starts_with("fa-");
    attributes(html, "id").filter(|id| !is_own(id)).collect()
}

/// The values of an attribute in the tags of a page.
fn attributes<'a>(html: &'a str, name: &str) -> impl Iterator<Item = &'a str> {
    let begin = format!(" {name}=\"");
    let tags = html.split('<').filter_map(|tag| tag.split('>').next());
    tags.filter_map(move |tag| tag.split_once(&begin)?.1.split('"').next())
}

/// Where a path on a page leads, from the root of the site; `None` outside of it.
fn target(page: &Path, path: &str) -> Option<PathBuf> {
    if path.is_empty() {
        return Some(page.to_owned());
    }
    let mut target = page.parent()?.to_owned();
    for part in path.strip_suffix('/').unwrap_or(path).split('/') {
        match part {
            "" => return None,
            "." => (),
            ".." => target.pop().then_some(())?,
            part => target.push(part),
        }
    }
    Some(target)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A site of two pages, one of which has these links.
    fn checked(links: &[&str]) -> (tempfile::TempDir, anyhow::Result<usize>) {
        let site = tempfile::tempdir().unwrap();
        std::fs::create_dir(site.path().join("ipc")).unwrap();
        let links = links
            .iter()
            .map(|link| format!("<a class=\"x\" href=\"{link}\">"));
        let pages = ["README.html", "ipc/README.html"];
        let texts = ["<h2 id=\"run-it\">".to_owned(), links.collect()];
        for (page, text) in pages.iter().zip(texts) {
            std::fs::write(site.path().join(page), text).unwrap();
        }
        let tracked = ["Cargo.toml", "ipc/Cargo.toml", "ipc/src/lib.rs"].map(PathBuf::from);
        let result = follow(site.path(), &pages.map(PathBuf::from), &tracked.into());
        (site, result)
    }

    #[test]
    fn tracked_files_and_directories_are_copied() {
        let links = [
            "../README.html#run-it",
            "../Cargo.toml",
            "src/",
            "https://x.y/z",
        ];
        let (site, count) = checked(&links);
        assert_eq!(count.unwrap(), 3);
        for (file, is_there) in [
            ("Cargo.toml.txt", true),
            ("ipc/src/lib.rs.txt", true),
            ("ipc/Cargo.toml.txt", false),
        ] {
            assert_eq!(site.path().join(file).exists(), is_there, "{file}");
        }
        let page = std::fs::read_to_string(site.path().join("ipc/README.html")).unwrap();
        assert!(page.contains(r#"href="../Cargo.toml.txt""#), "{page}");
        assert!(page.contains(r#"href="src/""#), "{page}");
    }

    #[test]
    fn a_broken_link_is_named_with_its_page_and_with_what_is_allowed() {
        for (link, what) in [
            (
                "../README.html#run",
                r#"no such heading; allowed: {"run-it"}"#,
            ),
            ("lib.rs", "no such file"),
            ("src/lib.rs#L1", "no page"),
            ("../../x.html", "outside of the book"),
            ("/README.html", "outside of the book"),
        ] {
            let error = checked(&[link]).1.unwrap_err().to_string();
            let place = format!("ipc/README.html: {link}: {what}");
            assert!(error.contains(&place), "{error}");
        }
    }
}
