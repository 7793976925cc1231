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
