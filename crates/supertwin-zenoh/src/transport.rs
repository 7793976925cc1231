//! Publishers and questions, with the settings that all of this crate share.

use std::time::Duration;
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::handlers::DefaultHandler;
use zenoh::pubsub::PublisherBuilder;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::session::SessionGetBuilder;

/// A publisher of JSON that never waits: what finds no room is dropped.
pub(crate) fn publisher(session: &Session, key: String, priority: Priority) -> PublisherBuilder<'_, 'static> {
    let publisher = session.declare_publisher(key).encoding(Encoding::APPLICATION_JSON);
    publisher.congestion_control(CongestionControl::Drop).priority(priority)
}

/// A question to everybody who answers on `key`, each of whose answers counts.
pub(crate) fn question<'a>(
    session: &'a Session,
    key: &'a str,
    patience: Duration,
) -> SessionGetBuilder<'a, 'a, DefaultHandler> {
    session.get(key).target(QueryTarget::All).consolidation(ConsolidationMode::None).timeout(patience)
}
