//! Questions about a set-up: who answers, how far away, by which way, with which files.

use crate::session::LinkError;
use crate::transport::question;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;
use supertwin_protocol::clock::Clock;
use supertwin_protocol::payload::Pong;
use zenoh::query::ConsolidationMode;
use zenoh::{Session, Wait};

/// How long one question waits for its answers.
const PATIENCE: Duration = Duration::from_millis(500);

/// Everybody's answers to a question, as `(key, value)`, sorted. Nobody answering is no error.
///
/// # Errors
/// When the session fails.
pub fn ask_all(session: &Session, key: &str) -> Result<Vec<(String, Value)>, LinkError> {
    let replies = question(session, key, PATIENCE).wait().map_err(LinkError::session(key))?;
    let mut answers: Vec<(String, Value)> = replies
        .into_iter()
        .filter_map(|reply| reply.into_result().ok())
        .filter_map(|sample| {
            let value = serde_json::from_slice(&sample.payload().to_bytes()).ok()?;
            Some((sample.key_expr().as_str().to_owned(), value))
        })
        .collect();
    answers.sort_by(|a, b| a.0.cmp(&b.0));
    Ok(answers)
}

/// Another machine's clock, as seen from here.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockOffset {
    /// Their clock minus ours; known to half the round trip.
    pub offset_ms: f64,
    /// Time from the question to its answer.
    pub round_trip_ms: f64,
}

/// Asks `key` for the time, `times` times; the shortest round trip counts. `None` when nobody answers.
///
/// # Errors
/// When the session fails.
pub fn clock_offset(
    session: &Session,
    key: &str,
    clock: &dyn Clock,
    times: usize,
) -> Result<Option<ClockOffset>, LinkError> {
    let mut best: Option<ClockOffset> = None;
    for _ in 0..times {
        let (began, began_ns) = (clock.now(), clock.unix_ns());
        let replies = session
            .get(key)
            .consolidation(ConsolidationMode::None)
            .timeout(PATIENCE)
            .wait()
            .map_err(LinkError::session(key))?;
        let Ok(reply) = replies.recv() else { return Ok(best) };
        let round_trip = clock.now().saturating_sub(began);
        let pong =
            reply.into_result().ok().and_then(|sample| serde_json::from_slice(&sample.payload().to_bytes()).ok());
        let Some(Pong { received_ns }) = pong else { return Ok(best) };
        let offset_ms =
            (i128::from(received_ns) - i128::from(began_ns)) as f64 / 1e6 - round_trip.as_secs_f64() * 500.0;
        let found = ClockOffset { offset_ms, round_trip_ms: round_trip.as_secs_f64() * 1e3 };
        if best.is_none_or(|best| found.round_trip_ms < best.round_trip_ms) {
            best = Some(found);
        }
    }
    Ok(best)
}

/// Where the session's links end.
#[must_use]
pub fn links(session: &Session) -> Vec<String> {
    let ends: BTreeSet<String> = session.info().links().wait().map(|link| link.dst().to_string()).collect();
    ends.into_iter().collect()
}

/// Files that the settings name, with their place: certificates, keys, dictionaries of users.
#[must_use]
pub fn files(settings: &Value) -> Vec<(String, PathBuf)> {
    let places = [
        "transport/link/tls/root_ca_certificate",
        "transport/link/tls/listen_private_key",
        "transport/link/tls/listen_certificate",
        "transport/link/tls/connect_private_key",
        "transport/link/tls/connect_certificate",
        "transport/auth/usrpwd/dictionary_file",
    ];
    let file = |place: &str| Some((place.to_owned(), settings.pointer(&format!("/{place}"))?.as_str()?.into()));
    places.into_iter().filter_map(file).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn files_are_found_where_the_settings_name_them() {
        let tls = json!({ "root_ca_certificate": "ca.pem", "connect_private_key": null, "enable_mtls": true });
        let settings = json!({ "transport": { "link": { "tls": tls } } });
        let expected = ("transport/link/tls/root_ca_certificate".to_owned(), PathBuf::from("ca.pem"));
        assert_eq!(files(&settings), [expected]);
        assert!(files(&json!({})).is_empty());
    }
}
