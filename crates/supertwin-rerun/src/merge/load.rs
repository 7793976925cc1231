//! One run of a comparison: the signals that are compared, at the times that all runs share.

use super::MergedRun;
use super::series::Series;
use crate::chunks::{Problem, text};
use crate::read::{self, Damage, ReadError, Recording};
use crate::scene::NET;
use crate::writer::Job;
use crate::{TICK, TIME};
use rerun::EntityPath;
use rerun::TimeColumn;
use rerun::external::arrow::buffer::ScalarBuffer;
use rerun::log::{Chunk, ChunkId, RowId};
use std::collections::BTreeMap;
use std::path::PathBuf;
use supertwin_core::Property;
use supertwin_core::signal::tracking::{self, QUANTITIES, Quantity};
use supertwin_core::signal::{controller, reference, truth};
use supertwin_core::source::Columns;

/// Components of every tracked quantity.
pub(super) const MEASURED: usize = tracking::DISTANCE.at("measured").index;
pub(super) const REFERENCE: usize = tracking::DISTANCE.at("reference").index;
const TRUE: usize = tracking::DISTANCE.at("true").index;

/// Averages move slowly.
const RMS_EVERY: i64 = 5;

/// What is drawn of one run.
#[derive(Default)]
pub(super) struct Loaded {
    /// Signals by path.
    pub(super) signals: BTreeMap<String, Columns>,
    /// Root mean square of measured and of true errors, per quantity.
    pub(super) rms: [[Option<Series>; 6]; 2],
    /// Mode and net, as they stand in the file.
    pub(super) drawings: Vec<Chunk>,
    pub(super) shift: Shift,
    pub(super) damage: Vec<Damage>,
}

/// Where a run is moved to in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Shift {
    pub(super) ns: i64,
    pub(super) ticks: i64,
}

impl Shift {
    /// As many ticks as the time has in this run.
    fn new(ns: i64, recording: &Recording) -> Self {
        let dt_s = match recording.property("run", "tick_s") {
            Some(Property::Number(dt_s)) if *dt_s > 0.0 => Some(*dt_s),
            _ => recording.signals.values().find_map(|columns| {
                let ticks = columns.tick.last()? - columns.tick.first()?;
                let ns = columns.time_ns.last()? - columns.time_ns.first()?;
                (ticks > 0 && ns > 0).then(|| ns as f64 / ticks as f64 / 1e9)
            }),
        };
        Self { ns, ticks: dt_s.map_or(0, |dt_s| (ns as f64 / 1e9 / dt_s).round() as i64) }
    }

    fn apply(self, columns: &mut Columns) {
        columns.tick.iter_mut().for_each(|tick| *tick = tick.saturating_add(self.ticks));
        columns.time_ns.iter_mut().for_each(|time| *time = time.saturating_add(self.ns));
    }
}

fn is_compared(path: &str) -> bool {
    is_tracked(path) || [controller::SIGMA.path, controller::K1.path, truth::POSE.path].contains(&path)
}

/// Whether this is the signal of a tracked quantity.
pub(super) fn is_tracked(path: &str) -> bool {
    QUANTITIES.iter().any(|quantity| quantity.signal.path == path)
}

fn files(run: &MergedRun) -> Result<Vec<PathBuf>, ReadError> {
    match &run.paths[..] {
        [one] => read::parts(one),
        several => Ok(several.to_vec()),
    }
}

/// Reads what is compared, at every so many ticks.
pub(super) fn load(run: &MergedRun, every: i64) -> Result<Loaded, ReadError> {
    let kept = |path: &str| path == reference::MODE.path || path == NET;
    let (mut recording, drawings) = read::read_and_keep(&files(run)?, &is_compared, &kept)?;
    let shift = Shift::new(run.offset_ns, &recording);
    recording.run.signals.retain(|_, columns| !columns.tick.is_empty());
    recording.run.signals.values_mut().for_each(|columns| shift.apply(columns));
    let rms = [MEASURED, TRUE].map(|which| {
        QUANTITIES.each_ref().map(|quantity| {
            let columns = recording.signals.get(quantity.signal.path)?;
            let error = Series::error(columns, which, REFERENCE, quantity.is_angle())?;
            Some(error.rms(RMS_EVERY.max(every))).filter(|rms| !rms.tick.is_empty())
        })
    });
    let mut loaded = Loaded { signals: recording.run.signals, rms, drawings, shift, damage: recording.damage };
    loaded.thin(every);
    Ok(loaded)
}

impl Loaded {
    /// Rows of the signal that has most.
    pub(super) fn rows(&self) -> usize {
        self.signals.values().map(|columns| columns.tick.len()).max().unwrap_or(0)
    }

    /// Keeps the ticks that `every` divides.
    pub(super) fn thin(&mut self, every: i64) {
        if every == 1 {
            return;
        }
        for columns in self.signals.values_mut() {
            let kept: Vec<usize> = (0..columns.tick.len()).filter(|&row| columns.tick[row] % every == 0).collect();
            columns.values = kept.iter().flat_map(|&row| columns.row(row).unwrap_or_default()).copied().collect();
            columns.time_ns = kept.iter().map(|&row| columns.time_ns[row]).collect();
            columns.tick = kept.iter().map(|&row| columns.tick[row]).collect();
            columns.clocks.clear();
        }
        self.rms.iter_mut().flatten().flatten().for_each(|rms| rms.thin(every));
    }

