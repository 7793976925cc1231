//! The messages of a recorded run by wire and tick: exact, where their bytes were recorded, else rebuilt from signals.

use std::any::Any;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use supertwin_core::message::{FromSignals, Measurements, Nav, Reference, SignalValues, Thrust};
use supertwin_core::{Message, RecordedRun, Signal, signal};

/// Everything that went over the wires of a run: by key and tick, with who sent it. Two who write the same wire may have the
/// same tick. A message is of the type that its key belongs to.
#[derive(Clone, Debug, Default)]
pub struct Messages(BTreeMap<(&'static str, u64), Vec<(String, AnyMessage)>>);

type AnyMessage = Arc<dyn Any + Send + Sync>;

impl Messages {
    /// Adds a message that `source` made at `tick`; a repetition is left out.
    pub fn add<M: Message>(&mut self, tick: u64, source: &str, message: M) {
        let known = self.0.entry((M::KEY, tick)).or_default();
        if known.iter().all(|(other, _)| other != source) {
            known.push((source.to_owned(), Arc::new(message)));
        }
    }

    /// In the place of whatever was made at `tick`.
    pub(crate) fn put<M: Message>(&mut self, tick: u64, message: M) {
        let message: AnyMessage = Arc::new(message);
        self.0.insert((M::KEY, tick), vec![(String::new(), message)]);
    }

    /// The message made at `tick` and who made it: that of `writer`, if there are several.
    pub(crate) fn at<M: Message>(&self, tick: u64, writer: &str) -> Option<(&String, &M)> {
        let all = self.0.get(&(M::KEY, tick))?;
        let (source, message) = all.iter().find(|(source, _)| source == writer).or_else(|| all.first())?;
        Some((source, message.downcast_ref()?))
    }

    /// Ticks at which messages were made, from `after` on (without it) to `until`.
    pub(crate) fn ticks<M: Message>(&self, after: Option<u64>, until: u64) -> Vec<u64> {
        let from = after.map_or(0, |after| after + 1);
        if from > until {
            return Vec::new();
        }
        self.0.range((M::KEY, from)..=(M::KEY, until)).map(|((_, tick), _)| *tick).collect()
    }

    /// Rebuilds from signals what has no exact bytes; how many that were, by wire.
    ///
    /// Every field of a message is a signal, with all its bits; what a message left out has no row at its tick. A beam
    /// range of zero stands for a beam that did not come back.
    pub fn rebuild(&mut self, source: &RecordedRun) -> BTreeMap<&'static str, u64> {
        let mut rebuilt = BTreeMap::new();
        // A plant that measured nothing at a tick sent a message all the same.
        let measured = signal::measurements::SIGNALS.iter().copied().flatten().copied().chain([&signal::truth::POSE]);
        self.rebuild_wire::<Measurements>(source, measured, &mut rebuilt);
        self.rebuild_wire::<Nav>(source, [&signal::nav::POSE], &mut rebuilt);
        self.rebuild_wire::<Reference>(source, [&signal::reference::DEPTH], &mut rebuilt);
        self.rebuild_wire::<Thrust>(source, [&signal::thrust::REQUESTED], &mut rebuilt);
        rebuilt
    }

    /// One wire, at every tick at which one of `shown` has a row.
    fn rebuild_wire<M: Message + FromSignals>(
        &mut self,
        source: &RecordedRun,
        shown: impl IntoIterator<Item = &'static Signal>,
        rebuilt: &mut BTreeMap<&'static str, u64>,
    ) {
        let ticks: BTreeSet<i64> = shown
            .into_iter()
            .filter_map(|signal| source.signal(signal))
            .flat_map(|columns| &columns.tick)
            .copied()
            .collect();
        for row in ticks {
            let Ok(tick) = u64::try_from(row) else { continue };
            if !self.0.contains_key(&(M::KEY, tick))
                && let Some(message) = M::from_signals(&At { source, tick: row })
            {
                self.add(tick, "", message);
                *rebuilt.entry(M::KEY).or_default() += 1;
            }
        }
    }
}

/// What was shown at a tick.
pub(super) struct At<'a> {
    pub(super) source: &'a RecordedRun,
    pub(super) tick: i64,
}

impl SignalValues for At<'_> {
    fn numbers(&self, signal: &'static Signal) -> Option<&[f64]> {
        self.source.signal(signal)?.at(self.tick)
    }
    fn label(&self, signal: &'static Signal) -> Option<&str> {
        let changes = self.source.label(signal);
        let next = changes.partition_point(|label| label.tick <= self.tick);
        Some(changes.get(next.checked_sub(1)?)?.value.as_str())
    }
}
