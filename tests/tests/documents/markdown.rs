//! What a Markdown file holds besides prose: commands, links, files to be written.

use std::path::{Path, PathBuf};

use crate::root;

/// A document of the repository.
pub struct Document {
    /// Path from the root.
    pub name: String,
    lines: Vec<String>,
}

/// A piece of a document and the number of its first line, from 1.
#[derive(Clone, Debug)]
pub struct Piece {
    pub line: usize,
    pub text: String,
}

/// What a reader would do, in the order of the document.
pub enum Act {
    /// Type this command.
    Command(Piece),
    /// Write this text into this file.
    File(PathBuf, String),
}

/// Every document of the repository, by name.
pub fn documents() -> Vec<Document> {
    let mut found = Vec::new();
    gather(root(), &mut found);
    found.sort_by(|a, b| a.name.cmp(&b.name));
    assert!(found.len() > 20, "{}", found.len());
    found
}

fn gather(directory: &Path, found: &mut Vec<Document>) {
    for entry in std::fs::read_dir(directory).unwrap().map(Result::unwrap) {
        let path = entry.path();
        let name = entry.file_name().into_string().unwrap();
        if path.is_dir() {
            // What is built, and what readers of the guides make.
            let made = ["target", "out", "own", "venv", "node_modules"].contains(&&*name);
            if !made && !name.starts_with('.') {
                gather(&path, found);
            }
        } else if name.ends_with(".md") {
            let text = std::fs::read_to_string(&path).unwrap();
            found.push(Document {
                name: path.strip_prefix(root()).unwrap().display().to_string(),
                lines: text.lines().map(str::to_owned).collect(),
            });
        }
    }
}

impl Document {
    /// The commands of its `sh` blocks, and the TOML blocks that follow a line "`PATH`:", in their order. Comments are
    /// cut off, lines that end with a backslash are joined.
    pub fn acts(&self) -> Vec<Act> {
        let mut acts = Vec::new();
        let mut block: Option<(String, Option<PathBuf>, String)> = None;
        let mut command: Option<Piece> = None;
        for (index, line) in self.lines.iter().enumerate() {
            if let Some(fence) = line.trim_start().strip_prefix("```") {
                match block.take() {
                    Some((_, Some(path), text)) => acts.push(Act::File(path, text)),
                    Some(_) => (),
                    None => block = Some((fence.to_owned(), self.file_above(index), String::new())),
                }
                continue;
            }
            let Some((language, _, text)) = &mut block else {
                continue;
            };
            if language != "sh" {
                *text += line;
                text.push('\n');
                continue;
            }
            let words = without_comment(line).trim();
            let (words, goes_on) = match words.strip_suffix('\\') {
                Some(words) => (words.trim(), true),
                None => (words, false),
            };
            if words.is_empty() {
                continue;
            }
            let piece = command.get_or_insert(Piece {
                line: index + 1,
                text: String::new(),
            });
            if !piece.text.is_empty() {
                piece.text.push(' ');
            }
            piece.text += words;
            if !goes_on {
                acts.extend(command.take().map(Act::Command));
            }
        }
        assert!(block.is_none(), "{}: a block does not end", self.name);
        acts
    }

    /// The file that the line above a block announces: "`PATH`:".
    fn file_above(&self, index: usize) -> Option<PathBuf> {
        let above = self.lines.get(index.checked_sub(1)?)?.trim();
        let path = above.strip_prefix('`')?.strip_suffix("`:")?;
        Some(PathBuf::from(path))
    }

    /// The commands of its `sh` blocks.
    pub fn commands(&self) -> Vec<Piece> {
        let commands = self.acts().into_iter().filter_map(|act| match act {
            Act::Command(piece) => Some(piece),
            Act::File(..) => None,
        });
        commands.collect()
    }

    /// What stands between single backticks outside of blocks, on one line or two.
    pub fn inline_code(&self) -> Vec<Piece> {
        let mut found = Vec::new();
        for (line, text) in self.paragraphs() {
            for code in text.split('`').skip(1).step_by(2) {
                found.push(Piece {
                    line,
                    text: code.split_whitespace().collect::<Vec<_>>().join(" "),
                });
            }
        }
        found
    }

    /// Targets of links outside of blocks.
    pub fn links(&self) -> Vec<Piece> {
        let mut found = Vec::new();
        for (line, text) in self.paragraphs() {
            for rest in text.split("](").skip(1) {
                let target = rest.split(')').next().unwrap_or("").to_owned();
                found.push(Piece { line, text: target });
            }
        }
        found
    }

    /// Headings as links name them.
    pub fn anchors(&self) -> Vec<String> {
        let headings = self.lines.iter().filter(|line| line.starts_with('#'));
        let anchor = |line: &String| -> String {
            let title = line.trim_start_matches('#').trim().to_lowercase();
            let kept = title.chars().filter_map(|c| match c {
                ' ' => Some('-'),
                '-' | '_' => Some(c),
                c => c.is_alphanumeric().then_some(c),
            });
            kept.collect()
        };
        headings.map(anchor).collect()
    }

    /// Runs of lines outside of blocks, each with the number of its first; rows of tables and items stand alone.
    fn paragraphs(&self) -> Vec<(usize, String)> {
        let mut found: Vec<(usize, String)> = Vec::new();
        let (mut in_block, mut fresh) = (false, true);
        for (index, line) in self.lines.iter().enumerate() {
            let words = line.trim_start();
            if words.starts_with("```") {
                in_block = !in_block;
                fresh = true;
                continue;
            }
            if in_block || words.is_empty() || line.starts_with("    ") {
                fresh = true;
                continue;
            }
            fresh |= words.starts_with(['|', '-', '#']);
            match found.last_mut() {
                Some((_, text)) if !fresh => {
                    text.push(' ');
                    text.push_str(words);
                }
                _ => found.push((index + 1, words.to_owned())),
            }
            fresh = false;
        }
        found
    }
}

/// A line of shell up to its comment.
fn without_comment(line: &str) -> &str {
    let mut quote = None;
    let mut before = ' ';
    for (place, c) in line.char_indices() {
        match (quote, c) {
            (None, '#') if before.is_whitespace() => return &line[..place],
            (None, '\'' | '"') => quote = Some(c),
            (Some(open), c) if open == c => quote = None,
            _ => (),
        }
        before = c;
    }
    line
}

#[test]
fn comments_continuations_and_quotes_are_read_as_a_shell_would() {
    let lines = "```sh\na --b 'c # d'   # a comment\ne \\\n    f\n# nothing\n```\n`own/x.toml`:\n```toml\nk = 1\n```";
    let document = Document {
        name: "x.md".into(),
        lines: lines.lines().map(str::to_owned).collect(),
    };
    let commands: Vec<_> = document.commands().into_iter().map(|c| c.text).collect();
    assert_eq!(commands, ["a --b 'c # d'", "e f"]);
    let files = document.acts().into_iter().filter_map(|act| match act {
        Act::File(path, text) => Some((path, text)),
        Act::Command(_) => None,
    });
    let files: Vec<_> = files.collect();
    assert_eq!(files, [(PathBuf::from("own/x.toml"), "k = 1\n".to_owned())]);
}
