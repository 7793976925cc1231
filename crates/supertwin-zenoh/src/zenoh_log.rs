//! The only door to Zenoh's log: the lines that say who was turned away and why a connection failed.
//!
//! Zenoh tells neither to anybody by its interface. Sources and wordings are those of Zenoh 1.10.2; `tests/zenoh_log.rs`
//! provokes every notice over a real router, and fails at once when an upgrade has made this blind.

use parking_lot::Mutex;
use std::fmt::{Debug, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use supertwin_protocol::role::parse_common_name;
use tracing::field::{Field, Visit};
use tracing::level_filters::LevelFilter;
use tracing::span::{Attributes, Id, Record};
use tracing::subscriber::Interest;
use tracing::{Event, Level, Metadata};

/// Where Zenoh says what access control decided.
const ACCESS_CONTROL: &str = "zenoh::net::routing::interceptor::access_control";
/// Where it says who came by TLS, and who was refused.
const TLS: &str = "zenoh_link_tls";
/// Where it says why it could not connect.
const CONNECT: &str = "zenoh::net::runtime::orchestrator";

/// What a line of the log says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Notice {
    /// A listener has accepted a TLS connection.
    Connected { common_name: String, from: String },
    /// A listener has refused a TLS handshake.
    HandshakeRefused { reason: String },
    /// The certificate of a session has no role at this router.
    WithoutRole { session: String },
    /// The common name of a session's certificate.
    Identified { session: String, common_name: String },
    /// A session tried what it may not.
    MessageRefused { session: String, action: String, key: String },
    /// An attempt to connect has failed.
    ConnectFailed { reason: String },
}

/// Hands what a router's access control and TLS say to `handle`, for the rest of the process; false when somebody listens
/// already.
pub(crate) fn listen_to_access(handle: impl Fn(Notice) + Send + Sync + 'static) -> bool {
    tracing::subscriber::set_global_default(Listener::new(is_of_access, handle)).is_ok()
}

/// Does something that may connect on this thread; with it the last reason that Zenoh gave for a failure.
pub(crate) fn with_connect_failure<T>(connect: impl FnOnce() -> T) -> (T, Option<String>) {
    let last = Arc::new(Mutex::new(None));
    let kept = Arc::clone(&last);
    let listener = Listener::new(is_of_connecting, move |notice| {
        if let Notice::ConnectFailed { reason } = notice {
            *kept.lock() = Some(reason);
        }
    });
    let done = tracing::subscriber::with_default(listener, connect);
    let reason = last.lock().take();
    (done, reason)
}

fn is_of_access(metadata: &Metadata<'_>) -> bool {
    let tls = metadata.target().starts_with(TLS) && *metadata.level() <= Level::DEBUG;
    metadata.is_event() && (tls || metadata.target() == ACCESS_CONTROL)
}

fn is_of_connecting(metadata: &Metadata<'_>) -> bool {
    metadata.is_event() && metadata.target() == CONNECT
}

thread_local! {
    /// The key of which this thread works out all permissions in advance: that is no attempt.
    static IN_ADVANCE: core::cell::RefCell<String> = const { core::cell::RefCell::new(String::new()) };
}

