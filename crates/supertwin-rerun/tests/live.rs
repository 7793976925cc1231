//! The live view with the viewer that everybody installs: it gets what is shown, and when it stops nobody waits for it.
#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use crate::common;
use crate::python;
use crate::written::until_written;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use supertwin_core::run::Properties;
use supertwin_core::signal::tracking;
use supertwin_core::{Probe, RunHeader, RunSink, Signal, Tick};
use supertwin_rerun::{Live, RerunSink, read};

/// A viewer without a window, that keeps what it gets.
struct Viewer(Child);

impl Viewer {
    fn open(url: &str, file: &Path) -> Self {
        let viewer = python::viewer(&python::environment());
        // It listens as well, and would share its usual port with the viewer of another test.
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let mut command = Command::new(viewer);
        command.arg(url).args(["--port", &port.to_string()]).arg("--save").arg(file);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let mut viewer = Self(command.spawn().unwrap());
        viewer.until_written(file, |file| file.exists().then_some(()));
        viewer
    }

    /// Waits until it has written something into its file, as long as it runs.
    fn until_written<T>(&mut self, file: &Path, mut look: impl FnMut(&Path) -> Option<T>) -> T {
        until_written(file.parent().unwrap(), "recording of the viewer", || {
            assert!(self.0.try_wait().unwrap().is_none(), "the viewer has ended");
            look(file)
        })
    }

    fn signal(&self, name: &str) {
        python::succeed(Command::new("kill").args(["-s", name, &self.0.id().to_string()]));
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_viewer_gets_what_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let (file, live) = (folder.path().join("got.rrd"), Live::serve(0, None).unwrap());
    let mut sink = RerunSink::live(&live, 10);
    sink.begin(&common::header("live")).unwrap();
    let mut viewer = Viewer::open(&live.url(), &file);
    common::play(&mut sink, 500).unwrap();
    sink.finish(&common::results()).unwrap();
    // The last of it is its results.
    let whole = |file: &Path| read(file).ok().filter(|got| got.properties.contains_key("result"));
    let got = viewer.until_written(&file, whole);
    drop(viewer);
    assert_eq!(live.dropped(), 0);
    assert_eq!(got.signals[tracking::DEPTH.path].tick, (0..500).collect::<Vec<_>>());
    assert_eq!(got.signals[tracking::DEPTH.path].names, ["measured", "reference", "true"]);
    assert_eq!(got.name, "live");
}

static WIDE: Signal = Signal { path: "test/wide", components: &[], units: &["m"], about: "" };

#[test]
fn a_viewer_that_is_stopped_costs_pictures_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let (file, live) = (folder.path().join("got.rrd"), Live::serve(0, None).unwrap());
    let mut sink = RerunSink::live(&live, 100);
    sink.begin(&RunHeader { name: "live".to_owned(), ..RunHeader::default() }).unwrap();
    let viewer = Viewer::open(&live.url(), &file);
    viewer.signal("STOP");
    // Batches of 1.6 MB, until the server holds its thread up and the queue is full: the loop goes on all the same.
    let values = [0.5; 2000];
    for k in 0..400_000 {
        sink.tick(Tick { k, dt_s: 0.02 }).unwrap();
        sink.vector(&WIDE, &values);
        if live.dropped() > 3 {
            break;
        }
    }
    assert!(live.dropped() > 3);
    sink.finish(&Properties::new()).unwrap();
    viewer.signal("CONT");
}

#[test]
fn nobody_has_to_look() {
    let live = Live::serve(0, None).unwrap();
    let mut sink = RerunSink::live(&live, 10);
    sink.begin(&common::header("live")).unwrap();
    common::play(&mut sink, 5000).unwrap();
    sink.finish(&common::results()).unwrap();
    assert!(live.url().contains("127.0.0.1"), "on this machine only");
}
