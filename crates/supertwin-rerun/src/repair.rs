//! A recording whole again: whatever can be read of a damaged file, written anew with its footer.

use crate::frames::Piece;
use crate::read::{self, Damage, ReadError, Recording};
use crate::{APPLICATION, atomic_file};
use rerun::external::re_log_encoding::Encoder;
use rerun::external::re_log_types::{SetStoreInfo, StoreInfo, StoreSource};
use rerun::log::{LogMsg, RowId};
use rerun::{StoreId, StoreKind};
use std::collections::BTreeSet;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use supertwin_core::{Property, Tick};

/// What a repair did.
#[derive(Clone, Debug, PartialEq)]
pub struct Repair {
    /// What was wrong, place by place; nothing when the file is whole.
    pub damage: Vec<Damage>,
    /// Bytes of the damaged file.
    pub bytes: u64,
    /// Bytes of it that could not be read.
    pub lost_bytes: u64,
    /// Rows of all signals that are left.
    pub rows: usize,
    /// The last tick that is left.
    pub last_tick: Option<i64>,
    /// Signals of every tick that end before it: of the last ticks, only a part is left.
    pub behind: usize,
    /// Ticks between that one and the end that the run's properties give, when they are left.
    pub lost_ticks: Option<u64>,
    /// The run says that it ended, so nothing is missing after the last tick.
    pub ended: bool,
}

impl Repair {
    /// There was nothing to repair, and nothing was written.
    #[must_use]
    pub fn was_whole(&self) -> bool {
        self.damage.is_empty()
    }
}

/// A recording can't be repaired.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// The damaged file can't be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Nothing of a run is left in it.
    #[error("{}: nothing could be saved: no part of a run can be read", path.display())]
    Nothing {
        /// The damaged file.
        path: PathBuf,
    },
    /// The repaired file can't be written, or does not read as what was saved.
    #[error("{0}")]
    Write(String),
}

/// Writes what can be read of the recording `from` to `to`, and reads it back.
///
/// A file that is whole is left alone, and nothing is written. `to` may be `from` itself, with `overwrite`.
///
/// # Errors
/// When nothing can be saved, or `to` can't be written or exists without `overwrite`.
pub fn repair(from: &Path, to: &Path, overwrite: bool) -> Result<Repair, RepairError> {
    let saved = read::read_parts(&[from.to_owned()], &|_| true)?;
    let bytes = from.metadata().map_or(0, |file| file.len());
    let lost_bytes = saved.damage.iter().map(|damage| damage.bytes).sum();
    let (lost_ticks, ended) = after(from, &saved)?;
    let repair = Repair {
        bytes,
        lost_bytes,
        rows: saved.signals.values().map(|columns| columns.tick.len()).sum(),
        last_tick: saved.last_tick(),
        behind: behind(&saved),
        lost_ticks,
        ended,
        damage: saved.damage.clone(),
    };
    if saved.complete {
        return Ok(repair);
    }
    if saved.rows.is_empty() && saved.properties.is_empty() {
        return Err(RepairError::Nothing { path: from.to_owned() });
    }
    atomic_file::create(to, overwrite, |file, unfinished| {
        let mut file = BufWriter::new(file);
        copy(from, &saved.damage, &mut file)?;
        file.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        verify(&saved, unfinished)
    })
    .map_err(|error| match error {
        RepairError::Write(cause) => RepairError::Write(format!("{}: {cause}", to.display())),
        other => other,
    })?;
    Ok(repair)
}

impl From<io::Error> for RepairError {
    fn from(error: io::Error) -> Self {
        Self::Write(error.to_string())
    }
}

