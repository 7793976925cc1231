//! Whatever bytes a recording consists of: it is read as far as it goes or refused, what is missing is named with its
//! place, and what can be saved is whole when it has been repaired.

use super::read::{Recording, read_parts, read_selected};
use super::repair::{RepairError, repair};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// One payload.
pub(crate) fn check(payload: &[u8]) {
    let folder = folder();
    let (path, to) = (folder.join("run.rrd"), folder.join("repaired.rrd"));
    std::fs::write(&path, payload).expect("a file");
    let length = payload.len() as u64;
    let whole = read(&path, &|_| true);
    // Of a closed file only the wanted parts are looked at, found by its list of contents.
    let part = read_selected(&path, &|signal| signal.starts_with("controller/")).ok();
    for recording in [&whole, &part].into_iter().flatten() {
        for damage in &recording.damage {
            let end = damage.from.checked_add(damage.bytes).expect("a place in a file");
            assert!(end <= length && !damage.problem.is_empty(), "{damage}: not in the file of {length} bytes");
            assert!(!damage.to_string().is_empty());
        }
        for (signal, columns) in &recording.signals {
            assert_eq!(columns.tick.len(), columns.time_ns.len(), "{signal}");
            assert_eq!(columns.values.len(), columns.tick.len() * columns.width, "{signal}");
            assert!(columns.clocks.values().all(|clock| clock.len() == columns.tick.len()), "{signal}");
        }
        assert_eq!(recording.complete, recording.damage.is_empty());
    }
    match repair(&path, &to, true) {
        Ok(repair) => {
            let lost: u64 = whole.iter().flat_map(|whole| &whole.damage).map(|damage| damage.bytes).sum();
            assert_eq!((repair.bytes, repair.lost_bytes), (length, lost));
            assert_eq!(to.is_file(), !repair.was_whole(), "a whole file is left alone");
            if to.is_file() {
                // A repair reads what it has written, and fails when that is not whole.
                std::fs::remove_file(&to).expect("removed");
            }
        }
        Err(RepairError::Read(_)) => assert!(whole.is_none(), "read, and not read for repair"),
        Err(RepairError::Nothing { .. }) => assert!(whole.is_some_and(|whole| whole.rows.is_empty())),
        Err(error) => panic!("{error}"),
    }
}

fn read(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Option<Recording> {
    read_parts(&[path.to_owned()], wanted).ok()
}

/// One of this process; its files are replaced by every payload.
fn folder() -> PathBuf {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    FOLDER.get_or_init(|| tempfile::tempdir().expect("a folder")).path().to_owned()
}
