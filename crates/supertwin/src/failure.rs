//! What can go wrong, and the exit status it has.

use std::process::ExitCode;
use supertwin_lab::{ConfigError, RunError};

/// Exit status of an interrupted call: 128 + SIGINT, as shells have it.
pub(crate) const INTERRUPTED: u8 = 130;

/// A failed call.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// The configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A run did not come to its end by itself.
    #[error("{name}: {cause}")]
    Run {
        /// Name of the run.
        name: String,
        /// Why.
        cause: RunError,
    },
    /// A file or folder can't be used.
    #[error("{path}: {cause}")]
    Path {
        /// Which.
        path: String,
        /// Why.
        cause: String,
    },
    /// The network can't be joined.
    #[error(transparent)]
    Link(#[from] supertwin_zenoh::LinkError),
    /// Certificates or their files are wrong.
    #[error(transparent)]
    Pki(#[from] supertwin_pki::PkiError),
    /// A request was not obeyed.
    #[error(transparent)]
    Client(#[from] supertwin_zenoh::ClientError),
    /// The call was right, and what it asked for is not so.
    #[error("{0}")]
    Verdict(String),
    /// The call itself is wrong.
    #[error("{0}")]
    Call(String),
}

impl Failure {
    /// Says so and gives the exit status.
    pub(crate) fn report(&self) -> ExitCode {
        crate::output::warn(&format!("error: {self}"));
        match self {
            Self::Run { cause: RunError::NonFinite(_), .. } | Self::Client(_) | Self::Verdict(_) => ExitCode::from(1),
            _ => ExitCode::from(2),
        }
    }
}
