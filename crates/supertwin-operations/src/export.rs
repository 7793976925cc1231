//! A recording for other programs: the signals that are wanted, in another format.

use crate::OperationError;
use glob::{MatchOptions, Pattern};
use std::path::Path;
use supertwin_rerun::{Damage, Exported, Format, ReadError, Recording, read_selected};

/// `*` is one part of a path, as in the keys of the network.
const OPTIONS: MatchOptions =
    MatchOptions { case_sensitive: true, require_literal_separator: true, require_literal_leading_dot: false };

/// A recording that was exported.
#[derive(Debug)]
pub struct Written {
    /// How much was written.
    pub exported: Exported,
    /// What of the recording could not be read.
    pub damage: Vec<Damage>,
    /// The recording has its end.
    pub complete: bool,
}

/// Writes the signals and labels of `file` that fit one of `patterns`, or all without any, to `out`.
///
/// # Errors
/// The recording can't be read, a pattern fits nothing, or `out` can't be written, or is there without `force`.
pub fn export(
    file: &Path,
    patterns: &[Pattern],
    format: Format,
    out: &Path,
    force: bool,
) -> Result<Written, OperationError> {
    let wanted = |path: &str| {
        let event = path.starts_with("event/");
        let drawn = path == "world" || path.starts_with("world/");
        event || !drawn && (patterns.is_empty() || patterns.iter().any(|pattern| fits(pattern, path)))
    };
    let call = |error: ReadError| OperationError::Option(error.to_string());
    let recording = read_selected(file, &wanted).map_err(call)?;
    let idle = patterns.iter().find(|pattern| !paths(&recording).any(|path| fits(pattern, path)));
    if let Some(pattern) = idle {
        let all = read_selected(file, &|_| true).map_err(call)?;
        let known: Vec<&str> = paths(&all).collect();
        return Err(OperationError::Option(format!(
            "{}: --signals {pattern}: nothing recorded fits; there are {}",
            file.display(),
            known.join(", ")
        )));
    }
    let exported = supertwin_rerun::export(&recording, format, out, force)
        .map_err(|error| OperationError::Option(error.to_string()))?;
    Ok(Written { exported, complete: recording.complete, damage: recording.damage })
}

/// Signals and labels that have any rows.
fn paths(recording: &Recording) -> impl Iterator<Item = &str> {
    let signals = recording.signals.iter().filter(|(_, columns)| !columns.tick.is_empty()).map(|(path, _)| path);
    signals.chain(recording.labels.keys()).map(String::as_str)
}

fn fits(pattern: &Pattern, path: &str) -> bool {
    pattern.matches_with(path, OPTIONS)
}
