//! Why a command is not obeyed.

/// A command that was not obeyed, and why.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct Refusal(pub String);
