//! The viewer that everybody installs can open what is recorded here. What it then shows is tested with real runs, in
//! `tests/dashboards.rs`.

#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use crate::common;
use crate::python;
use std::path::Path;
use std::process::Command;
use supertwin_core::RunSink;
use supertwin_rerun::{Options, RerunSink};

fn record(path: &Path) {
    let mut sink = RerunSink::create(path, Options { overwrite: true, ..Default::default() }).unwrap();
    sink.begin(&common::header("follow_net adaptive seed 1")).unwrap();
    common::play(&mut sink, 3000).unwrap();
    sink.finish(&common::results()).unwrap();
}

#[test]
fn the_viewer_opens_a_recording() {
    let viewer = python::viewer(&python::environment());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    record(&path);

    let verified = python::succeed(Command::new(&viewer).args(["rrd", "verify"]).arg(&path));
    let said = String::from_utf8_lossy(&[verified.stdout, verified.stderr].concat()).into_owned();
    assert!(said.contains("1 file"), "{said}");
    let stats = python::succeed(Command::new(&viewer).args(["rrd", "stats"]).arg(&path));
    let said = String::from_utf8_lossy(&stats.stdout).into_owned();
    assert!(said.contains("num_entity_paths"), "{said}");
}
