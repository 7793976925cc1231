//! The authority of a fleet: signs certificates, and renews those that it has signed.

use crate::certificate::{Certificate, read, unix_s};
use crate::credentials::{CA_CERTIFICATE, Credentials, read_key};
use crate::error::PkiError;
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, KeyUsagePurpose,
    SerialNumber, SubjectPublicKeyInfo,
};
use std::fs;
use std::io::Write;
use std::net::IpAddr;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;
use supertwin_protocol::clock::Clock;
use supertwin_protocol::keys;
use supertwin_protocol::role::{Role, Scope, common_name};

/// A day.
pub const DAY: Duration = Duration::from_secs(24 * 3600);
/// How long a certificate is valid unless told otherwise.
pub const CERTIFICATE_LIFETIME: Duration = Duration::from_secs(30 * 24 * 3600);
/// How long an authority is valid unless told otherwise.
pub const AUTHORITY_LIFETIME: Duration = Duration::from_secs(5 * 365 * 24 * 3600);
/// Certificates are valid this long before they were made, for machines whose clock is behind.
pub const BACKDATED: Duration = Duration::from_secs(3600);
/// The authority's key, beside its certificate.
pub(crate) const CA_KEY: &str = "ca.key";
/// Longest common name of X.520.
const MAX_COMMON_NAME: usize = 64;
/// The year 9999 is the last that a certificate can name.
const MAX_LIFETIME: Duration = Duration::from_secs(100 * 365 * 24 * 3600);

/// What a certificate is wanted for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// What its holder may do.
    pub role: Role,
    /// The vehicles with which it may.
    pub scope: Scope,
    /// Who holds it: a name of its own in this fleet.
    pub holder: String,
    /// DNS names and addresses at which it is reached; only for a role that listens.
    pub hosts: Vec<String>,
    /// How long the certificate is in force, from now on.
    pub lifetime: Duration,
}

impl Request {
    /// For thirty days, and no hosts.
    #[must_use]
    pub fn new(role: Role, scope: Scope, holder: &str) -> Self {
        Self { role, scope, holder: holder.to_owned(), hosts: Vec::new(), lifetime: CERTIFICATE_LIFETIME }
    }

    /// Reached at these DNS names and addresses.
    #[must_use]
    pub fn at(mut self, hosts: &[&str]) -> Self {
        self.hosts = hosts.iter().map(|&host| host.to_owned()).collect();
        self
    }

    fn check(&self) -> Result<(), PkiError> {
        let (holder, name) = (&self.holder, common_name(self.role, &self.scope));
        let cause = if !is_file_name(holder) {
            let rule = "must be 1 to 64 letters, digits, '-', '_' or '.', must not begin with '.' and not be ca";
            format!("holder {holder}: {rule}")
        } else if name.len() > MAX_COMMON_NAME {
            format!("{name}: a common name has at most {MAX_COMMON_NAME} letters")
        } else if let Some(host) = self.hosts.iter().find(|host| !is_host(host)) {
            format!("host {host}: must be a DNS name such as vehicle.local or an address, without a port")
        } else if self.role.listens() && self.hosts.is_empty() {
            format!("{name}: others connect to it, so its certificate must name a host")
        } else if !self.role.listens() && !self.hosts.is_empty() {
            // Else whoever holds it could stand for the vehicle's router.
            format!("{name}: nobody connects to it, so its certificate must name no host")
        } else {
            return check_lifetime(self.lifetime);
        };
        Err(PkiError::Asked(cause))
    }
}

fn check_lifetime(lifetime: Duration) -> Result<(), PkiError> {
    if lifetime.as_secs() > 0 && lifetime <= MAX_LIFETIME {
        return Ok(());
    }
    Err(PkiError::Asked(format!("lifetime {} s: must lie between a second and a hundred years", lifetime.as_secs())))
}

/// May be the name of a holder's folder beside the authority's own files.
fn is_file_name(name: &str) -> bool {
    keys::is_name(name) && !name.starts_with('.') && name != "ca"
}

/// May be the host of an endpoint.
fn is_host(name: &str) -> bool {
    let label = |label: &str| {
        let legal = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
        (1..=63).contains(&label.len()) && label.chars().all(legal) && !label.starts_with('-') && !label.ends_with('-')
    };
    name.parse::<IpAddr>().is_ok() || (name.len() <= 253 && name.split('.').all(label))
}

