//! A change of what a block is doing is an event.

use crate::event::EventKind;
use crate::{Block, Event, Notice, Notices, Tick};
use std::borrow::Cow;

/// Remembers a block's notices and makes events of their changes.
#[derive(Clone, Debug)]
pub struct Watch {
    last: Notices,
}

impl Watch {
    /// Begins with what the block says before its first step, which is no event.
    #[must_use]
    pub fn new<B: Block>(block: &B) -> Self {
        Self { last: block.notices(None) }
    }

    /// After a step: each change is an event.
    pub fn after<B: Block>(&mut self, tick: Tick, block: &B, out: &B::Out, mut event: impl FnMut(Event)) {
        let now = block.notices(Some(out));
        if now.len() == self.last.len() && now.iter().zip(&self.last).all(|(now, before)| goes_on(now, before)) {
            return;
        }
        for (i, notice) in now.iter().enumerate() {
            let before = self.last.get(i);
            if !before.is_some_and(|before| goes_on(notice, before)) {
                event(Event {
                    tick: tick.k,
                    service: Cow::Borrowed(B::NAME),
                    severity: notice.severity,
                    what: EventKind::StateChanged {
                        what: Cow::Borrowed(notice.what),
                        from: Cow::Borrowed(before.map_or("", |before| before.state)),
                        to: Cow::Borrowed(notice.state),
                        consequence: Cow::Borrowed(notice.consequence),
                    },
                });
            }
        }
        self.last = now;
    }
}

/// What a notice is about follows from its place, so that only its state can change. This is asked at every tick, and words
/// that stand at the same address need no comparison of letters.
#[inline]
fn goes_on(now: &Notice, before: &Notice) -> bool {
    now.severity == before.severity && (core::ptr::eq(now.state, before.state) || now.state == before.state)
}
