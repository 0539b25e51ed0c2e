//! Other programs of the same installation.

use std::path::PathBuf;

/// The program of this name beside the running one; where there is none, the name, for PATH.
pub fn sibling(name: &str) -> PathBuf {
    let beside = std::env::current_exe().map(|path| path.with_file_name(name));
    let beside = beside.ok().filter(|path| path.exists());
    beside.unwrap_or_else(|| name.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_beside_is_preferred() {
        let us = std::env::current_exe().unwrap();
        let name = us.file_name().unwrap().to_str().unwrap();
        assert_eq!(sibling(name), us);
        assert_eq!(sibling("no-such-program"), PathBuf::from("no-such-program"));
    }
}