/// Ticks that should follow the last one, and whether the run says that it ended.
fn after(from: &Path, saved: &Recording) -> Result<(Option<u64>, bool), ReadError> {
    let number = |name: &str| match saved.property("run", name)? {
        Property::Number(number) if *number > 0.0 => Some(*number),
        _ => None,
    };
    let there = saved.last_tick().map_or(0, |tick| tick.max(-1).wrapping_add(1) as u64);
    let several = read::is_one_of_several(from)?;
    let ended = match saved.property("result", "ticks") {
        Some(Property::Integer(ticks)) => Some(*ticks),
        _ => None,
    };
    // One part of several does not say what the others have.
    let expected = || number("duration_s").zip(number("tick_s")).map(|(span, dt_s)| Tick::at_or_after(span, dt_s));
    let expected = ended.or_else(|| expected().filter(|_| !several));
    Ok((expected.map(|expected| expected.saturating_sub(there)), ended.is_some()))
}

fn behind(saved: &Recording) -> usize {
    let last = saved.last_tick();
    let every = |ticks: &[i64]| ticks.windows(2).all(|pair| pair[1] == pair[0] + 1);
    let ends = saved.signals.values().filter(|columns| columns.tick.len() > 1 && every(&columns.tick));
    ends.filter(|columns| columns.tick.last().copied() < last).count()
}

/// Every message that was read, encoded as it was.
fn copy(from: &Path, damage: &[Damage], to: impl Write) -> Result<(), RepairError> {
    let lost: BTreeSet<u64> = damage.iter().filter(|damage| damage.bytes > 0).map(|damage| damage.from).collect();
    let read = |error| RepairError::Read(ReadError::File { path: from.to_owned(), error });
    let mut frames = read::open(from)?;
    let version = rerun::build_info().version;
    let mut encoder = Encoder::new_eager(version, frames.header.options, to).map_err(encoding)?;
    let mut introduced = BTreeSet::<StoreId>::new();
    while let Some((place, piece)) = frames.next().map_err(read)? {
        let (Piece::Chunk(message, _) | Piece::Message(message)) = piece else { continue };
        // It can be decoded, and is still no part of this run.
        if lost.contains(&place.start) {
            continue;
        }
        let store = message.store_id();
        if introduced.insert(store.clone()) && !matches!(*message, LogMsg::SetStoreInfo(_)) {
            // Its introduction was lost; readers expect one before anything else.
            let source = StoreSource::Other(format!("{APPLICATION}, repaired"));
            let info = StoreInfo::new(store.clone(), source);
            append(&mut encoder, &SetStoreInfo { row_id: *RowId::new(), info }.into())?;
        }
        let ours = store.application_id().as_str() == APPLICATION || store.kind() == StoreKind::Blueprint;
        if ours {
            append(&mut encoder, &message)?;
        }
    }
    encoder.finish().map_err(encoding)?;
    encoder.flush_blocking().map_err(encoding)
}

fn append(encoder: &mut Encoder<impl Write>, message: &LogMsg) -> Result<(), RepairError> {
    encoder.append(message).map_err(encoding).map(drop)
}

fn encoding(error: impl std::fmt::Display) -> RepairError {
    RepairError::Write(error.to_string())
}

/// The file is whole and has everything that was saved.
fn verify(saved: &Recording, path: &Path) -> Result<(), RepairError> {
    let another = |problem: &str| {
        let problem = format!("the repaired file is not what was saved: {problem}; nothing was kept");
        Err(RepairError::Write(problem))
    };
    let mut repaired = read::read_parts(&[path.to_owned()], &|_| true)?;
    if let Some(damage) = repaired.damage.first() {
        return another(&damage.to_string());
    }
    repaired.damage.clone_from(&saved.damage);
    repaired.complete = saved.complete;
    if same(&repaired, saved) { Ok(()) } else { another("its content is another") }
}

/// Equal in every bit; NaN is equal to itself.
fn same(a: &Recording, b: &Recording) -> bool {
    let strip = |recording: &Recording| {
        let mut bare = recording.clone();
        bare.run.signals.values_mut().for_each(|columns| columns.values.clear());
        bare
    };
    let bits = |recording: &Recording| -> Vec<u64> {
        recording.signals.values().flat_map(|columns| columns.values.iter().map(|x| x.to_bits())).collect()
    };
    strip(a) == strip(b) && bits(a) == bits(b)
}
