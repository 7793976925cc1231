//! Who came to a router and who was turned away: strangers whose certificate is not good, and those who tried what they may
//! not. Bounded, and told at most once a second.

use crate::zenoh_log::{Notice, listen_to_access};
use parking_lot::{Condvar, Mutex};
use std::collections::BTreeMap;
use std::sync::Arc;
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

/// What has not been reported yet.
#[derive(Debug, Default)]
struct Unreported {
    /// Each with how often it happened, in the order in which they happened first.
    counts: Vec<(EventKind, u64)>,
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
                EventKind::ConnectionAccepted { name: quoted(&common_name), from: quoted(&from), times: 1 }
            }
            Notice::HandshakeRefused { reason } => EventKind::ConnectionRefused { reason: quoted(&reason), times: 1 },
            Notice::WithoutRole { session } => EventKind::SessionWithoutRole { session, times: 1 },
            Notice::MessageRefused { session, action, key } => {
                let name = self.names.get(&session).cloned().unwrap_or_default();
                EventKind::AccessRefused { name, session, action, key: quoted(&key), times: 1 }
            }
            Notice::ConnectFailed { .. } => return,
        };
        if let Some((_, count)) = self.counts.iter_mut().find(|(known, _)| *known == event) {
            *count += 1;
        } else if self.counts.len() < KINDS {
            self.counts.push((event, 1));
        } else {
            self.more += 1;
        }
    }

    /// Everything that happened since the last call.
    fn drain(&mut self) -> Vec<EventKind> {
        let counted = |(mut event, count): (EventKind, u64)| {
            if let EventKind::ConnectionAccepted { times, .. }
            | EventKind::ConnectionRefused { times, .. }
            | EventKind::SessionWithoutRole { times, .. }
            | EventKind::AccessRefused { times, .. } = &mut event
            {
                *times = count;
            }
            event
        };
        let more = core::mem::take(&mut self.more);
        let more = (more > 0).then_some(EventKind::MoreRefused { refusals: more });
        core::mem::take(&mut self.counts).into_iter().map(counted).chain(more).collect()
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

/// Reports what happens at the listeners of this process, until dropped.
pub struct AccessLog {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl AccessLog {
    /// Listens from now on; `report` is told at most once a second, each thing with how often it happened. Only the first
    /// of a process hears anything.
    #[must_use]
    pub fn new(clock: Arc<dyn Clock>, mut report: impl FnMut(EventKind) + Send + 'static) -> Self {
        let shared = Arc::new(Shared::default());
        let inner = Arc::clone(&shared);
        // Somebody else may listen already, such as a test.
        let _ = listen_to_access(move |notice| {
            inner.unreported.lock().enter(notice);
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
        self.shared.unreported.lock().closing = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            // A panic in the thread has been printed already.
            let _ = thread.join();
        }
    }
}

fn report_all(shared: &Shared, clock: &dyn Clock, report: &mut impl FnMut(EventKind)) {
    let mut next = clock.now();
    loop {
        let mut unreported = shared.unreported.lock();
        loop {
            let left = next.saturating_sub(clock.now());
            let waiting = unreported.counts.is_empty() && unreported.more == 0;
            if unreported.closing || (!waiting && left.is_zero()) {
                break;
            }
            if waiting {
                shared.changed.wait(&mut unreported);
            } else {
                shared.changed.wait_for(&mut unreported, left);
            }
        }
        let (events, closing) = (unreported.drain(), unreported.closing);
        drop(unreported);
        events.into_iter().for_each(&mut *report);
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
        let told: Vec<String> = unreported.drain().iter().map(EventKind::to_string).collect();
        assert_eq!(told, ["observer.rov (session ab12) may not put on supertwin/rov/estimator/nav (3 times)"]);
    }

    #[test]
    fn a_flood_of_different_attempts_is_counted_and_not_kept() {
        let mut unreported = Unreported::default();
        for i in 0..KINDS + 10 {
            unreported.enter(refused(&format!("k{i}")));
        }
        let told = unreported.drain();
        assert_eq!((told.len(), told.last()), (KINDS + 1, Some(&EventKind::MoreRefused { refusals: 10 })));
    }
}
