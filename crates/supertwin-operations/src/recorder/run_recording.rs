//! One run of one vehicle on its way to disk: parts of a file, and a live view beside it.
//!
//! The file is the record of truth. When the disk fails, what was written stays readable, an alarm says so, and a new
//! part is tried every few seconds; the live view goes on meanwhile.

use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use std::time::Duration;
use supertwin_core::run::Properties;
use supertwin_core::{Event, EventKind, Probe, RunHeader, RunSink, Signal, SinkError, Tick};
use supertwin_lab::rescore::{self, Rescored};
use supertwin_rerun::{Clocks, Live, Options, RerunSink, compact, read_selected};

/// How often what was written goes to the file: what a crash can take.
const FLUSH: Duration = Duration::from_millis(500);
/// How long a disk that failed is left alone.
const RETRY: Duration = Duration::from_secs(5);
/// Ticks in a batch of the live view.
const LIVE_BATCH: usize = 10;

/// When a part is closed and the next one begun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation {
    /// Bytes of a part.
    pub bytes: u64,
    /// Time of a part on the wall.
    pub time: Duration,
}

impl Default for Rotation {
    /// Ten minutes, or two gigabytes.
    fn default() -> Self {
        Self { bytes: 2 << 30, time: Duration::from_secs(600) }
    }
}

/// A run on its way to disk.
pub(crate) struct RunRecording {
    header: RunHeader,
    folder: Option<PathBuf>,
    rotation: Rotation,
    part: u32,
    file: File,
    live: Option<RerunSink>,
    flushed_at: Duration,
    /// Ticks that could not be written while the disk failed.
    pub(crate) lost_ticks: u64,
    /// What happened to the file, for its owner to tell others.
    pub(crate) events: Vec<EventKind>,
    /// Parts that are closed and are being rewritten in larger pieces.
    pub(crate) compacting: Vec<JoinHandle<Result<(), String>>>,
}

enum File {
    Open {
        sink: Box<RerunSink>,
        path: PathBuf,
        since: Duration,
    },
    Broken {
        until: Duration,
    },
    /// Only a live view was asked for, or it is over.
    None,
}

impl RunRecording {
    /// Begins the first part in `folder`, if there is one, and the live view, if there is one.
    pub(crate) fn begin(
        header: RunHeader,
        folder: Option<PathBuf>,
        live: Option<&Live>,
        rotation: Rotation,
        now: Duration,
    ) -> Self {
        let live = live.and_then(|live| {
            let mut sink = RerunSink::live(live, LIVE_BATCH);
            // A view that can't begin is no reason not to record.
            sink.begin(&header).is_ok().then_some(sink)
        });
        let mut recording = Self {
            header,
            file: if folder.is_some() { File::Broken { until: now } } else { File::None },
            folder,
            rotation,
            part: 0,
            live,
            flushed_at: now,
            lost_ticks: 0,
            events: Vec::new(),
            compacting: Vec::new(),
        };
        recording.mend(now);
        recording
    }

    /// Name of part `n` of a run.
    fn path(folder: &Path, name: &str, n: u32) -> PathBuf {
        folder.join(if n == 1 { format!("{name}.rrd") } else { format!("{name}.part{n}.rrd") })
    }

    /// Begins the next part when the disk has been left alone for long enough.
    fn mend(&mut self, now: Duration) {
        let (File::Broken { until }, Some(folder)) = (&self.file, &self.folder) else { return };
        if now < *until {
            return;
        }
        let opened = std::fs::create_dir_all(folder)
            .map_err(|error| SinkError { what: folder.display().to_string(), cause: error.to_string() })
            .and_then(|()| {
                // A part that is there already is of an earlier recorder: nothing is overwritten.
                let free = (self.part + 1..u32::MAX).find(|n| !Self::path(folder, &self.header.name, *n).exists());
                self.part = free.unwrap_or(u32::MAX);
                let path = Self::path(folder, &self.header.name, self.part);
                let options = Options { compress: true, ..Options::default() };
                let mut sink = RerunSink::create(&path, options)?;
                sink.begin(&self.header)?;
                Ok((sink, path))
            });
        match opened {
            Ok((sink, path)) => {
                self.events.push(EventKind::RecordingOpened { path: path.display().to_string() });
                self.file = File::Open { sink: Box::new(sink), path, since: now };
            }
            Err(error) => self.broken(&error, now),
        }
    }

    fn broken(&mut self, error: &SinkError, now: Duration) {
        self.events.push(EventKind::RecordingFailed { reason: error.to_string() });
        // What has been written is closed as well as the disk allows, and stays readable in any case.
        self.file = File::Broken { until: now + RETRY };
    }

    /// Everything that is heard from here on belongs to `tick`.
    pub(crate) fn tick(&mut self, tick: Tick, clocks: Clocks, now: Duration) {
        self.mend(now);
        if let Some(live) = &mut self.live
            && live.tick(tick).is_ok()
        {
            live.clocks(clocks);
        }
        match &mut self.file {
            File::Open { sink, .. } => match sink.tick(tick) {
                Ok(()) => sink.clocks(clocks),
                Err(error) => {
                    self.lost_ticks += 1;
                    self.broken(&error, now);
                }
            },
            File::Broken { .. } => self.lost_ticks += 1,
            File::None => {}
        }
    }

