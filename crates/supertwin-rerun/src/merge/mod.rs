//! Several recordings side by side in one file: `/runs/<name>/…` holds each of them, `/compare/…` what follows from all.
//!
//! A viewer shows one recording at a time; only what stands in the same file can share a plot. Times are shifted so that
//! the runs meet at an event. What is compared is computed here, while the runs are read:
//!
//! | below `/compare` | is |
//! |---|---|
//! | `error/<quantity>/<label>` | measured minus reference |
//! | `rms/<quantity>/<label>` | root of its mean square over the last ten seconds |
//! | `true_rms/<quantity>/<label>` | the same of true minus reference, where the truth was recorded |
//! | `difference/<quantity>/<label>` | measured, minus measured of the run it is held against |
//! | `difference/rms_<quantity>/<label>` | `rms`, minus that of the run it is held against |
//! | `curve/<quantity>/<label>`, `sigma/…`, `k1/…` | what was measured, sliding variables and gains |
//! | `reference/<quantity>` | what was wanted |
//! | `scores/…` | the text, and the bars |
//! | `scene/…` | the net, and where each vehicle was |
//!
//! A label is a run, or a group of runs (a law with many seeds), which then shows median, 10 % and 90 % of its runs.

mod load;
mod scores;
mod series;
mod write;

use crate::blueprint::Compared;
use crate::chunks::Problem;
use crate::read::{Damage, ReadError};
use crate::writer::Writer;
use crate::{COMPARISON, atomic_file};
use load::Loaded;
use rerun::external::re_log_encoding::EncodingOptions;
use rerun::{StoreId, StoreKind};
pub use scores::{Better, Cell, ScoreRow, Scores};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use supertwin_core::signal::tracking;

/// Rows of all runs together that a file may have at full rate; with more, only every so many ticks are drawn.
const MOST_ROWS: usize = 200_000;
/// Every how many ticks; each divides the next, so that thinning twice is thinning once.
const EVERY: [i64; 7] = [1, 5, 10, 50, 100, 500, 1000];

/// One recording of several.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MergedRun {
    /// Stands in its paths, `/runs/<name>/…`; no two runs share it.
    pub name: String,
    /// The file, with its further parts in their order.
    pub paths: Vec<PathBuf>,
    /// Is added to the time of every row, and as many ticks as it has to the tick: minus the time of the event at which
    /// the runs meet.
    pub offset_ns: i64,
    /// Place of its group in [`Merge::groups`].
    pub group: usize,
    /// Place in [`Merge::runs`] of the run that it is held against: of the baseline, the one with the same seed.
    pub against: Option<usize>,
}

/// What is merged.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Merge {
    /// Title of the comparison.
    pub name: String,
    /// What is compared: names in legends and headings, one colour each. Of single runs, one group each.
    pub groups: Vec<String>,
    /// Recordings that are merged, with the group each belongs to.
    pub runs: Vec<MergedRun>,
    /// Place in `groups` of the one that the others are held against.
    pub baseline: usize,
    /// What 0 s is, such as "net following engaged"; empty for the start of each run.
    pub aligned_on: String,
    /// Their scores, with a cell per group.
    pub scores: Scores,
    /// Everything that was recorded, instead of what the dashboard shows.
    pub all: bool,
}

/// What was written.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Merged {
    /// Length of the file.
    pub bytes: u64,
    /// Runs that are in it.
    pub runs: usize,
    /// Curves show every so many ticks.
    pub every_ticks: i64,
    /// What could not be read, file by file.
    pub damage: Vec<Damage>,
    /// Names of runs without any signal that is compared.
    pub empty: Vec<String>,
    /// What the dashboard shows.
    pub compared: Compared,
}

/// Runs can't be merged.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    /// A recording can't be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The call contradicts itself.
    #[error("{0}")]
    Call(String),
    /// The merged file can't be written.
    #[error("{0}")]
    Write(String),
}

/// What a curve is called and how it is drawn: a run, or a group of runs.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Label {
    name: String,
    color: u32,
}

/// Writes the runs side by side to `out`, with a dashboard that compares them. Damaged recordings are read as far as
/// they can be. Until everything is written there is nothing under the name `out`.
///
/// # Errors
/// When a recording can't be read at all, names are not told apart, or `out` can't be written or exists without
/// `overwrite`.
pub fn merge(merge: &Merge, out: &Path, overwrite: bool) -> Result<Merged, MergeError> {
    check(merge).map_err(MergeError::Call)?;
    let mut merged = Merged { runs: merge.runs.len(), ..Merged::default() };
    let mut every = 0;
    let mut runs: Vec<Loaded> = Vec::new();
    for run in &merge.runs {
        let loaded = load::load(run, EVERY[every])?;
        merged.damage.extend(loaded.damage.iter().cloned());
        runs.push(loaded);
        while runs.iter().map(Loaded::rows).sum::<usize>() > MOST_ROWS && every + 1 < EVERY.len() {
            every += 1;
            runs.iter_mut().for_each(|run| run.thin(EVERY[every]));
        }
    }
    merged.every_ticks = EVERY[every];
    let nothing = merge.runs.iter().zip(&runs).filter(|(_, loaded)| loaded.rows() == 0);
    merged.empty = nothing.map(|(run, _)| run.name.clone()).collect();
    if merged.empty.len() == runs.len() {
        let what = "in none of the recordings is there any signal that is compared, such as";
        return Err(MergeError::Call(format!("{what} {}", tracking::SWAY.path)));
    }
    let written = atomic_file::create(out, overwrite, |file, _| to_file(merge, &runs, merged.every_ticks, file));
    (merged.bytes, merged.compared) = written.map_err(|error| match error {
        MergeError::Write(cause) => MergeError::Write(format!("{}: {cause}", out.display())),
        other => other,
    })?;
    Ok(merged)
}

