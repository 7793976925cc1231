//! Where a block's inputs arrive: messages with the tick they were made at, and the rule by which `step` sees them.
//!
//! A block says once which wires it listens to ([`Wired::input`]). The ring in one process, a host in another process and a
//! replay all hand it its inputs by that, each with [`Wires`] of its own.

use crate::input::OperatorLink;
use crate::{Block, Input, Message, Tick};
use core::any::Any;
use core::marker::PhantomData;

/// How a wire ends at a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PortRule {
    /// Step k calls the message fresh that was made so many ticks before: 0, or 1 for the unit delay.
    pub delay: u64,
    /// Its arrival starts a step in real time.
    pub trigger: bool,
    /// Lock step waits for it.
    pub required: bool,
    /// Messages that are kept until the next step: 1 keeps the newest only.
    pub keep: usize,
}

impl PortRule {
    /// The newest, held until a newer one comes.
    pub const NEWEST: Self = Self { delay: 0, trigger: false, required: true, keep: 1 };
    /// The newest, and its arrival starts a step.
    pub const TRIGGER: Self = Self { trigger: true, ..Self::NEWEST };
    /// The newest of the tick before.
    pub const BEFORE: Self = Self { delay: 1, ..Self::NEWEST };
    /// The newest, if somebody sends one.
    pub const OPTIONAL: Self = Self { required: false, ..Self::NEWEST };
    /// All since the last step, in order; their arrival starts a step.
    pub const EVERY: Self = Self { keep: 64, ..Self::TRIGGER };

    /// Tick of the message that step k calls fresh; `None` at the first tick of a delayed wire.
    #[must_use]
    pub fn expected(self, k: u64) -> Option<u64> {
        k.checked_sub(self.delay)
    }
}

/// What became of a message that was handed to a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Offered {
    /// Newer than what was there.
    Taken,
    /// Not newer than what was there; left out.
    Old,
    /// Taken, but an older one that no step has seen had to go.
    Displaced,
}

/// What is known of a port, whatever its messages are.
#[derive(Clone, Debug)]
pub struct PortState {
    /// Key of the wire.
    pub key: &'static str,
    /// How the wire ends here.
    pub rule: PortRule,
    made_at: Option<u64>,
    /// The tick of each message that is kept, in their order.
    ticks: Vec<u64>,
    /// The newest has been seen by a step: it is held, and no longer new.
    seen: bool,
}

impl PortState {
    /// Tick of the newest message.
    #[must_use]
    pub fn made_at(&self) -> Option<u64> {
        self.made_at
    }

    /// Tick of the message that step k calls fresh; `None` at the first tick of a delayed wire.
    #[must_use]
    pub fn expected(&self, k: u64) -> Option<u64> {
        self.rule.expected(k)
    }

    /// In lock step: step k needs nothing more from this wire.
    #[must_use]
    pub fn ready(&self, k: u64) -> bool {
        !self.rule.required || self.expected(k).is_none_or(|expected| self.made_at == Some(expected))
    }

    /// Ticks of the messages that a step uses now: all new ones where every one counts, else the newest.
    #[must_use]
    pub fn used(&self) -> &[u64] {
        if self.seen && self.rule.keep > 1 { &[] } else { &self.ticks }
    }
}

/// The receiving end of a wire.
#[derive(Clone, Debug)]
pub struct Port<M> {
    /// All but the messages.
    pub state: PortState,
    /// In the order of their ticks; the last is the newest. Emptied by a step only when every one counts.
    messages: Vec<M>,
}

impl<M> Port<M> {
    /// Without a message yet.
    #[must_use]
    pub fn new(key: &'static str, rule: PortRule) -> Self {
        let ticks = Vec::with_capacity(rule.keep);
        Self {
            state: PortState { key, rule, made_at: None, ticks, seen: false },
            messages: Vec::with_capacity(rule.keep),
        }
    }

    /// Hands over the message made at tick `made_at`.
    pub fn offer(&mut self, made_at: u64, message: M) -> Offered {
        let state = &mut self.state;
        if state.made_at.is_some_and(|newest| made_at <= newest) {
            return Offered::Old;
        }
        state.made_at = Some(made_at);
        if core::mem::take(&mut state.seen) && state.rule.keep > 1 {
            self.messages.clear();
            state.ticks.clear();
        }
        let full = self.messages.len() >= state.rule.keep;
        if full {
            self.messages.remove(0);
            state.ticks.remove(0);
        }
        self.messages.push(message);
        state.ticks.push(made_at);
        if full && state.rule.keep > 1 { Offered::Displaced } else { Offered::Taken }
    }

