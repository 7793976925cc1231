//! A change of what a block is doing is an event.

use crate::event::EventKind;
use crate::{Block, Event, Notices, Tick};
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
        if now == self.last {
            return;
        }
        for (i, notice) in now.iter().enumerate() {
            let before = self.last.get(i);
            if before != Some(notice) {
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
