//! The contract of the four services: a pure discrete-time system.

use crate::{Message, Observe, Tick};

/// A discrete-time system `x⁺, y = f(x, u)`.
///
/// Construction may fail; `step` may not: no I/O, no clock, no allocation, no logging. What goes wrong inside
/// becomes a health flag in the output. Batch, lock step over a network and replay call the same `step`.
pub trait Block: Observe + Send {
    /// The service's name and the first part of its keys.
    const NAME: &'static str;
    /// Everything one step consumes.
    type In<'a>;
    /// What one step produces, the wire's message.
    type Out: Message;
    /// What a mission or a client may ask of this block.
    type Command;

    /// One tick.
    fn step(&mut self, tick: Tick, input: Self::In<'_>) -> Self::Out;

    /// Takes a command into account from the next `step` on, or refuses it and changes nothing.
    ///
    /// # Errors
    /// [`Refusal`] names the value and the rule it breaks.
    fn command(&mut self, tick: Tick, command: &Self::Command) -> Result<(), Refusal>;
}

/// A command that was not obeyed, and why.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct Refusal(pub String);
