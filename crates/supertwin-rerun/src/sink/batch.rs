//! What one batch has gathered: the values of each signal, and the changes of each label.

use crate::chunks::Times;
use rerun::EntityPath;
use supertwin_core::Signal;

pub(super) fn times_of(every: &Times, rows: &[u32]) -> Times {
    let all = rows.len() == every.len() && rows.iter().enumerate().all(|(i, &row)| i as u32 == row);
    if all { every.clone() } else { every.select(rows) }
}

/// Values of one signal in this batch.
pub(super) struct Column {
    pub(super) entity: EntityPath,
    pub(super) width: usize,
    /// Places in the batch's ticks.
    pub(super) rows: Vec<u32>,
    pub(super) values: Vec<f64>,
    /// Names and colours are in the file.
    pub(super) described: bool,
}

impl Column {
    pub(super) fn new(signal: &Signal, width: usize, room: usize) -> Self {
        Self {
            entity: EntityPath::from(signal.path),
            width,
            rows: Vec::with_capacity(room),
            values: Vec::with_capacity(room * width),
            described: false,
        }
    }
}

/// Changes of one label in this batch.
pub(super) struct Track {
    pub(super) entity: EntityPath,
    pub(super) last: Option<&'static str>,
    /// Places in the batch's ticks.
    pub(super) rows: Vec<u32>,
    pub(super) changes: Vec<&'static str>,
    /// Every value so far, in the order of appearance.
    pub(super) known: Vec<&'static str>,
    /// How many of them have their colour in the file.
    pub(super) described: usize,
}

impl Track {
    pub(super) fn new(signal: &Signal) -> Self {
        Self {
            entity: EntityPath::from(signal.path),
            last: None,
            rows: Vec::new(),
            changes: Vec::new(),
            known: Vec::new(),
            described: 0,
        }
    }
}

/// Signals in the order in which they are shown.
///
/// Signals are told apart by address, and each is looked for where the last one was found: in the steady state the
/// first comparison hits, without any hashing of names.
pub(super) struct Slots<T> {
    pub(super) slots: Vec<(&'static Signal, T)>,
    pub(super) cursor: usize,
}

impl<T> Default for Slots<T> {
    fn default() -> Self {
        Self { slots: Vec::new(), cursor: 0 }
    }
}

impl<T> Slots<T> {
    #[inline]
    pub(super) fn find(&mut self, signal: &'static Signal) -> Option<usize> {
        let is_it = |slot: &(&'static Signal, T)| std::ptr::eq(slot.0, signal);
        let (before, after) = self.slots.split_at(self.cursor);
        let at = match after.iter().position(is_it) {
            Some(ahead) => self.cursor + ahead,
            None => before.iter().position(is_it)?,
        };
        self.cursor = at + 1;
        Some(at)
    }

    pub(super) fn insert(&mut self, signal: &'static Signal, value: T) -> usize {
        let at = self.cursor;
        self.slots.insert(at, (signal, value));
        self.cursor = at + 1;
        at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    static A: Signal = Signal { path: "test/a", components: &["x", "y"], units: &["m"], about: "" };
    static B: Signal = Signal { path: "test/b", components: &[], units: &["m"], about: "" };
    static C: Signal = Signal { path: "test/c", components: &[], units: &["m"], about: "" };

    #[test]
    fn signals_are_found_in_any_order_and_new_ones_get_their_place() {
        let mut slots = Slots::default();
        assert_eq!(slots.find(&A), None);
        slots.insert(&A, 'a');
        slots.insert(&C, 'c');
        slots.cursor = 0;
        assert_eq!(slots.find(&A), Some(0));
        assert_eq!(slots.find(&B), None);
        slots.insert(&B, 'b');
        assert_eq!(slots.slots.iter().map(|slot| slot.1).collect::<String>(), "abc");
        assert_eq!(slots.find(&C), Some(2));
        assert_eq!(slots.find(&B), Some(1));
        assert_eq!(slots.find(&B), Some(1));
    }

    #[test]
    fn only_signals_of_every_tick_share_their_times() {
        let every = Times::new(vec![7, 8, 9], vec![70, 80, 90]);
        let shared = |rows: &[u32]| std::ptr::eq(times_of(&every, rows).ticks(), every.ticks());
        assert!(shared(&[0, 1, 2]));
        assert!(!shared(&[0, 2]));
        assert!(!shared(&[0, 2, 2]));
        assert_eq!(times_of(&every, &[0, 2, 2]).ticks(), [7, 9, 9]);
    }
}
