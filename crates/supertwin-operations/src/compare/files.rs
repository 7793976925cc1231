//! Which recordings are meant: files, folders and patterns, each recording once.

use crate::{OperationError, entries};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use supertwin_rerun::read::first_part;

/// Recordings in the order in which they were named, and which of them is the baseline.
pub(super) struct Files {
    pub(super) paths: Vec<PathBuf>,
    /// All that `--baseline` means.
    pub(super) baseline: Option<Vec<PathBuf>>,
}

/// Recordings below the paths given; parts of one run count once.
pub(super) fn find(runs: &[PathBuf], baseline: Option<&Path>) -> Result<Files, OperationError> {
    let mut seen = BTreeSet::new();
    let mut paths = Vec::new();
    let baseline = baseline.map(meant).transpose()?;
    let named: Vec<Vec<PathBuf>> = runs.iter().map(|run| meant(run)).collect::<Result<_, _>>()?;
    for path in named.into_iter().flatten().chain(baseline.iter().flatten().cloned()) {
        // The same file by another way is the same run.
        if seen.insert(path.canonicalize().unwrap_or_else(|_| path.clone())) {
            paths.push(path);
        }
    }
    if paths.is_empty() {
        return Err(OperationError::Option(
            "name the recordings to compare: files, folders, or patterns with *".to_owned(),
        ));
    }
    Ok(Files { paths, baseline })
}

impl Files {
    /// Whether this recording belongs to what `--baseline` means.
    pub(super) fn is_baseline(&self, path: &Path) -> bool {
        let same = |other: &PathBuf| {
            other == path || matches!((other.canonicalize(), path.canonicalize()), (Ok(a), Ok(b)) if a == b)
        };
        self.baseline.as_ref().is_some_and(|paths| paths.iter().any(same))
    }
}

fn meant(run: &Path) -> Result<Vec<PathBuf>, OperationError> {
    let wrong = |cause: String| OperationError::at(run, &cause);
    let text = run.to_string_lossy();
    let found = if run.is_dir() {
        entries(run, is_recording)?
    } else if !run.exists() && text.contains(['*', '?', '[']) {
        let paths = glob::glob(&text).map_err(|cause| wrong(cause.to_string()))?;
        paths.flatten().filter(|path| path.is_file()).collect()
    } else {
        vec![run.to_owned()]
    };
    if found.is_empty() {
        return Err(wrong("no recordings there".to_owned()));
    }
    let firsts: BTreeSet<PathBuf> =
        found.into_iter().map(|path| first_part(&path).filter(|first| first.is_file()).unwrap_or(path)).collect();
    Ok(firsts.into_iter().collect())
}

fn is_recording(path: &Path) -> bool {
    path.is_file() && path.extension().is_some_and(|extension| extension == "rrd")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_recording_counts_once_however_it_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        for name in ["a.rrd", "a.part2.rrd", "a.part3.rrd", "b.rrd", "c.part2.rrd", "notes.txt"] {
            std::fs::write(path(name), "").expect("is written");
        }
        let names = |runs: &[PathBuf], baseline: Option<&Path>| -> Vec<String> {
            let files = find(runs, baseline).expect("is found");
            files.paths.iter().filter_map(|path| Some(path.file_name()?.to_str()?.to_owned())).collect()
        };
        // What is left of c is a part without the first.
        assert_eq!(names(&[folder.path().to_owned()], None), ["a.rrd", "b.rrd", "c.part2.rrd"]);
        assert_eq!(
            names(&[path("b.rrd"), path("a.part2.rrd"), path("*.rrd")], None),
            ["b.rrd", "a.rrd", "c.part2.rrd"]
        );
        assert_eq!(names(&[path("a.rrd")], Some(&path("b.rrd"))), ["a.rrd", "b.rrd"]);
        let files = find(&[path("a.rrd")], Some(&path("b.rrd"))).expect("is found");
        assert!(files.is_baseline(&folder.path().join("./b.rrd")) && !files.is_baseline(&path("a.rrd")));
        for wrong in [path("*.mcap"), path("?")] {
            let error = find(&[wrong], None).err().expect("nothing fits").to_string();
            assert!(error.ends_with("no recordings there"), "{error}");
        }
        assert!(find(&[], None).is_err());
    }
}
