//! Who may command: one client at a time, by a lease that expires. Lives on the vehicle, beside the controller.

use crate::keys;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::time::Duration;

/// Longest lease that is granted.
pub const MAX_LEASE_S: f64 = 60.0;

/// Shortest and longest token that a client may propose.
const MIN_TOKEN: usize = 32;
const MAX_TOKEN: usize = 128;

/// What a client asks of `authority/lease`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LeaseRequest {
    /// Name of the client.
    pub client: String,
    /// Whether it acquires, renews, releases or asks for the lease.
    pub action: LeaseAction,
    /// For how long, when acquiring or renewing.
    #[serde(default)]
    pub for_s: f64,
    /// What the client was given when it acquired; when it acquires, 32 to 128 random characters that it proposes.
    #[serde(default)]
    pub token: String,
}

/// What can be asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LeaseAction {
    /// Take the lease, if nobody has it.
    Acquire,
    /// Keep the lease that the client holds.
    Renew,
    /// Give it back: the vehicle goes on with what it was told.
    Release,
    /// Ask who has it, and change nothing.
    Status,
}

/// The answer to a [`LeaseRequest`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LeaseReply {
    /// The asker holds the lease now.
    pub granted: bool,
    /// Who holds it, if anybody.
    pub holder: Option<String>,
    /// For how much longer.
    pub expires_in_s: f64,
    /// Goes with every command; only in the answer to the one who acquired.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub token: Option<String>,
    /// Why it was not granted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// Why the last lease ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// There was none yet, or it was given back, or one is in force.
    #[default]
    Properly,
    /// It ran out: the operator is lost.
    Expired,
    /// Its holder disappeared from the network.
    Vanished,
}

/// What the other services are told: enough to check a token, not enough to make one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LeaseState {
    /// Which instance keeps the lease: one that starts anew has forgotten it.
    #[serde(default)]
    pub keeper: String,
    /// Who holds it, if anybody.
    pub holder: Option<String>,
    /// SHA-256 of the holder's token, hexadecimal.
    pub token_sha256: String,
    /// For how much longer, at the time of sending.
    pub expires_in_s: f64,
    /// How the last one ended.
    pub ended: Ended,
}

