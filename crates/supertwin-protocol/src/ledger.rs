//! The account of one wire: what arrived, twice, not at all, too late, or from somebody else.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Width of the window in which a gap can still be filled.
const WINDOW: u64 = 128;

/// Counters of one wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Counts {
    /// Messages that were new.
    pub received: u64,
    /// Sequence numbers between the first and the newest that never arrived.
    pub missing: u64,
    /// Sequence numbers that arrived again.
    pub duplicates: u64,
    /// Made at a tick that is not newer than what was there.
    pub old: u64,
    /// Arrived after the step that wanted it.
    pub late: u64,
    /// Payloads that were no message.
    pub rejected: u64,
    /// From a second writer while the first one was alive.
    pub rivals: u64,
    /// Displaced by newer ones before a step saw them.
    pub displaced: u64,
    /// Times that another instance took over.
    pub takeovers: u64,
}

/// What a sequence number means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SequenceCheck {
    /// Not seen before; `gap` numbers were jumped over.
    New {
        /// Numbers between the last one and this that have not come.
        gap: u64,
    },
    /// Another instance writes from here on.
    Takeover,
    /// A number that has been seen before.
    Duplicate,
    /// Somebody else writes while the first writer is alive: not taken.
    Rival,
}

/// The account of one wire.
#[derive(Clone, Debug, Default)]
pub struct Ledger {
    /// Service and instance of the writer.
    pub source: String,
    first_seq: u64,
    last_seq: u64,
    /// Bit i: number `last_seq − i` has been seen.
    window: u128,
    /// When something of the writer last arrived.
    pub received_at: Duration,
    silence: Duration,
    /// Counters of what the sequence numbers meant.
    pub counts: Counts,
}

impl Ledger {
    /// A second writer is let in when the first has been silent for `silence`.
    #[must_use]
    pub fn new(silence: Duration) -> Self {
        Self { silence, ..Self::default() }
    }

    /// First and newest number of the present writer.
    #[must_use]
    pub fn range(&self) -> [u64; 2] {
        [self.first_seq, self.last_seq]
    }

    /// The reader was held up for `stall` until `now`: the writer's silence does not count for as long.
    pub fn forgive(&mut self, stall: Duration, now: Duration) {
        self.received_at = (self.received_at + stall).min(now);
    }

    /// Enters the number of a message that has arrived at `now`, and tells what it means.
    pub fn enter(&mut self, source: &str, seq: u64, now: Duration) -> SequenceCheck {
        if self.source != source {
            let alive = !self.source.is_empty() && now.saturating_sub(self.received_at) < self.silence;
            if alive {
                self.counts.rivals += 1;
                return SequenceCheck::Rival;
            }
            let first = self.source.is_empty();
            source.clone_into(&mut self.source);
            (self.first_seq, self.last_seq, self.window, self.received_at) = (seq, seq, 1, now);
            self.counts.received += 1;
            self.counts.takeovers += u64::from(!first);
            return if first { SequenceCheck::New { gap: 0 } } else { SequenceCheck::Takeover };
        }
        self.received_at = now;
        if seq > self.last_seq {
            let ahead = seq - self.last_seq;
            self.window = if ahead < WINDOW { (self.window << ahead) | 1 } else { 1 };
            self.last_seq = seq;
            self.counts.received += 1;
            self.counts.missing = self.counts.missing.saturating_add(ahead - 1);
            return SequenceCheck::New { gap: ahead - 1 };
        }
        let behind = self.last_seq - seq;
        if seq >= self.first_seq && behind < WINDOW && self.window & (1 << behind) == 0 {
            // A gap is filled after all, unless the number is from before the first.
            self.window |= 1 << behind;
            self.counts.received += 1;
            self.counts.missing = self.counts.missing.saturating_sub(1);
            return SequenceCheck::New { gap: 0 };
        }
        if behind >= WINDOW {
            // Nobody repeats what is this old: the writer counts anew, or somebody has forged a number. The message's
            // tick decides whether it is news.
            (self.first_seq, self.last_seq, self.window) = (seq, seq, 1);
            self.counts.received += 1;
            return SequenceCheck::New { gap: 0 };
        }
        self.counts.duplicates += 1;
        SequenceCheck::Duplicate
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::{Fault, FaultRates};
    use std::collections::BTreeSet;

    #[test]
    fn the_account_agrees_with_what_was_sent() {
        let mut ledger = Ledger::new(Duration::from_secs(1));
        let mut fault = Fault::new(FaultRates { drop: 0.125, double: 0.125, seed: 1 }, "test");
        let arrived: Vec<u64> = (1..=5000).flat_map(|seq| std::iter::repeat_n(seq, fault.copies())).collect();
        for seq in &arrived {
            ledger.enter("a", *seq, Duration::ZERO);
        }
        let received = arrived.iter().collect::<BTreeSet<_>>().len() as u64;
        let (first, newest, duplicates) = (arrived[0], arrived[arrived.len() - 1], arrived.len() as u64 - received);
        let missing = newest - first + 1 - received;
        assert_eq!(ledger.counts, Counts { received, duplicates, missing, ..Counts::default() });
        assert!(duplicates > 300 && missing > 300, "the test must lose and double something");
    }

    #[test]
    fn order_does_not_matter_to_the_account() {
        let mut ledger = Ledger::new(Duration::from_secs(1));
        for seq in [1, 4, 3, 3, 2, 5] {
            ledger.enter("a", seq, Duration::ZERO);
        }
        assert_eq!(ledger.counts, Counts { received: 5, duplicates: 1, ..Counts::default() });
    }

    #[test]
    fn a_forged_number_does_not_deafen() {
        let mut ledger = Ledger::new(Duration::from_secs(1));
        for seq in [1, 2, u64::MAX, 3] {
            let check = ledger.enter("a", seq, Duration::ZERO);
            assert!(matches!(check, SequenceCheck::New { .. }), "{seq}: {check:?}");
        }
        assert_eq!(ledger.range(), [3, 3]);
    }

    #[test]
    fn a_second_writer_waits_until_the_first_is_silent() {
        let mut ledger = Ledger::new(Duration::from_millis(60));
        let ms = Duration::from_millis;
        assert_eq!(ledger.enter("a", 1, ms(0)), SequenceCheck::New { gap: 0 });
        assert_eq!(ledger.enter("b", 1, ms(20)), SequenceCheck::Rival);
        assert_eq!(ledger.enter("a", 2, ms(40)), SequenceCheck::New { gap: 0 });
        assert_eq!(ledger.enter("b", 2, ms(101)), SequenceCheck::Takeover);
        assert_eq!(ledger.enter("a", 3, ms(102)), SequenceCheck::Rival);
        assert_eq!((ledger.counts.rivals, ledger.counts.takeovers), (2, 1));
        // A reader that was held up itself lets nobody in for it.
        ledger.forgive(ms(500), ms(602));
        assert_eq!(ledger.enter("a", 4, ms(620)), SequenceCheck::Rival);
    }
}
