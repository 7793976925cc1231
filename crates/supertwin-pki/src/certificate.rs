//! What a certificate says: who holds it, for which role and vehicle, which hosts it names, from when until when.

use crate::error::PkiError;
use serde::Serialize;
use std::net::IpAddr;
use std::path::Path;
use supertwin_protocol::clock::Clock;
use supertwin_protocol::role::{Role, Scope, parse_common_name};
use x509_parser::extensions::GeneralName;
use x509_parser::prelude::{FromDer, X509Certificate};
use x509_parser::time::ASN1Time;
use x509_parser::x509::AttributeTypeAndValue;

/// A certificate that was read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Certificate {
    /// What access control compares.
    pub common_name: String,
    /// The role in the common name, if it is one of ours.
    pub role: Option<Role>,
    /// The vehicles in the common name, if it is one of ours.
    pub scope: Option<Scope>,
    /// Name of who holds it, for people.
    pub holder: Option<String>,
    /// Name of the fleet.
    pub fleet: Option<String>,
    /// Hosts that it names: DNS names and addresses.
    pub hosts: Vec<String>,
    /// Common name of the authority that signed it.
    pub issuer: String,
    /// Serial number, in hexadecimal digits.
    pub serial: String,
    /// Whether it is an authority's own.
    pub is_authority: bool,
    /// Begin of its validity, seconds since 1970.
    pub not_before_s: i64,
    /// End of its validity, seconds since 1970.
    pub not_after_s: i64,
    #[serde(skip)]
    pub(crate) der: Vec<u8>,
}

/// How a certificate stands at a moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// In force, and not about to end.
    Valid,
    /// In force, and about to end.
    ExpiresSoon,
    /// No longer in force.
    Expired,
    /// Not yet in force: most likely this machine's clock is behind.
    NotYetValid,
}

impl Certificate {
    /// Reads a certificate in PEM; of several, the first.
    ///
    /// # Errors
    /// Why it is none.
    pub fn parse(pem: &[u8]) -> Result<Self, String> {
        let (_, pem) = x509_parser::pem::parse_x509_pem(pem).map_err(|_| "is no certificate in PEM".to_owned())?;
        if pem.label != "CERTIFICATE" {
            return Err(format!("holds a {} and no certificate", pem.label.to_lowercase()));
        }
        let broken = |error: &dyn std::fmt::Display| format!("is no X.509 certificate: {error}");
        let (_, x509) = X509Certificate::from_der(&pem.contents).map_err(|error| broken(&error))?;
        let subject = x509.subject();
        let common_name = text(subject.iter_common_name()).unwrap_or_default();
        let (role, scope) = parse_common_name(&common_name).unzip();
        let hosts = x509.subject_alternative_name().map_err(|error| broken(&error))?;
        let hosts = hosts.iter().flat_map(|names| &names.value.general_names).filter_map(host).collect();
        Ok(Self {
            role,
            scope,
            holder: text(subject.iter_organizational_unit()),
            fleet: text(subject.iter_organization()),
            hosts,
            issuer: text(x509.issuer().iter_common_name()).unwrap_or_default(),
            serial: x509.raw_serial().iter().map(|byte| format!("{byte:02x}")).collect(),
            is_authority: x509.is_ca(),
            not_before_s: x509.validity().not_before.timestamp(),
            not_after_s: x509.validity().not_after.timestamp(),
            common_name,
            der: pem.contents.clone(),
        })
    }

    /// Whether `authority` signed it.
    #[must_use]
    pub fn is_signed_by(&self, authority: &Self) -> bool {
        let (Ok((_, own)), Ok((_, other))) =
            (X509Certificate::from_der(&self.der), X509Certificate::from_der(&authority.der))
        else {
            return false;
        };
        own.issuer() == other.subject() && own.verify_signature(Some(other.public_key())).is_ok()
    }

    /// Its public key, as it is signed.
    pub(crate) fn public_key(&self) -> Vec<u8> {
        X509Certificate::from_der(&self.der).map_or_else(|_| Vec::new(), |(_, x509)| x509.public_key().raw.to_vec())
    }

    /// Seconds that are left; negative once it has expired.
    #[must_use]
    pub fn left_s(&self, clock: &dyn Clock) -> i64 {
        self.not_after_s - unix_s(clock)
    }

    /// How it stands; "soon" is in the last third of its life, at most ninety days and at least `within_s` seconds ahead.
    #[must_use]
    pub fn standing(&self, within_s: i64, clock: &dyn Clock) -> Standing {
        const LONGEST_S: i64 = 90 * 24 * 3600;
        let soon_s = ((self.not_after_s - self.not_before_s) / 3).min(LONGEST_S).max(within_s);
        match self.left_s(clock) {
            _ if unix_s(clock) < self.not_before_s => Standing::NotYetValid,
            // Like TLS, it is over when its last second is.
            left_s if left_s < 0 => Standing::Expired,
            left_s if left_s < soon_s => Standing::ExpiresSoon,
            _ => Standing::Valid,
        }
    }

    /// When it ends, for people: `2026-11-25 22:41:26 UTC`.
    #[must_use]
    pub fn not_after(&self) -> String {
        date(self.not_after_s)
    }

    /// When it begins, for people.
    #[must_use]
    pub fn not_before(&self) -> String {
        date(self.not_before_s)
    }
}

/// Reads the certificate in a file.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn read(path: &Path) -> Result<Certificate, PkiError> {
    let pem = std::fs::read(path).map_err(|error| PkiError::file(path, error))?;
    Certificate::parse(&pem).map_err(|cause| PkiError::file(path, cause))
}

/// Seconds since 1970.
pub(crate) fn unix_s(clock: &dyn Clock) -> i64 {
    (clock.unix_ns() / 1_000_000_000) as i64
}

fn date(unix_s: i64) -> String {
    let Ok(time) = ASN1Time::from_timestamp(unix_s) else { return format!("{unix_s} s") };
    let time = time.to_datetime();
    let (date, (hour, minute, second)) = (time.date(), time.to_hms());
    format!("{date} {hour:02}:{minute:02}:{second:02} UTC")
}

/// The first of an attribute.
fn text<'s, 'x: 's>(mut found: impl Iterator<Item = &'s AttributeTypeAndValue<'x>>) -> Option<String> {
    found.next().and_then(|value| value.as_str().ok()).map(str::to_owned)
}

fn host(name: &GeneralName<'_>) -> Option<String> {
    match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(bytes) => {
            let v4 = <[u8; 4]>::try_from(*bytes).map(IpAddr::from);
            v4.or_else(|_| <[u8; 16]>::try_from(*bytes).map(IpAddr::from)).ok().map(|address| address.to_string())
        }
        _ => None,
    }
}
