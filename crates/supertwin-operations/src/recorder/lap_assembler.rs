//! Telemetry of the four services, put together tick by tick, in order, with what is missing named.

use std::collections::BTreeMap;
use std::time::Duration;
use supertwin_protocol::Telemetry;
use supertwin_rerun::Clocks;
use supertwin_zenoh::witness::RING;

/// How long a tick waits for the services that have not been heard at it.
const PATIENCE: Duration = Duration::from_millis(300);
/// How long newer ticks wait for what a service was asked to say again.
const RECALL: Duration = Duration::from_millis(700);
/// When it is asked once more: a way that was cut may take a moment to be whole again.
const AGAIN: Duration = Duration::from_millis(200);
/// Messages that are asked for beyond those that are missing: what comes while the question is on its way.
const BESIDE: u64 = 128;
/// Ticks that wait at most.
const ROOM: usize = 3000;

/// One service at one tick.
#[derive(Clone, Debug, Default)]
pub(crate) struct ServiceTelemetry {
    /// Who said it, and its number.
    pub(crate) source: String,
    pub(crate) seq: u64,
    pub(crate) digest: Option<u64>,
    pub(crate) clocks: Clocks,
    pub(crate) telemetry: Telemetry,
    /// Those before it were left out on purpose: a thin link carries every n-th only.
    pub(crate) thinned: bool,
}

/// Telemetry of one tick; `None` for services that were not heard at it.
#[derive(Debug)]
pub(crate) struct Lap {
    pub(crate) tick: u64,
    pub(crate) parts: [Option<ServiceTelemetry>; RING.len()],
    received_at: Duration,
}

impl Lap {
    pub(crate) fn is_complete(&self) -> bool {
        self.parts.iter().all(Option::is_some)
    }
}

/// What became of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Entered {
    /// It waits for its lap to be complete.
    Waiting,
    /// Some before it are missing: whoever keeps them should be asked for so many of the newest.
    Gap(u64),
    /// It was here before.
    Known,
    /// Its tick has been written without it; it will be written beside it.
    Late,
}

/// The account of a service.
#[derive(Clone, Debug, Default)]
struct Line {
    source: String,
    seq: u64,
    /// What the last message jumped over.
    jump: u64,
}

impl Line {
    /// A jump like the one before is no loss: telemetry is thinned out on its way.
    fn is_usual(&self, jump: u64) -> bool {
        jump > 0 && self.jump > 0 && jump.abs_diff(self.jump) <= (self.jump / 2).max(1)
    }
}

/// Ticks on their way into the recording.
#[derive(Debug, Default)]
pub(crate) struct LapAssembler {
    waiting: BTreeMap<u64, Lap>,
    /// The next tick to be written, once one has been.
    pub(crate) next: Option<u64>,
    lines: [Line; RING.len()],
    /// Until then newer ticks wait for older ones.
    hold_until: Duration,
    /// Services that were asked: when they are asked again, and for how many.
    asked: [Option<(Duration, u64)>; RING.len()],
    /// Messages that never came, by service.
    pub(crate) missing: [u64; RING.len()],
    /// Messages that were left out on purpose, by service.
    pub(crate) thinned: [u64; RING.len()],
    /// Messages that came after their tick had been written, and were written beside it.
    pub(crate) late: u64,
    written: [Option<(String, u64)>; RING.len()],
    /// What came after its tick had been written, by number, while those before it may still come.
    late_waiting: [BTreeMap<u64, (u64, ServiceTelemetry)>; RING.len()],
    late_telemetry: Vec<(usize, u64, ServiceTelemetry)>,
}

