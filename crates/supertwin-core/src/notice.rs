//! What a block is doing, in words: a change of one of these is an event.

use crate::run::Severity;
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
    /// The state in words.
    pub text: &'static str,
}

impl Notice {
    /// As planned.
    #[must_use]
    pub const fn info(text: &'static str) -> Self {
        Self { severity: Severity::Info, text }
    }

    /// Not as it should be.
    #[must_use]
    pub const fn warning(text: &'static str) -> Self {
        Self { severity: Severity::Warning, text }
    }

    /// A warning when `bad`, else as planned.
    #[must_use]
    pub const fn either(bad: bool, lost: &'static str, found: &'static str) -> Self {
        if bad { Self::warning(lost) } else { Self::info(found) }
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
            if self.last.get(i) != Some(notice) {
                event(Event {
                    tick: tick.k,
                    service: Cow::Borrowed(B::NAME),
                    severity: notice.severity,
                    text: Cow::Borrowed(notice.text),
                });
            }
        }
        self.last = now;
    }
}
