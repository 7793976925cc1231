//! A run as it is read: between whoever reads a recording and whoever scores, compares or repeats it.

use crate::run::{Properties, Property};
use crate::{Event, Signal};
use std::collections::BTreeMap;

/// Values of one signal, in order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Columns {
    /// Names of the components.
    pub names: Vec<String>,
    /// Tick of every row.
    pub tick: Vec<i64>,
    /// Time of every row in nanoseconds since the start of the run.
    pub time_ns: Vec<i64>,
    /// Number of values in a row.
    pub width: usize,
    /// Values of all rows, one row after the other.
    pub values: Vec<f64>,
    /// Further clocks of every row by name, in nanoseconds since 1970; none in a batch run.
    pub clocks: BTreeMap<String, Vec<Option<i64>>>,
}

impl Columns {
    /// Values at `tick`; of several rows the first.
    #[must_use]
    pub fn at(&self, tick: i64) -> Option<&[f64]> {
        let row = self.tick.partition_point(|at| *at < tick);
        self.row(row).filter(|_| self.tick.get(row) == Some(&tick))
    }

    /// Values of row number `row`.
    #[must_use]
    pub fn row(&self, row: usize) -> Option<&[f64]> {
        self.values.get(row * self.width..(row + 1) * self.width)
    }

    /// Puts the rows in the order of their ticks; rows of one tick keep theirs.
    pub fn sort(&mut self) {
        if self.tick.is_sorted() {
            return;
        }
        let mut order: Vec<usize> = (0..self.tick.len()).collect();
        order.sort_by_key(|&row| self.tick[row]);
        self.tick = order.iter().map(|&row| self.tick[row]).collect();
        self.time_ns = order.iter().map(|&row| self.time_ns[row]).collect();
        self.values = order.iter().flat_map(|&row| &self.values[row * self.width..][..self.width]).copied().collect();
        for clock in self.clocks.values_mut() {
            *clock = order.iter().map(|&row| clock[row]).collect();
        }
    }
}

/// A text at a tick: a label that took this value, or a command that applied.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Label {
    /// At this tick.
    pub tick: i64,
    /// At this time in nanoseconds since the start of the run.
    pub time_ns: i64,
    /// Value from this tick on.
    pub value: String,
}

/// A message as it stood on a wire.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WireMessage {
    /// At this tick.
    pub tick: i64,
    /// At this time in nanoseconds since the start of the run.
    pub time_ns: i64,
    /// Further clocks by name, in nanoseconds since 1970.
    pub clocks: BTreeMap<String, i64>,
    /// Payload as it was sent.
    pub bytes: Vec<u8>,
}

/// A run that was recorded, whatever it was read from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedRun {
    /// Name of the run; empty when not even that is left.
    pub name: String,
    /// Properties by group: `run` from the beginning, `result` from the end.
    pub properties: BTreeMap<String, Properties>,
    /// Numbers by path of the signal.
    pub signals: BTreeMap<String, Columns>,
    /// Changes of labels by path of the signal, in order of time.
    pub labels: BTreeMap<String, Vec<Label>>,
    /// What happened, in order of time.
    pub events: Vec<Event>,
    /// Commands that applied, as JSON, by service and in order of time; only a run over a network records them.
    pub commands: BTreeMap<String, Vec<Label>>,
    /// Words by path, in order of time: the account of each step at `step/<service>`, states at
    /// `state/<service>/<name>`; only a run over a network records them.
    pub words: BTreeMap<String, Vec<Label>>,
    /// The exact messages of wires by key, in order of time; only a run over a network records them.
    pub wires: BTreeMap<String, Vec<WireMessage>>,
}

impl RecordedRun {
    /// Property `name` of `group`.
    #[must_use]
    pub fn property(&self, group: &str, name: &str) -> Option<&Property> {
        self.properties.get(group)?.get(name)
    }

    /// Numbers of `signal`, if it was recorded.
    #[must_use]
    pub fn signal(&self, signal: &Signal) -> Option<&Columns> {
        self.signals.get(signal.path)
    }

    /// Changes of the label `signal`, in order of time; empty when it was not recorded.
    #[must_use]
    pub fn label(&self, signal: &Signal) -> &[Label] {
        self.labels.get(signal.path).map_or(&[], Vec::as_slice)
    }

    /// Commands that applied at `service`, in order of time.
    #[must_use]
    pub fn commands_of(&self, service: &str) -> &[Label] {
        self.commands.get(service).map_or(&[], Vec::as_slice)
    }

    /// Words at a path, in order of time.
    #[must_use]
    pub fn words(&self, path: &str) -> &[Label] {
        self.words.get(path).map_or(&[], Vec::as_slice)
    }

    /// Messages of the wire `key`; empty when it was not recorded.
    #[must_use]
    pub fn wire(&self, key: &str) -> &[WireMessage] {
        self.wires.get(key).map_or(&[], Vec::as_slice)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_found_by_tick_in_any_order_of_arrival() {
        let mut columns = Columns {
            tick: vec![4, 2, 9],
            time_ns: vec![40, 20, 90],
            width: 2,
            values: vec![4.0, 4.5, 2.0, 2.5, 9.0, 9.5],
            clocks: BTreeMap::from([("sender_clock".to_owned(), vec![Some(400), None, Some(900)])]),
            ..Columns::default()
        };
        columns.sort();
        assert_eq!(columns.time_ns, [20, 40, 90]);
        assert_eq!(columns.at(4), Some(&[4.0, 4.5][..]));
        assert_eq!((columns.at(3), columns.row(3)), (None, None));
        assert_eq!(columns.clocks["sender_clock"], [None, Some(400), Some(900)]);
    }
}
