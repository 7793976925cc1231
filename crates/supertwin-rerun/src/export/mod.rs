//! A recording for other programs: data frames (Parquet), spreadsheets (CSV), Foxglove (MCAP).

mod csv;
mod mcap;
mod parquet;
mod walk;

use crate::{Recording, place};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// One wide table over ticks, a column per component; the run's properties are in its metadata.
    Parquet,
    /// The same table as text.
    Csv,
    /// A channel per signal, in JSON with schemas; events as `foxglove.Log`.
    Mcap,
}

impl Format {
    /// The extension of its files.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Parquet => "parquet",
            Self::Csv => "csv",
            Self::Mcap => "mcap",
        }
    }
}

/// What was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exported {
    /// Rows of the table, or messages.
    pub rows: u64,
    /// Columns of the table, or channels.
    pub columns: usize,
}

/// A recording could not be exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// There is nothing to export.
    #[error("{name}: no signal and no label to export")]
    Nothing {
        /// The run.
        name: String,
    },
    /// The file can't be written.
    #[error("{}: {error}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
}

/// Writes a recording to the file at `path`. Without `overwrite` a file that exists stays as it is.
///
/// # Errors
/// When there is nothing to write, or the file can't be written.
pub fn export(recording: &Recording, format: Format, path: &Path, overwrite: bool) -> Result<Exported, ExportError> {
    let walk = walk::Walk::new(recording);
    if walk.is_empty() {
        return Err(ExportError::Nothing { name: recording.name.clone() });
    }
    place::create(path, overwrite, |file, _| {
        let mut file = BufWriter::new(file);
        let done = match format {
            Format::Parquet => parquet::write(recording, &walk, &mut file),
            Format::Csv => csv::write(&walk, &mut file),
            Format::Mcap => mcap::write(recording, &walk, &mut file),
        }?;
        file.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        Ok(done)
    })
    .map_err(|error: io::Error| ExportError::Write { path: path.to_owned(), error })
}