fn check(merge: &Merge) -> Result<(), String> {
    if merge.runs.is_empty() {
        return Err("there is no run to be merged".to_owned());
    }
    let mut names = BTreeSet::new();
    for run in &merge.runs {
        if run.name.is_empty() || !names.insert(&run.name) {
            return Err(format!("{:?} is the name of two runs, or of none: each needs its own", run.name));
        }
        if run.group >= merge.groups.len() {
            return Err(format!("{}: there is no group {}", run.name, run.group));
        }
        if run.against.is_some_and(|against| against >= merge.runs.len()) {
            return Err(format!("{}: the run that it is held against is not there", run.name));
        }
    }
    let mut groups = BTreeSet::new();
    match merge.groups.iter().find(|group| group.is_empty() || !groups.insert(*group)) {
        Some(group) => Err(format!("{group:?} is the name of two groups, or of none: each needs its own")),
        None => Ok(()),
    }
}

impl From<io::Error> for MergeError {
    fn from(error: io::Error) -> Self {
        Self::Write(error.to_string())
    }
}

impl From<Problem> for MergeError {
    fn from(problem: Problem) -> Self {
        Self::Write(problem)
    }
}

fn to_file(merge: &Merge, runs: &[Loaded], every: i64, file: File) -> Result<(u64, Compared), MergeError> {
    let store = StoreId::new(StoreKind::Recording, COMPARISON, merge.name.as_str());
    let disk = file.try_clone()?;
    let writer = Writer::start(BufWriter::new(file), store.clone(), EncodingOptions::PROTOBUF_COMPRESSED)?;
    let sent = write::all(merge, runs, every, &store, &mut |job| writer.send(job));
    let sent = sent.map_err(MergeError::from).and_then(|compared| {
        if merge.all {
            everything(merge, runs, &writer)?;
        }
        Ok(compared)
    });
    // The thread ends in any case.
    let written = writer.close();
    let (compared, bytes) = (sent?, written?);
    disk.sync_all()?;
    if disk.metadata()?.len() != bytes {
        return Err(MergeError::Write("the file is incomplete".to_owned()));
    }
    Ok((bytes, compared))
}

/// All pieces of all runs, as they stand in their files; one run at a time is in memory.
fn everything(merge: &Merge, runs: &[Loaded], writer: &Writer) -> Result<(), MergeError> {
    for (run, loaded) in merge.runs.iter().zip(runs) {
        let pieces = load::everything(run, loaded.shift)?;
        for piece in pieces {
            writer.send(piece?)?;
        }
    }
    Ok(())
}

/// Entity of `path` in the merged recording: `/runs/<name>/<path>`.
fn of_run(name: &str, path: &str) -> rerun::EntityPath {
    let home = rerun::EntityPath::from("runs").join(&rerun::EntityPath::from_single_string(name));
    home.join(&rerun::EntityPath::from(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two() -> Merge {
        let run = |name: &str, group| MergedRun { name: name.to_owned(), group, ..MergedRun::default() };
        let groups = vec!["a".to_owned(), "b".to_owned()];
        Merge { groups, runs: vec![run("x", 0), run("y", 1)], ..Merge::default() }
    }

    #[test]
    fn names_must_tell_runs_and_groups_apart() {
        assert_eq!(check(&two()), Ok(()));
        let wrong = |change: fn(&mut Merge)| {
            let mut merge = two();
            change(&mut merge);
            check(&merge).unwrap_err()
        };
        assert!(wrong(|merge| merge.runs.clear()).contains("no run"));
        assert!(wrong(|merge| merge.runs[1].name = "x".to_owned()).contains("\"x\" is the name of two runs"));
        assert!(wrong(|merge| merge.groups[1] = "a".to_owned()).contains("two groups"));
        assert!(wrong(|merge| merge.runs[1].group = 2).contains("y: there is no group 2"));
        assert!(wrong(|merge| merge.runs[0].against = Some(2)).contains("x: the run that it is held against"));
    }

    #[test]
    fn a_name_is_one_part_of_a_path_whatever_is_in_it() {
        let path = of_run("a/b.c 1", tracking::SWAY.path);
        assert_eq!(path.len(), 4);
        assert_eq!(rerun::EntityPath::from(path.to_string()), path);
    }
}
