//! The viewer that everybody installs can open what is recorded here.
//!
//! The viewer comes from PyPI into `target`, once. With `SUPERTWIN_SCREENSHOT=1` it also draws the first view; that
//! needs a Vulkan driver, such as the one in Debian's `mesa-vulkan-drivers` (with `libvulkan1` and `libegl1`).

#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use supertwin_core::RunSink;
use supertwin_rerun::{Options, RerunSink};

/// The same version as the crate that writes the files.
const VIEWER: &str = "rerun-sdk==0.36.3";

fn succeed(command: &mut Command) -> Output {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let said = [&output.stdout[..], &output.stderr].concat();
    assert!(output.status.success(), "{command:?}: {}\n{}", output.status, String::from_utf8_lossy(&said));
    output
}

/// The environment with the viewer in it, installed when it is not there yet.
fn environment() -> PathBuf {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
    let home = target.join("python-venv");
    // Other tests may do the same now: whoever holds the lock installs, the others find it installed.
    let lock = fs::File::create(target.join("python-venv.lock")).unwrap();
    lock.lock().unwrap();
    // Names what is installed, and is only there when the installation came to its end.
    let installed = home.join("installed");
    if fs::read_to_string(&installed).is_ok_and(|what| what == VIEWER) {
        return home;
    }
    succeed(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&home));
    let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", VIEWER];
    succeed(Command::new(home.join("bin/python")).args(pip));
    fs::write(installed, VIEWER).unwrap();
    home
}

/// The viewer itself; the `rerun` on the path of the environment is a script around it.
fn viewer(environment: &Path) -> PathBuf {
    let lib = fs::read_dir(environment.join("lib")).unwrap().flatten();
    let binary = |python: fs::DirEntry| python.path().join("site-packages/rerun_sdk/rerun_cli/rerun");
    lib.map(binary).find(|path| path.exists()).expect("the viewer is installed")
}

fn record(path: &Path) {
    let mut sink = RerunSink::create(path, Options { overwrite: true, ..Default::default() }).unwrap();
    sink.begin(&common::header("follow_net adaptive seed 1")).unwrap();
    common::play(&mut sink, 3000).unwrap();
    sink.finish(&common::results()).unwrap();
}

#[test]
fn the_viewer_opens_a_recording() {
    let environment = environment();
    let viewer = viewer(&environment);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    record(&path);

    let verified = succeed(Command::new(&viewer).args(["rrd", "verify"]).arg(&path));
    let said = String::from_utf8_lossy(&[verified.stdout, verified.stderr].concat()).into_owned();
    assert!(said.contains("1 file"), "{said}");
    let stats = succeed(Command::new(&viewer).args(["rrd", "stats"]).arg(&path));
    let said = String::from_utf8_lossy(&stats.stdout).into_owned();
    assert!(said.contains("num_entity_paths"), "{said}");

    if std::env::var_os("SUPERTWIN_SCREENSHOT").is_some_and(|wanted| wanted == "1") {
        screenshot(&environment, &viewer, &path);
    }
}

/// Counts pixels near the colours of the curves "measured" and "reference", and those that are not the background.
const COUNT: &str = "
import sys
from PIL import Image
image = Image.open(sys.argv[1]).convert('RGB')
background = max(image.getcolors(1 << 24))[1]
pixels = list(image.getdata())
near = lambda a, b: sum(abs(x - y) for x, y in zip(a, b)) < 60
print(image.width, image.height,
    sum(near(p, (0x4D, 0xA6, 0xFF)) for p in pixels),
    sum(near(p, (0xFF, 0x4B, 0x4B)) for p in pixels),
    sum(not near(p, background) for p in pixels))
";

/// Draws the first view and looks whether the curves are in it.
fn screenshot(environment: &Path, viewer: &Path, recording: &Path) {
    let picture = Path::new(env!("CARGO_TARGET_TMPDIR")).join("first_view.png");
    if picture.exists() {
        fs::remove_file(&picture).unwrap();
    }
    let home = tempfile::tempdir().unwrap();
    let mut command = Command::new(viewer);
    command.env("RUST_LOG", "error").env("XDG_RUNTIME_DIR", home.path()).env("HOME", home.path());
    command.args(["--headless", "--new", "--window-size", "1600x900", "--screenshot-to"]).arg(&picture);
    succeed(command.arg(recording));

    let counted = succeed(Command::new(environment.join("bin/python")).args(["-c", COUNT]).arg(&picture));
    let counted = String::from_utf8(counted.stdout).unwrap();
    let counted: Vec<usize> = counted.split_whitespace().map(|number| number.parse().unwrap()).collect();
    let [width, height, measured, reference, drawn] = counted[..] else { panic!("{counted:?}") };
    assert_eq!((width, height), (3200, 1800));
    assert!(measured > 2000 && reference > 2000, "the curves are missing: {counted:?}");
    assert!(drawn > width * height / 50, "the picture is empty: {counted:?}");
}
