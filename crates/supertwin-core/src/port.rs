//! Where a block's inputs arrive: messages with the tick they were made at, and the rule by which `step` sees them.
//!
//! A block says once which wires it listens to ([`Wired`]); any host, in any process, can then feed it.

use crate::input::OperatorLink;
use crate::{Block, Input, Message, Tick};

/// Which message tick k calls fresh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Timing {
    /// The one made at tick k.
    SameTick,
    /// The one made at tick k−1: the unit delay.
    TickBefore,
}

/// How a wire ends at a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PortRule {
    /// Which message is fresh.
    pub timing: Timing,
    /// Its arrival starts a step in real time.
    pub trigger: bool,
    /// Lock step waits for it.
    pub required: bool,
    /// Messages that are kept until the next step: 1 keeps the newest only.
    pub keep: usize,
}

impl PortRule {
    /// The newest, held until a newer one comes.
    pub const NEWEST: Self = Self { timing: Timing::SameTick, trigger: false, required: true, keep: 1 };
    /// The newest, and its arrival starts a step.
    pub const TRIGGER: Self = Self { trigger: true, ..Self::NEWEST };
    /// The newest of the tick before.
    pub const BEFORE: Self = Self { timing: Timing::TickBefore, ..Self::NEWEST };
    /// The newest, if somebody sends one.
    pub const OPTIONAL: Self = Self { required: false, ..Self::NEWEST };
    /// All since the last step, in order; their arrival starts a step.
    pub const EVERY: Self = Self { keep: 64, ..Self::TRIGGER };
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

/// The receiving end of a wire.
#[derive(Clone, Debug)]
pub struct Port<M> {
    rule: PortRule,
    made_at: Option<u64>,
    /// In the order of their ticks; the last is the newest. Emptied by a step only when every one counts.
    messages: Vec<M>,
    /// The tick of each of them.
    ticks: Vec<u64>,
    /// The newest has been seen by a step: it is held, and no longer new.
    seen: bool,
}

impl<M> Port<M> {
    /// Without a message yet.
    #[must_use]
    pub fn new(rule: PortRule) -> Self {
        Self {
            rule,
            made_at: None,
            messages: Vec::with_capacity(rule.keep),
            ticks: Vec::with_capacity(rule.keep),
            seen: false,
        }
    }

    /// How the wire ends here.
    #[must_use]
    pub fn rule(&self) -> PortRule {
        self.rule
    }

    /// Hands over the message made at tick `made_at`.
    pub fn offer(&mut self, made_at: u64, message: M) -> Offered {
        if self.made_at.is_some_and(|newest| made_at <= newest) {
            return Offered::Old;
        }
        self.made_at = Some(made_at);
        if core::mem::take(&mut self.seen) && self.rule.keep > 1 {
            self.messages.clear();
            self.ticks.clear();
        }
        let full = self.messages.len() >= self.rule.keep;
        if full {
            self.messages.remove(0);
            self.ticks.remove(0);
        }
        self.messages.push(message);
        self.ticks.push(made_at);
        if full && self.rule.keep > 1 { Offered::Displaced } else { Offered::Taken }
    }

    /// Tick of the newest message.
    #[must_use]
    pub fn made_at(&self) -> Option<u64> {
        self.made_at
    }

    /// Tick of the message that step k calls fresh; `None` at the first tick of a delayed wire.
    #[must_use]
    pub fn expected(&self, k: u64) -> Option<u64> {
        match self.rule.timing {
            Timing::SameTick => Some(k),
            Timing::TickBefore => k.checked_sub(1),
        }
    }

    /// In lock step: step k needs nothing more from this wire.
    #[must_use]
    pub fn ready(&self, k: u64) -> bool {
        !self.rule.required || self.expected(k).is_none_or(|expected| self.made_at == Some(expected))
    }

