//! Why a connection failed: Zenoh says it in its log, and in its error only that it did.

use crate::log_line;
use std::sync::{Arc, Mutex, PoisonError};
use tracing::level_filters::LevelFilter;
use tracing::span::{Attributes, Id, Record};
use tracing::subscriber::Interest;
use tracing::{Event, Metadata};

/// Where Zenoh says it.
const TARGET: &str = "zenoh::net::runtime::orchestrator";
/// How such a line begins; the endpoint follows, and behind `! ` the reason.
const FAILED: &str = "Unable to connect to configured peer ";

/// Does something that may connect on this thread; the last reason that Zenoh gave for a failure.
pub(crate) fn hear<T>(connect: impl FnOnce() -> T) -> (T, Option<String>) {
    let ear = Ear::default();
    let last = Arc::clone(&ear.last);
    let done = tracing::subscriber::with_default(ear, connect);
    let last = last.lock().unwrap_or_else(PoisonError::into_inner).take();
    (done, last)
}

/// What a reason of TLS means, and what to do, with the fleet's authority at hand or without; `None` for any other reason.
pub(crate) fn meaning(reason: &str, knows_authority: bool) -> Option<&'static str> {
    if reason.contains("invalid peer certificate: UnknownIssuer") && !knows_authority {
        return Some("its certificate is of a fleet: give --credentials");
    }
    let known = [
        ("NotValidForName", "its certificate does not name this host: issue it with --host"),
        ("not valid for name", "its certificate does not name this host: issue it with --host"),
        (
            "invalid peer certificate: UnknownIssuer",
            "its certificate is of another authority than the ca.pem given here",
        ),
        (
            "invalid peer certificate: BadSignature",
            "its certificate is of another authority than the ca.pem given here",
        ),
        ("invalid peer certificate: certificate expired", "its certificate has expired, or this clock is ahead"),
        ("invalid peer certificate: Expired", "its certificate has expired, or this clock is ahead"),
        (
            "invalid peer certificate: certificate not valid yet",
            "its certificate is not valid yet: is this clock behind?",
        ),
        ("alert: CertificateExpired", "it says that the certificate given here has expired; is its clock right?"),
        ("alert: CertificateRequired", "it wants a certificate: give --credentials"),
        ("alert: UnknownCA", "it knows another authority than that of the certificate given here"),
        ("alert: DecryptError", "it knows another authority than that of the certificate given here"),
        ("alert: BadCertificate", "it refuses the certificate given here"),
    ];
    known.iter().find(|(words, _)| reason.contains(words)).map(|(_, meaning)| *meaning)
}

#[derive(Default)]
struct Ear {
    last: Arc<Mutex<Option<String>>>,
}

impl tracing::Subscriber for Ear {
    fn register_callsite(&self, metadata: &'static Metadata<'static>) -> Interest {
        if metadata.is_event() && metadata.target() == TARGET { Interest::sometimes() } else { Interest::never() }
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        Some(LevelFilter::DEBUG)
    }

    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.is_event() && metadata.target() == TARGET
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        let text = log_line::message(event);
        if let Some((_, reason)) = text.strip_prefix(FAILED).and_then(|rest| rest.split_once("! ")) {
            *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some(reason.to_owned());
        }
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_tls_says_is_said_in_words() {
        let said = "Can not create a new TLS link bound to IpAddress(V4(Ipv4Addr([127, 0, 0, 1]))): invalid peer \
                    certificate: certificate not valid for name \"127.0.0.1\"; certificate is only valid for DnsName at x";
        let says = |reason: &str, knows: bool| meaning(reason, knows).unwrap_or_default();
        assert!(says(said, true).contains("--host"));
        assert!(says("received fatal alert: CertificateRequired at io", true).contains("--credentials"));
        let stranger = "bound to x: invalid peer certificate: UnknownIssuer at io";
        assert!(says(stranger, true).contains("another authority") && says(stranger, false).contains("--credentials"));
        assert_eq!(meaning("Connection refused (os error 111) at /io/x.rs:3", true), None);
    }

    #[test]
    fn the_last_reason_is_heard() {
        let ((), none) = hear(|| ());
        assert_eq!(none, None);
        let ((), reason) = hear(|| {
            tracing::debug!(target: TARGET, "Unable to connect to configured peer {}! first", "tls/a:1");
            tracing::debug!(target: TARGET, "Unable to connect to configured peer {}! Timeout! of two", "tls/a:1");
            tracing::debug!(target: "elsewhere", "Unable to connect to configured peer x! other");
        });
        assert_eq!(reason.as_deref(), Some("Timeout! of two"));
    }
}
