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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_signals_of_every_tick_share_their_times() {
        let every = Times::new(vec![7, 8, 9], vec![70, 80, 90]);
        let shared = |rows: &[u32]| std::ptr::eq(&*times_of(&every, rows).ticks, &*every.ticks);
        assert!(shared(&[0, 1, 2]));
        assert!(!shared(&[0, 2]));
        assert!(!shared(&[0, 2, 2]));
        assert_eq!(times_of(&every, &[0, 2, 2]).ticks[..], [7, 9, 9]);
    }
}
