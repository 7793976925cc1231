//! A client on the network, as tools need it: a session without a namespace, and the vehicle that is meant.

use crate::OperationError;
use std::sync::Arc;
use std::time::Duration;
use supertwin_protocol::{Clock, SystemClock, keys};
use supertwin_zenoh::{Inbox, Interrupter, Link, Session, client, watch};

/// The four services of a vehicle.
pub use supertwin_core::block::SERVICES;

/// A client on the network.
pub struct NetworkClient {
    /// Without a namespace: keys are full ones.
    pub session: Session,
    /// Tells when what was heard.
    pub clock: Arc<dyn Clock>,
    /// What was heard and is not yet read.
    pub inbox: Inbox,
    /// Ends every wait, from any thread.
    pub stop: Interrupter,
}

impl NetworkClient {
    /// Joins the network.
    ///
    /// # Errors
    /// The link's settings are wrong, or no router is there.
    pub fn join(link: &Link) -> Result<Self, OperationError> {
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
        let inbox = Inbox::new(Arc::clone(&clock));
        let session = link.open()?;
        let stop = inbox.interrupter();
        Ok(Self { session, clock, inbox, stop })
    }

    /// Leaves the network.
    pub fn close(self) {
        drop(self.inbox);
        supertwin_zenoh::close(&self.session);
    }

    /// The vehicle that is meant: the one asked for, else the only one that is up.
    ///
    /// # Errors
    /// None is up, or several are.
    pub fn vehicle(&self, asked_for: Option<&str>) -> Result<String, OperationError> {
        if let Some(name) = asked_for {
            return Ok(name.to_owned());
        }
        let mut up: Vec<String> = self.alive()?.into_iter().map(|(vehicle, ..)| vehicle).collect();
        up.dedup();
        match up.as_slice() {
            [only] => Ok(only.clone()),
            [] => Err(OperationError::Unmet("no vehicle is up: start one with `supertwin up`".to_owned())),
            several => Err(OperationError::Option(format!(
                "{} are up: say which, e.g. --vehicle {}",
                several.join(", "),
                several[0]
            ))),
        }
    }

    /// Services that are up: vehicle, service, instance.
    ///
    /// # Errors
    /// The network can't be asked.
    pub fn alive(&self) -> Result<Vec<(String, String, String)>, OperationError> {
        let mut alive = client::alive(&self.session)?;
        alive.retain(|(_, service, _)| service != "operator");
        Ok(alive)
    }

    /// The moment `s` seconds from now.
    #[must_use]
    pub fn after(&self, s: f64) -> Duration {
        // Longer than a year is for ever.
        self.clock.now() + Duration::from_secs_f64(s.min(3.2e7))
    }

    /// The full key of one that may be relative to the vehicle that `asked_for` means; checks it.
    ///
    /// # Errors
    /// It is no key, or it is not clear of which vehicle.
    pub fn key(&self, asked_for: Option<&str>, key: &str) -> Result<String, OperationError> {
        let wrong = |cause: String| OperationError::Option(format!("KEY {key}: {cause}"));
        watch::check_key(key).map_err(wrong)?;
        if key.starts_with("supertwin/") || key.starts_with("@") {
            return Ok(key.to_owned());
        }
        Ok(format!("{}/{key}", keys::namespace(&self.vehicle(asked_for)?)))
    }
}
