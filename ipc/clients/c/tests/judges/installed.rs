//! The library as a user finds it: Debian's packages that CMake makes, unpacked, and a project over
//! them.

use std::path::{Path, PathBuf};
use std::process::Command;

use testkit::python::run;
use testkit::{Ended, Place, are_installed};

use crate::program::{closes_the_loop, library};

/// What lintian may say: the project has no address yet, and CPack calls ldconfig beside its trigger.
const ALLOWED: &str =
    "bogus-mail-host,bogus-mail-host-in-debian-changelog,maintscript-calls-ldconfig";

fn cmake(arguments: &[&str]) -> Command {
    let mut cmake = testkit::command("cmake");
    cmake.args(arguments);
    cmake
}

/// Configures the build of the packages, of the library that is tested.
fn configure(place: &Place, name: &str, more: &[&str]) -> PathBuf {
    let build = place.path(name);
    let mut configure = cmake(&["-DCMAKE_INSTALL_PREFIX=/usr", "-S"]);
    configure.arg(testkit::root().join("ipc/clients/c"));
    configure.arg("-B").arg(&build).args(more);
    let built = library();
    let built = built.parent().unwrap().display();
    run(configure.arg(format!("-DVPCCLIENT_BUILT={built}"))).unwrap();
    build
}

/// Both packages.
fn packages(place: &Place) -> [PathBuf; 2] {
    let build = configure(place, "build", &[]);
    run(testkit::command("cpack").current_dir(&build)).unwrap();
    let version = env!("CARGO_PKG_VERSION");
    let (minor, _) = version.rsplit_once('.').unwrap();
    let architecture = run(testkit::command("dpkg").arg("--print-architecture")).unwrap();
    [format!("libvpcclient{minor}"), "libvpcclient-dev".into()]
        .map(|name| build.join(format!("{name}_{version}_{}.deb", architecture.trim())))
}

fn lintian_finds_nothing(package: &Path) {
    let mut lintian = testkit::command("lintian");
    lintian.args(["--fail-on", "error,warning", "--suppress-tags", ALLOWED]);
    if rustix::process::geteuid().is_root() {
        lintian.arg("--allow-root");
    }
    lintian.arg(package);
    let said = Ended::from(lintian.output().unwrap());
    assert!(said.code == Some(0) && said.stdout.is_empty(), "{said:?}");
}

/// The directory of a file that the packages brought.
fn directory_of(root: &Path, name: &str) -> PathBuf {
    let mut find = testkit::command("find");
    let found = run(find.arg(root).args(["-name", name])).unwrap();
    let (path, rest) = found.split_once('\n').unwrap();
    assert_eq!(rest, "", "more than one {name}");
    Path::new(path).parent().unwrap().to_owned()
}

#[test]
fn two_lines_build_a_program_without_cmake() {
    if !are_installed("a program without CMake", &["cc=gcc"]) {
        return;
    }
    let readme = include_str!("../../README.md");
    let line = readme.lines().find(|line| line.starts_with("cc -I"));
    let place = Place::new();
    let (built, program) = (library().with_extension("a"), place.path("camera"));
    let line = line.unwrap();
    let line = line.replace("target/release/libvpcclient.a", built.to_str().unwrap());
    let line = line.replace("-o camera", &format!("-o {}", program.display()));
    let mut shell = testkit::command("sh");
    run(shell.args(["-c", &line]).current_dir(testkit::root())).unwrap();
    let camera = testkit::command(program);
    let (start, twist) = (
        [0.2, 0.0, 0.7, 0.0, 0.0, 0.0],
        [0.2, 0.0, 0.1, 0.0, 0.0, 0.0],
    );
    closes_the_loop(&place, camera, start, twist);
}

