//! What is refused, in which words, and what the page and the schema say.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml_schema::{Document, FileError, reference, schema, schema_file};

/// A file for these tests.
#[derive(Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(extend("required" = ["picture"]))]
struct File {
    /// A file.
    #[schemars(extend("x-allowed" = "a file"))]
    picture: Option<String>,
    camera: Camera,
    #[schemars(length(max = 2))]
    part: Vec<Part>,
}

/// The camera.
#[derive(Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct Camera {
    /// Width of the image,
    /// in all.
    #[schemars(range(min = 16, max = 20000), extend("x-unit" = "px"))]
    width: Option<u32>,
    /// Rate of frames.
    #[schemars(range(min = 1e-6, max = 1e4), extend("multipleOf" = 0.5))]
    rate: f64,
    clock: Clock,
}

#[derive(Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
enum Clock {
    /// A quartz.
    #[default]
    Fixed,
    /// None.
    Free,
}

/// A part.
#[derive(Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Part {
    /// Where it is.
    #[schemars(inner(range(min = -std::f64::consts::PI, max = 10)), extend("x-unit" = "m"))]
    at: [f64; 2],
    /// Its form.
    form: Form,
}

#[derive(Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
enum Form {
    /// Of so many corners.
    Corners(#[schemars(range(min = 3, max = 12))] u32),
    Radius(f64),
}

fn check(text: &str) -> Result<File, FileError> {
    Document::parse(text, "a.toml")?.check()
}

fn refused(text: &str) -> String {
    check(&format!("picture = 'p'\n{text}"))
        .unwrap_err()
        .to_string()
}

#[test]
fn a_refusal_names_file_key_value_and_range() {
    for (text, words) in [
        (
            "[camera]\nwidth = 3",
            "a.toml: camera.width = 3; allowed: 16 to 2e4 px",
        ),
        (
            "[camera]\nwidth = -3",
            "a.toml: camera.width = -3; allowed: 16 to 2e4 px",
        ),
        (
            "[camera]\nrate = nan",
            "a.toml: camera.rate = NaN; allowed: 1e-6 to 1e4",
        ),
        (
            "[camera]\nrate = 1.25",
            "a.toml: camera.rate = 1.25; allowed: 1e-6 to 1e4",
        ),
        (
            "[camera]\nclock = 'sun'",
            "a.toml: camera.clock = sun; allowed: fixed, free",
        ),
        (
            "[[part]]\nat = [0.0, -4.0]",
            "a.toml: part[0].at[1] = -4; allowed: -pi to 10 m",
        ),
        (
            "[[part]]\nat = [0.0]",
            "a.toml: part[0].at = a list of 1; allowed: 2 numbers, -pi to 10 m",
        ),
        (
            "[[part]]\nat = [0, 0]\nform = { corners = 2 }",
            "a.toml: part[0].form.corners = 2; allowed: 3 to 12",
        ),
        (
            "[camera]\nclock = 5",
            "a.toml: camera.clock = 5; allowed: fixed, free",
        ),
        (
            "[camera]\nclock = ['free']",
            "a.toml: camera.clock = [\"free\"]; allowed: fixed, free",
        ),
        (
            "part = [{}, {}, {}]",
            "a.toml: part = a list of 3; allowed: at most 2 tables",
        ),
        (
            "[[part]]",
            "a.toml: part[0].at is missing; allowed: 2 numbers, -pi to 10 m",
        ),
        (
            "[[part]]\nat = [0, 0]",
            "a.toml: part[0].form is missing; allowed: a table with corners, or radius",
        ),
    ] {
        assert_eq!(refused(text), words);
    }
    assert_eq!(
        check("").unwrap_err().to_string(),
        "a.toml: picture is missing; allowed: a file"
    );
}

#[test]
fn long_numbers_are_told_by_their_power_of_ten() {
    for (value, words) in [
        ("1e300", "a.toml: camera.rate = 1e300; allowed"),
        ("1e-300", "a.toml: camera.rate = 1e-300; allowed"),
        ("12345.5", "a.toml: camera.rate = 12345.5; allowed"),
    ] {
        let message = refused(&format!("[camera]\nrate = {value}"));
        assert!(message.starts_with(words), "{message}");
    }
}

#[test]
fn unknown_keys_and_wrong_types_are_shown_in_their_line() {
    for (text, words) in [
        ("[camera]\nwidht = 30", "unknown field `widht`"),
        ("[camera]\nwidth = 'wide'", "invalid type: string \"wide\""),
        ("[camera]\nwidth = nan", "invalid type: floating point"),
        ("[[part]]\nat = 3", "invalid type: integer `3`"),
    ] {
        let message = refused(text);
        assert!(
            message.contains("line 3") && message.contains(words),
            "{message}"
        );
    }
    let missing = Document::read(Some(Path::new("/none.toml"))).unwrap_err();
    assert!(
        missing
            .to_string()
            .starts_with("/none.toml: cannot read: No such file"),
        "{missing}"
    );
}

#[test]
fn what_is_no_plain_file_is_refused_without_waiting() {
    let place = tempfile::tempdir().unwrap();
    let pipe = place.path().join("pipe");
    let mode = rustix::fs::Mode::from_raw_mode(0o600);
    rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, mode).unwrap();
    let mut document = Document::parse("", "a.toml").unwrap();
    for (path, what) in [
        (pipe.as_path(), "a pipe"),
        (place.path(), "a folder"),
        (Path::new("/dev/zero"), "a device"),
    ] {
        let name = path.display();
        let message = Document::read(Some(path)).unwrap_err().to_string();
        let words = format!("{name}: cannot read: is {what}; allowed: a plain file");
        assert_eq!(message, words);
        document.set("scene", "--scene", path.to_str());
        let message = document.readable(&["scene"]).unwrap_err().to_string();
        assert!(message.contains(&format!("is {what}")), "{message}");
    }
}

