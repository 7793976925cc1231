//! Being seen: a quantity shows itself once, and recordings, hashes, telemetry and tests listen to the same call.

use crate::Signal;

/// Hears what is shown: a recording, a hash, telemetry, a test.
pub trait Probe {
    /// A vector of numbers; signals that exist only now and then (a sonar ping) are shown only then.
    fn vector(&mut self, signal: &'static Signal, values: &[f64]);

    /// A state with a name, such as a mode.
    fn label(&mut self, signal: &'static Signal, value: &'static str);

    /// A number by itself: a vector of one component.
    #[inline]
    fn scalar(&mut self, signal: &'static Signal, value: f64) {
        self.vector(signal, &[value]);
    }
}

/// Everything that shows itself.
pub trait Observe {
    /// Shows every state, in an order that does not depend on the values.
    fn observe<P: Probe>(&self, probe: &mut P);
}

/// Two listeners at once.
#[derive(Debug)]
pub struct Both<'a, A, B>(pub &'a mut A, pub &'a mut B);

impl<A: Probe, B: Probe> Probe for Both<'_, A, B> {
    fn vector(&mut self, signal: &'static Signal, values: &[f64]) {
        self.0.vector(signal, values);
        self.1.vector(signal, values);
    }
    fn label(&mut self, signal: &'static Signal, value: &'static str) {
        self.0.label(signal, value);
        self.1.label(signal, value);
    }
}

/// Keeps what it hears; for tests and tools.
#[derive(Clone, Debug, Default)]
pub struct Snapshot {
    /// Path and values, in the order shown.
    pub vectors: Vec<(&'static Signal, Vec<f64>)>,
    /// Path and label, in the order shown.
    pub labels: Vec<(&'static Signal, &'static str)>,
}

impl Snapshot {
    /// What `subject` shows now.
    pub fn of(subject: &impl Observe) -> Self {
        let mut snapshot = Self::default();
        subject.observe(&mut snapshot);
        snapshot
    }

    /// The values of `signal`.
    #[must_use]
    pub fn get(&self, signal: &Signal) -> Option<&[f64]> {
        self.named(signal.path)
    }

    /// The values at a path that was heard of a service.
    #[must_use]
    pub fn named(&self, path: &str) -> Option<&[f64]> {
        self.vectors.iter().find(|(signal, _)| signal.path == path).map(|(_, values)| values.as_slice())
    }

    /// No value is NaN or infinite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.first_non_finite().is_none()
    }

    /// The first signal with a value that is NaN or infinite.
    #[must_use]
    pub fn first_non_finite(&self) -> Option<&'static Signal> {
        self.vectors.iter().find(|(_, values)| !values.iter().all(|x| x.is_finite())).map(|(signal, _)| *signal)
    }
}

impl Probe for Snapshot {
    fn vector(&mut self, signal: &'static Signal, values: &[f64]) {
        self.vectors.push((signal, values.to_vec()));
    }
    fn label(&mut self, signal: &'static Signal, value: &'static str) {
        self.labels.push((signal, value));
    }
}

/// Signals in the order in which they are shown.
///
/// Signals are told apart by address, and each is looked for where the last one was found: in the steady state the
/// first comparison hits, without any hashing of names.
#[derive(Clone, Debug)]
pub struct Slots<T> {
    /// What is kept of each signal.
    pub slots: Vec<(&'static Signal, T)>,
    /// Where the next signal is looked for; 0 where showing begins anew.
    pub cursor: usize,
}

impl<T> Default for Slots<T> {
    fn default() -> Self {
        Self { slots: Vec::new(), cursor: 0 }
    }
}

impl<T> Slots<T> {
    /// Where `signal` stands.
    #[inline]
    pub fn find(&mut self, signal: &'static Signal) -> Option<usize> {
        let is_it = |slot: &(&'static Signal, T)| std::ptr::eq(slot.0, signal);
        let (before, after) = self.slots.split_at(self.cursor);
        let at = match after.iter().position(is_it) {
            Some(ahead) => self.cursor + ahead,
            None => before.iter().position(is_it)?,
        };
        self.cursor = at + 1;
        Some(at)
    }

    /// Puts a signal where it was looked for; gives where.
    pub fn insert(&mut self, signal: &'static Signal, value: T) -> usize {
        let at = self.cursor;
        self.slots.insert(at, (signal, value));
        self.cursor = at + 1;
        at
    }

    /// What is kept of `signal`, at first `new`.
    pub fn get_or_insert_with(&mut self, signal: &'static Signal, new: impl FnOnce() -> T) -> &mut T {
        let at = self.find(signal).unwrap_or_else(|| self.insert(signal, new()));
        &mut self.slots[at].1
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
}