    /// Everything that is heard from here on belongs to `tick`, which has been written already.
    pub(crate) fn late_tick(&mut self, tick: Tick, clocks: Clocks) {
        self.each(|sink| sink.late_tick(tick, clocks));
    }

    /// Writes an event at its own tick.
    pub(crate) fn event(&mut self, event: &Event, clocks: Clocks) {
        self.each(|sink| {
            // What goes wrong here is heard again at the next tick.
            let _ = sink.event_at(event, Some(clocks));
        });
    }

    /// Words at `path`.
    pub(crate) fn text(&mut self, path: &str, tick: Tick, clocks: Clocks, words: &str) {
        self.each(|sink| sink.text(path, tick, clocks, words.to_owned()));
    }

    /// The exact bytes of a message; for the file only.
    pub(crate) fn bytes(&mut self, path: &str, tick: Tick, clocks: Clocks, bytes: Vec<u8>) {
        if let File::Open { sink, .. } = &mut self.file {
            sink.bytes(path, tick, clocks, bytes);
        }
    }

    fn each(&mut self, mut f: impl FnMut(&mut RerunSink)) {
        if let File::Open { sink, .. } = &mut self.file {
            f(sink);
        }
        if let Some(live) = &mut self.live {
            f(live);
        }
    }

    /// Saves, rotates and mends when it is time.
    pub(crate) fn poll(&mut self, now: Duration) {
        self.mend(now);
        if now.saturating_sub(self.flushed_at) >= FLUSH {
            self.save(now);
        }
    }

    /// Everything that was written so far is in the file when this returns, and no crash of the recorder can take it.
    pub(crate) fn save(&mut self, now: Duration) {
        self.flushed_at = now;
        if let Some(live) = &mut self.live {
            // A view never fails.
            let _ = live.flush();
        }
        let File::Open { sink, since, .. } = &mut self.file else { return };
        if let Err(error) = sink.sync() {
            self.broken(&error, now);
        } else if sink.written() >= self.rotation.bytes || now.saturating_sub(*since) >= self.rotation.time {
            self.close(&Properties::new(), now);
            self.file = File::Broken { until: now };
            self.mend(now);
        }
    }

    fn close(&mut self, results: &Properties, now: Duration) {
        let File::Open { mut sink, path, .. } = std::mem::replace(&mut self.file, File::None) else { return };
        match sink.finish(results) {
            Ok(()) => {
                self.events.push(EventKind::RecordingClosed { path: path.display().to_string() });
                self.compacting.push(std::thread::spawn(move || compact(&path)));
            }
            Err(error) => self.broken(&error, now),
        }
    }

    /// Scores of the run from what is in its files; `None` when there is no file.
    pub(crate) fn rescore(&mut self) -> Option<Result<Rescored, String>> {
        let File::Open { sink, .. } = &mut self.file else { return None };
        let first = Self::path(self.folder.as_deref()?, &self.header.name, 1);
        Some((|| {
            sink.sync().map_err(|error| error.to_string())?;
            let recording = read_selected(&first, &rescore::is_needed).map_err(|error| error.to_string())?;
            rescore::rescore(&recording).map_err(|error| error.to_string())
        })())
    }

    /// The run is over.
    pub(crate) fn finish(&mut self, results: &Properties, now: Duration) {
        self.close(results, now);
        if let Some(mut live) = self.live.take() {
            // A view never fails.
            let _ = live.finish(results);
        }
    }
}

impl Probe for RunRecording {
    fn vector(&mut self, signal: &'static Signal, values: &[f64]) {
        self.each(|sink| sink.vector(signal, values));
    }
    fn label(&mut self, signal: &'static Signal, value: &'static str) {
        self.each(|sink| sink.label(signal, value));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use supertwin_rerun::read;

    static DEPTH: Signal = Signal { path: "tracking/depth", components: &[], units: &["m"], about: "" };

    #[test]
    fn what_is_older_than_half_a_second_of_the_recorders_clock_is_in_the_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let header = RunHeader { name: "run".to_owned(), ..RunHeader::default() };
        let mut recording =
            RunRecording::begin(header, Some(folder.path().to_owned()), None, Rotation::default(), Duration::ZERO);
        // The processor is taken away from it between any two ticks, for longer and longer.
        let mut now = Duration::ZERO;
        let mut written: Vec<(Duration, i64)> = Vec::new();
        for k in 0..40 {
            recording.tick(Tick { k, dt_s: 0.02 }, Clocks::default(), now);
            recording.vector(&DEPTH, &[1.0]);
            written.push((now, k.cast_signed()));
            recording.poll(now);
            let file = folder.path().join("run.rrd");
            let message = read(&file).expect("is read").last_tick();
            let old = written.iter().rev().find(|(at, _)| now - *at > FLUSH).map(|(_, tick)| *tick);
            assert!(message >= old, "at {now:?}: {message:?} is in the file, {old:?} is old enough");
            now += Duration::from_millis(20 * k);
        }
        recording.tick(Tick { k: 40, dt_s: 0.02 }, Clocks::default(), now);
        recording.vector(&DEPTH, &[1.0]);
        recording.save(now);
        assert_eq!(read(&folder.path().join("run.rrd")).expect("is read").last_tick(), Some(40), "at once");
    }
}
