//! What a block is handed: values with an age, and the unit delay that closes the loop.

use crate::Tick;

/// A value on its way into [`crate::Block::step`].
///
/// In batch and in lock step every input is fresh by construction. In real time the host says how old a value is,
/// in ticks, and the block decides by its own parameters when that is too old.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Input<T> {
    /// Made at this very tick (for a [`Prev`]: at the tick before).
    Fresh(T),
    /// The newest there is, made at the tick `made_at`.
    Held {
        /// Newest value that has arrived.
        value: T,
        /// The tick at which it was made.
        made_at: u64,
    },
    /// Nothing has arrived yet.
    Missing,
}

impl<T> Input<T> {
    /// The value if it is at most `limit_ticks` old at `now`.
    pub fn within(self, now: Tick, limit_ticks: u64) -> Option<T> {
        match self {
            Self::Fresh(value) => Some(value),
            Self::Held { value, made_at } => (now.k.saturating_sub(made_at) <= limit_ticks).then_some(value),
            Self::Missing => None,
        }
    }

    /// The value, however old.
    pub fn newest(self) -> Option<T> {
        match self {
            Self::Fresh(value) | Self::Held { value, .. } => Some(value),
            Self::Missing => None,
        }
    }
}

/// Whether somebody is in command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OperatorLink {
    /// A mission, or an operator whose lease and liveliness stand.
    #[default]
    Present,
    /// The operator is gone: hold depth and heading.
    Lost,
}

/// z⁻¹: a value of the tick before. The only legal way to close the loop, hence visible in the types.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prev<T>(pub T);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_input_expires_after_its_limit() {
        let now = Tick { k: 10, dt_s: 0.02 };
        assert_eq!(Input::Held { value: 1, made_at: 7 }.within(now, 3), Some(1));
        assert_eq!(Input::Held { value: 1, made_at: 6 }.within(now, 3), None);
        assert_eq!(Input::Fresh(2).within(now, 0), Some(2));
        assert_eq!(Input::<i32>::Missing.within(now, u64::MAX), None);
    }
}