/// Signs certificates.
pub struct Authority {
    /// Folder of the authority.
    pub folder: PathBuf,
    /// The certificate of the authority itself.
    pub certificate: Certificate,
    fleet: String,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    /// Makes the authority of a fleet in `folder`, which may not have one.
    ///
    /// # Errors
    /// When there is one, the name is no name, or a file can't be written.
    pub fn init(folder: &Path, fleet: &str, lifetime: Duration, clock: &dyn Clock) -> Result<Self, PkiError> {
        if !keys::is_name(fleet) {
            return Err(PkiError::Asked(format!("fleet {fleet}: must be 1 to 64 letters, digits, '-', '_' or '.'")));
        }
        check_lifetime(lifetime)?;
        for name in [CA_KEY, CA_CERTIFICATE] {
            let path = folder.join(name);
            if path.exists() {
                let cause = "there is an authority here, and a key is never replaced; choose another folder";
                return Err(PkiError::file(&path, cause));
            }
        }
        if !folder.exists() {
            make_folder(folder)?;
        }
        let name = format!("{fleet} authority");
        let mut wanted = dated(&name, lifetime, None, clock)?;
        wanted.distinguished_name.push(DnType::OrganizationName, fleet);
        wanted.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        wanted.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        let key = KeyPair::generate().map_err(crypto(folder))?;
        let made = wanted.self_signed(&key).map_err(crypto(folder))?;
        write(&folder.join(CA_KEY), &key.serialize_pem(), KEY_MODE)?;
        write(&folder.join(CA_CERTIFICATE), &made.pem(), CERTIFICATE_MODE)?;
        Self::open(folder)
    }

    /// The authority in `folder`.
    ///
    /// # Errors
    /// When there is none, or its files do not belong together.
    pub fn open(folder: &Path) -> Result<Self, PkiError> {
        let (path, key_path) = (folder.join(CA_CERTIFICATE), folder.join(CA_KEY));
        if !path.exists() {
            return Err(PkiError::file(folder, "no authority here (no ca.pem): make one with `supertwin pki init`"));
        }
        let certificate = read(&path)?;
        if !key_path.exists() {
            let cause = "missing: this folder can't sign; certificates are issued and renewed where the authority is";
            return Err(PkiError::file(&key_path, cause));
        }
        let key = read_key(&key_path)?;
        if rcgen::PublicKeyData::subject_public_key_info(&key) != certificate.public_key() {
            return Err(PkiError::file(&key_path, format!("is not the key of {}", path.display())));
        }
        let issuer = Issuer::from_ca_cert_der(&certificate.der.as_slice().into(), key).map_err(crypto(&path))?;
        let fleet = certificate.fleet.clone().unwrap_or_default();
        Ok(Self { folder: folder.to_owned(), certificate, fleet, issuer })
    }

    /// Makes a key and a certificate, in a new folder named after the holder.
    ///
    /// # Errors
    /// When the request is not legal, the holder has a folder, the authority has expired, or a file can't be written.
    pub fn issue(&self, request: &Request, clock: &dyn Clock) -> Result<Credentials, PkiError> {
        request.check()?;
        let folder = self.folder.join(&request.holder);
        if folder.exists() {
            let cause = "exists, and a key is never replaced; renew its certificate with `supertwin pki renew`, or choose \
                         another name";
            return Err(PkiError::file(&folder, cause));
        }
        let key = KeyPair::generate().map_err(crypto(&folder))?;
        let pem = self.sign(request, &key, clock)?;

        // The folder is there with all of its files, or not at all.
        let stage = self.folder.join(format!(".{}.new", request.holder));
        if stage.exists() {
            fs::remove_dir_all(&stage).map_err(|error| PkiError::file(&stage, error))?;
        }
        make_folder(&stage)?;
        let files = Credentials::named(&stage, &request.holder);
        write(&files.key, &key.serialize_pem(), KEY_MODE)?;
        write(&files.certificate, &pem, CERTIFICATE_MODE)?;
        let trusted = self.folder.join(CA_CERTIFICATE);
        fs::copy(&trusted, &files.ca).map_err(|error| PkiError::file(&files.ca, error))?;
        fs::rename(&stage, &folder).map_err(|error| PkiError::file(&folder, error))?;
        Ok(Credentials::named(&folder, &request.holder))
    }

