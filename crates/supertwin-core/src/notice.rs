//! What a block is doing, as named states.

use crate::event::Severity;
use arrayvec::ArrayVec;

/// Most things that one block gives notice of.
pub const MAX_NOTICES: usize = 8;

/// The present state of one thing worth telling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Notice {
    /// How grave it is to come into this state.
    pub severity: Severity,
    /// What it is: `mode`, `reason`, `status`, or something that the block needs, such as `net`.
    pub what: &'static str,
    /// The state that it is in, as events and people name it.
    pub state: &'static str,
    /// What the block does about it; empty if nothing.
    pub consequence: &'static str,
}

impl Notice {
    /// A state that is as planned.
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