    /// The newest message as step k sees it.
    #[must_use]
    pub fn newest(&self, k: u64) -> Input<&M> {
        match (self.state.made_at, self.messages.last()) {
            (Some(made_at), Some(message)) if self.state.expected(k).is_some_and(|expected| made_at >= expected) => {
                Input::Fresh(message)
            }
            (Some(made_at), Some(message)) => Input::Held { value: message, made_at },
            _ => Input::Missing,
        }
    }

    /// Everything that arrived since the last step, in order.
    #[must_use]
    pub fn every(&self) -> &[M] {
        if self.state.seen { &[] } else { &self.messages }
    }
}

/// Walks over the ports of a block.
pub trait PortVisitor {
    /// The next port with its number, always in the same order.
    fn port<M: Message>(&mut self, number: usize, port: &mut Port<M>);
}

/// Walks over the wires that end at a block.
pub trait WireVisitor {
    /// The next wire, always in the same order.
    fn wire<M: Message>(&mut self, rule: PortRule);
}

/// Takes messages of any type.
pub trait MessageVisitor {
    /// The next message beside the output, always in the same order.
    fn message<M: Message>(&mut self, message: &M);
}

/// What arrives at a block, wire by wire.
pub trait Wires<'a> {
    /// The newest message of the next wire, as this step sees it.
    fn newest<M: Message>(&mut self, rule: PortRule) -> Input<&'a M>;
    /// All messages since the last step, in order.
    fn every<M: Message>(&mut self, rule: PortRule) -> &'a [M];
}

/// A block whose inputs come over wires.
pub trait Wired: Block {
    /// It makes the ticks that the others follow.
    const OWNS_TIME: bool = false;

    /// What `step` is handed. It asks for the same wires in the same order, whatever there is on them: this is also how
    /// others learn which wires end here.
    fn input<'a>(wires: &mut impl Wires<'a>, operator: OperatorLink) -> Self::In<'a>;

    /// Messages beside the output that nobody waits for, after a step.
    fn asides<V: MessageVisitor>(&self, visitor: &mut V) {
        let _ = visitor;
    }
}

/// Tells `visitor` which wires end at a block.
pub fn wires<B: Wired>(visitor: &mut impl WireVisitor) {
    struct Asked<'v, V>(&'v mut V);
    impl<'a, V: WireVisitor> Wires<'a> for Asked<'_, V> {
        fn newest<M: Message>(&mut self, rule: PortRule) -> Input<&'a M> {
            self.0.wire::<M>(rule);
            Input::Missing
        }
        fn every<M: Message>(&mut self, rule: PortRule) -> &'a [M] {
            self.0.wire::<M>(rule);
            &[]
        }
    }
    B::input(&mut Asked(visitor), OperatorLink::default());
}

/// A port of any message.
trait AnyPort: Any + Send {
    fn boxed(&self) -> Box<dyn AnyPort>;
    fn state(&self) -> &PortState;
    fn state_mut(&mut self) -> &mut PortState;
}

impl<M: Message> AnyPort for Port<M> {
    fn boxed(&self) -> Box<dyn AnyPort> {
        Box::new(self.clone())
    }
    fn state(&self) -> &PortState {
        &self.state
    }
    fn state_mut(&mut self) -> &mut PortState {
        &mut self.state
    }
}

/// The ports of a block that is fed over a network or from a recording, one for each wire that ends at it.
pub struct Ports<B> {
    ports: Vec<Box<dyn AnyPort>>,
    block: PhantomData<fn() -> B>,
}

impl<B> Clone for Ports<B> {
    fn clone(&self) -> Self {
        Self { ports: self.ports.iter().map(|port| port.boxed()).collect(), block: PhantomData }
    }
}

impl<B: Wired> Default for Ports<B> {
    fn default() -> Self {
        struct Opened(Vec<Box<dyn AnyPort>>);
        impl WireVisitor for Opened {
            fn wire<M: Message>(&mut self, rule: PortRule) {
                self.0.push(Box::new(Port::<M>::new(M::KEY, rule)));
            }
        }
        let mut opened = Opened(Vec::new());
        wires::<B>(&mut opened);
        Self { ports: opened.0, block: PhantomData }
    }
}

