//! The layers of the workspace hold: what depends on what is as the documents say.

mod circles;
