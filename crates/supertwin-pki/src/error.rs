//! What is wrong with certificates, keys or their files, and what to do.

use std::path::Path;

/// What is wrong with certificates, keys or their files.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PkiError {
    /// A file, and what is wrong with it.
    #[error("{path}: {cause}")]
    File {
        /// Path of the file.
        path: String,
        /// Why, and what to do.
        cause: String,
    },
    /// What was asked for is not legal.
    #[error("{0}")]
    Asked(String),
}

impl PkiError {
    #[allow(clippy::needless_pass_by_value, reason = "an error is handed over, and not used again")]
    pub(crate) fn file(path: &Path, cause: impl ToString) -> Self {
        Self::File { path: path.display().to_string(), cause: cause.to_string() }
    }
}
