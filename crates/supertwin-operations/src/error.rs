//! What can go wrong with an operation.

use supertwin_lab::{ConfigError, RunError};
use supertwin_pki::PkiError;
use supertwin_zenoh::{ClientError, LinkError};

/// An operation that was not done.
#[derive(Debug, thiserror::Error)]
pub enum OperationError {
    /// The configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A run did not come to its end by itself.
    #[error("{name}: {cause}")]
    Run {
        /// Name of the run.
        name: String,
        /// What ended it.
        cause: RunError,
    },
    /// A file or folder can't be used.
    #[error("{path}: {cause}")]
    Path {
        /// The file or folder.
        path: String,
        /// What is wrong with it.
        cause: String,
    },
    /// The network can't be joined.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Certificates or their files are wrong.
    #[error(transparent)]
    Pki(#[from] PkiError),
    /// A request was not obeyed.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// The options are right, and what they ask for is not there or not so.
    #[error("{0}")]
    Unmet(String),
    /// An option, or a value of it, is wrong.
    #[error("{0}")]
    Option(String),
}

impl OperationError {
    /// An error at `path`, which `cause` may name already.
    pub fn at(path: &std::path::Path, cause: &impl std::fmt::Display) -> Self {
        let path = path.display().to_string();
        Self::Path { cause: without_prefix(&path, cause), path }
    }
}

/// What `error` says after the name that it begins with.
pub(crate) fn without_prefix(name: &str, error: &impl std::fmt::Display) -> String {
    let text = error.to_string();
    text.strip_prefix(&format!("{name}: ")).unwrap_or(&text).to_owned()
}
