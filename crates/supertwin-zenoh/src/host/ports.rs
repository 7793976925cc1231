//! Walks over the ports of a block: names, delivery, readiness.

use super::WireState;
use crate::outbox::Outbox;
use std::time::Duration;
use supertwin_core::port::{MessageVisitor, Offered, PortVisitor, WireVisitor};
use supertwin_core::{Message, Port, PortRule};
use supertwin_protocol::envelope::{Envelope, Rejected, decode, encode};
use supertwin_protocol::ledger::{Ledger, SequenceCheck};
use supertwin_protocol::telemetry::Used;

pub(super) struct Keys(pub(super) Vec<(&'static str, PortRule)>);
impl WireVisitor for Keys {
    fn wire<M: Message>(&mut self, rule: PortRule) {
        self.0.push((M::KEY, rule));
    }
}

pub(super) struct AsideKeys(pub(super) Vec<String>);
impl MessageVisitor for AsideKeys {
    fn message<M: Message>(&mut self, _: &M) {
        self.0.push(M::KEY.to_owned());
    }
}

/// Puts a payload into port number `wanted`.
pub(super) struct Deliver<'a> {
    pub(super) wanted: usize,
    pub(super) at: usize,
    pub(super) payload: &'a [u8],
    pub(super) ledger: &'a mut Ledger,
    pub(super) run: &'a mut String,
    pub(super) lock_step: bool,
    pub(super) now: Duration,
    pub(super) newest_allowed: u64,
    pub(super) outcome: Delivered,
}

#[derive(Debug, Default)]
pub(super) enum Delivered {
    #[default]
    Nothing,
    Rejected(Rejected),
    /// Not for us: another run, a rival, a repetition.
    Left {
        repeat: bool,
    },
    /// Another instance writes now, or another run began.
    Changed {
        source: String,
        run: String,
        tick: u64,
    },
    Taken {
        tick: u64,
        clock_ns: u64,
        trigger: bool,
        gap: u64,
        takeover: bool,
    },
}

impl PortVisitor for Deliver<'_> {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        self.at += 1;
        if self.at != self.wanted + 1 {
            return;
        }
        let envelope: Envelope<'_, M> = match decode(self.payload) {
            Ok(envelope) => envelope,
            Err(rejected) => {
                self.ledger.counts.rejected += 1;
                self.outcome = Delivered::Rejected(rejected);
                return;
            }
        };
        if envelope.tick > self.newest_allowed {
            self.ledger.counts.rejected += 1;
            let text = format!("tick {} lies too far ahead", envelope.tick);
            self.outcome = Delivered::Rejected(Rejected::Malformed(text));
            return;
        }
        let changed = |envelope: &Envelope<'_, M>| Delivered::Changed {
            source: envelope.source.clone().into_owned(),
            run: envelope.run.clone().into_owned(),
            tick: envelope.tick,
        };
        let others_run = !envelope.run.is_empty() && !self.run.is_empty() && envelope.run != *self.run;
        if others_run && self.lock_step {
            self.outcome = changed(&envelope);
            return;
        }
        if self.run.is_empty() && envelope.run.is_empty() && port.rule().trigger {
            self.ledger.counts.rejected += 1;
            self.outcome = Delivered::Rejected(Rejected::Malformed("run: is missing".to_owned()));
            return;
        }
        let check = self.ledger.enter(&envelope.source, envelope.seq, self.now);
        let (gap, takeover) = match check {
            SequenceCheck::New { gap } => (gap, false),
            SequenceCheck::Takeover if self.lock_step => {
                self.outcome = changed(&envelope);
                return;
            }
            SequenceCheck::Takeover => (0, true),
            SequenceCheck::Rival if self.lock_step => {
                self.outcome = changed(&envelope);
                return;
            }
            SequenceCheck::Duplicate | SequenceCheck::Rival => {
                self.outcome = Delivered::Left { repeat: envelope.repeat };
                return;
            }
        };
        if others_run {
            // Only the wire that carries time can begin another run.
            let left = Delivered::Left { repeat: envelope.repeat };
            self.outcome = if port.rule().trigger { changed(&envelope) } else { left };
            return;
        }
        if self.run.is_empty() && !envelope.run.is_empty() {
            *self.run = envelope.run.clone().into_owned();
        }
        let (tick, clock_ns, repeat) = (envelope.tick, envelope.clock_ns, envelope.repeat);
        match port.offer(tick, envelope.data) {
            Offered::Old => {
                self.ledger.counts.old += 1;
                self.outcome = Delivered::Left { repeat };
                return;
            }
            Offered::Displaced => self.ledger.counts.displaced += 1,
            Offered::Taken => {}
        }
        self.outcome = Delivered::Taken { tick, clock_ns, trigger: port.rule().trigger, gap, takeover };
    }
}

/// Whether step k has all it needs, and the ticks of what it would use.
pub(super) struct Readiness<'a> {
    pub(super) k: u64,
    pub(super) ready: bool,
    pub(super) at: usize,
    pub(super) used: &'a mut Used,
    pub(super) ages: &'a mut [WireState],
}

impl PortVisitor for Readiness<'_> {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        self.ready &= port.ready(self.k);
        if let Some(made_at) = port.made_at() {
            self.used.push(M::KEY, port.used());
            let age = port.expected(self.k).map_or(0, |expected| expected.saturating_sub(made_at));
            if let Some(wire) = self.ages.get_mut(self.at) {
                wire.age_max = wire.age_max.max(age);
            }
        }
        self.at += 1;
    }
}

pub(super) struct Ready(pub(super) u64, pub(super) bool);
impl PortVisitor for Ready {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        self.1 &= port.ready(self.0);
    }
}

pub(super) struct Missing(pub(super) u64, pub(super) Vec<&'static str>);
impl PortVisitor for Missing {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        if !port.ready(self.0) {
            self.1.push(M::KEY);
        }
    }
}

pub(super) struct Stepped;
impl PortVisitor for Stepped {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        port.stepped();
    }
}

pub(super) struct Clear;
impl PortVisitor for Clear {
    fn port<M: Message>(&mut self, port: &mut Port<M>) {
        port.clear();
    }
}

pub(super) struct AsideWriter<'a> {
    pub(super) envelope: Envelope<'a, ()>,
    pub(super) outbox: &'a Outbox,
    pub(super) at: usize,
}
impl MessageVisitor for AsideWriter<'_> {
    fn message<M: Message>(&mut self, message: &M) {
        self.at += 1;
        let envelope = with(&self.envelope, message);
        let mut payload = Vec::with_capacity(1024);
        if encode(&envelope, &mut payload).is_ok() {
            // Number 0 is telemetry.
            self.outbox.telemetry(self.at, payload);
        }
    }
}

pub(super) fn with<'a, T>(envelope: &Envelope<'a, ()>, data: T) -> Envelope<'a, T> {
    Envelope {
        run: envelope.run.clone(),
        source: envelope.source.clone(),
        tick: envelope.tick,
        seq: envelope.seq,
        sim_time_s: envelope.sim_time_s,
        clock_ns: envelope.clock_ns,
        digest: envelope.digest.clone(),
        repeat: envelope.repeat,
        data,
    }
}
