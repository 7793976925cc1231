//! The runs of a sweep, on all cores, each into the journal as soon as it is finished.

use super::journal::Journal;
use super::run_row::RunRow;
use crate::placement::provenance;
use crate::{OperationError, Progress};
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use supertwin_core::{NoSink, RunSink};
use supertwin_lab::sweep::{KeepRecordings, Plan};
use supertwin_lab::{ResolvedTrial, RunError, RunOutcome};
use supertwin_rerun::{Options, RerunSink};

/// Folder of the recordings, in that of the sweep.
pub(crate) const RECORDINGS: &str = "recordings";

/// What all runs share.
pub(crate) struct Campaign<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) keep_recordings: KeepRecordings,
    /// The sweep's folder.
    pub(crate) folder: &'a Path,
    /// Puts the verdict to a complete run.
    pub(crate) judge: &'a (dyn Fn(&mut RunRow) + Sync),
    pub(crate) stop: &'a AtomicBool,
    pub(crate) progress: &'a dyn Progress,
}

impl Campaign<'_> {
    /// Does the runs of these indices; returns what was finished. The first failure ends it.
    pub(crate) fn execute(&self, todo: &[usize], journal: &mut Journal) -> Result<Vec<RunRow>, OperationError> {
        if self.keep_recordings != KeepRecordings::None {
            let folder = self.folder.join(RECORDINGS);
            std::fs::create_dir_all(&folder).map_err(|error| OperationError::at(&folder, &error))?;
        }
        let shared = Mutex::new((journal, Vec::with_capacity(todo.len())));
        let failures: Vec<OperationError> = todo
            .par_iter()
            // A run is long enough to be handed out by itself.
            .with_max_len(1)
            .filter_map(|run| {
                let failed = self.one(*run).and_then(|row| {
                    let Some(row) = row else { return Ok(()) };
                    let mut shared = shared.lock().unwrap_or_else(PoisonError::into_inner);
                    let (journal, rows) = &mut *shared;
                    journal.add(&row)?;
                    rows.push(row);
                    Ok(())
                });
                failed.inspect_err(|_| self.stop.store(true, Ordering::Relaxed)).err()
            })
            .collect();
        let (journal, rows) = shared.into_inner().unwrap_or_else(PoisonError::into_inner);
        journal.sync()?;
        match failures.into_iter().next() {
            Some(failure) => Err(failure),
            None => Ok(rows),
        }
    }

    /// `None`: it was interrupted.
    fn one(&self, run: usize) -> Result<Option<RunRow>, OperationError> {
        if self.stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let planned = &self.plan.runs[run];
        let trial = &self.plan.configurations[planned.configuration].trial;
        let place = format!("{RECORDINGS}/{}.rrd", planned.id);
        let outcome = match self.keep_recordings {
            KeepRecordings::All => self.recorded(trial, planned.seed, &place),
            KeepRecordings::OnFail | KeepRecordings::None => self.watched(trial, planned.seed, &mut NoSink, false),
        };
        let mut row = match outcome {
            Ok(outcome) if !outcome.complete => {
                self.forget(&place);
                return Ok(None);
            }
            Ok(outcome) => {
                let mut row = RunRow::complete(run, &planned.id, &outcome);
                (self.judge)(&mut row);
                row
            }
            Err(RunError::Sink(error)) => {
                return Err(OperationError::Run { name: planned.id.clone(), cause: RunError::Sink(error) });
            }
            Err(error) => RunRow::invalid(run, &planned.id, &error),
        };
        // A run repeats bit for bit: it is recorded once it is known to be worth it.
        if self.keep_recordings == KeepRecordings::OnFail && !row.verdict.is_well() {
            match self.recorded(trial, planned.seed, &place) {
                Err(RunError::Sink(error)) => {
                    return Err(OperationError::Run { name: planned.id.clone(), cause: RunError::Sink(error) });
                }
                Ok(outcome) if !outcome.complete => {
                    self.forget(&place);
                    return Ok(None);
                }
                _ => {}
            }
        }
        // What can't even start leaves no recording.
        if row.ticks == 0 {
            self.forget(&place);
        }
        let kept = self.keep_recordings == KeepRecordings::All
            || self.keep_recordings == KeepRecordings::OnFail && !row.verdict.is_well();
        row.recording = (kept && row.ticks > 0).then_some(place);
        Ok(Some(row))
    }

    fn recorded(&self, trial: &ResolvedTrial, seed: u64, place: &str) -> Result<RunOutcome, RunError> {
        // What is there was left by a run that is not in the journal.
        let options = Options { overwrite: true, ..Options::default() };
        let mut sink = RerunSink::create(&self.folder.join(place), options)?;
        self.watched(trial, seed, &mut sink, true)
    }

    fn watched<S: RunSink>(
        &self,
        trial: &ResolvedTrial,
        seed: u64,
        sink: &mut S,
        recording: bool,
    ) -> Result<RunOutcome, RunError> {
        let provenance = provenance();
        let mut shown = 0;
        let outcome = supertwin_lab::run(trial, seed, sink, recording.then_some(&provenance), |ticks| {
            self.progress.advance(ticks - shown);
            shown = ticks;
            !self.stop.load(Ordering::Relaxed)
        });
        self.progress.advance(trial.ticks() - shown);
        outcome
    }

    /// Removes the recording of a run that is not finished, if there is one.
    fn forget(&self, place: &str) {
        if self.keep_recordings != KeepRecordings::None {
            drop(std::fs::remove_file(self.folder.join(place)));
        }
    }
}
