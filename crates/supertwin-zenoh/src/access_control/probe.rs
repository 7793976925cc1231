//! Tries what the matrix says: two sessions, one that tries and one that may see everything, and no wait for something that
//! does not come.
//!
//! Messages of one session and priority stay in order through a router. So whoever tries something and then asks the
//! witness a question that is allowed knows with the answer that all before it has arrived, or never will.

use crate::session::{LinkError, unique};
use crate::transport::question;
use crate::watch::Presence;
use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use supertwin_protocol::access::{AccessRow, Verb};
use supertwin_protocol::keys;
use zenoh::handlers::FifoChannelHandler;
use zenoh::key_expr::KeyExpr;
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable, Reply, ReplyKeyExpr};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

/// How long an answer may take that must come.
const PATIENCE: Duration = Duration::from_secs(5);
/// Between two looks whether a question was refused.
const LOOK: Duration = Duration::from_millis(5);
/// Times that the witness is asked before it counts as gone.
const TRIES: u32 = 4;

/// What came of an attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// Nothing that belongs to it was seen.
    Nothing,
    /// Something, but not all that belongs to it: a question arrived and its answer did not.
    Part,
    /// All that belongs to it was seen.
    All,
}

impl Seen {
    fn all_if(whole: bool) -> Self {
        if whole { Self::All } else { Self::Nothing }
    }

    /// Whether this is what the matrix says.
    #[must_use]
    pub fn is_expected(self, allowed: bool) -> bool {
        self == if allowed { Self::All } else { Self::Nothing }
    }
}

/// What a session heard: full keys, and whether it was put or deleted.
#[derive(Clone, Debug, Default)]
struct SampleLog(Arc<Mutex<Vec<(String, SampleKind)>>>);

impl SampleLog {
    fn callback(&self, marks: String) -> impl Fn(Sample) + Send + Sync + 'static {
        let received = Arc::clone(&self.0);
        move |sample| {
            // The vehicle's own messages are none of the probe's.
            let ours = sample.kind() == SampleKind::Delete || sample.payload().to_bytes().starts_with(marks.as_bytes());
            if ours {
                received.lock().push((sample.key_expr().as_str().to_owned(), sample.kind()));
            }
        }
    }

    fn drain(&self) -> Vec<(String, SampleKind)> {
        core::mem::take(&mut *self.0.lock())
    }
}

/// A session with full access to a vehicle that sees what arrives there.
pub struct Witness {
    /// Its session, which has full access.
    pub session: Session,
    root: String,
    /// Begins every payload, and names what nobody else would.
    pub mark: String,
    asked: u64,
    marker: Queryable<FifoChannelHandler<Query>>,
    samples: SampleLog,
    _subscribers: Vec<Subscriber<()>>,
}

impl Witness {
    /// Sees everything of `vehicle` by `session`, which has full access to it and no namespace.
    ///
    /// # Errors
    /// When the session fails.
    pub fn open(session: &Session, vehicle: &str) -> Result<Self, LinkError> {
        let root = keys::namespace(vehicle);
        let mark = format!("access-probe-{}", unique());
        let marker = session
            .declare_queryable(format!("{root}/{}/*", keys::state("plant", &mark)))
            .complete(true)
            .with(zenoh::handlers::FifoChannel::new(64))
            .wait()
            .map_err(LinkError::session("the witness"))?;
        let samples = SampleLog::default();
        let all = format!("{root}/**");
        let subscribers = [all.clone(), keys::advanced(&all)]
            .into_iter()
            .map(|key| session.declare_subscriber(key).callback(samples.callback(mark.clone())).wait())
            .collect::<Result<_, _>>()
            .map_err(LinkError::session("the witness"))?;
        Ok(Self { session: session.clone(), root, mark, asked: 0, marker, samples, _subscribers: subscribers })
    }

    /// Lets `subject` ask a question that every role may ask; `meanwhile` is done before it is answered. Afterwards all
    /// that the two sent before has arrived, or was refused. False when no answer comes: `subject` may not even ask.
    ///
    /// # Errors
    /// When a session fails.
    pub fn settle(
        &mut self,
        subject: &Session,
        meanwhile: impl FnOnce() -> Result<(), LinkError>,
    ) -> Result<bool, LinkError> {
        let mut meanwhile = Some(meanwhile);
        for _ in 0..TRIES {
            self.asked += 1;
            let key = format!("{}/{}", self.root, keys::state("plant", &format!("{}/{}", self.mark, self.asked)));
            let replies = ask(subject, &key)?;
            loop {
                match self.marker.recv_timeout(LOOK).ok().flatten() {
                    Some(query) if query.key_expr().as_str() == key => {
                        if let Some(meanwhile) = meanwhile.take() {
                            meanwhile()?;
                        }
                        query.reply(key.clone(), "").wait().map_err(LinkError::session("the witness"))?;
                        drop(query);
                        if replies.into_iter().any(|reply| reply.result().is_ok()) {
                            return Ok(true);
                        }
                        break;
                    }
                    // Of an earlier try.
                    Some(_) => {}
                    // The end of the answers before the question: it was refused.
                    None if replies.try_recv().is_err() => break,
                    None => {}
                }
            }
        }
        Ok(false)
    }

    /// Lets `subject` try `verb` on an example of `row`, and looks what comes of it. Payloads are such that no service takes
    /// them for anything.
    ///
    /// # Errors
    /// When a session fails.
    pub fn attempt(
        &mut self,
        subject: &Session,
        row: &AccessRow,
        verb: Verb,
        allowed: bool,
    ) -> Result<Seen, LinkError> {
        let key = format!("{}/{}", self.root, row.example(&self.mark));
        let mut seen = self.attempt_on(subject, &key, row.is_liveliness(), verb)?;
        // What should work is tried again: samples may be dropped, and nothing says when a declaration has come everywhere.
        // What should not work must not at the first time.
        for _ in 1..TRIES {
            if !allowed || seen == Seen::All {
                break;
            }
            self.pause();
            seen = self.attempt_on(subject, &key, row.is_liveliness(), verb)?;
        }
        Ok(seen)
    }

