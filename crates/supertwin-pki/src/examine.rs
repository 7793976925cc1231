//! What is wrong with the certificates in a place, and what to do: for people who look after them.

use crate::authority::CA_KEY;
use crate::certificate::{Certificate, Standing, read, unix_s};
use crate::credentials::{CA_CERTIFICATE, Credentials};
use crate::error::PkiError;
use serde::Serialize;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use supertwin_protocol::clock::Clock;

/// One certificate, and what was found.
#[derive(Clone, Debug, Serialize)]
pub struct Examined {
    /// The certificate's file.
    pub path: PathBuf,
    /// What the certificate says.
    #[serde(flatten)]
    pub certificate: Certificate,
    /// How it stands now.
    pub standing: Standing,
    /// Days until it expires; negative once it has.
    pub days_left: f64,
    /// Each a sentence with a remedy; none when all is well.
    pub problems: Vec<String>,
}

/// Everything in a place: an authority's folder with its holders, a holder's folder, or a certificate. `within_s`: how
/// far ahead an end is worth a word, at least.
///
/// # Errors
/// When the place is none of these, or a certificate can't be read.
pub fn examine(place: &Path, within_s: i64, clock: &dyn Clock) -> Result<Vec<Examined>, PkiError> {
    if !place.is_dir() {
        let found = Credentials::find(place)?;
        let alone = found.key.exists().then_some(&found);
        return Ok(vec![examined(&found.certificate, alone, within_s, clock)?]);
    }
    let mut all = Vec::new();
    let entries = fs::read_dir(place).map_err(|error| PkiError::file(place, error))?;
    let mut holders: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    holders.sort();
    let authority = place.join(CA_CERTIFICATE);
    if authority.exists() && place.join(CA_KEY).exists() {
        let mut own = examined(&authority, None, within_s, clock)?;
        own.problems.extend(loose(&place.join(CA_KEY)));
        own.problems.extend(loose(place));
        all.push(own);
        holders.retain(|path| path.is_dir() && !hidden(path));
    } else {
        holders.retain(|path| path.extension().is_some_and(|extension| extension == "key"));
    }
    for holder in holders {
        let found = Credentials::find(&holder)?;
        all.push(examined(&found.certificate, Some(&found), within_s, clock)?);
    }
    if all.is_empty() {
        return Err(PkiError::file(place, "no certificates here: neither an authority's folder nor a holder's"));
    }
    Ok(all)
}

fn hidden(path: &Path) -> bool {
    path.file_name().is_none_or(|name| name.to_string_lossy().starts_with('.'))
}

fn examined(path: &Path, files: Option<&Credentials>, within_s: i64, clock: &dyn Clock) -> Result<Examined, PkiError> {
    let certificate = read(path)?;
    let mut problems = Vec::new();
    let standing = certificate.standing(within_s, clock);
    problems.extend(dated(&certificate, standing, clock));
    if let Some(files) = files {
        problems.extend(files.belong_together().err().map(|error| error.to_string()));
        problems.extend(loose(&files.key));
        problems.extend(files.key.parent().and_then(loose));
        if let Ok(ca) = read(&files.ca) {
            problems
                .extend(dated(&ca, ca.standing(within_s, clock), clock).map(|text| format!("its authority {text}")));
        }
    }
    let days_left = certificate.left_s(clock) as f64 / 86_400.0;
    Ok(Examined { path: path.to_owned(), certificate, standing, days_left, problems })
}

fn dated(certificate: &Certificate, standing: Standing, clock: &dyn Clock) -> Option<String> {
    let remedy = if certificate.is_authority {
        "make a new authority with `supertwin pki init --dir NEW` and issue anew"
    } else {
        "renew it where the authority is: `supertwin pki renew`"
    };
    match standing {
        Standing::Valid => None,
        Standing::ExpiresSoon => {
            Some(format!("expires in {}, on {}: {remedy}", span(certificate.left_s(clock)), certificate.not_after()))
        }
        Standing::Expired => {
            Some(format!("expired {} ago, on {}: {remedy}", span(-certificate.left_s(clock)), certificate.not_after()))
        }
        Standing::NotYetValid => Some(format!(
            "is valid only in {}, from {} on: is this machine's clock right?",
            span(certificate.not_before_s - unix_s(clock)),
            certificate.not_before()
        )),
    }
}

/// A length of time for people.
#[must_use]
pub fn span(s: i64) -> String {
    match s {
        ..120 => format!("{s} s"),
        120..7_200 => format!("{} minutes", s / 60),
        7_200..172_800 => format!("{} hours", s / 3_600),
        _ => format!("{} days", s / 86_400),
    }
}

/// Whether others than its owner may read a key or look into its folder, and the remedy.
#[must_use]
pub fn loose(path: &Path) -> Option<String> {
    let found = fs::metadata(path).ok()?;
    let mode = found.permissions().mode() & 0o777;
    let wanted = if found.is_dir() { 0o700 } else { 0o600 };
    (mode & 0o077 != 0)
        .then(|| format!("{} is open to others (mode {mode:03o}): chmod {wanted:03o} {0}", path.display()))
}
