//! Fewer and larger pieces: a recording that was written second by second opens as fast as one that was written at once.

use rerun::rrd::{OptimizationProfile, optimize_file};
use std::path::Path;

/// Rewrites a recording that is closed. Until the new file is whole the old one stays; what goes wrong leaves it as it
/// was. Takes as much memory as the recording is long.
///
/// # Errors
/// When it can't be read, or there is no room for both.
pub fn compact(path: &Path) -> Result<(), String> {
    let mut name = std::ffi::OsString::from(".");
    name.push(path.file_name().ok_or("is no file")?);
    name.push(".compact");
    let new = path.with_file_name(name);
    let done = optimize_file(path, &new, &OptimizationProfile::LIVE)
        .map_err(|error| format!("{error:#}"))
        .and_then(|_| std::fs::rename(&new, path).map_err(|error| error.to_string()));
    if done.is_err() {
        // It may never have been there.
        let _ = std::fs::remove_file(&new);
    }
    done.map_err(|cause| format!("{}: {cause}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Options, RerunSink, read};
    use supertwin_core::run::Properties;
    use supertwin_core::{Probe, RunHeader, RunSink, Signal, Tick};

    static A: Signal = Signal { path: "test/a", components: &["x", "y"], units: &["m"], about: "" };
    static MODE: Signal = Signal { path: "test/mode", components: &[], units: &[], about: "" };

    #[test]
    fn nothing_changes_but_the_pieces() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.rrd");
        let mut sink = RerunSink::create(&path, Options { batch_ticks: 5, ..Options::default() }).unwrap();
        sink.begin(&RunHeader { name: "run".to_owned(), ..RunHeader::default() }).unwrap();
        for k in 0..500 {
            sink.tick(Tick { k, dt_s: 0.02 }).unwrap();
            sink.vector(&A, &[k as f64, 0.5]);
            sink.label(&MODE, if k < 300 { "off" } else { "on" });
        }
        sink.finish(&Properties::from([("ticks".to_owned(), 500_u64.into())])).unwrap();
        let (before, length) = (read(&path).unwrap(), path.metadata().unwrap().len());
        compact(&path).unwrap();
        let after = read(&path).unwrap();
        assert!(after.complete && path.metadata().unwrap().len() < length);
        assert_eq!(after.run, before.run);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_can_not_be_read_stays_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.rrd");
        std::fs::write(&path, "no recording").unwrap();
        assert!(compact(&path).unwrap_err().contains("run.rrd"));
        assert_eq!(std::fs::read(&path).unwrap(), b"no recording");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