    /// The same on one full key.
    ///
    /// # Errors
    /// When a session fails.
    pub fn attempt_on(&mut self, subject: &Session, key: &str, alive: bool, verb: Verb) -> Result<Seen, LinkError> {
        let failed = || LinkError::session(key.to_owned());
        match verb {
            Verb::Put | Verb::Delete => {
                self.samples.drain();
                let kind = if verb == Verb::Put {
                    subject.put(key.to_owned(), self.mark.clone()).wait().map_err(failed())?;
                    SampleKind::Put
                } else {
                    subject.delete(key.to_owned()).wait().map_err(failed())?;
                    SampleKind::Delete
                };
                self.settle(subject, || Ok(()))?;
                Ok(Seen::all_if(self.samples.drain().iter().any(|(received, of)| received == key && *of == kind)))
            }
            Verb::Subscribe => self.subscribe(subject, key, alive),
            Verb::Get | Verb::Queryable | Verb::Liveliness => {
                let witness = self.session.clone();
                let (asks, answers) = if verb == Verb::Get { (subject, &witness) } else { (&witness, subject) };
                if verb == Verb::Liveliness || (alive && verb == Verb::Get) {
                    let _token = Presence::show(answers, key)?;
                    self.settle(subject, || Ok(()))?;
                    return Ok(Seen::all_if(is_shown(asks, key)?));
                }
                let (_queryable, asked) = answering(answers, key, &self.mark)?;
                self.settle(subject, || Ok(()))?;
                Ok(match (is_answered(asks, key, &self.mark)?, asked.load(Ordering::SeqCst)) {
                    (true, _) => Seen::All,
                    (false, true) => Seen::Part,
                    (false, false) => Seen::Nothing,
                })
            }
        }
    }

    /// Waits for a moment: nobody but the probe asks there.
    fn pause(&self) {
        // Nothing comes.
        let _ = self.marker.recv_timeout(LOOK);
    }

    fn subscribe(&mut self, subject: &Session, key: &str, alive: bool) -> Result<Seen, LinkError> {
        let (samples, failed) = (SampleLog::default(), || LinkError::session(key.to_owned()));
        let session = self.session.clone();
        if alive {
            // A token has no payload: everything that is heard is its own.
            let listening = subject
                .liveliness()
                .declare_subscriber(key.to_owned())
                .callback(samples.callback(String::new()))
                .wait();
            let listening = listening.map_err(failed())?;
            self.settle(subject, || Ok(()))?;
            let mut token = None;
            self.settle(subject, || {
                token = Some(Presence::show(&session, key)?);
                Ok(())
            })?;
            let seen = !samples.drain().is_empty();
            drop((listening, token));
            return Ok(Seen::all_if(seen));
        }
        let listening = subject.declare_subscriber(key.to_owned()).callback(samples.callback(self.mark.clone())).wait();
        let listening = listening.map_err(failed())?;
        self.settle(subject, || Ok(()))?;
        let mark = self.mark.clone();
        self.settle(subject, || session.put(key.to_owned(), mark).wait().map_err(failed()))?;
        drop(listening);
        Ok(Seen::all_if(!samples.drain().is_empty()))
    }
}

fn ask(session: &Session, key: &str) -> Result<FifoChannelHandler<Reply>, LinkError> {
    question(session, key, PATIENCE).accept_replies(ReplyKeyExpr::Any).wait().map_err(LinkError::session(key))
}

/// Whether anybody at all answers a question, if only by a refusal.
pub(super) fn is_answered_by_anybody(session: &Session, key: &str) -> Result<Seen, LinkError> {
    let said = |reply: Reply| reply.result().map_or_else(|error| *error.payload().to_bytes() != *b"Timeout", |_| true);
    let answers: Vec<bool> = ask(session, key)?.into_iter().map(said).collect();
    Ok(Seen::all_if(answers.contains(&true)))
}

fn is_answered(session: &Session, key: &str, mark: &str) -> Result<bool, LinkError> {
    let replies = ask(session, key)?;
    let ours =
        |reply: Reply| reply.result().is_ok_and(|sample| sample.payload().to_bytes().starts_with(mark.as_bytes()));
    // All of them, so that nothing of this question is left on the way.
    let answers: Vec<bool> = replies.into_iter().map(ours).collect();
    Ok(answers.contains(&true))
}

/// Answers on `key`; the flag is set when somebody asks.
fn answering(session: &Session, key: &str, mark: &str) -> Result<(Queryable<()>, Arc<AtomicBool>), LinkError> {
    let asked = Arc::new(AtomicBool::new(false));
    let (flag, mark, at) = (Arc::clone(&asked), mark.to_owned(), KeyExpr::try_from(key.to_owned()));
    let at = at.map_err(LinkError::session(key))?;
    let queryable = session
        .declare_queryable(key.to_owned())
        .callback(move |query: Query| {
            flag.store(true, Ordering::SeqCst);
            // One that does not get through is one that was not answered.
            let _ = query.reply(at.clone(), mark.clone()).wait();
        })
        .wait()
        .map_err(LinkError::session(key))?;
    Ok((queryable, asked))
}

fn is_shown(session: &Session, key: &str) -> Result<bool, LinkError> {
    let replies = session.liveliness().get(key.to_owned()).timeout(PATIENCE).wait().map_err(LinkError::session(key))?;
    Ok(replies.into_iter().filter(|reply| reply.result().is_ok()).count() > 0)
}
