//! The documentation of the libraries, which `cargo doc` makes.

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde_json::Value;

use crate::release::{said, tool};

/// The page that lists the libraries, and the folder of their documentation.
pub const PAGE: &str = "api.md";
pub const FOLDER: &str = "api";

/// The packages that a program of one's own may use.
const LIBRARIES: [&str; 6] = ["vpc", "memory-blob", "scene", "messages", "ipc", "arm"];

/// What cargo made.
pub struct Api {
    metadata: Value,
    /// Where it lies.
    made: PathBuf,
}

impl Api {
    /// Makes the documentation of [`LIBRARIES`], in a folder of its own.
    ///
    /// # Errors
    /// What cargo says.
    pub fn make() -> anyhow::Result<Self> {
        let cargo = || tool(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        let metadata = said(cargo().args(["metadata", "--no-deps", "--format-version", "1"]))?;
        let metadata: Value = serde_json::from_str(&metadata)?;
        let target = metadata["target_directory"].as_str();
        let target = Path::new(target.context("cargo names no target directory")?).join("book");
        let made = target.join("doc");
        if made.exists() {
            std::fs::remove_dir_all(&made)?;
        }
        let mut doc = cargo();
        doc.args(["doc", "--locked", "--no-deps", "--lib", "--target-dir"]);
        doc.arg(&target);
        for name in LIBRARIES {
            doc.args(["--package", name]);
        }
        said(&mut doc)?;
        Ok(Self { metadata, made })
    }

    /// A page with a link to each library.
    ///
    /// # Errors
    /// Where cargo does not know one.
    pub fn page(&self) -> anyhow::Result<String> {
        let mut text = "# The libraries in Rust\n\n".to_owned();
        for name in LIBRARIES {
            let packages = self.metadata["packages"].as_array().into_iter().flatten();
            let package = packages.into_iter().find(|package| package["name"] == name);
            let package = package.with_context(|| format!("{name}: no package"))?;
            let description = package["description"].as_str().unwrap_or_default();
            let crate_name = name.replace('-', "_");
            text += &format!("- [`{name}`]({FOLDER}/{crate_name}/index.html): {description}\n");
        }
        Ok(text)
    }

    /// Copies the documentation.
    ///
    /// # Errors
    /// Where a file cannot be read or written.
    pub fn copy(&self, to: &Path) -> anyhow::Result<()> {
        copy(&self.made, to)
    }
}

/// Copies a directory with all in it.
fn copy(from: &Path, to: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(to)?;
    for entry in std::fs::read_dir(from).with_context(|| from.display().to_string())? {
        let entry = entry?;
        let name = entry.file_name();
        // Cargo's lock.
        if name.as_encoded_bytes().starts_with(b".") {
            continue;
        }
        let to = to.join(name);
        match entry.file_type()?.is_dir() {
            true => copy(&entry.path(), &to)?,
            false => std::fs::copy(entry.path(), to).map(|_| ())?,
        }
    }
    Ok(())
}
