//! The journal of a sweep: a line for every finished run, written when it is finished. What a kill leaves of a line is
//! dropped, and its run done again.

use super::run_row::RunRow;
use crate::OperationError;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use supertwin_lab::sweep::Plan;

/// The first line: which sweep the rows belong to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Heading {
    /// Name of the sweep.
    pub(crate) sweep: String,
    /// Fingerprint of its runs, with everything they are made of.
    pub(crate) plan: String,
    /// The program that runs them.
    pub(crate) program: String,
    /// Which part of them.
    pub(crate) shard: String,
}

/// An open journal; nobody else writes it.
pub(crate) struct Journal {
    file: File,
    path: PathBuf,
}

/// A journal with what was in it.
pub(crate) struct Opened {
    pub(crate) journal: Journal,
    /// Finished runs, by index.
    pub(crate) rows: BTreeMap<usize, RunRow>,
    /// Lines that were no rows: their runs are done again.
    pub(crate) dropped: usize,
}

impl Journal {
    /// Opens or begins it. `anew` forgets what is there.
    pub(crate) fn open(path: &Path, heading: &Heading, plan: &Plan, anew: bool) -> Result<Opened, OperationError> {
        let wrong = |cause: String| OperationError::at(path, &cause);
        let io = |error: std::io::Error| wrong(error.to_string());
        let mut file = File::options().read(true).write(true).create(true).truncate(false).open(path).map_err(io)?;
        file.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => wrong("another sweep is writing here now".to_owned()),
            TryLockError::Error(error) => io(error),
        })?;
        if anew {
            file.set_len(0).map_err(io)?;
        }
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(io)?;
        let mut journal = Self { file, path: path.to_owned() };
        // A kill in the very first write leaves less than a line.
        let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        journal.cut(whole as u64)?;
        let mut rows = BTreeMap::new();
        let mut dropped = usize::from(whole < bytes.len());
        let mut lines = bytes[..whole].split_inclusive(|byte| *byte == b'\n');
        match lines.next() {
            None => {
                dropped = 0;
                journal.add(heading)?;
            }
            Some(first) => {
                let there: Heading = serde_json::from_slice(first)
                    .map_err(|error| wrong(format!("is no journal of a sweep ({error}); use another --out")))?;
                differs(&there, heading).map_err(wrong)?;
            }
        }
        for line in lines {
            match serde_json::from_slice::<RunRow>(line) {
                Ok(row) if plan.runs.get(row.run).is_some_and(|run| run.id == row.id) => {
                    rows.insert(row.run, row);
                }
                _ => dropped += 1,
            }
        }
        Ok(Opened { journal, rows, dropped })
    }

    /// Hands all lines to the disk.
    pub(crate) fn sync(&self) -> Result<(), OperationError> {
        self.file.sync_all().map_err(|error| self.wrong(&error))
    }

    /// Adds a line: the heading, or a finished run.
    pub(crate) fn add(&mut self, content: &impl Serialize) -> Result<(), OperationError> {
        let mut line = serde_json::to_vec(content).map_err(|error| OperationError::at(&self.path, &error))?;
        line.push(b'\n');
        // One write: a kill leaves the whole line, or a beginning without a line break.
        self.file.write_all(&line).map_err(|error| self.wrong(&error))
    }

    fn cut(&mut self, length: u64) -> Result<(), OperationError> {
        let cut = self.file.set_len(length).and_then(|()| self.file.seek(SeekFrom::End(0)));
        cut.map(drop).map_err(|error| self.wrong(&error))
    }

    fn wrong(&self, error: &std::io::Error) -> OperationError {
        OperationError::at(&self.path, error)
    }
}

/// What is there must belong to the same runs.
fn differs(there: &Heading, heading: &Heading) -> Result<(), String> {
    let advice = "use another --out, or --force to begin anew";
    if there.sweep != heading.sweep {
        return Err(format!("belongs to the sweep {}, not to {}; {advice}", there.sweep, heading.sweep));
    }
    if there.shard != heading.shard {
        return Err(format!("belongs to the part {}, not to {}; {advice}", there.shard, heading.shard));
    }
    if there.program != heading.program {
        return Err(format!(
            "was begun by supertwin {}, this is {}: their numbers may differ; {advice}",
            there.program, heading.program
        ));
    }
    if there.plan != heading.plan {
        return Err(format!(
            "was begun with other runs: the sweep's file, a file that it uses, --set, or --recordings has changed; {advice}"
        ));
    }
    Ok(())
}