#[test]
fn a_project_builds_over_the_packages_and_closes_the_loop() {
    let tools = [
        "cmake",
        "cc=gcc",
        "pkg-config",
        "dpkg-shlibdeps=dpkg-dev",
        "lintian",
    ];
    if !are_installed("a project over the packages", &tools) {
        return;
    }
    let place = Place::new();
    let root = place.path("root");
    let packages = packages(&place);
    // A program that was built with it needs it, or a later one.
    let mut needed = testkit::command("dpkg-deb");
    let needed = run(needed.arg("--info").arg(&packages[0]).arg("shlibs")).unwrap();
    let least = format!("(>= {})\n", env!("CARGO_PKG_VERSION"));
    assert!(needed.ends_with(&least), "{needed}");
    for package in packages {
        lintian_finds_nothing(&package);
        let mut unpack = testkit::command("dpkg-deb");
        run(unpack.arg("--extract").arg(&package).arg(&root)).unwrap();
    }

    let configured = |source: &Path, build: &Path| {
        let mut configure = cmake(&["-S"]);
        configure.arg(source).arg("-B").arg(build);
        configure.arg(format!(
            "-DCMAKE_PREFIX_PATH={}",
            root.join("usr").display()
        ));
        Ended::from(configure.output().unwrap())
    };
    let (source, build) = (
        testkit::root().join("ipc/clients/c/tests/consumer"),
        place.path("consumer"),
    );
    let configuration = configured(&source, &build);
    assert_eq!(configuration.code, Some(0), "{configuration:?}");
    run(cmake(&["--build"]).arg(&build)).unwrap();

    // Another minor version may have another interface.
    let lists = std::fs::read_to_string(source.join("CMakeLists.txt")).unwrap();
    let lists = lists.replace("vpcclient 0.1", "vpcclient 0.0");
    std::fs::create_dir(place.path("other")).unwrap();
    place.file("other/CMakeLists.txt", lists);
    let other = configured(&place.path("other"), &place.path("other-build"));
    assert!(
        other.code == Some(1) && other.stderr.contains("requested version \"0.0\""),
        "{other:?}"
    );

    let by_flags = |name: &str, more: &[&str], library: &str| {
        let mut flags = testkit::command("pkg-config");
        flags.args(["--cflags", "--libs", "vpcclient"]).args(more);
        flags.env("PKG_CONFIG_PATH", directory_of(&root, "vpcclient.pc"));
        let flags = run(&mut flags).unwrap().replace("-lvpcclient", library);
        let program = place.path(name);
        let mut cc = testkit::command("cc");
        cc.arg(testkit::root().join("ipc/clients/c/examples/camera.c"));
        cc.args(flags.split_whitespace()).arg("-lm");
        run(cc.arg("-o").arg(&program)).unwrap();
        program
    };

    let libraries = directory_of(&root, "libvpcclient.a");
    for (program, is_shared) in [
        (build.join("with-shared"), true),
        (build.join("with-static"), false),
        (by_flags("flags", &[], "-lvpcclient"), true),
        // The linker prefers the shared one of two by the same name.
        (
            by_flags("static-flags", &["--static"], "-l:libvpcclient.a"),
            false,
        ),
    ] {
        let needed = run(testkit::command("ldd")
            .arg(&program)
            .env("LD_LIBRARY_PATH", &libraries));
        assert_eq!(
            needed.unwrap().contains(libraries.to_str().unwrap()),
            is_shared,
            "{}",
            program.display()
        );
        let place = Place::new();
        let mut camera = testkit::command(program);
        camera.env("LD_LIBRARY_PATH", &libraries);
        let start = [0.2, 0.0, 0.7, 0.0, 0.0, 0.0];
        closes_the_loop(&place, camera, start, [0.2, 0.0, 0.1, 0.0, 0.0, 0.0]);
    }
}

#[test]
fn packages_of_a_cross_build_are_for_the_machine_that_it_is_for() {
    if !are_installed("a cross build", &["cmake", "cc=gcc"]) {
        return;
    }
    let place = Place::new();
    let packing = |processor: &str| {
        let target = format!("-DCMAKE_SYSTEM_PROCESSOR={processor}");
        let build = configure(&place, processor, &["-DCMAKE_SYSTEM_NAME=Linux", &target]);
        std::fs::read_to_string(build.join("CPackConfig.cmake"))
    };
    for (processor, architecture) in [("aarch64", "arm64"), ("x86_64", "amd64")] {
        let packing = packing(processor).unwrap();
        let line = format!("set(CPACK_DEBIAN_PACKAGE_ARCHITECTURE \"{architecture}\")");
        assert!(packing.contains(&line), "{packing}");
    }
    // Debian's name of it is not known.
    assert!(packing("sparc").is_err());
}