    /// The newest message as step k sees it.
    #[must_use]
    pub fn newest(&self, k: u64) -> Input<&M> {
        match (self.made_at, self.messages.last()) {
            (Some(made_at), Some(message)) if self.expected(k).is_some_and(|expected| made_at >= expected) => {
                Input::Fresh(message)
            }
            (Some(made_at), Some(message)) => Input::Held { value: message, made_at },
            _ => Input::Missing,
        }
    }

    /// Everything that arrived since the last step, in order.
    #[must_use]
    pub fn every(&self) -> &[M] {
        if self.seen { &[] } else { &self.messages }
    }

    /// Ticks of the messages that a step uses now: all new ones where every one counts, else the newest.
    #[must_use]
    pub fn used(&self) -> &[u64] {
        if self.seen && self.rule.keep > 1 { &[] } else { &self.ticks }
    }

    /// A step has seen what is here.
    pub fn stepped(&mut self) {
        self.seen = true;
    }

    /// Forgets everything: another run begins.
    pub fn clear(&mut self) {
        self.made_at = None;
        self.messages.clear();
        self.ticks.clear();
        self.seen = false;
    }
}

/// Walks over the ports of a block.
pub trait PortVisitor {
    /// The next port, always in the same order.
    fn port<M: Message>(&mut self, port: &mut Port<M>);
}

/// Takes messages of any type.
pub trait MessageVisitor {
    /// The next message.
    fn message<M: Message>(&mut self, message: &M);
}

/// A block whose inputs come over wires.
pub trait Wired: Block {
    /// Its ports.
    type Ports: Send;

    /// It makes the ticks that the others follow.
    const OWNS_TIME: bool = false;

    /// All of them, empty.
    fn ports() -> Self::Ports;

    /// Shows each port, always in the same order.
    fn visit<V: PortVisitor>(ports: &mut Self::Ports, visitor: &mut V);

    /// What `step` is handed at `tick`.
    fn input(ports: &Self::Ports, tick: Tick, operator: OperatorLink) -> Self::In<'_>;

    /// Messages beside the output that nobody waits for, after a step.
    fn asides<V: MessageVisitor>(&self, visitor: &mut V) {
        let _ = visitor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_holds_the_newest_and_knows_what_is_fresh() {
        let mut port = Port::new(PortRule::NEWEST);
        assert!(!port.ready(0));
        assert_eq!(port.newest(0), Input::Missing);
        assert_eq!(port.offer(3, 'c'), Offered::Taken);
        assert_eq!(port.offer(3, 'x'), Offered::Old);
        assert_eq!(port.offer(2, 'x'), Offered::Old);
        assert!(port.ready(3) && !port.ready(4));
        assert_eq!(port.newest(3), Input::Fresh(&'c'));
        assert_eq!(port.newest(5), Input::Held { value: &'c', made_at: 3 });
        port.stepped();
        assert_eq!(port.used(), [3], "what is held is used again");
    }

    #[test]
    fn a_delayed_port_needs_nothing_at_the_first_tick() {
        let mut port = Port::new(PortRule::BEFORE);
        assert!(port.ready(0) && !port.ready(1));
        port.offer(0, 'a');
        assert!(port.ready(1));
        assert_eq!(port.newest(1), Input::Fresh(&'a'));
        assert_eq!(port.newest(2), Input::Held { value: &'a', made_at: 0 });
    }

    #[test]
    fn a_port_for_every_message_hands_each_over_once_and_counts_the_displaced() {
        let mut port = Port::new(PortRule { keep: 2, ..PortRule::EVERY });
        port.offer(1, 'a');
        port.offer(2, 'b');
        assert_eq!((port.every(), port.used()), (&['a', 'b'][..], &[1, 2][..]));
        port.stepped();
        assert!(port.every().is_empty() && port.used().is_empty());
        assert_eq!(port.offer(3, 'c'), Offered::Taken);
        assert_eq!(port.every(), ['c']);
        port.offer(4, 'd');
        assert_eq!(port.offer(5, 'e'), Offered::Displaced);
        assert_eq!((port.every(), port.used()), (&['d', 'e'][..], &[4, 5][..]));
    }
}
