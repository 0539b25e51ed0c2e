//! TOML files read into structs and checked against the JSON Schema that the structs derive.
//!
//! A key of a file is declared once, as the field of a struct: its doc comment is the description,
//! its serde default the default, and `#[schemars(..)]` gives range or length. From the derived
//! [`schema`] come the checks at run time ([`Document::check`]), the file that editors complete
//! from ([`schema_file`]) and the reference page ([`reference()`]). These keywords of our own
//! are understood: `x-unit`, the unit of a number; `x-allowed`, what is allowed in words, where
//! range and type do not tell it all; `x-default`, the default in words, where it depends on
//! something.
//!
//! ```
//! #[derive(serde::Deserialize, schemars::JsonSchema)]
//! struct Settings {
//!     /// Width of the image.
//!     #[schemars(range(min = 16, max = 4096), extend("x-unit" = "px"))]
//!     width: u32,
//! }
//! let wrong = toml_schema::Document::parse("width = 3", "a.toml").unwrap();
//! let error = wrong.check::<Settings>().err().unwrap();
//! assert_eq!(error.to_string(), "a.toml: width = 3; allowed: 16 to 4096 px");
//! ```
#![forbid(unsafe_code)]

mod difference;
mod document;
#[cfg(feature = "flags")]
mod flags;
mod generated;
mod judge;
mod reference;
mod schema;
#[cfg(feature = "yaml")]
mod yaml;

pub use difference::Difference;
pub use document::{
    COMMAND_LINE, Document, FileError, MOST_TEXT, open_file, read_bytes, read_text,
};
#[cfg(feature = "flags")]
pub use flags::arguments;
pub use generated::{Generated, GeneratedError, update};
pub use judge::{Refusal, check};
pub use reference::reference;
pub use schema::{schema, schema_file};
#[cfg(feature = "yaml")]
pub use yaml::{YamlFile, YamlNode};
