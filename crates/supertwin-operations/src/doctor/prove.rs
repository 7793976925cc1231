//! The doctor's proof of access control: each role whose credentials are at hand tries what it may and may not.

use super::Diagnosis;
use crate::{NetworkClient, OperationError, Progress, entries};
use std::path::{Path, PathBuf};
use supertwin_pki::{self as pki, Credentials};
use supertwin_protocol::role::Role;
use supertwin_zenoh::access_control::probe::Witness;
use supertwin_zenoh::access_control::{self, Attempt};
use supertwin_zenoh::{Link, LinkError, Session, close};

/// What one holder may and may not.
#[derive(Clone, Debug)]
pub struct Proof {
    /// Common name of the certificate.
    pub who: String,
    /// Role whose certificate the identity has.
    pub role: Role,
    /// One for each row and verb of the matrix.
    pub attempts: Vec<Attempt>,
}

impl Proof {
    /// What is not as documented.
    #[must_use]
    pub fn differences(&self) -> Vec<String> {
        let what = |attempt: &Attempt| {
            let may = if attempt.allowed { "may not, and should" } else { "may, and should not" };
            format!("{may}: {} {}", attempt.verb, attempt.keys.join(", "))
        };
        self.attempts.iter().filter(|attempt| attempt.differs()).map(what).collect()
    }

    /// Attempts that told something.
    #[must_use]
    pub fn tried(&self) -> usize {
        self.attempts.iter().filter(|attempt| attempt.observed.is_some()).count()
    }
}

/// A holder's credentials, and what their certificate says.
#[derive(Clone, Debug)]
pub struct Holder {
    place: PathBuf,
    who: String,
    role: Role,
}

/// The credentials at a place: a holder's folder, or a folder with several of those.
///
/// # Errors
/// There are none of a role.
pub fn holders(place: &Path) -> Result<Vec<Holder>, OperationError> {
    let one = |place: &Path| -> Option<Holder> {
        let certificate = pki::read(&Credentials::find(place).ok()?.certificate).ok()?;
        Some(Holder { place: place.to_owned(), who: certificate.common_name, role: certificate.role? })
    };
    if let Some(holder) = one(place) {
        return Ok(vec![holder]);
    }
    let found: Vec<Holder> = entries(place, Path::is_dir)?.iter().filter_map(|path| one(path)).collect();
    if found.is_empty() {
        // In its own words, why it is none.
        Credentials::find(place)?;
        return Err(OperationError::at(place, &"no credentials of a role in it"));
    }
    Ok(found)
}

/// Whose credentials the doctor itself uses: who sees most.
#[must_use]
pub fn best(holders: &[Holder]) -> Option<&Path> {
    let order = [Role::Vehicle, Role::Operator, Role::Recorder, Role::Observer, Role::Guidance];
    let rank = |holder: &&Holder| order.iter().position(|role| *role == holder.role);
    holders.iter().min_by_key(rank).map(|holder| holder.place.as_path())
}

/// Whose rights are tried, and from where.
#[derive(Clone, Debug)]
pub struct ProofOptions {
    /// Credentials of each role that tries.
    pub holders: Vec<Holder>,
    /// How they join, but for their credentials.
    pub link: Link,
    /// How somebody on the vehicle's own computer joins.
    pub local: Link,
}

/// Lets every holder try everything; whether there was a witness to see what arrives.
pub(super) fn prove(
    network: &NetworkClient,
    options: &ProofOptions,
    vehicle: &str,
    tell: &mut dyn FnMut(Diagnosis<'_>),
    progress: &dyn Progress,
) -> Result<(Vec<Proof>, bool), OperationError> {
    let ProofOptions { holders, link, local } = options;
    let sees_all = witness_session(network, link, local, holders);
    let mut witness = sees_all.as_ref().map(|(session, _)| Witness::open(session, vehicle)).transpose()?;
    progress.begin("trying what each role may", holders.len() as u64);
    let mut proofs = Vec::new();
    for holder in holders.iter().take_while(|_| !network.stop.interrupted()) {
        let session = join(link, holder)?;
        // A witness of another router would see nothing, and call everything denied.
        if holder.role != Role::Vehicle
            && let Some(seer) = &mut witness
            && !seer.settle(&session, || Ok(()))?
        {
            tell(Diagnosis::Warning(format!("{} reaches no vehicle called {vehicle} here", holder.who)));
        }
        let attempts = access_control::prove(&session, holder.role, vehicle, witness.as_mut(), &network.clock)?;
        close(&session);
        proofs.push(Proof { who: holder.who.clone(), role: holder.role, attempts });
        progress.advance(1);
    }
    progress.end();
    let seen = witness.is_some();
    drop(witness);
    if let Some((session, true)) = sees_all {
        close(&session);
    }
    Ok((proofs, seen))
}

fn join(link: &Link, holder: &Holder) -> Result<Session, LinkError> {
    Link { credentials: Some(holder.place.clone()), ..link.clone() }.open()
}

/// A session with full access: by the vehicle's socket, or with its own credentials. True if it is a new one.
fn witness_session(network: &NetworkClient, link: &Link, local: &Link, holders: &[Holder]) -> Option<(Session, bool)> {
    if link.connect.iter().any(|endpoint| endpoint.starts_with("unixsock")) {
        return Some((network.session.clone(), false));
    }
    let vehicle = holders.iter().find(|holder| holder.role == Role::Vehicle);
    let own = vehicle.and_then(|holder| join(link, holder).ok());
    own.or_else(|| local.open().ok()).map(|session| (session, true))
}

#[cfg(test)]
mod tests {
    use super::*;
    use supertwin_protocol::access::Verb;

    #[test]
    fn only_what_was_tried_can_differ() {
        let attempts = [(true, None), (false, None), (true, Some(true)), (true, Some(false)), (false, Some(true))];
        let attempts = attempts.map(|(allowed, observed)| {
            let keys = vec!["clock/ping".to_owned()];
            Attempt { keys, verb: Verb::Get, allowed, observed }
        });
        let proof = Proof { who: "operator.rov".to_owned(), role: Role::Operator, attempts: attempts.into() };
        assert_eq!(proof.differences(), ["may not, and should: get clock/ping", "may, and should not: get clock/ping"]);
        assert_eq!(proof.tried(), 3);
    }
}
