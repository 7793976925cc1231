//! The matrix tried on a vehicle that may be at work: nothing that a service could take for something, and nothing at all
//! where only something real could tell.

use super::probe::{Seen, Witness, is_answered_by_anybody};
use crate::session::{LinkError, unique};
use crate::watch::Inbox;
use serde::Serialize;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use supertwin_protocol::access::{AccessRow, Verb, matrix};
use supertwin_protocol::{Clock, Role, keys};
use zenoh::Session;

/// How long is listened to what flows by itself: health comes once a second.
const FLOW: Duration = Duration::from_millis(1500);

/// One attempt of one role to do one thing on the keys of a row, and its result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Attempt {
    /// Keys of the access matrix's row.
    pub keys: Vec<String>,
    /// The action that was tried on them.
    pub verb: Verb,
    /// What the matrix says.
    pub allowed: bool,
    /// Whether it was so; nothing when it could not be tried.
    pub observed: Option<bool>,
}

impl Attempt {
    /// It was tried, and it is not as documented.
    #[must_use]
    pub fn differs(&self) -> bool {
        self.observed.is_some_and(|observed| observed != self.allowed)
    }
}

/// Tries everything that `subject`, in `role`, may and may not on `vehicle`. Without a witness that sees everything there,
/// only questions that services answer and messages that flow by themselves can tell.
///
/// # Errors
/// When a session fails.
pub fn prove(
    subject: &Session,
    role: Role,
    vehicle: &str,
    mut witness: Option<&mut Witness>,
    clock: &Arc<dyn Clock>,
) -> Result<Vec<Attempt>, LinkError> {
    let rows = matrix();
    let root = keys::namespace(vehicle);
    let flows = flows(subject, witness.as_deref(), &root, &rows, clock)?;
    let mark = witness.as_ref().map_or_else(|| format!("access-probe-{}", unique()), |witness| witness.mark.clone());
    let mut attempts = Vec::new();
    for row in &rows {
        // Nobody at work writes or reads a key that has this name in it.
        let own = row.example(&mark).contains(&mark);
        for verb in Verb::ALL {
            let allowed = row.allows(role, verb);
            let seen = match (verb, &mut witness) {
                (Verb::Subscribe, _) if !own => flows.seen(row),
                // What it deleted or said in a service's place would be the vehicle's own.
                (Verb::Put | Verb::Delete | Verb::Queryable, _) if !own && role == Role::Vehicle => None,
                (_, Some(witness)) => Some(witness.attempt(subject, row, verb, allowed)?),
                (Verb::Get, None) if is_asked(row) => {
                    Some(is_answered_by_anybody(subject, &format!("{root}/{}", row.example(&mark)))?)
                }
                (_, None) => None,
            };
            let observed = seen.map(|seen| if seen.is_expected(allowed) { allowed } else { !allowed });
            attempts.push(Attempt { keys: row.keys.clone(), verb, allowed, observed });
        }
    }
    Ok(attempts)
}

/// A service answers any question there, if only by a refusal.
fn is_asked(row: &AccessRow) -> bool {
    let starts = [keys::command("", ""), keys::param("", ""), keys::LEASE.to_owned(), keys::PING.to_owned()];
    let starts = starts.map(|start| start.trim_end_matches('/').to_owned());
    row.keys.iter().all(|key| starts.iter().any(|start| key.starts_with(start.as_str())))
}

/// What flowed by itself, as somebody and the witness heard it.
struct Flows {
    theirs: BTreeSet<String>,
    real: Option<BTreeSet<String>>,
}

impl Flows {
    fn seen(&self, row: &AccessRow) -> Option<Seen> {
        let received = |keys: &BTreeSet<String>| row.keys.iter().any(|key| keys.contains(key));
        match (received(&self.theirs), self.real.as_ref().map(received)) {
            (true, _) => Some(Seen::All),
            (false, Some(true)) => Some(Seen::Nothing),
            // Nothing flows there now.
            (false, _) => None,
        }
    }
}

fn flows(
    subject: &Session,
    witness: Option<&Witness>,
    root: &str,
    rows: &[AccessRow],
    clock: &Arc<dyn Clock>,
) -> Result<Flows, LinkError> {
    let listen = |session: &Session| {
        let mut inbox = Inbox::new(Arc::clone(clock));
        for key in
            rows.iter().filter(|row| !row.is_liveliness()).flat_map(|row| &row.keys).filter(|key| !key.contains('*'))
        {
            inbox.listen(session, &format!("{root}/{key}"))?;
        }
        Ok::<Inbox, LinkError>(inbox)
    };
    let (theirs, real) = (listen(subject)?, witness.map(|witness| listen(&witness.session)).transpose()?);
    let end = clock.now() + FLOW;
    let hear = |inbox: &Inbox, end: Duration| {
        let mut received = BTreeSet::new();
        while clock.now() < end
            && let Some(sample) = inbox.next(Some(end))
        {
            received.extend(sample.key.strip_prefix(root).and_then(|key| key.strip_prefix('/')).map(str::to_owned));
        }
        received
    };
    let real = real.map(|inbox| hear(&inbox, end));
    // What the witness has heard by then has been on its way to the other as well, and has a moment more.
    let theirs = hear(&theirs, clock.now().max(end) + FLOW / 5);
    Ok(Flows { theirs, real })
}
