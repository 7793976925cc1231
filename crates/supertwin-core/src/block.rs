//! The contract of the four services: a pure discrete-time system.

use crate::notice::Notices;
pub use crate::services::SERVICES;
use crate::{Message, Observe, Refusal, Tick};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// A discrete-time system `x⁺, y = f(x, u)`.
///
/// Construction may fail; `step` may not: no I/O, no clock, no allocation, no logging. What goes wrong inside
/// becomes a health flag in the output. Batch, lock step over a network and replay call the same `step`.
pub trait Block: Observe + Clone + Send {
    /// The service's name and the first part of its keys.
    const NAME: &'static str;
    /// Everything one step consumes.
    type In<'a>;
    /// What one step produces, the wire's message.
    type Out: Message;
    /// What a mission or a client may ask of this block.
    type Command: Serialize + DeserializeOwned + Clone + Send;

    /// Computes `x⁺` and `y` of one tick.
    fn step(&mut self, tick: Tick, input: Self::In<'_>) -> Self::Out;

    /// Takes a command into account from the next `step` on, or refuses it and changes nothing.
    ///
    /// # Errors
    /// [`Refusal`] names the value and the rule it breaks.
    fn command(&mut self, tick: Tick, command: &Self::Command) -> Result<(), Refusal>;

    /// What it is doing, in words, in an order that does not depend on the values: a change is an event.
    /// `out` is the output of the last step; before the first there is none.
    fn notices(&self, out: Option<&Self::Out>) -> Notices {
        let _ = out;
        Notices::new()
    }

    /// Takes over from `old`, built alike, what outlives the run that has ended: an emergency in force.
    fn succeed(&mut self, old: &Self) {
        let _ = old;
    }

    /// Parameters that may be changed while it runs, as a tree of names and values.
    fn parameters(&self) -> Value {
        Value::Null
    }
}
