//! How large and how frequent what comes by TLS may be.
//!
//! Zenoh 1.10.2 can refuse what is too large, and what follows the message before too closely on the same link; it knows
//! no budget of bursts and no bytes per second. An honest client's next question follows an answer at once: with a rule of
//! a thousand a second, six of ten were refused. So requests have no rate here: what keeps a flood of them from the control
//! loop is that services look at a bounded number between two ticks. Rates are for what costs the vehicle much, and for
//! streams of which the next message replaces the last.

use serde_json::{Value, json};
use supertwin_core::Message;
use supertwin_core::message::{Truth, WrenchRequest};
use supertwin_protocol::access::ABOARD;
use supertwin_protocol::command_queue::MAX_REQUEST;
use supertwin_protocol::keys;
use supertwin_protocol::payload::STREAMS;

/// Largest message of any kind, in bytes; requests, set-points and wrenches are no larger than what the services look at.
const LARGEST_MESSAGE: usize = 65_536;

/// How often one client may send on the keys of a pattern.
struct Rate {
    /// What: `put` or `query`.
    message: &'static str,
    /// Relative to the vehicle's namespace.
    key: String,
    /// Inverse of the least distance between two of them.
    per_s: f64,
}

/// What a service kept is asked for after a cut; each answer may be all of it.
const HISTORIES_PER_S: f64 = 20.0;
/// Set-points: ten times what a joystick sends.
const SETPOINTS_PER_S: f64 = 500.0;

/// All of them. Patterns of one kind of message do not overlap: Zenoh counts a message for one of them only.
fn rates() -> Vec<Rate> {
    let services = || ABOARD.into_iter().chain(["guidance"]);
    let telemetry = services().map(keys::telemetry);
    let events = services().chain(["recorder", "router"]).map(keys::event);
    let history = |key: String| Rate { message: "query", key: keys::advanced(&key), per_s: HISTORIES_PER_S };
    let mut rates: Vec<Rate> =
        events.chain(telemetry).chain([Truth::KEY.to_owned(), keys::shadow(Truth::KEY)]).map(history).collect();
    let streams = STREAMS.map(keys::setpoint);
    let put = |key: String| Rate { message: "put", key, per_s: SETPOINTS_PER_S };
    rates.extend(streams.map(put));
    rates.push(put(WrenchRequest::KEY.to_owned()));
    rates
}

/// As Zenoh's `downsampling`.
pub(super) fn downsampling(vehicle: &str) -> Value {
    let all = rates();
    let item = |message: &str| {
        let rules: Vec<Value> = all
            .iter()
            .filter(|rate| rate.message == message)
            .map(|rate| json!({ "key_expr": format!("{}/{}", keys::namespace(vehicle), rate.key), "freq": rate.per_s }))
            .collect();
        json!({
            "id": format!("{message}-rates"), "link_protocols": ["tls"], "flows": ["ingress"], "messages": [message],
            "rules": rules,
        })
    };
    json!([item("query"), item("put")])
}

/// As Zenoh's `low_pass_filter`.
pub(super) fn sizes(vehicle: &str) -> Value {
    let all = ["**".to_owned(), keys::advanced("**")];
    let streams =
        [keys::setpoint("*"), WrenchRequest::KEY.to_owned()].map(|key| format!("{}/{key}", keys::namespace(vehicle)));
    let item = |id: &str, messages: &[&str], keys: &[String], size: usize| {
        json!({
            "id": id, "link_protocols": ["tls"], "flows": ["ingress"], "messages": messages, "key_exprs": keys,
            "size_limit": size,
        })
    };
    json!([
        item("request-size", &["query"], &all, MAX_REQUEST),
        item("setpoint-size", &["put"], &streams, MAX_REQUEST),
        item("message-size", &["put", "delete", "reply"], &all, LARGEST_MESSAGE),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::watch::overlap;

    #[test]
    fn no_message_is_counted_for_two_rates() {
        let all = rates();
        for (i, a) in all.iter().enumerate() {
            for b in all.iter().skip(i + 1).filter(|b| b.message == a.message) {
                assert!(!overlap(&a.key, &b.key), "{} and {}", a.key, b.key);
            }
        }
        assert!(all.len() > 10);
    }
}
