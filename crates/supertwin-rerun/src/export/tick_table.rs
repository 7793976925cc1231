//! Signals and labels side by side, tick by tick.

use crate::Recording;
use supertwin_core::source::{Columns, Label};

/// What is exported, and all ticks at which any of it was recorded.
pub(super) struct TickTable<'a> {
    /// Numbers: path and columns.
    pub(super) signals: Vec<(&'a str, &'a Columns)>,
    /// Labels: path and changes.
    pub(super) labels: Vec<(&'a str, &'a [Label])>,
    /// Tick and time of every row.
    pub(super) moments: Vec<(i64, i64)>,
}

impl<'a> TickTable<'a> {
    pub(super) fn new(recording: &'a Recording) -> Self {
        let signals = recording.signals.iter().filter(|(_, columns)| columns.width > 0 && !columns.tick.is_empty());
        let signals: Vec<_> = signals.map(|(path, columns)| (path.as_str(), columns)).collect();
        let labels = recording.labels.iter().filter(|(_, changes)| !changes.is_empty());
        let labels: Vec<_> = labels.map(|(path, changes)| (path.as_str(), changes.as_slice())).collect();
        Self { signals, labels, moments: recording.moments() }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.signals.is_empty() && self.labels.is_empty()
    }

    /// Names of all columns of numbers: `path:component`, or the path of what has no components.
    pub(super) fn names(&self) -> Vec<String> {
        let name = |(path, columns): &(&str, &Columns)| {
            let path = (*path).to_owned();
            components(&path, columns).into_iter().map(move |component| match component {
                Some(component) => format!("{path}:{component}"),
                None => path.clone(),
            })
        };
        self.signals.iter().flat_map(name).collect()
    }
}

impl Recording {
    /// All ticks at which a signal or label was recorded, with their times in nanoseconds, in order.
    #[must_use]
    pub fn moments(&self) -> Vec<(i64, i64)> {
        let mut moments = Vec::new();
        for columns in self.signals.values() {
            join(&mut moments, || columns.tick.iter().copied().zip(columns.time_ns.iter().copied()));
        }
        for changes in self.labels.values() {
            join(&mut moments, || changes.iter().map(|change| (change.tick, change.time_ns)));
        }
        moments
    }
}

/// Nanoseconds in seconds.
pub(super) fn seconds(time_ns: i64) -> f64 {
    time_ns as f64 / 1e9
}

/// Adds moments to those that are there, in order and each tick once.
fn join<M: Iterator<Item = (i64, i64)>>(moments: &mut Vec<(i64, i64)>, more: impl Fn() -> M) {
    let before = moments.len();
    let mut known = 0;
    // Most signals have no tick that another has not: look before anything is moved.
    let new: Vec<_> = more()
        .filter(|(tick, _)| {
            while moments[known..before].first().is_some_and(|moment| moment.0 < *tick) {
                known += 1;
            }
            moments.get(known).is_none_or(|moment| moment.0 != *tick)
        })
        .collect();
    if !new.is_empty() {
        moments.extend(new);
        moments.sort_by_key(|moment| moment.0);
        moments.dedup_by_key(|moment| moment.0);
    }
}

/// Names of the components of a signal, without units; `None` for the only one of a signal that has no components.
pub(super) fn components(path: &str, columns: &Columns) -> Vec<Option<String>> {
    let last = path.rsplit('/').next().unwrap_or(path);
    let bare = |name: &String| name.split(" [").next().unwrap_or_default().to_owned();
    let names: Vec<String> = columns.names.iter().map(bare).collect();
    if columns.width == 1 {
        return vec![names.into_iter().next().filter(|name| name != last)];
    }
    (0..columns.width)
        .map(|i| {
            let named = names.get(i).filter(|name| names.iter().filter(|other| other == name).count() == 1);
            Some(named.cloned().unwrap_or_else(|| i.to_string()))
        })
        .collect()
}

/// Walks along a signal with ticks that only grow.
pub(super) struct Cursor<'a> {
    columns: &'a Columns,
    next: usize,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(columns: &'a Columns) -> Self {
        Self { columns, next: 0 }
    }

    /// The last row of this tick.
    pub(super) fn at(&mut self, tick: i64) -> Option<&'a [f64]> {
        while self.columns.tick.get(self.next).is_some_and(|at| *at <= tick) {
            self.next += 1;
        }
        let row = self.next.checked_sub(1)?;
        (self.columns.tick[row] == tick).then(|| self.columns.row(row)).flatten()
    }
}

/// Walks along the changes of a label: it keeps its value until the next one.
pub(super) struct State<'a> {
    changes: &'a [Label],
    next: usize,
}

impl<'a> State<'a> {
    pub(super) fn new(changes: &'a [Label]) -> Self {
        Self { changes, next: 0 }
    }

    /// The value at this tick, and whether it is new.
    pub(super) fn at(&mut self, tick: i64) -> Option<(&'a str, bool)> {
        let before = self.next;
        while self.changes.get(self.next).is_some_and(|change| change.tick <= tick) {
            self.next += 1;
        }
        let change = self.changes.get(self.next.checked_sub(1)?)?;
        Some((&change.value, self.next > before))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns(ticks: &[i64], names: &[&str], width: usize) -> Columns {
        Columns {
            names: names.iter().map(|name| (*name).to_owned()).collect(),
            tick: ticks.to_vec(),
            time_ns: ticks.iter().map(|tick| tick * 10).collect(),
            width,
            values: (0..ticks.len() * width).map(|i| i as f64).collect(),
            ..Columns::default()
        }
    }

    #[test]
    fn all_ticks_are_there_once_and_in_order() {
        let mut recording = Recording::default();
        recording.run.signals.insert("a".to_owned(), columns(&[0, 2, 4, 4], &[], 1));
        recording.run.signals.insert("b".to_owned(), columns(&[2, 4], &[], 1));
        recording.run.signals.insert("c".to_owned(), columns(&[-1, 3, 9], &[], 1));
        let ticks: Vec<i64> = TickTable::new(&recording).moments.iter().map(|moment| moment.0).collect();
        assert_eq!(ticks, [-1, 0, 2, 3, 4, 9]);
    }

    #[test]
    fn components_have_names_without_units_or_numbers() {
        let some = |names: &[&str]| names.iter().map(|name| Some((*name).to_owned())).collect::<Vec<_>>();
        assert_eq!(
            components("a/net", &columns(&[0], &["distance [m]", "heading [rad]"], 2)),
            some(&["distance", "heading"])
        );
        assert_eq!(components("a/depth", &columns(&[0], &["depth"], 1)), [None]);
        assert_eq!(components("a/force", &columns(&[0], &["t1"], 1)), some(&["t1"]));
        assert_eq!(components("a/b", &columns(&[0], &["x", "x", "y"], 4)), some(&["0", "1", "y", "3"]));
    }

    #[test]
    fn a_tick_has_its_last_row_and_a_label_keeps_its_value() {
        let columns = columns(&[2, 4, 4], &[], 1);
        let mut cursor = Cursor::new(&columns);
        assert_eq!(
            [1, 2, 3, 4, 5].map(|tick| cursor.at(tick).map(|row| row[0])),
            [None, Some(0.0), None, Some(2.0), None]
        );
        let changes = [(2, "a"), (5, "b")].map(|(tick, value)| Label { tick, time_ns: 0, value: value.to_owned() });
        let mut state = State::new(&changes);
        let seen = [1, 2, 3, 5].map(|tick| state.at(tick));
        assert_eq!(seen, [None, Some(("a", true)), Some(("a", false)), Some(("b", true))]);
    }
}
