//! The runs of a sweep, on all cores, each into the journal as soon as it is finished.

use super::journal::Journal;
use super::run_row::RunRow;
use crate::run::watched;
use crate::{OperationError, Progress};
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use supertwin_core::NoSink;
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
        let failed = |cause| OperationError::Run { name: planned.id.clone(), cause };
        let mut recorded = self.keep_recordings == KeepRecordings::All;
        let mut row = match self.run(trial, planned.seed, recorded.then_some(place.as_str())) {
            Ok(outcome) if !outcome.complete => return Ok(self.forget(&place)),
            Ok(outcome) => {
                let mut row = RunRow::complete(run, &planned.id, &outcome);
                (self.judge)(&mut row);
                row
            }
            Err(error @ RunError::Sink(_)) => return Err(failed(error)),
            Err(error) => RunRow::invalid(run, &planned.id, &error),
        };
        // A run repeats bit for bit: it is recorded once it is known to be worth it.
        if self.keep_recordings == KeepRecordings::OnFail && !row.verdict.is_well() {
            recorded = true;
            match self.run(trial, planned.seed, Some(&place)) {
                Ok(outcome) if !outcome.complete => return Ok(self.forget(&place)),
                Err(error @ RunError::Sink(_)) => return Err(failed(error)),
                _ => {}
            }
        }
        // What can't even start leaves no recording.
        if row.ticks == 0 {
            self.forget(&place);
        }
        row.recording = (recorded && row.ticks > 0).then_some(place);
        Ok(Some(row))
    }

    /// One run, recorded if there is a place for its recording.
    fn run(&self, trial: &ResolvedTrial, seed: u64, place: Option<&str>) -> Result<RunOutcome, RunError> {
        let Some(place) = place else { return watched(trial, seed, &mut NoSink, false, self.stop, self.progress) };
        // What is there was left by a run that is not in the journal.
        let options = Options { overwrite: true, ..Options::default() };
        let mut sink = RerunSink::create(&self.folder.join(place), options)?;
        watched(trial, seed, &mut sink, true, self.stop, self.progress)
    }

    /// Removes the recording of a run that is not finished, if there is one; such a run has no row.
    fn forget(&self, place: &str) -> Option<RunRow> {
        if self.keep_recordings != KeepRecordings::None {
            drop(std::fs::remove_file(self.folder.join(place)));
        }
        None
    }
}
