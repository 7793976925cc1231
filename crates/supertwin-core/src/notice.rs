//! What a block is doing, as named states: a change of one of these is an event.

use crate::event::{EventKind, Severity};
use crate::{Block, Event, Tick};
use arrayvec::ArrayVec;
use std::borrow::Cow;

/// Most things that one block gives notice of.
pub const MAX_NOTICES: usize = 8;

/// The present state of one thing worth telling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Notice {
    /// How grave it is to come into this state.
    pub severity: Severity,
    /// What it is: `mode`, `reason`, `status`, or something that the block needs, such as `net`.
    pub what: &'static str,
    /// Its state.
    pub state: &'static str,
    /// What the block does about it; empty if nothing.
    pub consequence: &'static str,
}

impl Notice {
    /// As planned.
    #[must_use]
    pub const fn info(what: &'static str, state: &'static str) -> Self {
        Self { severity: Severity::Info, what, state, consequence: "" }
    }

    /// A warning when `bad`, else as planned.
    #[must_use]
    pub const fn either(bad: bool, what: &'static str, lost: &'static str, found: &'static str) -> Self {
        if bad { Self { severity: Severity::Warning, ..Self::info(what, lost) } } else { Self::info(what, found) }
    }

    /// With what the block does about it, if it is a warning.
    #[must_use]
    pub const fn with_consequence(self, consequence: &'static str) -> Self {
        if matches!(self.severity, Severity::Info) { self } else { Self { consequence, ..self } }
    }
}

/// Notices in the block's own order.
pub type Notices = ArrayVec<Notice, MAX_NOTICES>;

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
