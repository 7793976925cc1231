//! Who was turned away at a router: strangers whose certificate is not good, and those who tried what they may not.
//!
//! Zenoh tells neither to anybody: a refused handshake is a line of its log, and so is a refused message, among those that
//! were let through. This listens to just these lines. Lines of no interest are recognised once, and never made again.

use crate::log_line;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use supertwin_core::EventKind;
use supertwin_protocol::clock::Clock;
use supertwin_protocol::role::parse_common_name;
use tracing::level_filters::LevelFilter;
use tracing::span::{Attributes, Id, Record};
use tracing::subscriber::Interest;
use tracing::{Event, Level, Metadata};

/// Where Zenoh says what access control decided.
const RULES: &str = "zenoh::net::routing::interceptor::access_control";
/// Where it says who came by TLS, and who was refused.
const TLS: &str = "zenoh_link_tls";
/// Different things that are told apart between two reports; what goes beyond is counted together.
const KINDS: usize = 64;
/// Sessions whose certificate is remembered.
const SESSIONS: usize = 256;
/// Longest part of a report that somebody else has written.
const QUOTED: usize = 160;
/// Between two reports.
const REPORT: Duration = Duration::from_secs(1);

/// Something that happened at the door, and how often since the last report.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Knock {
    /// Somebody with a good certificate came.
    Came {
        /// Common name of the certificate.
        name: String,
        /// Address.
        from: String,
    },
    /// Somebody was refused before a word was said.
    Stranger {
        /// Why.
        reason: String,
    },
    /// Somebody whose certificate has no role here; he may do nothing.
    NoRole {
        /// His session.
        session: String,
    },
    /// Somebody tried what he may not.
    Refused {
        /// Common name of the certificate, if it is known.
        name: String,
        /// His session.
        session: String,
        /// What he tried.
        action: String,
        /// On which key.
        key: String,
    },
    /// More than are told one by one.
    More,
}

impl Knock {
    /// It as an event.
    #[must_use]
    pub fn event(&self, times: u64) -> EventKind {
        match self.clone() {
            Self::Came { name, from } => EventKind::ConnectionAccepted { name, from, times },
            Self::Stranger { reason } => EventKind::ConnectionRefused { reason, times },
            Self::NoRole { session } => EventKind::SessionWithoutRole { session, times },
            Self::Refused { name, session, action, key } => {
                EventKind::AccessRefused { name, session, action, key, times }
            }
            Self::More => EventKind::MoreRefused { refusals: times },
        }
    }

    /// Whether somebody was turned away.
    #[must_use]
    pub fn is_refusal(&self) -> bool {
        !matches!(self, Self::Came { .. })
    }
}

#[derive(Debug, Default)]
struct Book {
    knocks: BTreeMap<Knock, u64>,
    more: u64,
    /// Common names by session.
    names: BTreeMap<String, String>,
    closing: bool,
}

#[derive(Debug, Default)]
struct Shared {
    book: Mutex<Book>,
    written: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn enter(&self, knock: impl FnOnce(&Book) -> Knock) {
        let mut book = self.lock();
        let knock = knock(&book);
        if book.knocks.len() < KINDS || book.knocks.contains_key(&knock) {
            *book.knocks.entry(knock).or_default() += 1;
        } else {
            book.more += 1;
        }
        drop(book);
        self.written.notify_all();
    }
}

thread_local! {
    /// The key of which this thread works out all permissions in advance: that is no attempt.
    static IN_ADVANCE: core::cell::RefCell<String> = const { core::cell::RefCell::new(String::new()) };
}

/// Hears Zenoh's log.
struct Ear {
    shared: Arc<Shared>,
    /// Lines of the source of access control that say nothing of interest; 0 is none.
    quiet: [AtomicU32; 16],
}

impl Ear {
    fn is_quiet(&self, line: u32) -> bool {
        self.quiet.iter().any(|other| other.load(Ordering::Relaxed) == line)
    }

    fn hush(&self, line: Option<u32>) {
        let Some(line) = line.filter(|line| !self.is_quiet(*line)) else { return };
        for place in &self.quiet {
            if place.compare_exchange(0, line, Ordering::Relaxed, Ordering::Relaxed).is_ok() {
                return;
            }
        }
    }

