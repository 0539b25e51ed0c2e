//! Names the shared library for the dynamic linker: programs that were linked with one 0.x version
//! are not run with another.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let version = |part: &str| std::env::var(format!("CARGO_PKG_VERSION_{part}"));
    if let (Ok(major), Ok(minor)) = (version("MAJOR"), version("MINOR")) {
        println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libvpcclient.so.{major}.{minor}");
        // What iceoryx2 exports is not part of this library's interface.
        println!("cargo::rustc-cdylib-link-arg=-Wl,--exclude-libs,ALL");
    }
}
