//! Files that a call leaves: none replaces another unless the caller says so; and what is in a folder.

use crate::OperationError;
use std::fs::File;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// Writes `bytes` to `path`, in a folder that may not be there yet; with `force` whatever is there is replaced.
///
/// # Errors
/// The folder or the file can't be written, or the file is there and `force` is not given.
pub fn save(path: &Path, bytes: &[u8], force: bool) -> Result<(), OperationError> {
    let wrong = |cause: String| OperationError::at(path, &cause);
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|cause| wrong(format!("can't create its folder: {cause}")))?;
    }
    let mut how = File::options();
    how.write(true).create(force).truncate(force).create_new(!force);
    let mut file = how.open(path).map_err(|cause| match cause.kind() {
        ErrorKind::AlreadyExists => wrong("exists already; use --force to replace it".to_owned()),
        _ => wrong(format!("can't create the file: {cause}")),
    })?;
    file.write_all(bytes).map_err(|cause| wrong(cause.to_string()))
}

/// What in `folder` fits, by name.
pub(crate) fn entries(folder: &Path, fits: impl Fn(&Path) -> bool) -> Result<Vec<PathBuf>, OperationError> {
    let entries = std::fs::read_dir(folder).map_err(|cause| OperationError::at(folder, &cause))?;
    let mut found: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).filter(|path| fits(path)).collect();
    found.sort();
    Ok(found)
}
