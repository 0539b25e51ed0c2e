//! The library as a user finds it: Debian's packages that CMake makes, unpacked, and a project over
//! them.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use testkit::python::run;
use testkit::{Ended, Place, are_installed};

use crate::process::{closes_the_loop, library};

/// What lintian may say: the project has no address yet, and CPack calls ldconfig beside its trigger.
const ALLOWED: &str =
    "bogus-mail-host,bogus-mail-host-in-debian-changelog,maintscript-calls-ldconfig";

fn cmake(arguments: &[&str]) -> Command {
    let mut cmake = Command::new("cmake");
    cmake.args(arguments);
    cmake
}

/// Both packages, of the library that is tested.
fn packages(place: &Place) -> [PathBuf; 2] {
    let build = place.path("build");
    let mut configure = cmake(&["-DCMAKE_INSTALL_PREFIX=/usr", "-S"]);
    configure.arg(testkit::root().join("ipc/c"));
    configure.arg("-B").arg(&build);
    let built = library();
    let built = built.parent().unwrap().display();
    run(configure.arg(format!("-DVPCCLIENT_BUILT={built}"))).unwrap();
    run(Command::new("cpack").current_dir(&build)).unwrap();
    let version = env!("CARGO_PKG_VERSION");
    let (minor, _) = version.rsplit_once('.').unwrap();
    let architecture = run(Command::new("dpkg").arg("--print-architecture")).unwrap();
    [format!("libvpcclient{minor}"), "libvpcclient-dev".into()]
        .map(|name| build.join(format!("{name}_{version}_{}.deb", architecture.trim())))
}

fn lintian_finds_nothing(package: &Path) {
    let mut lintian = Command::new("lintian");
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
    let mut find = Command::new("find");
    let found = run(find.arg(root).args(["-name", name])).unwrap();
    let (path, rest) = found.split_once('\n').unwrap();
    assert_eq!(rest, "", "more than one {name}");
    Path::new(path).parent().unwrap().to_owned()
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
    for package in packages(&place) {
        lintian_finds_nothing(&package);
        let mut unpack = Command::new("dpkg-deb");
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
        testkit::root().join("ipc/c/tests/consumer"),
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

    let by_flags = place.path("by-flags");
    let mut flags = Command::new("pkg-config");
    flags.args(["--cflags", "--libs", "vpcclient"]);
    flags.env("PKG_CONFIG_PATH", directory_of(&root, "vpcclient.pc"));
    let flags = run(&mut flags).unwrap();
    let mut cc = Command::new("cc");
    cc.arg(testkit::root().join("ipc/c/examples/camera.c"));
    cc.args(flags.split_whitespace()).arg("-lm");
    run(cc.arg("-o").arg(&by_flags)).unwrap();

    let libraries = directory_of(&root, "libvpcclient.a");
    for (program, is_shared) in [
        (build.join("with-shared"), true),
        (build.join("with-static"), false),
        (by_flags, true),
    ] {
        let needed = run(Command::new("ldd")
            .arg(&program)
            .env("LD_LIBRARY_PATH", &libraries));
        assert_eq!(
            needed.unwrap().contains(libraries.to_str().unwrap()),
            is_shared,
            "{}",
            program.display()
        );
        let place = Place::new();
        let mut camera = Command::new(program);
        camera
            .arg(place.domain())
            .env("LD_LIBRARY_PATH", &libraries);
        camera.stdout(Stdio::piped());
        let start = [0.2, 0.0, 0.7, 0.0, 0.0, 0.0];
        closes_the_loop(&place, camera, start, [0.2, 0.0, 0.1, 0.0, 0.0, 0.0]);
    }
}
