//! The pictures of the pages, each made again by the programs that draw it.

use std::path::Path;

use anyhow::{Context, ensure};
use testkit::python::run;

use crate::release::tool;
use crate::root;

/// Where the pages find them, below the root of the repository.
const GALLERY: &str = "controller/figures/gallery";

/// A picture of the gallery.
struct Picture {
    name: &'static str,
    make: Make,
    /// The file that the lines make, below `out/`.
    from: &'static str,
}

/// Lines of a shell at the root of the repository.
enum Make {
    Lines(&'static str),
    /// The first block of them after the picture in this page, in the same section.
    Page(&'static str),
}

const PICTURES: [Picture; 4] = [
    Picture {
        name: "demo.gif",
        make: Make::Lines("cargo demo --output out/demo"),
        from: "demo/strategies.gif",
    },
    Picture {
        name: "laboratory.gif",
        make: Make::Lines("cargo laboratory --starts 1@1501 --film out/film.gif"),
        from: "film.gif",
    },
    Picture {
        name: "crescent.png",
        make: Make::Page("memory-blob/GUIDE.md"),
        from: "plots/start-0.png",
    },
    Picture {
        name: "stop.gif",
        make: Make::Page("controller/SAFETY.md"),
        from: "plots/run.gif",
    },
];

/// What stands before the lines: the programs of this clone, in a domain of their own. What the
/// lines leave at work ends with the shell.
const BEFORE: &str = r#"
cargo build --release --quiet
mkdir "$OUT/programs"
for program in vpcd hw-sim vpcctl; do
    printf '#!/bin/sh\nexec "%s" --domain "%s" "$@"\n' \
        "$PROGRAMS/$program" "$OUT/domain" >"$OUT/programs/$program"
    chmod +x "$OUT/programs/$program"
done
PATH=$OUT/programs:$PATH
trap 'kill $(jobs -p) 2>/dev/null || :; wait' EXIT
"#;

/// Makes the pictures of these names, or all.
///
/// # Errors
/// A name is none of the gallery's, or a line fails.
pub fn gallery(names: &[String]) -> anyhow::Result<()> {
    let known = PICTURES.map(|picture| picture.name);
    for name in names {
        let allowed = known.join(", ");
        ensure!(
            known.contains(&&**name),
            "picture `{name}`; allowed: {allowed}"
        );
    }
    let is_wanted = |name: &str| names.is_empty() || names.iter().any(|wanted| wanted == name);
    // Beside the directory of this program.
    let program = std::env::current_exe()?;
    let target = program.ancestors().nth(2).context("no target directory")?;
    for picture in PICTURES.iter().filter(|picture| is_wanted(picture.name)) {
        let out = tempfile::tempdir()?;
        let lines = match picture.make {
            Make::Lines(lines) => lines.to_owned(),
            Make::Page(page) => of_page(page, picture.name)?,
        };
        // What a reader of the page made in `out` is left alone.
        let lines = lines.replace("out/", "\"$OUT\"/");
        let mut shell = tool("bash");
        shell
            .args(["-euc", &format!("{BEFORE}{lines}")])
            .env("OUT", out.path())
            .env("PROGRAMS", target.join("release"));
        run(&mut shell).map_err(|error| anyhow::anyhow!("{}: {error}", picture.name))?;
        let to = Path::new(GALLERY).join(picture.name);
        std::fs::copy(out.path().join(picture.from), root().join(&to))
            .with_context(|| format!("{}: {}", picture.name, picture.from))?;
        println!("{}: written", to.display());
    }
    Ok(())
}

/// The block of lines after the picture in the page.
fn of_page(page: &str, picture: &str) -> anyhow::Result<String> {
    let text = std::fs::read_to_string(root().join(page)).with_context(|| page.to_owned())?;
    let after = text.split_once(&format!("gallery/{picture})"));
    let lines = after.and_then(|(_, rest)| {
        let (between, lines) = rest.split_once("```sh\n")?;
        let is_there = !between.contains("\n#") && !between.contains("![");
        is_there.then(|| lines.split_once("```"))?
    });
    let (lines, _) = lines.with_context(|| format!("{page}: no lines after {picture}"))?;
    Ok(lines.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_picture_of_the_gallery_has_its_commands() {
        let files = std::fs::read_dir(root().join(GALLERY)).unwrap();
        let mut there: Vec<_> = files
            .map(|file| file.unwrap().file_name().into_string().unwrap())
            .collect();
        let mut known = PICTURES.map(|picture| picture.name.to_owned());
        there.sort();
        known.sort();
        assert_eq!(there, known);
        for picture in PICTURES {
            if let Make::Page(page) = picture.make {
                assert!(of_page(page, picture.name).unwrap().contains("out/plots"));
            }
        }
        assert!(of_page("README.md", "stop.gif").is_err());
        assert!(gallery(&["none.png".into()]).is_err());
    }
}
