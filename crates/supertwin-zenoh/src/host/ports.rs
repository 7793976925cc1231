//! Delivery to the ports of a block, and the messages beside its output.

use crate::outbox::Outbox;
use std::time::Duration;
use supertwin_core::port::{MessageVisitor, Offered, PortVisitor};
use supertwin_core::{Message, Port};
use supertwin_protocol::envelope::{Envelope, Rejected, decode, encode};
use supertwin_protocol::ledger::{Ledger, SequenceCheck};

pub(super) struct AsideKeys(pub(super) Vec<String>);
impl MessageVisitor for AsideKeys {
    fn message<M: Message>(&mut self, _: &M) {
        self.0.push(M::KEY.to_owned());
    }
}

/// Puts a payload into port number `wanted`.
pub(super) struct Deliver<'a> {
    pub(super) wanted: usize,
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
    fn port<M: Message>(&mut self, number: usize, port: &mut Port<M>) {
        if number == self.wanted {
            self.outcome = self.deliver(port);
        }
    }
}

impl Deliver<'_> {
    fn deliver<M: Message>(&mut self, port: &mut Port<M>) -> Delivered {
        let read = decode::<M>(self.payload).and_then(|envelope| {
            let unnamed = self.run.is_empty() && envelope.run.is_empty() && port.state.rule.trigger;
            let others_run = !envelope.run.is_empty() && !self.run.is_empty() && envelope.run != *self.run;
            if envelope.tick > self.newest_allowed {
                return Err(Rejected(format!("tick {} lies too far ahead", envelope.tick)));
            }
            if unnamed {
                return Err(Rejected("run: is missing".to_owned()));
            }
            Ok((envelope, others_run))
        });
        let (envelope, others_run) = match read {
            Ok(read) => read,
            Err(rejected) => {
                self.ledger.counts.rejected += 1;
                return Delivered::Rejected(rejected);
            }
        };
        let changed = |envelope: Envelope<'_, M>| Delivered::Changed {
            source: envelope.source.into_owned(),
            run: envelope.run.into_owned(),
            tick: envelope.tick,
        };
        if others_run && self.lock_step {
            return changed(envelope);
        }
        let left = Delivered::Left { repeat: envelope.repeat };
        let (gap, takeover) = match self.ledger.enter(&envelope.source, envelope.seq, self.now) {
            SequenceCheck::New { gap } => (gap, false),
            SequenceCheck::Takeover | SequenceCheck::Rival if self.lock_step => return changed(envelope),
            SequenceCheck::Takeover => (0, true),
            SequenceCheck::Duplicate | SequenceCheck::Rival => return left,
        };
        let trigger = port.state.rule.trigger;
        if others_run {
            // Only the wire that carries time can begin another run.
            return if trigger { changed(envelope) } else { left };
        }
        if self.run.is_empty() {
            *self.run = envelope.run.into_owned();
        }
        let (tick, clock_ns) = (envelope.tick, envelope.clock_ns);
        match port.offer(tick, envelope.data) {
            Offered::Old => {
                self.ledger.counts.old += 1;
                return left;
            }
            Offered::Displaced => self.ledger.counts.displaced += 1,
            Offered::Taken => {}
        }
        Delivered::Taken { tick, clock_ns, trigger, gap, takeover }
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
        let envelope = self.envelope.clone().with(message);
        let mut payload = Vec::with_capacity(1024);
        if encode(&envelope, &mut payload).is_ok() {
            // Number 0 is telemetry.
            self.outbox.telemetry(self.at, payload);
        }
    }
}
