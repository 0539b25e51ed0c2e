//! The subcommands.

mod hand_eye;
mod intrinsics;
mod latency;
mod views;

use std::fmt::Display;
use std::sync::atomic::AtomicBool;

use program::Exit;
use tag_board::Board;
use toml_schema::FileError;

use crate::arguments::{BoardArguments, Command, OutputArguments, board};
use crate::detector::Detector;
use crate::live::LiveError;
use crate::output::{self, OutputError};
use crate::picture::PictureError;
use crate::verdict::Verdict;
use crate::{layout, sheet};

/// There is no result.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct Failure {
    /// The exit code; [`Exit::Attention`] where the views say too little.
    pub exit: Exit,
    message: String,
}

impl Failure {
    fn new(exit: Exit, message: impl Display) -> Self {
        Self {
            exit,
            message: message.to_string(),
        }
    }

    /// What was taken is not enough, or wrong.
    fn not_enough(message: impl Display) -> Self {
        Self::new(Exit::Attention, format!("not good enough: {message}"))
    }
}

impl From<FileError> for Failure {
    fn from(error: FileError) -> Self {
        Self::new(Exit::from(&error), error)
    }
}

impl From<PictureError> for Failure {
    fn from(error: PictureError) -> Self {
        Self::new(Exit::NoInput, error)
    }
}

impl From<LiveError> for Failure {
    fn from(error: LiveError) -> Self {
        match error {
            LiveError::Config(error) => error.into(),
            error => Self::new(Exit::Unavailable, error),
        }
    }
}

impl From<OutputError> for Failure {
    fn from(error: OutputError) -> Self {
        Self::new(Exit::CannotCreate, error)
    }
}

impl From<vpc_camera::tags::TagError> for Failure {
    fn from(error: vpc_camera::tags::TagError) -> Self {
        Self::new(Exit::Software, error)
    }
}

impl From<layout::LayoutError> for Failure {
    fn from(error: layout::LayoutError) -> Self {
        Self::not_enough(error)
    }
}

/// Runs a subcommand, until `stop` is set at the longest. Returns whether the result is good.
///
/// # Errors
/// [`Failure`]: there is no result.
pub fn run(command: &Command, stop: &AtomicBool) -> Result<bool, Failure> {
    match command {
        Command::Board(arguments) => draw(arguments),
        Command::Intrinsics(arguments) => intrinsics::run(arguments, stop),
        Command::HandEye(arguments) => hand_eye::run(arguments, stop),
        Command::Latency(arguments) => latency::run(arguments, stop),
    }
}

fn draw(arguments: &BoardArguments) -> Result<bool, Failure> {
    let board = board(arguments.board.as_deref())?;
    let svg = sheet::svg(&board);
    if arguments.output.output.is_empty() {
        print!("{svg}");
    }
    for path in &arguments.output.output {
        output::write(path, &svg, arguments.output.force)?;
        eprintln!("written: {}", path.display());
    }
    Ok(true)
}

/// A detector of a board, or of a scene's tags; refuses a board that looks the same upside down.
fn oriented(board: Option<Board>) -> Result<Detector, Failure> {
    let board = board.unwrap_or_default();
    if board.is_symmetric() {
        let Board { columns, rows, .. } = board;
        let message = format!(
            "a chessboard of {columns} x {rows} inner corners looks the same upside down; allowed: columns + rows odd, or a board with tags"
        );
        return Err(Failure::new(Exit::Config, message));
    }
    Ok(Detector::new(&board)?)
}

/// Refuses files that exist, before there is something to lose.
fn check_outputs(arguments: &OutputArguments) -> Result<(), OutputError> {
    let mut paths = arguments.output.iter();
    paths.try_for_each(|path| output::check(path, arguments.force))
}

/// Prints a result with its verdict, and writes the files of one that is good.
fn conclude(
    result: &impl Display,
    verdict: &Verdict,
    arguments: &OutputArguments,
    text: impl Fn(&std::path::Path) -> String,
) -> Result<bool, Failure> {
    print!("{result}");
    println!("{verdict}");
    if !verdict.is_good() {
        return Ok(false);
    }
    for path in &arguments.output {
        output::write(path, &text(path), arguments.force)?;
        println!("written: {}", path.display());
    }
    Ok(true)
}
