//! YAML files of other tools: their numbers, with errors that name file, key and value.

use saphyr::{LoadableYamlNode, Yaml};
use saphyr_parser::{Event, Parser};

use crate::document::FileError;
use crate::judge::Refusal;

/// Most lists and tables in each other; calibrations have four.
const DEEPEST: u32 = 32;

/// The contents of a YAML file.
#[derive(Debug)]
pub struct YamlFile {
    path: String,
    root: Yaml<'static>,
}

/// A value in a YAML file.
#[derive(Clone, Debug)]
pub struct YamlNode<'a> {
    path: &'a str,
    /// The keys that lead to it, with dots between them.
    key: String,
    value: &'a Yaml<'static>,
}

impl YamlFile {
    /// Parses the text of a file, also one that OpenCV wrote; `path` is for messages. Of several
    /// documents, the first counts.
    ///
    /// # Errors
    /// [`FileError::Syntax`] if it is not YAML, or empty.
    pub fn parse(text: &str, path: &str) -> Result<Self, FileError> {
        // OpenCV writes a directive that is not YAML's.
        let text = text.strip_prefix("%YAML:1.0").unwrap_or(text);
        let syntax = |message: String| FileError::Syntax {
            path: path.to_owned(),
            message,
        };
        bounded(text).map_err(syntax)?;
        let documents = Yaml::load_from_str(text).map_err(|error| syntax(error.to_string()))?;
        let root = documents.into_iter().next();
        Ok(Self {
            path: path.to_owned(),
            root: root.ok_or_else(|| syntax("the file is empty".to_owned()))?,
        })
    }

    /// The outermost value.
    pub fn root(&self) -> YamlNode<'_> {
        YamlNode {
            path: &self.path,
            key: String::new(),
            value: &self.root,
        }
    }
}

impl<'a> YamlNode<'a> {
    /// The value of a key, if it is there.
    pub fn find(&self, key: &str) -> Option<Self> {
        Some(Self {
            path: self.path,
            key: self.full(key),
            value: untagged(self.value).as_mapping_get(key)?,
        })
    }

    /// The value of a key.
    ///
    /// # Errors
    /// [`FileError::Value`] if the key is missing.
    pub fn get(&self, key: &str, allowed: &str) -> Result<Self, FileError> {
        self.find(key)
            .ok_or_else(|| self.refusal(key, None, allowed))
    }

    /// The finite number of a key.
    ///
    /// # Errors
    /// [`FileError::Value`] if the key is missing or is no finite number.
    pub fn number(&self, key: &str) -> Result<f64, FileError> {
        const ALLOWED: &str = "a number";
        let node = self.get(key, ALLOWED)?;
        let number = float(node.value).filter(|number| number.is_finite());
        number.ok_or_else(|| node.refuse(ALLOWED))
    }

    /// The finite numbers of a key: a list.
    ///
    /// # Errors
    /// [`FileError::Value`] if the key is missing, is no list, or one of the list is no finite
    /// number.
    pub fn numbers(&self, key: &str) -> Result<Vec<f64>, FileError> {
        const ALLOWED: &str = "a list of numbers";
        let node = self.get(key, ALLOWED)?;
        let Some(list) = untagged(node.value).as_sequence() else {
            return Err(node.refuse(ALLOWED));
        };
        let one = |(index, value): (usize, &Yaml)| {
            let number = float(value).filter(|number| number.is_finite());
            number.ok_or_else(|| {
                let key = format!("{key}[{index}]");
                self.refusal(&key, Some(words(value)), "a number")
            })
        };
        list.iter().enumerate().map(one).collect()
    }

    /// The value if it is a text.
    pub fn as_str(&self) -> Option<&'a str> {
        untagged(self.value).as_str()
    }

    /// The value if it is true or false.
    pub fn as_bool(&self) -> Option<bool> {
        untagged(self.value).as_bool()
    }

    /// Returns the error for this value.
    pub fn refuse(&self, allowed: &str) -> FileError {
        self.refuse_as(words(self.value), allowed)
    }

    /// Returns the error for this value, said in other words.
    pub fn refuse_as(&self, found: impl ToString, allowed: &str) -> FileError {
        FileError::value(self.path, &self.key, found, allowed)
    }

    fn full(&self, key: &str) -> String {
        match self.key.as_str() {
            "" => key.to_owned(),
            within => format!("{within}.{key}"),
        }
    }

    fn refusal(&self, key: &str, value: Option<String>, allowed: &str) -> FileError {
        FileError::Value {
            path: self.path.to_owned(),
            refusal: Refusal {
                key: self.full(key),
                value,
                allowed: allowed.to_owned(),
            },
        }
    }
}

