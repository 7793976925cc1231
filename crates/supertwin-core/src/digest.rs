//! State hashes: the same trial and seed give the same number, whatever process, profile or machine ran it.

use crate::{Observe, Probe, Signal, Tick};
use xxhash_rust::xxh3::{xxh3_64, xxh3_64_with_seed};

/// Room for what a block shows at one tick; more is folded in pieces.
const CAPACITY: usize = 256;

/// Labels that are remembered from one round to the next.
const LABELS: usize = 8;

/// A listener that hashes what it hears: values in canonical form, in the order shown.
///
/// −0 counts as 0 and every NaN as one NaN. A label counts by its text. Where a signal was absent, its neighbours
/// move up and the count tells the difference.
#[derive(Debug)]
pub struct DigestProbe {
    /// Little-endian words, so that the hash does not depend on the machine.
    words: [[u8; 8]; CAPACITY],
    len: usize,
    folded: u64,
    /// Sum of everything heard: finite as long as all of it was, NaN or infinite as soon as something was not.
    sum: f64,
    /// The labels of the last round with their hashes, in the order shown: a label that stays is not hashed again.
    labels: [(&'static str, u64); LABELS],
    next_label: usize,
}

impl Default for DigestProbe {
    fn default() -> Self {
        Self { words: [[0; 8]; CAPACITY], len: 0, folded: 0, sum: 0.0, labels: [("", 0); LABELS], next_label: 0 }
    }
}

impl DigestProbe {
    /// The hash of everything heard since the last call, and a clean slate.
    pub fn finish(&mut self) -> u64 {
        self.fold();
        core::mem::take(&mut self.folded)
    }

    /// Ends a tick: true only if everything heard since the last call was a number. Numbers so large that their sum is none
    /// give false as well: who wants to know has to look.
    pub fn finish_tick(&mut self) -> bool {
        self.next_label = 0;
        core::mem::take(&mut self.sum).is_finite()
    }

    fn fold(&mut self) {
        if !self.sum.is_finite() {
            for word in &mut self.words[..self.len] {
                *word = canonical_nan(u64::from_le_bytes(*word)).to_le_bytes();
            }
        }
        let bytes = self.words[..self.len].as_flattened();
        self.folded = if self.folded == 0 { xxh3_64(bytes) } else { xxh3_64_with_seed(bytes, self.folded) };
        self.len = 0;
    }

    /// Room for `count` more words, at most the capacity.
    #[inline(always)]
    fn reserve(&mut self, count: usize) -> &mut [[u8; 8]] {
        if self.len + count > CAPACITY {
            self.fold();
        }
        let room = &mut self.words[self.len..self.len + count];
        self.len += count;
        room
    }
}

/// NaN in one form.
fn canonical_nan(bits: u64) -> u64 {
    if f64::from_bits(bits).is_nan() { f64::NAN.to_bits() & !(1 << 63) } else { bits }
}

impl Probe for DigestProbe {
    // Most callers show arrays of known length: inlined, the loop has no loop.
    #[inline(always)]
    fn vector(&mut self, _: &'static Signal, values: &[f64]) {
        debug_assert!(values.len() <= CAPACITY, "a signal wider than the hash's buffer");
        let mut sum = self.sum;
        for (word, x) in self.reserve(values.len()).iter_mut().zip(values) {
            // Adding zero turns −0 into 0.
            *word = (x + 0.0).to_bits().to_le_bytes();
            sum += x;
        }
        self.sum = sum;
    }
    fn label(&mut self, _: &'static Signal, value: &'static str) {
        let known = &mut self.labels[self.next_label % LABELS];
        self.next_label += 1;
        if !core::ptr::eq(known.0, value) {
            *known = (value, xxh3_64(value.as_bytes()));
        }
        let hash = known.1;
        self.reserve(1)[0] = hash.to_le_bytes();
    }
}

/// Hash of one block's states and output at one tick.
pub fn block_digest(probe: &mut DigestProbe, block: &impl Observe, output: &impl Observe) -> u64 {
    block.observe(probe);
    output.observe(probe);
    probe.finish()
}

/// Hash of a run, tick by tick: each tick's block hashes are folded into what came before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RunDigest(u64);

impl RunDigest {
    /// Folds the hashes of plant, estimator, guidance and controller at `tick` in; returns that tick's own hash.
    pub fn fold(&mut self, tick: Tick, blocks: [u64; 4]) -> u64 {
        let mut bytes = [0u8; 32];
        for (chunk, word) in bytes.as_chunks_mut::<8>().0.iter_mut().zip(blocks) {
            *chunk = word.to_le_bytes();
        }
        let of_tick = xxh3_64_with_seed(&bytes, tick.k);
        self.0 = xxh3_64_with_seed(&of_tick.to_le_bytes(), self.0);
        of_tick
    }
}

impl core::fmt::Display for RunDigest {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    static S: Signal = Signal { path: "test/x", components: &[], units: &["1"], about: "test" };

    fn digest(values: &[f64]) -> u64 {
        let mut probe = DigestProbe::default();
        values.chunks(7).for_each(|values| probe.vector(&S, values));
        probe.finish()
    }

    #[test]
    fn canonical_forms_are_equal_and_values_are_not() {
        assert_eq!(digest(&[0.0]), digest(&[-0.0]));
        assert_eq!(digest(&[f64::NAN]), digest(&[-f64::NAN]));
        assert_ne!(digest(&[1.0]), digest(&[1.0 + f64::EPSILON]));
        assert_ne!(digest(&[1.0, 2.0]), digest(&[2.0, 1.0]));
        assert_ne!(digest(&[0.0]), digest(&[0.0, 0.0]));
    }

    #[test]
    fn more_than_the_capacity_is_folded_and_nothing_is_lost() {
        let mut values = vec![1.0; 1000];
        let before = digest(&values);
        values[3] = 2.0;
        assert_ne!(digest(&values), before);
        values[3] = 1.0;
        values[999] = 2.0;
        assert_ne!(digest(&values), before);
    }
}