/// Receives the lines of Zenoh's log.
struct Listener<F> {
    is_wanted: fn(&Metadata<'_>) -> bool,
    handle: F,
    /// Source lines of access control that say nothing of interest, so that their text is made only once; 0 is none.
    silenced: [AtomicU32; 16],
}

impl<F: Fn(Notice)> Listener<F> {
    fn new(is_wanted: fn(&Metadata<'_>) -> bool, handle: F) -> Self {
        Self { is_wanted, handle, silenced: Default::default() }
    }

    fn is_silenced(&self, line: u32) -> bool {
        self.silenced.iter().any(|other| other.load(Ordering::Relaxed) == line)
    }

    fn silence(&self, line: Option<u32>) {
        let Some(line) = line.filter(|line| !self.is_silenced(*line)) else { return };
        for free in &self.silenced {
            if free.compare_exchange(0, line, Ordering::Relaxed, Ordering::Relaxed).is_ok() {
                return;
            }
        }
    }

    fn access_control(&self, text: &str, line: Option<u32>) {
        if let Some((_, rest)) = text.split_once("(ingress): caching permissions for `") {
            let key = rest.split('`').next().unwrap_or(rest);
            return IN_ADVANCE.with_borrow_mut(|of| key.clone_into(of));
        }
        if let Some((session, _)) = text.split_once(" did not match any configured ACL subject") {
            return (self.handle)(Notice::WithoutRole { session: session.to_owned() });
        }
        let Some((who, what)) = text.split_once(" is unauthorized to ") else {
            // What was let through, or does not come from outside.
            return self.silence(line);
        };
        let Some((action, key)) = what.split_once(" (ingress) on ") else {
            // What is kept from somebody who listens to more than is his. The line may be one that serves both directions.
            if who.contains("cached result") {
                self.silence(line);
            }
            return;
        };
        let (session, subject) = match who.strip_prefix("Using cached result: ") {
            Some(session) => (session, None),
            None => who.split_once(" on ").map_or((who, None), |(session, subject)| (session, Some(subject))),
        };
        let common_name = |part: &'_ str| {
            let (_, name) = part.split_once("CertCommonName(")?;
            name.strip_suffix(')').filter(|name| parse_common_name(name).is_some()).map(str::to_owned)
        };
        let session = session.to_owned();
        if let Some(common_name) = subject.and_then(|subject| subject.split('+').find_map(common_name)) {
            (self.handle)(Notice::Identified { session: session.clone(), common_name });
        }
        if subject.is_none() || IN_ADVANCE.with_borrow(|of| of != key) {
            let (action, key) = (action.to_lowercase(), key.to_owned());
            (self.handle)(Notice::MessageRefused { session, action, key });
        }
    }

    fn tls(&self, text: &str, level: Level) {
        if let Some((_, rest)) = text.split_once("Accepted TLS connection on ") {
            // Local address, remote address, and what the certificate says.
            let Some((ends, name)) = rest.split_once(". ") else { return };
            let from = ends.split_once(": ").map_or(ends, |(_, from)| from).to_owned();
            let name = name.split_once("Common Name: ").map_or(name, |(_, name)| name).trim_end_matches('.');
            let common_name = if name == "None" { "nobody" } else { name }.to_owned();
            (self.handle)(Notice::Connected { common_name, from });
        } else if level == Level::WARN {
            let reason = text.split(". Hint:").next().unwrap_or(text).to_owned();
            (self.handle)(Notice::HandshakeRefused { reason });
        }
    }