    /// Puts a new certificate in the place of one that this authority has signed, in one step: for the same key, holder,
    /// role, vehicles and hosts, and as long as the old one or for `lifetime`. It may have expired.
    ///
    /// # Errors
    /// When it is not of this authority, or the file can't be written.
    pub fn renew(
        &self,
        certificate: &Path,
        lifetime: Option<Duration>,
        clock: &dyn Clock,
    ) -> Result<Certificate, PkiError> {
        let old = read(certificate)?;
        if old.is_authority {
            let cause = "is an authority's: make a new one with `supertwin pki init` and issue anew";
            return Err(PkiError::file(certificate, cause));
        }
        if !old.is_signed_by(&self.certificate) {
            let cause = format!("was not signed by the authority in {}", self.folder.display());
            return Err(PkiError::file(certificate, cause));
        }
        let (Some(role), Some(scope)) = (old.role, old.scope.clone()) else {
            return Err(PkiError::file(certificate, "has a common name without a role"));
        };
        let lived_s = u64::try_from(old.not_after_s - old.not_before_s).unwrap_or(0);
        let request = Request {
            role,
            scope,
            holder: old.holder.clone().unwrap_or_default(),
            hosts: old.hosts.clone(),
            lifetime: lifetime.unwrap_or_else(|| Duration::from_secs(lived_s).saturating_sub(BACKDATED)),
        };
        request.check()?;
        let key = SubjectPublicKeyInfo::from_der(&old.public_key()).map_err(crypto(certificate))?;
        let pem = self.sign(&request, &key, clock)?;
        let next = certificate.with_extension("pem.new");
        if next.exists() {
            fs::remove_file(&next).map_err(|error| PkiError::file(&next, error))?;
        }
        write(&next, &pem, CERTIFICATE_MODE)?;
        fs::rename(&next, certificate).map_err(|error| PkiError::file(certificate, error))?;
        read(certificate)
    }

    fn sign(&self, request: &Request, key: &impl rcgen::PublicKeyData, clock: &dyn Clock) -> Result<String, PkiError> {
        let place = self.folder.join(CA_CERTIFICATE);
        if self.certificate.left_s(clock) <= 0 {
            let cause = format!("the authority expired on {}", self.certificate.not_after());
            return Err(PkiError::file(&place, cause));
        }
        let name = common_name(request.role, &request.scope);
        let mut wanted = dated(&name, request.lifetime, Some(self.certificate.not_after_s), clock)?;
        wanted.distinguished_name.push(DnType::OrganizationName, self.fleet.as_str());
        wanted.distinguished_name.push(DnType::OrganizationalUnitName, request.holder.as_str());
        wanted.subject_alt_names =
            CertificateParams::new(request.hosts.clone()).map_err(crypto(&place))?.subject_alt_names;
        wanted.is_ca = IsCa::ExplicitNoCa;
        wanted.use_authority_key_identifier_extension = true;
        wanted.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        wanted.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
        if request.role.listens() {
            wanted.extended_key_usages.push(ExtendedKeyUsagePurpose::ServerAuth);
        }
        Ok(wanted.signed_by(key, &self.issuer).map_err(crypto(&place))?.pem())
    }
}

/// A certificate's common name, number and dates; it does not outlive its authority.
fn dated(
    name: &str,
    lifetime: Duration,
    last_s: Option<i64>,
    clock: &dyn Clock,
) -> Result<CertificateParams, PkiError> {
    let mut wanted = CertificateParams::default();
    wanted.distinguished_name = rcgen::DistinguishedName::new();
    wanted.distinguished_name.push(DnType::CommonName, name);
    let mut serial = [0; 16];
    getrandom::fill(&mut serial).map_err(|error| PkiError::Asked(format!("no random numbers: {error}")))?;
    wanted.serial_number = Some(SerialNumber::from_slice(&serial));
    let epoch = rcgen::date_time_ymd(1970, 1, 1);
    let now_s = u64::try_from(unix_s(clock)).unwrap_or(0);
    let last_s = last_s.and_then(|last_s| u64::try_from(last_s).ok()).unwrap_or(u64::MAX);
    wanted.not_before = epoch + Duration::from_secs(now_s).saturating_sub(BACKDATED);
    wanted.not_after = epoch + Duration::from_secs((now_s + lifetime.as_secs()).min(last_s));
    Ok(wanted)
}

fn crypto(path: &Path) -> impl FnOnce(rcgen::Error) -> PkiError {
    let path = path.to_owned();
    move |error| PkiError::file(&path, error)
}

fn make_folder(path: &Path) -> Result<(), PkiError> {
    fs::DirBuilder::new().recursive(true).mode(0o700).create(path).map_err(|error| PkiError::file(path, error))
}

/// Modes of files: a key is for its owner only.
const KEY_MODE: u32 = 0o600;
const CERTIFICATE_MODE: u32 = 0o644;

/// Writes a file that does not exist, through to the disk.
fn write(path: &Path, pem: &str, mode: u32) -> Result<(), PkiError> {
    let opened = fs::OpenOptions::new().write(true).create_new(true).mode(mode).open(path);
    opened
        .and_then(|mut file| file.write_all(pem.as_bytes()).and_then(|()| file.sync_all()))
        .map_err(|error| PkiError::file(path, error))
}
