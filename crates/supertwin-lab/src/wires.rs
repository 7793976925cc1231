//! The wires of the ring in one process: the last message that got through each, what is cut, and who is in command.

use std::any::Any;
use supertwin_core::command::{LinkCommand, Wire as WireName};
use supertwin_core::message::{Measurements, Nav, Reference, Thrust, WrenchRequest};
use supertwin_core::port::{PortRule, WireVisitor, wires};
use supertwin_core::{Input, Message, OperatorLink, Refusal, Tick, Wired, Wires};

/// All wires of the ring.
#[derive(Clone, Debug, Default)]
pub(crate) struct RingWires {
    measurements: RingWire<Measurements>,
    nav: RingWire<Nav>,
    reference: RingWire<Reference>,
    thrust: RingWire<Thrust>,
    wrench_request: RingWire<WrenchRequest>,
    /// What an external controller asks for, and until which tick.
    requested: Option<(u64, WrenchRequest)>,
    operator_lost_until: u64,
}

impl RingWires {
    /// The wire whose messages are `M`; `None` for a message that no wire of the ring carries.
    fn wire<M: Message>(&self) -> Option<&RingWire<M>> {
        let wires: [&dyn Any; 5] = [&self.measurements, &self.nav, &self.reference, &self.thrust, &self.wrench_request];
        wires.into_iter().find_map(|wire| wire.downcast_ref())
    }

    fn wire_mut<M: Message>(&mut self) -> Option<&mut RingWire<M>> {
        let wires: [&mut dyn Any; 5] =
            [&mut self.measurements, &mut self.nav, &mut self.reference, &mut self.thrust, &mut self.wrench_request];
        wires.into_iter().find_map(|wire| wire.downcast_mut())
    }

    /// What a mission does to the wires, from now on.
    pub(crate) fn command(&mut self, tick: Tick, command: &LinkCommand) -> Result<(), Refusal> {
        let until = command.until(tick)?;
        match command {
            LinkCommand::Withhold { wire, .. } => match wire {
                WireName::Measurements => self.measurements.cut_until = until,
                WireName::Nav => self.nav.cut_until = until,
                WireName::Reference => self.reference.cut_until = until,
                WireName::Thrust => self.thrust.cut_until = until,
            },
            LinkCommand::OperatorLostForS(_) => self.operator_lost_until = until,
            LinkCommand::WrenchRequest { request, .. } => self.requested = Some((until, request.clone())),
        }
        Ok(())
    }

    /// Begins a lap: an external controller speaks first. Returns what it asks for.
    pub(crate) fn begin(&mut self, tick: Tick) -> Option<&WrenchRequest> {
        let (_, request) = self.requested.as_ref().filter(|(until, _)| tick.k < *until)?;
        self.wrench_request.send(tick.k, request.clone());
        self.wrench_request.at_source()
    }

    /// Whether somebody is in command.
    pub(crate) fn operator(&self, tick: Tick) -> OperatorLink {
        if tick.k < self.operator_lost_until { OperatorLink::Lost } else { OperatorLink::Present }
    }

    /// What block `B` is handed at `tick`.
    pub(crate) fn input<B: Wired>(&self, tick: Tick) -> B::In<'_> {
        struct At<'a>(&'a RingWires, u64);
        impl<'a> Wires<'a> for At<'a> {
            fn newest<M: Message>(&mut self, rule: PortRule) -> Input<&'a M> {
                self.0.wire().map_or(Input::Missing, |wire| wire.newest(rule.expected(self.1)))
            }
            fn every<M: Message>(&mut self, rule: PortRule) -> &'a [M] {
                match self.newest(rule) {
                    Input::Fresh(message) => std::slice::from_ref(message),
                    _ => &[],
                }
            }
        }
        B::input(&mut At(self, tick.k), self.operator(tick))
    }

    /// Ticks of the messages that block `B` is handed at `tick`, by key. A key that is not there: nothing has ever arrived.
    pub(crate) fn used<B: Wired>(&self, tick: Tick) -> Vec<(String, Vec<u64>)> {
        struct Used<'a>(&'a RingWires, u64, Vec<(String, Vec<u64>)>);
        impl WireVisitor for Used<'_> {
            fn wire<M: Message>(&mut self, rule: PortRule) {
                let Some((made_at, _)) = self.0.wire::<M>().and_then(RingWire::delivered) else { return };
                // Where every one counts, each counts once.
                let new = rule.keep == 1 || rule.expected(self.1) == Some(*made_at);
                self.2.push((M::KEY.to_owned(), new.then_some(*made_at).into_iter().collect()));
            }
        }
        let mut used = Used(self, tick.k, Vec::new());
        wires::<B>(&mut used);
        used.2
    }

    /// Sends the message made at tick `k`.
    pub(crate) fn send<M: Message>(&mut self, k: u64, message: M) {
        if let Some(wire) = self.wire_mut() {
            wire.send(k, message);
        }
    }

    /// The newest message at its source, whether or not it got through.
    pub(crate) fn at_source<M: Message>(&self) -> Option<&M> {
        self.wire()?.at_source()
    }

    /// Messages lost so far: measurements, nav, reference, thrust.
    pub(crate) fn withheld(&self) -> [u64; 4] {
        [self.measurements.withheld, self.nav.withheld, self.reference.withheld, self.thrust.withheld]
    }
}

/// Carries messages of one type from tick to tick, unless it is cut.
#[derive(Clone, Debug)]
struct RingWire<M> {
    /// The newest message, whether or not it got through.
    made: Option<(u64, M)>,
    /// On a cut wire, what got through last.
    held: Option<Option<(u64, M)>>,
    cut_until: u64,
    withheld: u64,
}

impl<M> Default for RingWire<M> {
    fn default() -> Self {
        Self { made: None, held: None, cut_until: 0, withheld: 0 }
    }
}

impl<M> RingWire<M> {
    /// Sends the message made at tick `k`; on a cut wire it is lost, and counted.
    fn send(&mut self, k: u64, message: M) {
        let last = self.made.replace((k, message));
        if k >= self.cut_until {
            self.held = None;
        } else {
            self.withheld += 1;
            self.held.get_or_insert(last);
        }
    }

    fn delivered(&self) -> Option<&(u64, M)> {
        self.held.as_ref().unwrap_or(&self.made).as_ref()
    }

    /// What the receiver has, who expects the message of tick `expected`.
    fn newest(&self, expected: Option<u64>) -> Input<&M> {
        match self.delivered() {
            None => Input::Missing,
            Some((made_at, message)) if Some(*made_at) == expected => Input::Fresh(message),
            Some((made_at, message)) => Input::Held { value: message, made_at: *made_at },
        }
    }

    /// The newest message at its source, whether or not it got through.
    fn at_source(&self) -> Option<&M> {
        self.made.as_ref().map(|(_, message)| message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cut_wire_holds_its_last_message_and_counts_the_lost() {
        let mut wire = RingWire::default();
        assert_eq!(wire.newest(Some(0)), Input::Missing);
        wire.send(0, 'a');
        assert_eq!(wire.newest(Some(0)), Input::Fresh(&'a'));
        wire.cut_until = 3;
        for (k, m) in [(1, 'b'), (2, 'c')] {
            wire.send(k, m);
        }
        assert_eq!(wire.newest(Some(2)), Input::Held { value: &'a', made_at: 0 });
        assert_eq!(wire.withheld, 2);
        wire.send(3, 'd');
        assert_eq!(wire.newest(Some(3)), Input::Fresh(&'d'));
    }
}
