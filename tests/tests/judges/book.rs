//! The book.

use testkit::{ended, program};

use crate::markdown::documents;

#[test]
#[ignore = "long: mdBook makes the book"]
fn the_book_has_every_document_and_what_they_link_to() {
    let place = tempfile::tempdir().unwrap();
    let book = place.path().join("book");
    // The second time it replaces the first.
    for _ in 0..2 {
        let mut xtask = testkit::command(program("xtask"));
        let said = ended(xtask.arg("book").arg(&book));
        assert_eq!(said.code, Some(0), "{said:?}");
    }
    for document in documents() {
        let page = book.join(&document.name).with_extension("html");
        assert!(page.is_file(), "{}", page.display());
    }
    for file in [
        "index.html",
        "controller/figures/gallery/demo.gif",
        "controller/vpc/src/law.rs.txt",
        "controller/vpcd.toml.txt",
    ] {
        assert!(book.join(file).is_file(), "{file}");
    }
}

#[test]
#[ignore = "long: mdBook makes the book"]
fn the_book_may_have_the_libraries() {
    let place = tempfile::tempdir().unwrap();
    let mut xtask = testkit::command(program("xtask"));
    let said = ended(xtask.args(["book", "--api"]).arg(place.path()));
    assert_eq!(said.code, Some(0), "{said:?}");
    let page = std::fs::read_to_string(place.path().join("api.html")).unwrap();
    assert!(page.contains("api/memory_blob/index.html"), "{page}");
    let law = place.path().join("api/vpc/law/struct.Law.html");
    assert!(law.is_file(), "{}", law.display());
}

#[test]
#[ignore = "long: mdBook makes the book"]
fn the_book_replaces_nothing_but_a_book() {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("mine.txt");
    std::fs::write(&file, "mine").unwrap();
    let mut xtask = testkit::command(program("xtask"));
    let said = ended(xtask.arg("book").arg(place.path()));
    assert!(said.stderr.contains("neither empty nor a book"), "{said:?}");
    assert!(file.is_file());
}