    fn rules(&self, text: &str, line: Option<u32>) {
        if let Some((_, rest)) = text.split_once("(ingress): caching permissions for `") {
            let key = rest.split('`').next().unwrap_or(rest);
            return IN_ADVANCE.with_borrow_mut(|of| key.clone_into(of));
        }
        if let Some((session, _)) = text.split_once(" did not match any configured ACL subject") {
            let session = session.to_owned();
            return self.shared.enter(|_| Knock::NoRole { session });
        }
        let Some((who, what)) = text.split_once(" is unauthorized to ") else {
            // What was let through, or does not come from outside.
            return self.hush(line);
        };
        let Some((verb, key)) = what.split_once(" (ingress) on ") else {
            // What is kept from somebody who listens to more than is his. The line may be one that serves both directions.
            if who.contains("cached result") {
                self.hush(line);
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
        let name = subject.and_then(|subject| subject.split('+').find_map(common_name));
        if let Some(name) = name {
            let mut book = self.shared.lock();
            if book.names.len() < SESSIONS || book.names.contains_key(session) {
                book.names.insert(session.to_owned(), name);
            }
        }
        if subject.is_some() && IN_ADVANCE.with_borrow(|of| of == key) {
            return;
        }
        let key: String = key.chars().filter(|c| !c.is_control()).take(QUOTED).collect();
        self.shared.enter(|book| {
            let name = book.names.get(session).cloned().unwrap_or_default();
            Knock::Refused { name, session: session.to_owned(), action: verb.to_lowercase(), key }
        });
    }

    fn tls(&self, text: &str, level: Level) {
        if let Some((_, rest)) = text.split_once("Accepted TLS connection on ") {
            // Local address, remote address, and what the certificate says.
            let Some((ends, name)) = rest.split_once(". ") else { return };
            let from = ends.split_once(": ").map_or(ends, |(_, from)| from);
            let name = name.split_once("Common Name: ").map_or(name, |(_, name)| name).trim_end_matches('.');
            let name = if name == "None" { "nobody" } else { name };
            let (from, name) = (quoted(from), quoted(name));
            return self.shared.enter(|_| Knock::Came { name, from });
        }
        if level == Level::WARN {
            let reason = quoted(text.split(". Hint:").next().unwrap_or(text));
            self.shared.enter(|_| Knock::Stranger { reason });
        }
    }
}

fn quoted(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(QUOTED).collect()
}

impl tracing::Subscriber for Ear {
    fn register_callsite(&self, metadata: &'static Metadata<'static>) -> Interest {
        let tls = metadata.target().starts_with(TLS) && *metadata.level() <= Level::DEBUG;
        if metadata.is_event() && (tls || metadata.target() == RULES) {
            Interest::sometimes()
        } else {
            Interest::never()
        }
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        Some(LevelFilter::TRACE)
    }

    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        match metadata.target() {
            RULES => !metadata.line().is_some_and(|line| self.is_quiet(line)),
            target => target.starts_with(TLS) && metadata.is_event() && *metadata.level() <= Level::DEBUG,
        }
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        let text = log_line::message(event);
        let metadata = event.metadata();
        if metadata.target() == RULES {
            self.rules(&text, metadata.line());
        } else {
            self.tls(&text, *metadata.level());
        }
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

/// Says what happens at the doors of this process, until dropped.
pub struct Doorman {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Doorman {
    /// Listens from now on; `say` is told at most once a second, each thing with how often it happened. Only the first of a
    /// process hears anything.
    #[must_use]
    pub fn new(clock: Arc<dyn Clock>, mut say: impl FnMut(&Knock, u64) + Send + 'static) -> Self {
        let shared = Arc::new(Shared::default());
        // Somebody else may listen already, such as a test.
        let _ = tracing::subscriber::set_global_default(Ear { shared: Arc::clone(&shared), quiet: Default::default() });
        let inner = Arc::clone(&shared);
        let thread =
            std::thread::Builder::new().name("doorman".to_owned()).spawn(move || report(&inner, &*clock, &mut say));
        // Without a thread nobody is told, and nothing else is the worse for it.
        Self { shared, thread: thread.ok() }
    }
}

impl Drop for Doorman {
    fn drop(&mut self) {
        self.shared.lock().closing = true;
        self.shared.written.notify_all();
        if let Some(thread) = self.thread.take() {
            // A panic in the thread has been printed already.
            let _ = thread.join();
        }
    }
}

fn report(shared: &Shared, clock: &dyn Clock, say: &mut impl FnMut(&Knock, u64)) {
    let mut next = clock.now();
    loop {
        let mut book = shared.lock();
        loop {
            let left = next.saturating_sub(clock.now());
            let waiting = book.knocks.is_empty() && book.more == 0;
            if book.closing || (!waiting && left.is_zero()) {
                break;
            }
            book = if waiting {
                shared.written.wait(book).unwrap_or_else(PoisonError::into_inner)
            } else {
                shared.written.wait_timeout(book, left).unwrap_or_else(PoisonError::into_inner).0
            };
        }
        let (knocks, more, closing) =
            (core::mem::take(&mut book.knocks), core::mem::take(&mut book.more), book.closing);
        drop(book);
        for (knock, times) in &knocks {
            say(knock, *times);
        }
        if more > 0 {
            say(&Knock::More, more);
        }
        if closing {
            return;
        }
        next = clock.now() + REPORT;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ear() -> Ear {
        Ear { shared: Arc::default(), quiet: Default::default() }
    }

    fn heard(ear: &Ear) -> Vec<String> {
        ear.shared.lock().knocks.iter().map(|(knock, times)| knock.event(*times).to_string()).collect()
    }

    #[test]
    fn a_refused_message_is_told_with_the_name_in_its_senders_certificate() {
        let ear = ear();
        ear.rules("ACL (ingress): caching permissions for `supertwin/rov/estimator/nav` ...", Some(7));
        let subject = "Interface(lo)+CertCommonName(observer.rov)+tls+ab12";
        ear.rules(
            &format!("ab12 on {subject} is unauthorized to Put (ingress) on supertwin/rov/estimator/nav"),
            Some(8),
        );
        assert!(heard(&ear).is_empty(), "worked out in advance, and not tried");
        for _ in 0..3 {
            ear.rules(
                "Using cached result: ab12 is unauthorized to Put (ingress) on supertwin/rov/estimator/nav",
                Some(9),
            );
        }
        ear.rules(
            &format!("ab12 on {subject} is unauthorized to Query (ingress) on supertwin/rov/authority/lease"),
            Some(8),
        );
        assert_eq!(
            heard(&ear),
            [
                "observer.rov (session ab12) may not put on supertwin/rov/estimator/nav (3 times)",
                "observer.rov (session ab12) may not query on supertwin/rov/authority/lease",
            ]
        );
    }

    #[test]
    fn lines_of_no_interest_are_made_once() {
        let ear = ear();
        ear.rules("Using cached result: ab12 is authorized to Put (ingress) on a", Some(5));
        ear.rules("Using cached result: ab12 is unauthorized to Put (egress) on a", Some(6));
        ear.rules("ab12 on lo+x+tls is unauthorized to Put (egress) on a", Some(7));
        assert!(heard(&ear).is_empty());
        assert_eq!([5, 6, 7].map(|line| ear.is_quiet(line)), [true, true, false], "the last serves both directions");
    }

    #[test]
    fn strangers_and_guests_are_told_apart() {
        let ear = ear();
        ear.tls("invalid peer certificate: UnknownIssuer. Hint: increase the system open file limit.", Level::WARN);
        let accepted = "Accepted TLS connection on 127.0.0.1:7447: 127.0.0.1:5000. Common Name: operator.rov.";
        ear.tls(accepted, Level::DEBUG);
        ear.rules("ab12 did not match any configured ACL subject. Default permission `Deny` will be applied", Some(3));
        let knocks: Vec<(bool, String)> =
            ear.shared.lock().knocks.keys().map(|knock| (knock.is_refusal(), knock.event(1).to_string())).collect();
        assert_eq!(
            knocks,
            [
                (false, "operator.rov has come from 127.0.0.1:5000".to_owned()),
                (true, "a connection was refused: invalid peer certificate: UnknownIssuer".to_owned()),
                (true, "session ab12 has no role here and may do nothing".to_owned()),
            ]
        );
    }

    #[test]
    fn a_flood_of_different_attempts_is_counted_and_not_kept() {
        let ear = ear();
        for i in 0..KINDS + 10 {
            ear.rules(&format!("ab12 on lo+observer.rov+tls is unauthorized to Put (ingress) on k{i}"), Some(8));
        }
        let book = ear.shared.lock();
        assert_eq!((book.knocks.len(), book.more), (KINDS, 10));
    }
}
