//! Waits for what others write into a folder.
#![allow(unreachable_pub, reason = "two programs of tests use it")]

use rustix::fs::inotify::{CreateFlags, WatchFlags, add_watch, init};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::mpsc::channel;
use std::time::Duration;

/// Longest time in which nothing changes.
const LIMIT: Duration = Duration::from_secs(180);

/// Looks into a folder whenever something in it has changed, until there is what is looked for.
pub fn until_written<T>(folder: &Path, what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let watch = init(CreateFlags::CLOEXEC).expect("files can be watched");
    let changes = WatchFlags::CREATE | WatchFlags::MODIFY | WatchFlags::MOVED_TO | WatchFlags::CLOSE_WRITE;
    add_watch(&watch, folder, changes).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let (tell, told) = channel();
    // Ends with the folder at the latest: that is a change as well.
    std::thread::spawn(move || {
        let mut watch = File::from(watch);
        while watch.read(&mut [0; 4096]).is_ok() && tell.send(()).is_ok() {}
    });
    loop {
        if let Some(found) = look() {
            return found;
        }
        let changed = told.recv_timeout(LIMIT);
        assert!(changed.is_ok(), "{}: no {what}, and nothing changes any more", folder.display());
        // Of many changes only the last one matters.
        told.try_iter().for_each(drop);
    }
}
