//! Who came to a router and who was turned away: strangers whose certificate is not good, and those who tried what they may
//! not. Bounded, and told at most once a second.

use crate::zenoh_log::{Notice, listen_to_access};
use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use supertwin_core::EventKind;
use supertwin_protocol::Clock;

/// Different things that are told apart between two reports; what goes beyond is counted together.
const KINDS: usize = 64;
/// Sessions whose certificate is remembered.
const SESSIONS: usize = 256;
/// Longest part of a report that somebody else has written.
const QUOTED: usize = 160;
/// Shortest time between two reports.
const REPORT: Duration = Duration::from_secs(1);

/// Something that happened at a router's listener; [`AccessLog`] says how often since the last report.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AccessEvent {
    /// Somebody with a good certificate has connected.
    Connected {
        /// Common name of the certificate.
        name: String,
        /// Address and port from which it came.
        from: String,
    },
    /// Somebody was refused before a word was said.
    ConnectionRefused {
        /// Reason of TLS, as Zenoh logs it.
        reason: String,
    },
    /// Somebody whose certificate has no role here; he may do nothing.
    WithoutRole {
        /// Identifier of the Zenoh session.
        session: String,
    },
    /// Somebody tried what he may not.
    MessageRefused {
        /// Common name of the certificate, if it is known.
        name: String,
        /// Identifier of the Zenoh session.
        session: String,
        /// What was tried: put, query, declare …, in lower case.
        action: String,
        /// Key on which it was tried.
        key: String,
    },
    /// More refusals than are told one by one.
    MoreRefused,
}

impl AccessEvent {
    /// As an event of the router that happened so many times.
    #[must_use]
    pub fn event(&self, times: u64) -> EventKind {
        match self.clone() {
            Self::Connected { name, from } => EventKind::ConnectionAccepted { name, from, times },
            Self::ConnectionRefused { reason } => EventKind::ConnectionRefused { reason, times },
            Self::WithoutRole { session } => EventKind::SessionWithoutRole { session, times },
            Self::MessageRefused { name, session, action, key } => {
                EventKind::AccessRefused { name, session, action, key, times }
            }
            Self::MoreRefused => EventKind::MoreRefused { refusals: times },
        }
    }

    /// Whether somebody was turned away.
    #[must_use]
    pub fn is_refusal(&self) -> bool {
        !matches!(self, Self::Connected { .. })
    }
}

/// What has not been reported yet.
#[derive(Debug, Default)]
struct Unreported {
    counts: BTreeMap<AccessEvent, u64>,
    more: u64,
    /// Common names by session.
    names: BTreeMap<String, String>,
    closing: bool,
}

impl Unreported {
    fn enter(&mut self, notice: Notice) {
        let event = match notice {
            Notice::Identified { session, common_name } => {
                if self.names.len() < SESSIONS || self.names.contains_key(&session) {
                    self.names.insert(session, common_name);
                }
                return;
            }
            Notice::Connected { common_name, from } => {
                AccessEvent::Connected { name: quoted(&common_name), from: quoted(&from) }
            }
            Notice::HandshakeRefused { reason } => AccessEvent::ConnectionRefused { reason: quoted(&reason) },
            Notice::WithoutRole { session } => AccessEvent::WithoutRole { session },
            Notice::MessageRefused { session, action, key } => {
                let name = self.names.get(&session).cloned().unwrap_or_default();
                AccessEvent::MessageRefused { name, session, action, key: quoted(&key) }
            }
            Notice::ConnectFailed { .. } => return,
        };
        if self.counts.len() < KINDS || self.counts.contains_key(&event) {
            *self.counts.entry(event).or_default() += 1;
        } else {
            self.more += 1;
        }
    }
}

fn quoted(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(QUOTED).collect()
}