impl<B: Wired> Ports<B> {
    /// What is known of each port, in the order of the wires.
    pub fn states(&self) -> impl Iterator<Item = &PortState> {
        self.ports.iter().map(|port| port.state())
    }

    /// A step has seen what is here.
    pub fn stepped(&mut self) {
        self.ports.iter_mut().for_each(|port| port.state_mut().seen = true);
    }

    /// Shows each port, in the order of the wires.
    pub fn visit(&mut self, visitor: &mut impl PortVisitor) {
        struct Each<'p, V>(core::iter::Enumerate<core::slice::IterMut<'p, Box<dyn AnyPort>>>, &'p mut V);
        impl<V: PortVisitor> WireVisitor for Each<'_, V> {
            fn wire<M: Message>(&mut self, _: PortRule) {
                if let Some((number, port)) = self.0.next()
                    && let Some(port) = (&mut **port as &mut dyn Any).downcast_mut::<Port<M>>()
                {
                    self.1.port(number, port);
                }
            }
        }
        wires::<B>(&mut Each(self.ports.iter_mut().enumerate(), visitor));
    }

    /// What `step` is handed at `tick`.
    #[must_use]
    pub fn input(&self, tick: Tick, operator: OperatorLink) -> B::In<'_> {
        struct Arrived<'p>(core::slice::Iter<'p, Box<dyn AnyPort>>, u64);
        impl<'p> Arrived<'p> {
            fn next<M: Message>(&mut self) -> Option<&'p Port<M>> {
                (&**self.0.next()? as &dyn Any).downcast_ref()
            }
        }
        impl<'p> Wires<'p> for Arrived<'p> {
            fn newest<M: Message>(&mut self, _: PortRule) -> Input<&'p M> {
                let k = self.1;
                self.next::<M>().map_or(Input::Missing, |port| port.newest(k))
            }
            fn every<M: Message>(&mut self, _: PortRule) -> &'p [M] {
                self.next::<M>().map_or(&[], Port::every)
            }
        }
        B::input(&mut Arrived(self.ports.iter(), tick.k), operator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_holds_the_newest_and_knows_what_is_fresh() {
        let mut port = Port::new("wire", PortRule::NEWEST);
        assert!(!port.state.ready(0));
        assert_eq!(port.newest(0), Input::Missing);
        assert_eq!(port.offer(3, 'c'), Offered::Taken);
        assert_eq!(port.offer(3, 'x'), Offered::Old);
        assert_eq!(port.offer(2, 'x'), Offered::Old);
        assert!(port.state.ready(3) && !port.state.ready(4));
        assert_eq!(port.newest(3), Input::Fresh(&'c'));
        assert_eq!(port.newest(5), Input::Held { value: &'c', made_at: 3 });
        port.state.seen = true;
        assert_eq!(port.state.used(), [3], "what is held is used again");
    }

    #[test]
    fn a_delayed_port_needs_nothing_at_the_first_tick() {
        let mut port = Port::new("wire", PortRule::BEFORE);
        assert!(port.state.ready(0) && !port.state.ready(1));
        port.offer(0, 'a');
        assert!(port.state.ready(1));
        assert_eq!(port.newest(1), Input::Fresh(&'a'));
        assert_eq!(port.newest(2), Input::Held { value: &'a', made_at: 0 });
    }

    #[test]
    fn a_port_for_every_message_hands_each_over_once_and_counts_the_displaced() {
        let mut port = Port::new("wire", PortRule { keep: 2, ..PortRule::EVERY });
        port.offer(1, 'a');
        port.offer(2, 'b');
        assert_eq!((port.every(), port.state.used()), (&['a', 'b'][..], &[1, 2][..]));
        port.state.seen = true;
        assert!(port.every().is_empty() && port.state.used().is_empty());
        assert_eq!(port.offer(3, 'c'), Offered::Taken);
        assert_eq!(port.every(), ['c']);
        port.offer(4, 'd');
        assert_eq!(port.offer(5, 'e'), Offered::Displaced);
        assert_eq!((port.every(), port.state.used()), (&['d', 'e'][..], &[4, 5][..]));
    }
}