/// SHA-256 in hexadecimal.
fn hash(token: &str) -> String {
    Sha256::digest(token.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The lease as a service sees it.
#[derive(Clone, Debug, Default)]
pub struct LeaseView {
    /// As it was told; how long it lasts is told by `until`.
    state: LeaseState,
    /// The keeper died with a lease in force, and nobody has taken a new one.
    orphaned: bool,
    until: Duration,
}

impl LeaseView {
    /// Takes over what the vehicle says.
    pub fn update(&mut self, state: LeaseState, now: Duration) {
        let forgotten = self.state.keeper != state.keeper && self.state.holder.is_some() && state.holder.is_none();
        self.orphaned = (self.orphaned || forgotten) && state.holder.is_none();
        let left_s = if state.expires_in_s.is_finite() { state.expires_in_s.clamp(0.0, MAX_LEASE_S) } else { 0.0 };
        self.until = now + Duration::from_secs_f64(left_s);
        self.state = state;
    }

    /// Who holds it now.
    #[must_use]
    pub fn holder(&self, now: Duration) -> Option<&str> {
        self.state.holder.as_deref().filter(|_| now < self.until)
    }

    /// The holder is gone without having given the lease back.
    #[must_use]
    pub fn operator_lost(&self, now: Duration) -> bool {
        match &self.state.holder {
            Some(_) => now >= self.until,
            None => self.orphaned || self.state.ended != Ended::Properly,
        }
    }

    /// Whether `client` with `token` may command.
    ///
    /// # Errors
    /// The sentence that the client is told.
    pub fn allows(&self, client: &str, token: &str, now: Duration) -> Result<(), String> {
        match self.holder(now) {
            None => Err(format!("nobody holds the authority: acquire it first ({})", keys::LEASE)),
            Some(holder) if holder != client => Err(format!("{holder} holds the authority")),
            Some(holder) if hash(token) != self.state.token_sha256 => {
                Err(format!("wrong token: {holder} holds the authority with another"))
            }
            Some(_) => Ok(()),
        }
    }
}

/// Grants and takes back the lease.
#[derive(Clone, Debug, Default)]
pub struct Authority {
    /// The lease as it stands now.
    pub view: LeaseView,
}

impl Authority {
    /// What to tell the others.
    #[must_use]
    pub fn state(&self, keeper: &str, now: Duration) -> LeaseState {
        let expires_in_s = self.view.until.saturating_sub(now).as_secs_f64();
        LeaseState { keeper: keeper.to_owned(), expires_in_s, ..self.view.state.clone() }
    }

    /// A lease that ran out ends; whose it was, when it did just now.
    pub fn expire(&mut self, now: Duration) -> Option<String> {
        let expired = self.view.state.holder.take_if(|_| now >= self.view.until);
        if expired.is_some() {
            self.end(Ended::Expired);
        }
        expired
    }

    /// A client's liveliness token is gone; true when it was the holder's.
    pub fn vanished(&mut self, client: &str) -> bool {
        let was = self.view.state.holder.as_deref() == Some(client);
        if was {
            self.end(Ended::Vanished);
        }
        was
    }

    fn end(&mut self, ended: Ended) {
        self.view = LeaseView { state: LeaseState { ended, ..LeaseState::default() }, ..LeaseView::default() };
    }

    /// Answers a request; `new_token` is used when a lease is granted. The flag says whether anything changed.
    pub fn answer(&mut self, request: &LeaseRequest, new_token: &str, now: Duration) -> (LeaseReply, bool) {
        let mut changed = self.expire(now).is_some();
        let held = self.view.holder(now).map(str::to_owned);
        let mine = self.view.allows(&request.client, &request.token, now).is_ok();
        let mut token = None;
        let outcome = match request.action {
            LeaseAction::Status => Ok(()),
            _ if !keys::is_name(&request.client) => {
                Err("client: must be 1 to 64 letters, digits, '-', '_' or '.'".to_owned())
            }
            LeaseAction::Release if mine => {
                self.end(Ended::Properly);
                changed = true;
                Ok(())
            }
            LeaseAction::Acquire | LeaseAction::Renew if !(0.2..=MAX_LEASE_S).contains(&request.for_s) => {
                Err(format!("for_s = {}: must lie between 0.2 and {MAX_LEASE_S}", request.for_s))
            }
            LeaseAction::Acquire if held.is_none() => {
                // A token that the client proposes makes a repeated request harmless.
                let long = (MIN_TOKEN..=MAX_TOKEN).contains(&request.token.len());
                let new_token = if long { &request.token } else { new_token };
                let (holder, token_sha256) = (Some(request.client.clone()), hash(new_token));
                let state = LeaseState { holder, token_sha256, ..LeaseState::default() };
                let until = now + Duration::from_secs_f64(request.for_s);
                self.view = LeaseView { state, orphaned: false, until };
                token = Some(new_token.to_owned());
                changed = true;
                Ok(())
            }
            LeaseAction::Acquire | LeaseAction::Renew if mine => {
                self.view.until = now + Duration::from_secs_f64(request.for_s);
                changed = true;
                Ok(())
            }
            LeaseAction::Acquire | LeaseAction::Renew | LeaseAction::Release => match &held {
                Some(holder) if *holder != request.client => Err(format!("{holder} holds the authority")),
                Some(_) => Err("wrong token".to_owned()),
                None => Err("nobody holds the authority: acquire it first".to_owned()),
            },
        };
        let holder = self.view.holder(now).map(str::to_owned);
        let reply = LeaseReply {
            granted: outcome.is_ok() && holder.as_deref() == Some(request.client.as_str()) && (mine || token.is_some()),
            expires_in_s: if holder.is_some() { self.view.until.saturating_sub(now).as_secs_f64() } else { 0.0 },
            holder,
            token,
            reason: outcome.err(),
        };
        (reply, changed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: fn(u64) -> Duration = Duration::from_secs;

    fn ask(client: &str, action: LeaseAction, token: &str) -> LeaseRequest {
        LeaseRequest { client: client.to_owned(), action, for_s: 5.0, token: token.to_owned() }
    }

    #[test]
    fn one_client_at_a_time_and_the_others_are_told_who() {
        let mut authority = Authority::default();
        let (reply, _) = authority.answer(&ask("anna", LeaseAction::Acquire, ""), "secret", S(0));
        assert_eq!((reply.granted, reply.token.as_deref()), (true, Some("secret")));
        let (reply, changed) = authority.answer(&ask("ben", LeaseAction::Acquire, ""), "other", S(1));
        assert!(!reply.granted && !changed && reply.token.is_none());
        assert_eq!(reply.reason.as_deref(), Some("anna holds the authority"));
        assert!(authority.view.allows("anna", "secret", S(2)).is_ok());
        assert!(authority.view.allows("anna", "guess", S(2)).is_err());
        assert!(authority.view.allows("ben", "secret", S(2)).is_err());
        let (reply, _) = authority.answer(&ask("anna", LeaseAction::Renew, "guess"), "x", S(2));
        assert!(!reply.granted);
    }

    #[test]
    fn a_lease_that_runs_out_loses_the_operator_and_one_given_back_does_not() {
        let mut authority = Authority::default();
        authority.answer(&ask("anna", LeaseAction::Acquire, ""), "t", S(0));
        assert!(!authority.view.operator_lost(S(4)));
        assert!(authority.view.operator_lost(S(5)), "even before anybody noticed");
        assert!(authority.expire(S(6)).is_some() && authority.view.operator_lost(S(6)));
        authority.answer(&ask("ben", LeaseAction::Acquire, ""), "u", S(7));
        assert!(!authority.view.operator_lost(S(7)));
        let (reply, _) = authority.answer(&ask("ben", LeaseAction::Release, "u"), "", S(8));
        assert!(reply.reason.is_none() && !authority.view.operator_lost(S(20)));
        authority.answer(&ask("ben", LeaseAction::Acquire, ""), "v", S(21));
        assert!(!authority.vanished("anna") && authority.vanished("ben"));
        assert!(authority.view.operator_lost(S(21)));
    }

    #[test]
    fn the_others_can_check_a_token_from_the_published_state() {
        let mut authority = Authority::default();
        authority.answer(&ask("anna", LeaseAction::Acquire, ""), "secret", S(0));
        let state = authority.state("c1", S(1));
        assert!(!serde_json::to_string(&state).expect("JSON").contains("secret"));
        let mut view = LeaseView::default();
        view.update(state, S(100));
        assert!(view.allows("anna", "secret", S(103)).is_ok());
        assert!(view.allows("anna", "secret", S(104)).is_err(), "4 s were left");
    }

    #[test]
    fn acquiring_twice_with_the_same_proposed_token_is_acquiring_once() {
        let mut authority = Authority::default();
        let proposed = "0123456789abcdef0123456789abcdef";
        for _ in 0..2 {
            assert!(authority.answer(&ask("anna", LeaseAction::Acquire, proposed), "other", S(0)).0.granted);
        }
        assert!(authority.view.allows("anna", proposed, S(1)).is_ok());
        assert!(!authority.answer(&ask("anna", LeaseAction::Acquire, "0123"), "x", S(1)).0.granted);
    }

    #[test]
    fn a_keeper_that_dies_with_a_lease_leaves_the_operator_lost() {
        let mut authority = Authority::default();
        authority.answer(&ask("anna", LeaseAction::Acquire, ""), "t", S(0));
        let mut view = LeaseView::default();
        view.update(authority.state("c1", S(0)), S(0));
        let fresh = Authority::default();
        for t in 1..4 {
            view.update(fresh.state("c2", S(t)), S(t));
            assert!(view.operator_lost(S(t)), "also when it is said again");
        }
        authority.answer(&ask("anna", LeaseAction::Renew, "t"), "", S(4));
        view.update(authority.state("c2", S(4)), S(4));
        assert!(!view.operator_lost(S(4)));
    }

    #[test]
    fn names_that_could_not_be_keys_and_silly_times_are_refused() {
        let mut authority = Authority::default();
        for (client, for_s) in [("", 5.0), ("a/b", 5.0), ("*", 5.0), ("anna", f64::NAN), ("anna", 1e9), ("anna", -1.0)]
        {
            let request = LeaseRequest { for_s, ..ask(client, LeaseAction::Acquire, "") };
            let (reply, changed) = authority.answer(&request, "t", S(0));
            assert!(!reply.granted && !changed && reply.reason.is_some(), "{client:?} {for_s}");
        }
    }
}
