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
//!
//! ```
//! use std::time::Duration;
//! use supertwin_pki::{Authority, Request};
//! use supertwin_protocol::{Role, Scope, SystemClock};
//!
//! let home = tempfile::tempdir()?;
//! let clock = SystemClock::start();
//! let year = Duration::from_secs(365 * 24 * 3600);
//! let authority = Authority::init(&home.path().join("pki"), "rataren", year, &clock)?;
//! let anna = Request::new(Role::Operator, Scope::Vehicle("argus-mini".to_owned()), "anna");
//! authority.issue(&anna, &clock)?;
//! assert!(home.path().join("pki/anna/anna.pem").exists());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod authority;
mod certificate;
mod credentials;
mod error;
mod examine;

pub use authority::{AUTHORITY_LIFETIME, Authority, BACKDATED, CERTIFICATE_LIFETIME, DAY, Request};
pub use certificate::{Certificate, Standing, read};
pub use credentials::Credentials;
pub use error::PkiError;
pub use examine::{Examined, examine, loose, span};

#[cfg(test)]
mod tests;