    /// Measured, reference and true of a quantity.
    pub(super) fn tracking(&self, quantity: &Quantity) -> Option<&Columns> {
        self.signals.get(quantity.signal.path)
    }

    /// The drawing at `path`, to be drawn at `entity`.
    pub(super) fn moved(&self, path: &str, entity: &EntityPath) -> Result<Vec<Chunk>, Problem> {
        let path = EntityPath::from(path);
        let pieces = self.drawings.iter().filter(|piece| *piece.entity_path() == path);
        pieces.map(|piece| moved(piece, entity.clone(), self.shift)).collect()
    }
}

/// Everything of a run but its properties, in the order of its files.
pub(super) fn everything(run: &MergedRun, shift: Shift) -> Result<Vec<Result<Job, Problem>>, ReadError> {
    let (_, pieces) = read::read_and_keep(&files(run)?, &|_| false, &|path| !path.starts_with("__"))?;
    let job = |piece: Chunk| {
        let path = piece.entity_path().to_string();
        moved(&piece, super::of_run(&run.name, path.trim_start_matches('/')), shift).map(Job::Chunk)
    };
    Ok(pieces.into_iter().map(job).collect())
}

/// The same rows at another place and at other times. Wall clocks are left out: runs of different days would never meet.
fn moved(piece: &Chunk, entity: EntityPath, shift: Shift) -> Result<Chunk, Problem> {
    let id = ChunkId::new();
    // The same file may be there twice.
    let fresh = piece.clone_as(id, RowId::from_tuid(*id).next());
    let timelines = fresh.timelines().iter().filter_map(|(name, column)| {
        let by = match &*name.to_string() {
            TIME => shift.ns,
            TICK => shift.ticks,
            _ => return None,
        };
        let times: ScalarBuffer<i64> = column.times_raw().iter().map(|time| time.saturating_add(by)).collect();
        Some((*name, TimeColumn::new(None, *column.timeline(), times)))
    });
    let timelines = timelines.collect();
    Chunk::new(id, entity, None, fresh.row_ids_array().clone(), timelines, fresh.components().clone()).map_err(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunks::{Clocks, Rows, Times};

    #[test]
    fn a_piece_moves_in_time_and_leaves_its_wall_clocks() {
        let clocks = [Clocks { sender_ns: 5, recorder_ns: 6 }; 2];
        let times = Times::new(vec![100, 101], vec![2_000_000_000, 2_020_000_000]).with_clocks(&clocks);
        let rows = Rows { entity: "a".into(), times, width: 1, values: vec![1.0, 2.0] };
        let piece = rows.into_chunk().unwrap();
        let shift = Shift { ns: -2_000_000_000, ticks: -100 };
        let moved = moved(&piece, super::super::of_run("x", "a"), shift).unwrap();
        assert_eq!(moved.entity_path().to_string(), "/runs/x/a");
        let times = |name: &'static str| moved.timelines().get(&name.into()).map(|column| column.times_raw().to_vec());
        assert_eq!((times(TIME), times(TICK)), (Some(vec![0, 20_000_000]), Some(vec![0, 1])));
        assert_eq!(moved.timelines().len(), 2);
        assert_ne!(moved.id(), piece.id());
        let fixed = crate::chunks::fixed("a", &rerun::SeriesLines::new().with_names(["n"])).unwrap();
        assert!(super::moved(&fixed, "b".into(), shift).unwrap().is_static());
    }

    #[test]
    fn ticks_are_shifted_by_as_many_as_the_time_has() {
        let mut recording = Recording::default();
        assert_eq!(Shift::new(-1_000_000_000, &recording), Shift { ns: -1_000_000_000, ticks: 0 });
        let columns = Columns { tick: vec![0, 4], time_ns: vec![0, 100_000_000], ..Columns::default() };
        recording.run.signals.insert("a".to_owned(), columns);
        assert_eq!(Shift::new(-1_000_000_000, &recording).ticks, -40);
        recording.run.properties.entry("run".to_owned()).or_default().insert("tick_s".to_owned(), 0.02.into());
        assert_eq!(Shift::new(-1_000_000_000, &recording).ticks, -50);
    }

    #[test]
    fn thinning_twice_is_thinning_once() {
        let columns = || {
            let tick: Vec<i64> = (-7..93).collect();
            let time_ns = tick.iter().map(|tick| tick * 20_000_000).collect();
            let values = tick.iter().flat_map(|&tick| [tick as f64, 0.5]).collect();
            Columns { tick, time_ns, values, width: 2, ..Columns::default() }
        };
        let loaded = || Loaded { signals: [("a".to_owned(), columns())].into(), ..Loaded::default() };
        let (mut once, mut twice) = (loaded(), loaded());
        once.thin(10);
        twice.thin(5);
        twice.thin(10);
        assert_eq!(once.signals, twice.signals);
        assert_eq!(once.signals["a"].tick[..3], [0, 10, 20]);
        assert_eq!(once.signals["a"].row(1), Some(&[10.0, 0.5][..]));
    }
}
