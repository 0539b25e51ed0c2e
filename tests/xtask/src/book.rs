//! The book: the Markdown of the tree as one site, which mdBook makes and which works from a file.

mod api;
mod links;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};

use crate::release::{said, tool};
use crate::root;

/// What to install where no mdBook is.
const MDBOOK: &str =
    "cargo install mdbook --version '^0.5' --locked --no-default-features --features search";

/// The parts in reading order; of each page its title and its file.
const PARTS: &[(&str, &[(&str, &str)])] = &[
    (
        "Start",
        &[
            ("vpcd, a first run", "README.md"),
            ("Your own task", "memory-blob/GUIDE.md"),
        ],
    ),
    (
        "For researchers",
        &[
            ("The method", "controller/vpc/METHOD.md"),
            ("The law, measured", "controller/vpc/README.md"),
            ("The module for Python", "controller/python/README.md"),
            ("The benchmark, and your method", "tests/peers/README.md"),
            ("The robot experiment", "tests/LABORATORY.md"),
            ("Figures", "controller/figures/README.md"),
        ],
    ),
    (
        "With a Franka Panda",
        &[
            ("Panda and FR3", "ipc/clients/panda/README.md"),
            ("Camera and tags", "ipc/clients/camera/README.md"),
            ("Learning the mask", "ipc/clients/camera/MASK.md"),
            ("Calibration", "ipc/clients/calib/README.md"),
        ],
    ),
    ("With ROS 2", &[("ROS 2", "ipc/clients/ros2/README.md")]),
    (
        "With a robot of your own",
        &[
            ("Emulator and own robot", "hw-sim/README.md"),
            ("The client in C", "ipc/clients/c/README.md"),
        ],
    ),
    (
        "With a policy",
        &[
            ("vpcd as a guardian", "controller/README.md"),
            ("The client in Python", "ipc/clients/python/README.md"),
        ],
    ),
    (
        "At work",
        &[
            ("vpcctl", "controller/vpcctl/README.md"),
            ("Services", "controller/systemd/README.md"),
            ("Recordings", "ipc/recording/README.md"),
            ("The flight record", "controller/FLIGHT.md"),
        ],
    ),
    (
        "Safety and judges",
        &[
            ("Safety, and what it is not", "controller/SAFETY.md"),
            ("What it cannot do", "controller/LIMITS.md"),
            ("Promises", "tests/PROMISES.md"),
            ("Judges", "tests/JUDGES.md"),
        ],
    ),
    (
        "Reference",
        &[
            ("Configuration", "controller/CONFIGURATION.md"),
            (
                "Configuration of the clients",
                "ipc/clients/CONFIGURATION.md",
            ),
            ("The contract", "ipc/CONTRACT.md"),
            ("Scene files", "ipc/scene/README.md"),
            ("The memory of motion", "memory-blob/README.md"),
            ("The memory file", "memory-blob/FORMAT.md"),
            ("vpc-memory", "memory-blob/builder/README.md"),
            ("Changes", "CHANGELOG.md"),
        ],
    ),
    (
        "For developers",
        &[
            ("Contributing", "CONTRIBUTING.md"),
            ("Architecture", "ARCHITECTURE.md"),
            ("The transport", "ipc/README.md"),
            ("Arms", "ipc/arm/README.md"),
            ("Masks", "ipc/mask/README.md"),
            ("Configuration files", "ipc/toml-schema/README.md"),
            ("The allocation meter", "ipc/heap-meter/README.md"),
            ("The emulated arm", "hw-sim/panda/README.md"),
            ("The vendor's interface", "hw-sim/fci/README.md"),
            ("Rendered images", "hw-sim/vision/README.md"),
            ("Tests", "tests/README.md"),
        ],
    ),
];

