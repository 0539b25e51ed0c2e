//! What a Markdown file holds besides prose: commands, links, files to be written.

use std::path::Path;

use testkit::root;

/// A document of the repository.
pub struct Document {
    /// Path from the root.
    pub name: String,
    lines: Vec<String>,
}

/// A piece of a document and where it is.
#[derive(Clone, Debug)]
pub struct Piece {
    /// `FILE:LINE`.
    pub place: String,
    pub text: String,
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
    /// A place in it, by the index of a line.
    fn place(&self, index: usize) -> String {
        format!("{}:{}", self.name, index + 1)
    }

    /// Its blocks in a language: the line above, the index of the first line, and the lines.
    fn blocks(&self, language: &str) -> Vec<(&str, usize, &[String])> {
        let fences = self.lines.iter().enumerate();
        let fences = fences.filter(|(_, line)| line.trim_start().starts_with("```"));
        let fences: Vec<usize> = fences.map(|(index, _)| index).collect();
        assert!(
            fences.len().is_multiple_of(2),
            "{}: a block does not end",
            self.name
        );
        let mut blocks = Vec::new();
        for fence in fences.chunks_exact(2) {
            if self.lines[fence[0]].trim_start() == format!("```{language}") {
                let above = fence[0]
                    .checked_sub(1)
                    .map_or("", |above| self.lines[above].trim());
                let first = fence[0] + 1;
                blocks.push((above, first, &self.lines[first..fence[1]]));
            }
        }
        blocks
    }

    /// The commands of its `sh` blocks. Comments are cut off, lines that end with a backslash are
    /// joined.
    pub fn commands(&self) -> Vec<Piece> {
        let mut commands = Vec::new();
        for (_, first, lines) in self.blocks("sh") {
            let mut text = String::new();
            for (index, line) in lines.iter().enumerate() {
                text += without_comment(line).trim();
                if let Some(begun) = text.strip_suffix('\\') {
                    text = begun.to_owned();
                } else if !text.is_empty() {
                    let place = self.place(first + index);
                    commands.push(Piece {
                        place,
                        text: std::mem::take(&mut text),
                    });
                }
            }
        }
        commands
    }

    /// Its TOML blocks below a line "`PATH`:", with that path.
    pub fn files(&self) -> Vec<(&str, String)> {
        let named = |above: &str| above.strip_prefix('`')?.strip_suffix("`:").map(str::len);
        let blocks = self.blocks("toml").into_iter();
        let files = blocks.filter_map(|(above, _, lines)| {
            Some((&above[1..=named(above)?], lines.join("\n") + "\n"))
        });
        files.collect()
    }

    /// What stands between single backticks outside of blocks, on one line or two.
    pub fn inline_code(&self) -> Vec<Piece> {
        let mut found = Vec::new();
        for (index, text) in self.paragraphs() {
            for code in text.split('`').skip(1).step_by(2) {
                let text = code.split_whitespace().collect::<Vec<_>>().join(" ");
                found.push(Piece {
                    place: self.place(index),
                    text,
                });
            }
        }
        found
    }

    /// Targets of links outside of blocks.
    pub fn links(&self) -> Vec<Piece> {
        let mut found = Vec::new();
        for (index, text) in self.paragraphs() {
            for rest in text.split("](").skip(1) {
                let text = rest.split(')').next().unwrap_or("").to_owned();
                found.push(Piece {
                    place: self.place(index),
                    text,
                });
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

    /// Runs of lines outside of blocks, each with the index of its first; rows of tables and items
    /// stand alone.
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
                _ => found.push((index, words.to_owned())),
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
    assert_eq!(document.files(), [("own/x.toml", "k = 1\n".to_owned())]);
}