impl LapAssembler {
    /// A message of service number `service`.
    pub(crate) fn enter(&mut self, service: usize, tick: u64, mut part: ServiceTelemetry, now: Duration) -> Entered {
        if self.next.is_some_and(|next| tick < next) {
            // Others than the last writer are history.
            let new = |(source, seq): &(String, u64)| *source == part.source && part.seq > *seq;
            let late = self.written[service].as_ref().is_some_and(new);
            if !late {
                return Entered::Known;
            }
            self.late += 1;
            let before = self.written[service].as_ref().map_or(0, |(_, seq)| *seq);
            let gap = part.seq.saturating_sub(before + 1);
            if self.late_waiting[service].len() < ROOM {
                self.late_waiting[service].insert(part.seq, (tick, part));
            }
            self.settle(service, None);
            if !self.late_waiting[service].is_empty() && self.asked[service].is_none() {
                // A link that was cut is whole again: what it kept back can be asked for.
                return self.ask(service, gap, now);
            }
            return Entered::Late;
        }
        let line = &mut self.lines[service];
        let first = line.source.is_empty();
        let gap =
            if line.source == part.source { part.seq.saturating_sub(line.seq + 1) } else { part.seq.saturating_sub(1) };
        let newer = line.source != part.source || part.seq > line.seq;
        if newer {
            part.thinned = line.is_usual(gap);
            line.source.clone_from(&part.source);
            // What came before the first message of all is history, and no jump.
            (line.seq, line.jump) = (part.seq, if first { 0 } else { gap });
        }
        let lap = self.waiting.entry(tick).or_insert_with(|| Lap { tick, parts: Default::default(), received_at: now });
        let slot = &mut lap.parts[service];
        if slot.as_ref().is_some_and(|known| known.source == part.source && known.seq == part.seq) {
            return Entered::Known;
        }
        let thinned = part.thinned;
        *slot = Some(part);
        if newer && gap > 0 && !thinned {
            // Before the first message of all there may be none that anybody keeps; asking costs nothing.
            return self.ask(service, gap, now);
        }
        Entered::Waiting
    }

    /// Newer ticks wait while a service is asked for the `gap` messages that are missing.
    fn ask(&mut self, service: usize, gap: u64, now: Duration) -> Entered {
        self.hold_until = now + RECALL;
        let wanted = gap.saturating_add(BESIDE);
        self.asked[service] = Some((now + AGAIN, wanted));
        Entered::Gap(wanted)
    }

    /// Puts what came too late in order: what follows the last one that was written, and everything below number `below`.
    fn settle(&mut self, service: usize, below: Option<u64>) {
        while let Some(entry) = self.late_waiting[service].first_entry() {
            let next = self.written[service].as_ref().map_or(0, |(_, seq)| *seq) + 1;
            if *entry.key() != next && below.is_none_or(|below| *entry.key() >= below) {
                return;
            }
            let (seq, (tick, part)) = entry.remove_entry();
            self.missing[service] += seq.saturating_sub(next);
            self.written[service] = Some((part.source.clone(), seq));
            self.late_telemetry.push((service, tick, part));
        }
    }

    /// What came after its tick had been written: service, tick and what it was, in order of each service.
    pub(crate) fn take_late(&mut self, now: Duration, flush: bool) -> Vec<(usize, u64, ServiceTelemetry)> {
        if flush || now >= self.hold_until {
            (0..RING.len()).for_each(|service| self.settle(service, Some(u64::MAX)));
        }
        std::mem::take(&mut self.late_telemetry)
    }