/// Makes the book in a directory that is empty, not there, or has a book; with the documentation of
/// the libraries if it `has_api`.
///
/// # Errors
/// Without mdBook, if [`PARTS`] is not complete, if a library cannot be documented, or if a link is
/// broken.
pub fn book(to: &Path, has_api: bool) -> anyhow::Result<()> {
    let found = said(tool("mdbook").arg("--version")).unwrap_or_default();
    ensure!(
        found.starts_with("mdbook v0.5."),
        "mdbook in PATH: {found:?}; needed: 0.5, by {MDBOOK}"
    );
    let tracked = tracked()?;
    check_pages(&tracked)?;

    std::fs::create_dir_all(to).with_context(|| to.display().to_string())?;
    let to = &to.canonicalize()?;
    // mdBook empties it.
    let may_go = std::fs::read_dir(to)?.next().is_none() || to.join("toc.html").exists();
    ensure!(may_go, "{}: neither empty nor a book", to.display());

    let place = tempfile::tempdir()?;
    let source = place.path().join("src");
    for page in pages() {
        copy(page, &source.join(page))?;
    }
    let mut summary = summary();
    let api = has_api.then(api::Api::make).transpose()?;
    if let Some(api) = &api {
        std::fs::write(source.join(api::PAGE), api.page()?)?;
        summary += &format!("# Libraries\n\n- [The libraries in Rust]({})\n", api::PAGE);
    }
    std::fs::write(source.join("SUMMARY.md"), summary)?;
    for (name, text) in [
        ("book.toml", include_str!("book/book.toml")),
        ("book.css", include_str!("book/book.css")),
    ] {
        std::fs::write(place.path().join(name), text)?;
    }
    let mut mdbook = tool("mdbook");
    said(mdbook.arg("build").arg(place.path()).arg("-d").arg(to))?;

    let made = ["index.html", "toc.html"].map(PathBuf::from);
    let listed = pages().chain(api.is_some().then_some(Path::new(api::PAGE)));
    let pages = listed.map(|page| page.with_extension("html"));
    let pages: Vec<_> = pages.chain(made).collect();
    if let Some(api) = &api {
        api.copy(&to.join(api::FOLDER))?;
    }
    let links = links::follow(to, &pages, &tracked)?;
    let start = to.join("index.html");
    println!("{}: {links} links", start.display());
    Ok(())
}

fn pages() -> impl Iterator<Item = &'static Path> {
    let pages = PARTS.iter().flat_map(|(_, pages)| *pages);
    pages.map(|(_, file)| Path::new(file))
}

/// The files that git tracks, from the root.
fn tracked() -> anyhow::Result<BTreeSet<PathBuf>> {
    let files = said(tool("git").arg("ls-files"))?;
    Ok(files.lines().map(PathBuf::from).collect())
}

/// Every tracked Markdown file is a page once.
fn check_pages(tracked: &BTreeSet<PathBuf>) -> anyhow::Result<()> {
    let documents = tracked.iter().map(PathBuf::as_path);
    let is_markdown = |file: &&Path| file.extension().is_some_and(|end| end == "md");
    let mut left: BTreeSet<&Path> = documents.filter(is_markdown).collect();
    let wrong: Vec<_> = pages().filter(|page| !left.remove(page)).collect();
    ensure!(
        left.is_empty() && wrong.is_empty(),
        "PARTS in tests/xtask/src/book.rs lacks {left:?}, and has {wrong:?} twice or untracked; \
        allowed: every tracked Markdown file, once"
    );
    Ok(())
}

/// Copies a file of the tree, and makes the directory for it.
fn copy(file: &Path, to: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(to.parent().unwrap_or(to))?;
    std::fs::copy(root().join(file), to).with_context(|| file.display().to_string())?;
    Ok(())
}

/// [`PARTS`] as mdBook reads it.
fn summary() -> String {
    let mut text = "# Summary\n\n".to_owned();
    for (part, pages) in PARTS {
        text += &format!("# {part}\n\n");
        for (title, file) in *pages {
            text += &format!("- [{title}]({file})\n");
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_document_is_a_page_once() {
        match tracked() {
            Ok(tracked) => check_pages(&tracked).unwrap(),
            Err(error) => testkit::not_run("the pages of the book", error),
        }
    }

    #[test]
    fn a_page_that_is_missing_or_not_tracked_is_named() {
        let mut tracked: BTreeSet<_> = pages().map(Path::to_owned).collect();
        tracked.insert("ipc/NEW.md".into());
        tracked.remove(Path::new("README.md"));
        let error = check_pages(&tracked).unwrap_err().to_string();
        assert!(error.contains(r#"lacks {"ipc/NEW.md"}"#), "{error}");
        assert!(error.contains(r#"has ["README.md"]"#), "{error}");
    }
}