    fn connect(&self, text: &str) {
        // The endpoint follows, and behind `! ` the reason.
        let rest = text.strip_prefix("Unable to connect to configured peer ");
        if let Some((_, reason)) = rest.and_then(|rest| rest.split_once("! ")) {
            (self.handle)(Notice::ConnectFailed { reason: reason.to_owned() });
        }
    }
}

impl<F: Fn(Notice) + Send + Sync + 'static> tracing::Subscriber for Listener<F> {
    fn register_callsite(&self, metadata: &'static Metadata<'static>) -> Interest {
        if (self.is_wanted)(metadata) { Interest::sometimes() } else { Interest::never() }
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        Some(LevelFilter::TRACE)
    }

    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        let silenced = || metadata.line().is_some_and(|line| self.is_silenced(line));
        (self.is_wanted)(metadata) && !(metadata.target() == ACCESS_CONTROL && silenced())
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        let mut message = Message(String::new());
        event.record(&mut message);
        let (text, metadata) = (message.0, event.metadata());
        match metadata.target() {
            ACCESS_CONTROL => self.access_control(&text, metadata.line()),
            CONNECT => self.connect(&text),
            _ => self.tls(&text, *metadata.level()),
        }
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

/// The text of a line.
struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            // Writing to a string can't fail.
            let _ = write!(self.0, "{value:?}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a listener makes of lines of access control, which follow each other on one thread.
    fn notices(say: impl FnOnce(&Listener<&dyn Fn(Notice)>)) -> Vec<Notice> {
        let received = Mutex::new(Vec::new());
        say(&Listener::new(is_of_access, &|notice| received.lock().push(notice)));
        received.into_inner()
    }

    fn refused(action: &str, key: &str) -> Notice {
        Notice::MessageRefused { session: "ab12".to_owned(), action: action.to_owned(), key: key.to_owned() }
    }

    #[test]
    fn a_refused_message_is_told_apart_from_permissions_that_are_worked_out_in_advance() {
        let named = Notice::Identified { session: "ab12".to_owned(), common_name: "observer.rov".to_owned() };
        let on = "ab12 on Interface(lo)+CertCommonName(observer.rov)+tls+ab12 is unauthorized to";
        let received = notices(|listener| {
            listener.access_control("ACL (ingress): caching permissions for `rov/estimator/nav` ...", Some(7));
            listener.access_control(&format!("{on} Put (ingress) on rov/estimator/nav"), Some(8));
            let cached = "Using cached result: ab12 is unauthorized to Put (ingress) on rov/estimator/nav";
            listener.access_control(cached, Some(9));
            listener.access_control(&format!("{on} Query (ingress) on rov/authority/lease"), Some(8));
        });
        let expected =
            [named.clone(), refused("put", "rov/estimator/nav"), named, refused("query", "rov/authority/lease")];
        assert_eq!(received, expected);
    }

    #[test]
    fn lines_of_no_interest_are_made_once() {
        let received = notices(|listener| {
            listener.access_control("Using cached result: ab12 is authorized to Put (ingress) on a", Some(5));
            listener.access_control("Using cached result: ab12 is unauthorized to Put (egress) on a", Some(6));
            listener.access_control("ab12 on lo+x+tls is unauthorized to Put (egress) on a", Some(7));
            let silenced = [5, 6, 7].map(|line| listener.is_silenced(line));
            assert_eq!(silenced, [true, true, false], "the last serves both directions");
        });
        assert!(received.is_empty(), "{received:?}");
    }

    #[test]
    fn handshakes_are_told_with_their_end() {
        let received = notices(|listener| {
            listener.tls("invalid peer certificate: UnknownIssuer. Hint: increase the open file limit.", Level::WARN);
            let accepted = "Accepted TLS connection on 127.0.0.1:7447: 127.0.0.1:5000. Common Name: operator.rov.";
            listener.tls(accepted, Level::DEBUG);
            let unmatched = "ab12 did not match any configured ACL subject. Default permission `Deny` will be applied";
            listener.access_control(unmatched, Some(3));
        });
        let expected = [
            Notice::HandshakeRefused { reason: "invalid peer certificate: UnknownIssuer".to_owned() },
            Notice::Connected { common_name: "operator.rov".to_owned(), from: "127.0.0.1:5000".to_owned() },
            Notice::WithoutRole { session: "ab12".to_owned() },
        ];
        assert_eq!(received, expected);
    }

    #[test]
    fn the_last_reason_of_a_failure_counts() {
        let ((), none) = with_connect_failure(|| ());
        assert_eq!(none, None);
        let ((), reason) = with_connect_failure(|| {
            tracing::debug!(target: CONNECT, "Unable to connect to configured peer {}! first", "tls/a:1");
            tracing::debug!(target: CONNECT, "Unable to connect to configured peer {}! Timeout! of two", "tls/a:1");
            tracing::debug!(target: "elsewhere", "Unable to connect to configured peer x! other");
        });
        assert_eq!(reason.as_deref(), Some("Timeout! of two"));
    }
}
