//! Whom a router lets in: not everybody by mistake, by which rules, and who was turned away.

use crate::OperationError;
use serde_json::json;
use std::sync::Arc;
use supertwin_core::{EventKind, Severity, Tick};
use supertwin_protocol::{Clock, keys};
use supertwin_zenoh::access_log::AccessLog;
use supertwin_zenoh::{Link, LinkError, ServicePublisher, Session, access_control, session, unique};

/// What a router may let in.
#[derive(Clone, Debug)]
pub struct RouterAccess {
    /// Hash of its rules; `None`: whoever reaches it may do everything.
    pub rules: Option<String>,
    /// The vehicle that its settings name.
    vehicle: Option<String>,
    /// What should be known of its settings.
    pub exposures: Vec<String>,
}

impl RouterAccess {
    /// Looks at the settings before anything is opened: others may only reach a router that asks them who they are.
    ///
    /// # Errors
    /// The settings are wrong, or let everybody do everything and `open_to_everyone` is not given.
    pub fn check(link: &Link, open_to_everyone: bool) -> Result<Self, OperationError> {
        let settings = link.settings()?;
        let open = session::open_listeners(&settings);
        if !open.is_empty() && !open_to_everyone {
            return Err(OperationError::Option(format!(
                "the router {}: whoever reaches it could steer the vehicle. Lock it (supertwin zenoh-config vehicle \
                 --vehicle NAME --credentials DIR --out router.json5), listen on loopback or a unix socket, or say \
                 --open-to-everyone",
                open.join(", and ")
            )));
        }
        let locked = settings["access_control"]["enabled"] == json!(true);
        Ok(Self {
            rules: locked.then(|| access_control::hash(&settings)),
            vehicle: settings["metadata"]["vehicle"].as_str().map(str::to_owned),
            exposures: session::exposures(&settings),
        })
    }

    /// Which rules it keeps, for people.
    #[must_use]
    pub fn text(&self) -> String {
        match &self.rules {
            Some(hash) => format!("access rules {hash}"),
            None => "no access rules: whoever reaches it may do everything".to_owned(),
        }
    }

    /// Tells who comes and who is turned away: with a sentence and whether it is a refusal, and as events of the router
    /// if the vehicle is known. `namespace` is the session's own vehicle.
    ///
    /// # Errors
    /// The router's events can't be published.
    pub fn watch(
        &self,
        session: &Session,
        namespace: Option<&str>,
        clock: &Arc<dyn Clock>,
        mut tell: impl FnMut(&str, bool) + Send + 'static,
    ) -> Result<Option<AccessLog>, LinkError> {
        if self.rules.is_none() {
            return Ok(None);
        }
        let root = match (namespace, &self.vehicle) {
            (Some(_), _) => Some(String::new()),
            (None, Some(vehicle)) => Some(format!("{}/", keys::namespace(vehicle))),
            (None, None) => None,
        };
        let open = |root: &String| ServicePublisher::open(session, root, "router", &unique(), Arc::clone(clock), false);
        let mut publisher = root.as_ref().map(open).transpose()?;
        Ok(Some(AccessLog::new(Arc::clone(clock), move |what| {
            let refusal = !matches!(what, EventKind::ConnectionAccepted { .. });
            tell(&what.to_string(), refusal);
            if let Some(publisher) = &mut publisher {
                let severity = if refusal { Severity::Warning } else { Severity::Info };
                publisher.event("", Tick { k: 0, dt_s: 0.0 }, severity, what);
            }
        })))
    }
}
