//! Programs in C over the shared library of `ipc/clients/c`.

use std::path::{Path, PathBuf};

use crate::{Place, root};

/// Compiles `source` into `place`, where it finds `library`, a `libvpcclient.so`. Warnings are
/// errors.
///
/// # Panics
/// Where it does not compile.
pub fn compiled(place: &Place, source: &Path, library: &Path) -> PathBuf {
    let version = (
        env!("CARGO_PKG_VERSION_MAJOR"),
        env!("CARGO_PKG_VERSION_MINOR"),
    );
    // The dynamic linker looks for this name.
    let named = place.path(&format!("libvpcclient.so.{}.{}", version.0, version.1));
    let _ = std::os::unix::fs::symlink(library, &named);
    let program = place.path("program");
    let mut cc = crate::command("cc");
    cc.args(["-std=c11", "-pedantic", "-Wall", "-Wextra", "-Werror", "-I"]);
    cc.arg(root().join("ipc/clients/c/include")).arg(source);
    cc.arg("-o").arg(&program).arg(&named).arg("-lm");
    cc.arg(format!("-Wl,-rpath,{}", place.path("").display()));
    let status = cc.status();
    assert!(
        status.is_ok_and(|status| status.success()),
        "{} does not compile",
        source.display()
    );
    program
}
