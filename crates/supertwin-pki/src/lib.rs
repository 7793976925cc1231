//! Certificates of a fleet: its authority, what a certificate says, and the files that a holder has.
//!
//! ```text
//! pki/            0700  the authority's folder: stays at home
//!   ca.pem              what everybody trusts
//!   ca.key        0600
//!   anna/         0700  a holder's folder: is handed over
//!     ca.pem
//!     anna.pem          operator.argus-mini, thirty days
//!     anna.key    0600
//! ```
//!
//! All keys are ECDSA P-256. Nothing here replaces a key: renewal puts a new certificate of the same key in the old one's
//! place, in one step. There is no revocation list, as Zenoh reads none: certificates live shortly instead.

mod authority;
mod certificate;
mod credentials;
mod examine;

pub use authority::{Authority, Request};
pub use certificate::{Certificate, Standing, read};
pub use credentials::{Credentials, tls_files};
pub use examine::{Examined, examine, loose, span};

use std::path::Path;
use std::time::Duration;
use supertwin_protocol::clock::Clock;

/// A day.
pub const DAY: Duration = Duration::from_secs(24 * 3600);
/// How long a certificate is valid unless told otherwise.
pub const CERTIFICATE_LIFETIME: Duration = Duration::from_secs(30 * 24 * 3600);
/// How long an authority is valid unless told otherwise.
pub const AUTHORITY_LIFETIME: Duration = Duration::from_secs(5 * 365 * 24 * 3600);
/// Certificates are valid this long before they were made, for machines whose clock is behind.
pub const BACKDATED: Duration = Duration::from_secs(3600);

/// What is wrong with certificates, keys or their files.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PkiError {
    /// A file, and what is wrong with it.
    #[error("{path}: {cause}")]
    File {
        /// Which.
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

/// Seconds since 1970.
pub(crate) fn unix_s(clock: &dyn Clock) -> i64 {
    (clock.unix_ns() / 1_000_000_000) as i64
}

#[cfg(test)]
mod tests;
