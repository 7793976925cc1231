//! Tables of parts, made by any machines, into the rows of the whole sweep: each run once.

use super::run_row::{self, RunRow};
use super::{Prepared, TABLE, program};
use crate::{OperationError, entries};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use supertwin_rerun::Table;

/// Numbers of runs that an error lists.
const LISTED: usize = 8;

/// The rows of all parts, in order.
pub(super) fn gather(prepared: &Prepared, parts: &[PathBuf]) -> Result<Vec<RunRow>, OperationError> {
    let mut rows: BTreeMap<usize, (RunRow, PathBuf)> = BTreeMap::new();
    for path in files(parts)? {
        let wrong = |cause: String| OperationError::at(&path, &cause);
        let table = Table::read(&path).map_err(|error| OperationError::Option(error.to_string()))?;
        let about = |name: &str| table.about.get(name).map(String::as_str);
        let Some(plan) = about("supertwin.plan") else {
            return Err(wrong("is no table of a sweep".to_owned()));
        };
        if plan != prepared.fingerprint {
            let of = about("supertwin.sweep").unwrap_or("?");
            return Err(wrong(format!(
                "has other runs than {} has now: it is of the sweep {of}, or a file, --set or --recordings differs",
                prepared.sweep.path.display()
            )));
        }
        let made_by = about("supertwin.program").unwrap_or("?");
        if made_by != program() {
            let this = program();
            return Err(wrong(format!("was made by supertwin {made_by}, this is {this}: their numbers may differ")));
        }
        for row in run_row::rows(&prepared.sweep, &table).map_err(&wrong)? {
            if prepared.plan.runs.get(row.run).is_none_or(|run| run.id != row.id) {
                return Err(wrong(format!("run {} ({}) is not in the sweep", row.run, row.id)));
            }
            if let Some((_, other)) = rows.get(&row.run) {
                return Err(wrong(format!("run {} ({}) is in {} too", row.run, row.id, other.display())));
            }
            rows.insert(row.run, (row, path.clone()));
        }
    }
    let missing: Vec<usize> = (0..prepared.plan.runs.len()).filter(|run| !rows.contains_key(run)).collect();
    if !missing.is_empty() {
        let ids: Vec<&str> = missing.iter().take(LISTED).map(|run| prepared.plan.runs[*run].id.as_str()).collect();
        let more = if missing.len() > LISTED { ", …" } else { "" };
        return Err(OperationError::Option(format!(
            "{} of {} runs are missing: {}{more}; is a part not finished, or not named?",
            missing.len(),
            prepared.plan.runs.len(),
            ids.join(", ")
        )));
    }
    Ok(rows.into_values().map(|(row, _)| row).collect())
}

/// The files named, and the tables of parts in the folders named.
fn files(parts: &[PathBuf]) -> Result<Vec<PathBuf>, OperationError> {
    let mut files = Vec::new();
    for part in parts {
        if !part.is_dir() {
            files.push(part.clone());
            continue;
        }
        let found = entries(part, is_part)?;
        if found.is_empty() {
            return Err(OperationError::at(part, &format!("no {TABLE}.K-of-N.parquet there")));
        }
        files.extend(found);
    }
    Ok(files)
}

fn is_part(path: &Path) -> bool {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let part =
        name.strip_prefix(TABLE).and_then(|rest| rest.strip_prefix('.')).and_then(|rest| rest.strip_suffix(".parquet"));
    part.is_some_and(|part| part.contains("-of-"))
}
