//! The messages of the troubleshooting tables are the programs' own: each piece of them between placeholders is found in
//! a string of the code.

use std::path::Path;

use crate::root;

/// Documents with such a table: heading of its first column, and the least of its rows.
const TABLES: [(&str, usize); 2] = [("controller/README.md", 20), ("memory-blob/GUIDE.md", 6)];

/// All sources as one text, in which strings that are broken into lines are whole.
fn sources(directory: &Path, text: &mut String) {
    for path in std::fs::read_dir(directory)
        .unwrap()
        .map(|e| e.unwrap().path())
    {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            let holds_code = !name.starts_with('.') && name != "target" && name != "tests";
            if holds_code {
                sources(&path, text);
            }
        } else if name.ends_with(".rs") {
            let source = std::fs::read_to_string(&path).unwrap();
            // Words of documentation are no words of the program.
            let code = source
                .lines()
                .filter(|line| !line.trim_start().starts_with("//"));
            let mut goes_on = false;
            for line in code {
                let line = if goes_on { line.trim_start() } else { line };
                goes_on = line.ends_with('\\');
                text.push_str(line.trim_end_matches('\\'));
                if !goes_on {
                    text.push('\n');
                }
            }
        }
    }
}

/// The pieces of a message that no placeholder fills: between ellipses, numbers and what is quoted.
fn pieces(message: &str) -> Vec<String> {
    let plain: String = message
        .replace("...", "\0")
        .chars()
        .map(|c| {
            if c.is_ascii_digit() || c == '"' {
                '\0'
            } else {
                c
            }
        })
        .collect();
    let pieces = plain
        .split('\0')
        .map(|piece| piece.trim_matches([' ', ';', ',', ':', '(', ')']));
    pieces
        .filter(|piece| piece.len() > 3)
        .map(str::to_owned)
        .collect()
}

#[test]
fn every_message_of_the_tables_is_in_the_code() {
    let mut code = String::new();
    for directory in ["controller", "ipc", "memory-blob", "hw-sim"] {
        sources(&root().join(directory), &mut code);
    }
    let mut faults = Vec::new();
    for (name, least) in TABLES {
        let text = std::fs::read_to_string(root().join(name)).unwrap();
        let (_, table) = text.split_once("| It says | Do |\n|---|---|\n").unwrap();
        let rows: Vec<&str> = table
            .lines()
            .take_while(|row| row.starts_with("| "))
            .collect();
        assert!(rows.len() >= least, "{name}: {} rows", rows.len());
        for row in rows {
            let column = row.split(" | ").next().unwrap();
            let messages: Vec<&str> = column.split('`').skip(1).step_by(2).collect();
            assert!(!messages.is_empty(), "{name}: {row}");
            for message in messages {
                let pieces = pieces(message);
                assert!(!pieces.is_empty(), "{name}: {message}");
                for piece in pieces {
                    // `KEY is missing; ...` and `STATE: CAUSE` are put together from names.
                    let parts = piece
                        .split([':', ';'])
                        .flat_map(|part| part.split(" is missing"));
                    let found = code.contains(&piece)
                        || parts.map(str::trim).all(|part| code.contains(part));
                    if !found {
                        faults.push(format!("{name}: `{message}`: nothing says `{piece}`"));
                    }
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn pieces_are_what_stands_between_placeholders() {
    assert_eq!(
        pieces("pixel (17, 0) is coloured"),
        ["pixel", "is coloured"]
    );
    assert_eq!(
        pieces("owned by user ...; allowed: a directory (no link) of user ..."),
        ["owned by user", "allowed: a directory (no link) of user"]
    );
}