    /// The next lap that is ready to be written: complete, or not to be waited for any longer; all of them, if `flush`.
    pub(crate) fn pop(&mut self, now: Duration, complete_only: bool, flush: bool) -> Option<Lap> {
        let (&tick, lap) = self.waiting.first_key_value()?;
        let expected = self.next.is_none_or(|next| tick == next);
        let ready = if complete_only {
            lap.is_complete() && (expected || flush)
        } else {
            let held = now < self.hold_until && !(self.next.is_some() && expected && lap.is_complete());
            // In silence nothing is late: the newest tick may be all that came through before a cut.
            let newest = self.waiting.len() == 1 && !lap.is_complete();
            let patient = (newest || now.saturating_sub(lap.received_at) < PATIENCE) && self.waiting.len() < ROOM;
            let waits = (held && self.waiting.len() < ROOM) || (patient && !(lap.is_complete() && expected));
            !waits
        };
        if !ready && !flush {
            return None;
        }
        self.next = Some(tick + 1);
        let lap = self.waiting.remove(&tick)?;
        for (service, part) in lap.parts.iter().enumerate() {
            let Some(part) = part else { continue };
            if self.written[service].as_ref().is_some_and(|(source, _)| *source == part.source) {
                self.settle(service, Some(part.seq));
            } else {
                self.late_waiting[service].clear();
            }
            let before = self.written[service].replace((part.source.clone(), part.seq));
            // A source that is new starts counting; what it said before anybody listened is not missing.
            if let Some((source, seq)) = before
                && source == part.source
            {
                let gap = part.seq.saturating_sub(seq + 1);
                let account = if part.thinned { &mut self.thinned } else { &mut self.missing };
                account[service] += gap;
            }
        }
        Some(lap)
    }

    /// A service that should be asked once more for what is missing, and for how many of its newest messages.
    pub(crate) fn ask_again(&mut self, now: Duration) -> Option<(usize, u64)> {
        if now >= self.hold_until {
            self.asked = [None; RING.len()];
        }
        let due = |(service, asked): (usize, &Option<(Duration, u64)>)| {
            asked.filter(|(due, _)| now >= *due).map(|(_, wanted)| (service, wanted))
        };
        let (service, wanted) = self.asked.iter().enumerate().find_map(due)?;
        self.asked[service] = Some((now + AGAIN, wanted));
        Some((service, wanted))
    }

    /// Signals of the first tick that waits.
    pub(crate) fn first_paths(&self) -> impl Iterator<Item = &String> {
        let parts = self.waiting.first_key_value().into_iter().flat_map(|(_, lap)| lap.parts.iter().flatten());
        parts.flat_map(|part| part.telemetry.signals.keys())
    }

    /// Nothing newer than `tick` has been heard.
    pub(crate) fn is_newest(&self, tick: u64) -> bool {
        self.waiting.last_key_value().is_none_or(|(newest, _)| tick >= *newest)
            && self.next.is_none_or(|next| tick >= next)
    }

