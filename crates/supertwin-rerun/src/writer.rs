//! The file: one thread turns chunks into bytes, and every error of the disk comes back as an error.
//!
//! Rerun's own `FileSink` only logs what the disk says and then drops the rest of the run in silence, hence a writer
//! of our own around Rerun's encoder.

use crate::chunks::{Problem, Rows, text};
use rerun::StoreId;
use rerun::external::re_log_encoding::{Encoder, EncodingOptions};
use rerun::log::{Chunk, LogMsg};
use std::io::{self, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

/// Batches that wait for the disk before the run waits as well.
const WAITING: usize = 4;

/// What can be written.
pub(crate) enum Job {
    /// Part of the recording.
    Chunk(Chunk),
    /// Columns of the recording that still have to become chunks.
    Batch(Vec<Rows>),
    /// Anything else, such as the blueprint.
    Message(LogMsg),
    /// Several at once: all of them get through, or none.
    All(Vec<Job>),
    /// Whoever waits for this hears when everything before it is in the file.
    Sync(SyncSender<()>),
}

impl Job {
    /// Hands the messages of `store` that this comes to, one by one, to `take`.
    pub(crate) fn unpack(
        self,
        store: &StoreId,
        take: &mut dyn FnMut(LogMsg) -> Result<(), Problem>,
    ) -> Result<(), Problem> {
        let message = |chunk: &Chunk| {
            let message = chunk.to_arrow_msg().map_err(text)?;
            Ok::<_, Problem>(LogMsg::ArrowMsg(store.clone(), message))
        };
        match self {
            Self::Chunk(chunk) => take(message(&chunk)?),
            Self::Batch(batch) => batch.into_iter().try_for_each(|rows| take(message(&rows.into_chunk()?)?)),
            Self::Message(message) => take(message),
            Self::All(jobs) => jobs.into_iter().try_for_each(|job| job.unpack(store, take)),
            Self::Sync(done) => {
                // Who does not wait any more needs no answer.
                let _ = done.send(());
                Ok(())
            }
        }
    }
}

/// A file that grows in its own thread.
pub(crate) struct Writer {
    jobs: SyncSender<Job>,
    thread: JoinHandle<Result<u64, Problem>>,
    failure: Arc<OnceLock<Problem>>,
    written: Arc<AtomicU64>,
}

impl Writer {
    /// Starts to write `store` to `target`.
    pub(crate) fn start(
        target: impl Write + Send + 'static,
        store: StoreId,
        options: EncodingOptions,
    ) -> Result<Self, Problem> {
        let (jobs, inbox) = sync_channel(WAITING);
        let failure = Arc::new(OnceLock::new());
        let report = Arc::clone(&failure);
        let written = Arc::new(AtomicU64::new(0));
        let count = Arc::clone(&written);
        let thread = std::thread::Builder::new()
            .name("recording".to_owned())
            .spawn(move || {
                let outcome = write(Counted { target, written: count }, &store, options, &inbox);
                if let Err(problem) = &outcome {
                    // Set before the inbox goes away: who finds nobody listening also finds the reason.
                    report.get_or_init(|| problem.clone());
                }
                drop(inbox);
                outcome
            })
            .map_err(text)?;
        Ok(Self { jobs, thread, failure, written })
    }

    /// Waits until everything that was queued is in the file.
    pub(crate) fn sync(&self) -> Result<(), Problem> {
        let (done, wait) = sync_channel(1);
        self.send(Job::Sync(done))?;
        // An error ends the thread, and with it the wait.
        wait.recv().or_else(|_| self.check())
    }

    /// Bytes that the disk has taken so far.
    pub(crate) fn written(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// What went wrong so far.
    pub(crate) fn check(&self) -> Result<(), Problem> {
        self.failure.get().map_or(Ok(()), |problem| Err(problem.clone()))
    }

    /// Queues a job; waits when the disk can't follow.
    pub(crate) fn send(&self, job: Job) -> Result<(), Problem> {
        self.jobs.send(job).map_err(|_| self.check().err().unwrap_or_else(|| "the writing thread is gone".to_owned()))
    }

    /// Writes what is queued and the footer; the length of the file.
    pub(crate) fn close(self) -> Result<u64, Problem> {
        drop(self.jobs);
        self.thread.join().map_err(|_| "the writing thread panicked".to_owned())?
    }
}

fn write(
    target: Counted<impl Write>,
    store: &StoreId,
    options: EncodingOptions,
    inbox: &Receiver<Job>,
) -> Result<u64, Problem> {
    let version = rerun::build_info().version;
    let mut encoder = Encoder::new_eager(version, options, target).map_err(text)?;
    let outcome = (|| {
        for job in inbox {
            job.unpack(store, &mut |message| encoder.append(&message).map_err(text).map(drop))?;
        }
        encoder.finish().map_err(text)?;
        encoder.flush_blocking().map_err(text)
    })();
    // Taking the file out keeps the encoder's `drop` from writing a footer after an error.
    let target = encoder.into_inner().map_err(text)?;
    outcome.map(|()| target.written.load(Ordering::Relaxed))
}

/// Knows how long the file must be in the end.
struct Counted<W> {
    target: W,
    written: Arc<AtomicU64>,
}

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.target.write(bytes)?;
        self.written.fetch_add(n as u64, Ordering::Relaxed);
        Ok(n)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.target.flush()
    }
}
