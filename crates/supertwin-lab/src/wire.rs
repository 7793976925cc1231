//! A wire of the ring in one process: the last message that got through, with the tick it was made at.

use supertwin_core::Input;

/// Carries messages of one type from tick to tick, unless it is cut.
#[derive(Clone, Debug)]
pub struct Wire<M> {
    /// The newest message, whether or not it got through.
    made: Option<(u64, M)>,
    /// On a cut wire, what got through last.
    held: Option<Option<(u64, M)>>,
    cut_until: u64,
    withheld: u64,
}

impl<M> Default for Wire<M> {
    fn default() -> Self {
        Self { made: None, held: None, cut_until: 0, withheld: 0 }
    }
}

impl<M> Wire<M> {
    /// Sends the message made at tick `k`; on a cut wire it is lost, and counted.
    pub fn send(&mut self, k: u64, message: M) {
        let last = self.made.replace((k, message));
        if k >= self.cut_until {
            self.held = None;
        } else {
            self.withheld += 1;
            self.held.get_or_insert(last);
        }
    }

    /// Carries nothing before tick `k`.
    pub fn cut_until(&mut self, k: u64) {
        self.cut_until = k;
    }

    fn delivered(&self) -> Option<&(u64, M)> {
        self.held.as_ref().unwrap_or(&self.made).as_ref()
    }

    /// What the receiver has, who expects the message of tick `expected`.
    pub fn receive(&self, expected: Option<u64>) -> Input<&M> {
        match self.delivered() {
            None => Input::Missing,
            Some((made_at, message)) if Some(*made_at) == expected => Input::Fresh(message),
            Some((made_at, message)) => Input::Held { value: message, made_at: *made_at },
        }
    }

    /// Tick of what the receiver has.
    pub fn made_at(&self) -> Option<u64> {
        self.delivered().map(|(made_at, _)| *made_at)
    }

    /// The message of tick `k`, if it got through.
    pub fn fresh(&self, k: u64) -> Option<&M> {
        self.delivered().filter(|(made_at, _)| *made_at == k).map(|(_, message)| message)
    }

    /// The newest message at its source, whether or not it got through.
    pub fn at_source(&self) -> Option<&M> {
        self.made.as_ref().map(|(_, message)| message)
    }

    /// Messages lost so far.
    #[must_use]
    pub fn withheld(&self) -> u64 {
        self.withheld
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cut_wire_holds_its_last_message_and_counts_the_lost() {
        let mut wire = Wire::default();
        assert_eq!(wire.receive(Some(0)), Input::Missing);
        wire.send(0, 'a');
        assert_eq!(wire.receive(Some(0)), Input::Fresh(&'a'));
        wire.cut_until(3);
        for (k, m) in [(1, 'b'), (2, 'c')] {
            wire.send(k, m);
        }
        assert_eq!(wire.receive(Some(2)), Input::Held { value: &'a', made_at: 0 });
        assert_eq!(wire.withheld(), 2);
        wire.send(3, 'd');
        assert_eq!(wire.receive(Some(3)), Input::Fresh(&'d'));
        assert_eq!(wire.fresh(2), None);
    }
}
