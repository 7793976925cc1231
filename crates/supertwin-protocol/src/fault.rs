//! A codec that loses and doubles messages on purpose: TCP would hide it, and lock step must not care.

use supertwin_core::random::Stream;

/// How much goes wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FaultRates {
    /// Share of messages that are never sent.
    pub drop: f64,
    /// Share of messages that are sent twice.
    pub double: f64,
    /// Seed of the draws.
    pub seed: u64,
}

/// Draws the fate of each message.
#[derive(Clone, Debug)]
pub struct Fault {
    rates: FaultRates,
    stream: Stream,
}

impl Fault {
    /// The faults of one sender, from a stream of random numbers of its own.
    #[must_use]
    pub fn new(rates: FaultRates, sender: &'static str) -> Self {
        Self { rates, stream: Stream::new(rates.seed, sender) }
    }

    /// How often the next message is sent: 0, 1 or 2 times.
    pub fn copies(&mut self) -> usize {
        let draw = self.stream.uniform(0.0, 1.0);
        if draw < self.rates.drop {
            0
        } else if draw < self.rates.drop + self.rates.double {
            2
        } else {
            1
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shares_are_what_was_asked_for() {
        let mut fault = Fault::new(FaultRates { drop: 0.1, double: 0.1, seed: 1 }, "test");
        let fates: Vec<usize> = (0..10_000).map(|_| fault.copies()).collect();
        let share = |n: usize| fates.iter().filter(|copies| **copies == n).count() as f64 / 10_000.0;
        assert!((share(0) - 0.1).abs() < 0.01 && (share(2) - 0.1).abs() < 0.01);
    }
}