#[derive(Debug, Default)]
struct Shared {
    unreported: Mutex<Unreported>,
    changed: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Unreported> {
        self.unreported.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Reports what happens at the listeners of this process, until dropped.
pub struct AccessLog {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl AccessLog {
    /// Listens from now on; `report` is told at most once a second, each thing with how often it happened. Only the first
    /// of a process hears anything.
    #[must_use]
    pub fn new(clock: Arc<dyn Clock>, mut report: impl FnMut(&AccessEvent, u64) + Send + 'static) -> Self {
        let shared = Arc::new(Shared::default());
        let inner = Arc::clone(&shared);
        // Somebody else may listen already, such as a test.
        let _ = listen_to_access(move |notice| {
            inner.lock().enter(notice);
            inner.changed.notify_all();
        });
        let inner = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("access-log".to_owned());
        let thread = thread.spawn(move || report_all(&inner, &*clock, &mut report));
        // Without a thread nobody is told, and nothing else is the worse for it.
        Self { shared, thread: thread.ok() }
    }
}

impl Drop for AccessLog {
    fn drop(&mut self) {
        self.shared.lock().closing = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            // A panic in the thread has been printed already.
            let _ = thread.join();
        }
    }
}

fn report_all(shared: &Shared, clock: &dyn Clock, report: &mut impl FnMut(&AccessEvent, u64)) {
    let mut next = clock.now();
    loop {
        let mut unreported = shared.lock();
        loop {
            let left = next.saturating_sub(clock.now());
            let waiting = unreported.counts.is_empty() && unreported.more == 0;
            if unreported.closing || (!waiting && left.is_zero()) {
                break;
            }
            unreported = if waiting {
                shared.changed.wait(unreported).unwrap_or_else(PoisonError::into_inner)
            } else {
                shared.changed.wait_timeout(unreported, left).unwrap_or_else(PoisonError::into_inner).0
            };
        }
        let (counts, more) = (core::mem::take(&mut unreported.counts), core::mem::take(&mut unreported.more));
        let closing = unreported.closing;
        drop(unreported);
        for (event, times) in &counts {
            report(event, *times);
        }
        if more > 0 {
            report(&AccessEvent::MoreRefused, more);
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

    fn refused(key: &str) -> Notice {
        Notice::MessageRefused { session: "ab12".to_owned(), action: "put".to_owned(), key: key.to_owned() }
    }

    #[test]
    fn a_refused_message_is_told_with_the_name_in_its_senders_certificate_and_counted() {
        let mut unreported = Unreported::default();
        unreported.enter(Notice::Identified { session: "ab12".to_owned(), common_name: "observer.rov".to_owned() });
        for _ in 0..3 {
            unreported.enter(refused("supertwin/rov/estimator/nav"));
        }
        let told: Vec<String> =
            unreported.counts.iter().map(|(event, times)| event.event(*times).to_string()).collect();
        assert_eq!(told, ["observer.rov (session ab12) may not put on supertwin/rov/estimator/nav (3 times)"]);
    }

    #[test]
    fn strangers_and_guests_are_told_apart() {
        let mut unreported = Unreported::default();
        let from = "127.0.0.1:5000".to_owned();
        unreported.enter(Notice::HandshakeRefused { reason: "no certificate".to_owned() });
        unreported.enter(Notice::Connected { common_name: "operator.rov".to_owned(), from });
        unreported.enter(Notice::WithoutRole { session: "ab12".to_owned() });
        let told: Vec<(bool, String)> =
            unreported.counts.keys().map(|event| (event.is_refusal(), event.event(1).to_string())).collect();
        assert_eq!(
            told,
            [
                (false, "operator.rov has come from 127.0.0.1:5000".to_owned()),
                (true, "a connection was refused: no certificate".to_owned()),
                (true, "session ab12 has no role here and may do nothing".to_owned()),
            ]
        );
    }

    #[test]
    fn a_flood_of_different_attempts_is_counted_and_not_kept() {
        let mut unreported = Unreported::default();
        for i in 0..KINDS + 10 {
            unreported.enter(refused(&format!("k{i}")));
        }
        assert_eq!((unreported.counts.len(), unreported.more), (KINDS, 10));
    }
}
