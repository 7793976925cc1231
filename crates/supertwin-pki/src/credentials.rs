//! The files of a holder: what it trusts, its certificate, its key; and whether they are good.

use crate::certificate::{Certificate, Standing, read};
use crate::error::PkiError;
use rcgen::KeyPair;
use std::fs;
use std::path::{Path, PathBuf};
use supertwin_protocol::clock::Clock;

/// What a holder trusts, beside its certificate.
pub(crate) const CA_CERTIFICATE: &str = "ca.pem";

/// The three files of a holder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Credentials {
    /// The authority's certificate.
    pub ca: PathBuf,
    /// The holder's certificate.
    pub certificate: PathBuf,
    /// The holder's key.
    pub key: PathBuf,
}

impl Credentials {
    /// `ca.pem`, `NAME.pem` and `NAME.key` in a folder, whether they are there or not.
    #[must_use]
    pub fn named(folder: &Path, name: &str) -> Self {
        Self {
            ca: folder.join(CA_CERTIFICATE),
            certificate: folder.join(format!("{name}.pem")),
            key: folder.join(format!("{name}.key")),
        }
    }

    /// The credentials at a place: a holder's folder, its certificate, or both their names without `.pem` and `.key`.
    ///
    /// # Errors
    /// When there are none, or several.
    pub fn find(place: &Path) -> Result<Self, PkiError> {
        if place.is_dir() {
            return Self::in_folder(place);
        }
        let name = place.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let name = name.strip_suffix(".pem").or_else(|| name.strip_suffix(".key")).unwrap_or(name);
        let found = Self::named(place.parent().unwrap_or(Path::new("")), name);
        if found.certificate.exists() || found.key.exists() {
            return Ok(found);
        }
        Err(PkiError::file(place, "no credentials: must be the folder of a holder, as `supertwin pki issue` makes it"))
    }

    fn in_folder(folder: &Path) -> Result<Self, PkiError> {
        let entries = fs::read_dir(folder).map_err(|error| PkiError::file(folder, error))?;
        let mut names: Vec<String> = entries
            .flatten()
            .filter_map(|entry| entry.file_name().into_string().ok())
            .filter_map(|name| name.strip_suffix(".key").map(str::to_owned))
            .collect();
        names.sort();
        match names.as_slice() {
            [name] if name == "ca" => {
                let cause = "is the authority's own folder: give the folder of a holder in it";
                Err(PkiError::file(folder, cause))
            }
            [name] => Ok(Self::named(folder, name)),
            [] => Err(PkiError::file(folder, "no credentials in it: no NAME.key beside ca.pem and NAME.pem")),
            several => {
                let (last, first) = (several.last().cloned().unwrap_or_default(), folder.join(&several[0]));
                let cause = format!("has keys of several, up to {last}: say whose, e.g. {}", first.display());
                Err(PkiError::file(folder, cause))
            }
        }
    }

    /// Reads and checks all three: they belong together and are in force.
    ///
    /// # Errors
    /// Names the file, what is wrong and what to do.
    pub fn check(&self, clock: &dyn Clock) -> Result<Certificate, PkiError> {
        check_certificate(&self.certificate, clock)?;
        check_certificate(&self.ca, clock)?;
        self.belong_together()
    }

    /// Reads all three, whenever they are in force.
    ///
    /// # Errors
    /// When a file can't be read, or they do not belong together.
    pub fn belong_together(&self) -> Result<Certificate, PkiError> {
        let (certificate, ca) = (read(&self.certificate)?, read(&self.ca)?);
        if !certificate.is_signed_by(&ca) {
            let cause = format!("was not signed by the authority in {}", self.ca.display());
            return Err(PkiError::file(&self.certificate, cause));
        }
        let key = read_key(&self.key)?;
        if rcgen::PublicKeyData::subject_public_key_info(&key) != certificate.public_key() {
            return Err(PkiError::file(&self.key, format!("is not the key of {}", self.certificate.display())));
        }
        Ok(certificate)
    }
}

/// A certificate that is in force.
fn check_certificate(path: &Path, clock: &dyn Clock) -> Result<(), PkiError> {
    let certificate = read(path)?;
    let cause = match certificate.standing(0, clock) {
        Standing::Valid | Standing::ExpiresSoon => return Ok(()),
        Standing::Expired if certificate.is_authority => {
            format!("the authority expired on {}: make a new one with `supertwin pki init`", certificate.not_after())
        }
        Standing::Expired => format!(
            "expired on {}: renew it where the authority is, with `supertwin pki renew`",
            certificate.not_after()
        ),
        Standing::NotYetValid => {
            format!("valid only from {} on: is this machine's clock right?", certificate.not_before())
        }
    };
    Err(PkiError::file(path, cause))
}

pub(crate) fn read_key(path: &Path) -> Result<KeyPair, PkiError> {
    let pem = fs::read_to_string(path).map_err(|error| PkiError::file(path, error))?;
    KeyPair::from_pem(&pem).map_err(|error| PkiError::file(path, format!("is no private key in PEM: {error}")))
}