#[test]
fn a_file_that_is_too_long_is_refused_by_its_length() {
    let file = tempfile::NamedTempFile::new().unwrap();
    file.as_file().set_len(1 << 40).unwrap();
    let message = toml_schema::read_bytes(file.path(), 7).unwrap_err();
    assert_eq!(message.to_string(), "1099511627776 bytes; allowed: up to 7");
    file.as_file().set_len(7).unwrap();
    assert_eq!(toml_schema::read_bytes(file.path(), 7).unwrap(), [0; 7]);
}

#[test]
fn an_unreadable_file_is_named_with_its_flag_or_key() {
    let mut document = Document::parse("scene = 'no.toml'", "a/b.toml").unwrap();
    document.relative_to(Path::new("a"), &["scene"]);
    let refused = |document: &Document| {
        let error = document.readable(&["scene", "memory"]).unwrap_err();
        assert!(matches!(error, FileError::Named { .. }), "{error:?}");
        error.to_string()
    };
    let message = refused(&document);
    let words = "a/b.toml: scene = a/no.toml: cannot read: No such file";
    assert!(message.starts_with(words), "{message}");
    document.set("scene", "--scene", Some("/none.toml"));
    let message = refused(&document);
    let words = "command line: --scene = /none.toml: cannot read: No such file";
    assert!(message.starts_with(words), "{message}");
    document.set("scene", "--scene", Some(file!()));
    let is_here = Path::new(file!()).exists();
    assert_eq!(document.readable(&["scene"]).is_ok(), is_here);
    document.readable(&["memory"]).unwrap();
}

#[test]
fn a_flag_wins_and_is_refused_by_its_name() {
    let mut document = Document::parse("[camera]\nwidth = 3\nrate = 1.0", "a.toml").unwrap();
    document.set("picture", "--picture", Some("p"));
    document.set("camera.width", "--width", Some(640));
    document.set("camera.rate", "--rate", None::<f64>);
    let file: File = document.check().unwrap();
    assert_eq!((file.camera.width, file.camera.rate), (Some(640), 1.0));
    document.set("camera.rate", "--rate", Some(0.0));
    let message = document.check::<File>().unwrap_err().to_string();
    assert_eq!(message, "command line: --rate = 0; allowed: 1e-6 to 1e4");
}

#[test]
fn paths_are_relative_to_the_directory_of_the_file() {
    let mut document = Document::parse("picture = 'p.png'", "a.toml").unwrap();
    document.relative_to(Path::new("/etc"), &["picture", "camera.none"]);
    assert_eq!(
        document.check::<File>().unwrap().picture.unwrap(),
        "/etc/p.png"
    );
}

#[test]
fn a_struct_is_checked_as_its_file_would_be() {
    let mut file = check("picture = 'p'\n[camera]\nrate = 2.0").unwrap();
    assert_eq!(toml_schema::check(&file), Ok(()));
    file.camera.rate = 1e5;
    let refusal = toml_schema::check(&file).unwrap_err();
    assert_eq!(
        refusal.to_string(),
        "camera.rate = 100000; allowed: 1e-6 to 1e4"
    );
}

#[test]
fn the_page_has_the_keys_in_the_order_of_a_file_that_shows_them() {
    let place = |page: &str, row: &str| page.find(row).unwrap_or_else(|| panic!("{page}: {row}"));
    let schema = schema::<File>();
    let by_name = reference(&schema, "");
    assert!(place(&by_name, "| `clock`") < place(&by_name, "| `width`"));
    let example = "# A picture.\n[camera]\nwidth = 640\n# clock = 'free'\n";
    let shown = reference(&schema, example);
    assert!(place(&shown, "| `width`") < place(&shown, "| `clock`"));
}

#[test]
fn the_page_has_a_row_for_each_key_under_its_table() {
    let page = reference(&schema::<File>(), "");
    for row in [
        "| `picture` | required; a file | A file. |",
        "### `[camera]`\n\nThe camera.\n",
        "| `width` | none; 16 to 2e4 px | Width of the image, in all. |",
        "| `clock` | `\"fixed\"` | `fixed`: A quartz. `free`: None. |",
        "### `[[part]]`\n\nA part.\n",
    ] {
        assert!(page.contains(row), "{page}\nlacks {row}");
    }
    let file = schema_file(schema::<File>());
    assert!(
        file.contains("Width of the image, in all. Allowed: 16 to 2e4 px."),
        "{file}"
    );
    assert!(
        !file.contains("null") && file.contains("draft-07"),
        "{file}"
    );
}
