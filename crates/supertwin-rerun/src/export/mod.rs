//! A recording for other programs: data frames (Parquet), spreadsheets (CSV), Foxglove (MCAP).

mod csv;
mod mcap;
mod parquet;
mod tick_table;

use crate::{Recording, atomic_file};
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
        /// Name of the run, as its recording states it.
        name: String,
    },
    /// The file can't be written.
    #[error("{}: {error}", path.display())]
    Write {
        /// Path of the file as it was given.
        path: PathBuf,
        /// What the system or the parser reported.
        error: io::Error,
    },
}

/// Writes a recording to the file at `path`. Without `overwrite` a file that exists stays as it is.
///
/// # Errors
/// When there is nothing to write, or the file can't be written.
pub fn export(recording: &Recording, format: Format, path: &Path, overwrite: bool) -> Result<Exported, ExportError> {
    let table = tick_table::TickTable::new(recording);
    if table.is_empty() {
        return Err(ExportError::Nothing { name: recording.name.clone() });
    }
    atomic_file::create(path, overwrite, |file, _| {
        let mut file = BufWriter::new(file);
        let done = match format {
            Format::Parquet => parquet::write(recording, &table, &mut file),
            Format::Csv => csv::write(&table, &mut file),
            Format::Mcap => mcap::write(recording, &table, &mut file),
        }?;
        file.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        Ok(done)
    })
    .map_err(|error: io::Error| ExportError::Write { path: path.to_owned(), error })
}