/// Checks that nothing in a text takes more than the text does: no value is repeated by an alias,
/// and lists and tables are in each other [`DEEPEST`] times at most. What is no YAML passes.
fn bounded(text: &str) -> Result<(), String> {
    let mut depth = 0_u32;
    for event in Parser::new_from_str(text) {
        match event {
            Err(_) => break,
            Ok((Event::Alias(_), at)) => {
                let line = at.start.line();
                return Err(format!(
                    "line {line}: an alias; allowed: none, write the value again"
                ));
            }
            Ok((Event::SequenceStart(..) | Event::MappingStart(..), at)) => {
                depth += 1;
                if depth > DEEPEST {
                    let line = at.start.line();
                    return Err(format!(
                        "line {line}: more than {DEEPEST} lists and tables in each other; allowed: up to {DEEPEST}"
                    ));
                }
            }
            Ok((Event::SequenceEnd | Event::MappingEnd, _)) => depth = depth.saturating_sub(1),
            Ok(_) => (),
        }
    }
    Ok(())
}

/// A value without the type that OpenCV gives it.
fn untagged<'a>(value: &'a Yaml<'static>) -> &'a Yaml<'static> {
    value.get_tagged_node().unwrap_or(value)
}

/// A number, also one without a fraction.
fn float(value: &Yaml) -> Option<f64> {
    let whole = value.as_integer().map(|whole| whole as f64);
    value.as_floating_point().or(whole)
}

/// A value in an error.
fn words(value: &Yaml) -> String {
    if let Some(number) = float(value) {
        return number.to_string();
    }
    match value {
        Yaml::Sequence(list) => format!("a list of {}", list.len()),
        Yaml::Mapping(_) => "a table".to_owned(),
        Yaml::Tagged(_, value) => words(value),
        _ => match (value.as_str(), value.as_bool()) {
            (Some(text), _) => format!("\"{text}\""),
            (_, Some(word)) => word.to_string(),
            _ => "nothing".to_owned(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused<T: std::fmt::Debug>(
        text: &str,
        read: impl Fn(&YamlNode) -> Result<T, FileError>,
    ) -> String {
        let file = YamlFile::parse(text, "a.yaml").unwrap();
        read(&file.root()).unwrap_err().to_string()
    }

    #[test]
    fn numbers_are_read_as_each_tool_writes_them() {
        let text =
            "%YAML:1.0\n---\na: !!opencv-matrix\n   data: [ 1., -2, 5.0e-02,\n      3 ]\nb: 7\n";
        let file = YamlFile::parse(text, "a.yaml").unwrap();
        let matrix = file.root().get("a", "a matrix").unwrap();
        assert_eq!(matrix.numbers("data").unwrap(), [1.0, -2.0, 0.05, 3.0]);
        assert_eq!(file.root().number("b").unwrap(), 7.0);
    }

    #[test]
    fn a_text_takes_no_more_than_its_size() {
        let said = |text: &str| YamlFile::parse(text, "a.yaml").unwrap_err().to_string();
        let mut laughs = "a0: &a0 [x,x,x,x,x,x,x,x,x,x]\n".to_owned();
        for i in 1..10 {
            let again = vec![format!("*a{}", i - 1); 10].join(",");
            laughs += &format!("a{i}: &a{i} [{again}]\n");
        }
        assert_eq!(
            said(&laughs),
            "a.yaml: line 2: an alias; allowed: none, write the value again"
        );
        let lists = format!("a: {}1{}", "[".repeat(100), "]".repeat(100));
        let tables = (0..20_000).map(|i| format!("{}k:\n", " ".repeat(i % 6000)));
        let deep: String = tables.take(6000).collect();
        for text in [lists, deep + &" ".repeat(6000) + "1\n"] {
            assert!(said(&text).contains("allowed: up to 32"), "{}", said(&text));
        }
    }

    #[test]
    fn errors_name_file_key_and_value() {
        let numbers = |node: &YamlNode| node.get("a", "a table")?.numbers("b");
        for (text, said) in [
            ("c: 1", "a.yaml: a is missing; allowed: a table"),
            ("a: 1", "a.yaml: a.b is missing; allowed: a list of numbers"),
            ("a: {b: 1}", "a.yaml: a.b = 1; allowed: a list of numbers"),
            (
                "a: {b: [1, .nan]}",
                "a.yaml: a.b[1] = NaN; allowed: a number",
            ),
            ("a: {b: [x]}", "a.yaml: a.b[0] = \"x\"; allowed: a number"),
        ] {
            assert_eq!(refused(text, numbers), said);
        }
        let number = |node: &YamlNode| node.number("a");
        for (text, said) in [
            ("a: true", "a.yaml: a = true; allowed: a number"),
            ("a: [1, 2]", "a.yaml: a = a list of 2; allowed: a number"),
            ("a: {b: 1}", "a.yaml: a = a table; allowed: a number"),
            ("a: .Inf", "a.yaml: a = inf; allowed: a number"),
        ] {
            assert_eq!(refused(text, number), said);
        }
        for text in ["", "a: ["] {
            assert!(YamlFile::parse(text, "a.yaml").is_err());
        }
    }
}
