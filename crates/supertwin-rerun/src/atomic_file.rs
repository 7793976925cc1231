//! Files that are there whole or not at all.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Creates the file at `path` by way of a neighbour that takes its name when it is complete.
///
/// `write` returns what it has to say. Without `overwrite` a file that exists stays as it is.
pub(crate) fn create<T, E: From<io::Error>>(
    path: &Path,
    overwrite: bool,
    write: impl FnOnce(File, &Path) -> Result<T, E>,
) -> Result<T, E> {
    if !overwrite && path.try_exists()? {
        return Err(exists().into());
    }
    let name = path.file_name().ok_or(io::ErrorKind::IsADirectory).map_err(io::Error::from)?;
    let mut unfinished = name.to_owned();
    unfinished.push(".unfinished");
    let place = path.with_file_name(unfinished);
    // One that is there is not ours: another call may be writing the same file now.
    let file = File::options().write(true).read(true).create_new(true).open(&place);
    let file = file.map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => {
            io::Error::new(error.kind(), format!("{} is there: remove it first", place.display()))
        }
        _ => error,
    })?;
    let unfinished = Unfinished(place);
    let done = write(file, &unfinished.0)?;
    if overwrite {
        std::fs::rename(&unfinished.0, path)?;
    } else {
        // Unlike a renamed file, a link never takes the place of one that came meanwhile.
        std::fs::hard_link(&unfinished.0, path).map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => exists(),
            _ => error,
        })?;
    }
    Ok(done)
}

fn exists() -> io::Error {
    io::Error::new(io::ErrorKind::AlreadyExists, "exists already; use --force to replace it, or another --out")
}

/// Goes away whatever happens.
struct Unfinished(PathBuf);

impl Drop for Unfinished {
    fn drop(&mut self) {
        drop(std::fs::remove_file(&self.0));
    }
}