    /// When to look again, if nothing arrives.
    pub(crate) fn due(&self) -> Option<Duration> {
        let lap = self.waiting.first_key_value()?.1;
        let again = self.asked.iter().flatten().map(|(due, _)| *due).min().unwrap_or(Duration::MAX);
        Some((lap.received_at + PATIENCE).max(self.hold_until).min(again))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(seq: u64) -> ServiceTelemetry {
        ServiceTelemetry { source: "a".to_owned(), seq, ..ServiceTelemetry::default() }
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// An assembler that has written its first lap.
    fn begun() -> LapAssembler {
        let mut assembler = LapAssembler::default();
        lap(&mut assembler, 0, ms(0));
        assert_eq!(ticks(&mut assembler, ms(0)), [0]);
        assembler
    }

    fn ticks(assembler: &mut LapAssembler, now: Duration) -> Vec<u64> {
        std::iter::from_fn(|| assembler.pop(now, false, false)).map(|lap| lap.tick).collect()
    }

    fn lap(assembler: &mut LapAssembler, tick: u64, now: Duration) -> Vec<Entered> {
        (0..4).map(|service| assembler.enter(service, tick, part(tick + 1), now)).collect()
    }

    #[test]
    fn complete_laps_are_written_at_once_and_in_order() {
        let mut assembler = LapAssembler::default();
        for tick in [0, 1] {
            assert_eq!(lap(&mut assembler, tick, ms(0)), [Entered::Waiting; 4]);
        }
        assert_eq!(ticks(&mut assembler, ms(0)), [0, 1]);
        assembler.enter(0, 2, part(3), ms(20));
        assert_eq!(ticks(&mut assembler, ms(900)), [0_u64; 0], "waits for the others");
        assembler.enter(0, 3, part(4), ms(910));
        assert_eq!(ticks(&mut assembler, ms(910)), [2], "not when newer ones come");
        assert_eq!(assembler.enter(1, 2, part(3), ms(920)), Entered::Late);
        assert_eq!(assembler.enter(0, 2, part(3), ms(920)), Entered::Known);
        let late = assembler.take_late(ms(920), false);
        assert!(matches!(late[..], [(1, 2, _)]) && assembler.late == 1, "{late:?}");
    }

    #[test]
    fn after_an_outage_newer_ticks_wait_for_what_is_asked_for_again() {
        let mut assembler = begun();
        assert_eq!(lap(&mut assembler, 5, ms(5000)), [Entered::Gap(4 + BESIDE); 4]);
        assert_eq!(ticks(&mut assembler, ms(5400)), [0_u64; 0], "five waits for one to four");
        for tick in 2..5 {
            lap(&mut assembler, tick, ms(5410));
        }
        assert_eq!(ticks(&mut assembler, ms(5410)), [0_u64; 0], "one may still come");
        assert_eq!(ticks(&mut assembler, ms(5800)), [2, 3, 4, 5]);
        assert_eq!(assembler.missing, [1; 4]);
    }

    #[test]
    fn what_a_cut_link_brings_too_late_is_put_in_order_and_only_what_never_comes_is_missing() {
        let mut assembler = begun();
        // Three speak, the fourth does not.
        for tick in 1..=50 {
            for service in 0..3 {
                assert_eq!(assembler.enter(service, tick, part(tick + 1), ms(20 * tick)), Entered::Waiting);
            }
        }
        let written = ticks(&mut assembler, ms(2000));
        assert_eq!(written.len(), 49, "{written:?}");
        // The first that comes again is late itself: those before it are asked for.
        assert!(matches!(assembler.enter(3, 49, part(50), ms(2010)), Entered::Gap(_)));
        assert!(assembler.take_late(ms(2010), false).is_empty(), "those before it may come");
        for seq in (4..50).chain([20, 50]) {
            assembler.enter(3, seq - 1, part(seq), ms(2020));
        }
        assert!(assembler.take_late(ms(2100), false).is_empty(), "two and three may still come");
        let late: Vec<u64> = assembler.take_late(ms(2800), false).iter().map(|(_, _, part)| part.seq).collect();
        assert_eq!(late, (4..=50).collect::<Vec<_>>());
        assert_eq!(assembler.missing, [0, 0, 0, 2]);
    }

    #[test]
    fn telemetry_that_is_thinned_out_on_its_way_is_not_asked_for() {
        let mut assembler = LapAssembler::default();
        let entered: Vec<Entered> = (1..=20).flat_map(|i| lap(&mut assembler, 10 * i + i % 2, ms(200 * i))).collect();
        let asked = entered.iter().filter(|entered| matches!(entered, Entered::Gap(_))).count();
        assert_eq!(asked, 8, "at the beginning, and once more to learn that it is always so");
        while assembler.pop(ms(100_000), false, true).is_some() {}
        let (missing, thinned) = (assembler.missing, assembler.thinned);
        assert!(missing[0] == 8 && thinned[0] > 150, "{missing:?} {thinned:?}");
    }

    #[test]
    fn in_lock_step_nothing_is_left_out() {
        let mut assembler = LapAssembler::default();
        lap(&mut assembler, 0, ms(0));
        lap(&mut assembler, 2, ms(0));
        let mut pop = |now| assembler.pop(now, true, false).map(|lap| lap.tick);
        assert_eq!(pop(ms(0)), Some(0));
        assert_eq!(pop(ms(100_000)), None, "one is missing, however long it takes");
    }
}
