//! The file: one thread turns chunks into bytes, and every error of the disk comes back as an error.
//!
//! Rerun's own `FileSink` only logs what the disk says and then drops the rest of the run in silence, hence a writer
//! of our own around Rerun's encoder.

use crate::chunks::{Problem, Rows, text};
use rerun::StoreId;
use rerun::external::re_log_encoding::{Encoder, EncodingOptions};
use rerun::log::{Chunk, LogMsg};
use std::io::{self, Write};
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
}

/// A file that grows in its own thread.
pub(crate) struct Writer {
    jobs: SyncSender<Job>,
    thread: JoinHandle<Result<u64, Problem>>,
    failure: Arc<OnceLock<Problem>>,
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
        let thread = std::thread::Builder::new()
            .name("recording".to_owned())
            .spawn(move || {
                let outcome = write(target, &store, options, &inbox);
                if let Err(problem) = &outcome {
                    // Set before the inbox goes away: who finds nobody listening also finds the reason.
                    report.get_or_init(|| problem.clone());
                }
                drop(inbox);
                outcome
            })
            .map_err(text)?;
        Ok(Self { jobs, thread, failure })
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

fn write(target: impl Write, store: &StoreId, options: EncodingOptions, inbox: &Receiver<Job>) -> Result<u64, Problem> {
    let target = Counted { target, written: 0 };
    let version = rerun::build_info().version;
    let mut encoder = Encoder::new_eager(version, options, target).map_err(text)?;
    let outcome = (|| {
        for job in inbox {
            match job {
                Job::Chunk(chunk) => append(&mut encoder, store, &chunk)?,
                Job::Batch(batch) => {
                    for rows in batch {
                        append(&mut encoder, store, &rows.into_chunk()?)?;
                    }
                }
                Job::Message(message) => {
                    encoder.append(&message).map_err(text)?;
                }
            }
        }
        encoder.finish().map_err(text)?;
        encoder.flush_blocking().map_err(text)
    })();
    // Taking the file out keeps the encoder's `drop` from writing a footer after an error.
    let target = encoder.into_inner().map_err(text)?;
    outcome.map(|()| target.written)
}

fn append(encoder: &mut Encoder<impl Write>, store: &StoreId, chunk: &Chunk) -> Result<(), Problem> {
    let message = LogMsg::ArrowMsg(store.clone(), chunk.to_arrow_msg().map_err(text)?);
    encoder.append(&message).map_err(text).map(drop)
}

/// Knows how long the file must be in the end.
struct Counted<W> {
    target: W,
    written: u64,
}

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.target.write(bytes)?;
        self.written += n as u64;
        Ok(n)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.target.flush()
    }
}
