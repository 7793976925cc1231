//! What is said on the network, whatever carries it. No session, no thread and no socket stands here.
//!
//! * [`keys`], [`envelope`], [`payload`], [`telemetry`], [`health`]: where what is said stands, and what it looks like;
//!   [`schema`] describes all of it for other languages.
//! * [`ledger`], [`event_order`]: what of it arrived, and in which order it was said.
//! * [`lease`], [`command_queue`]: who may command, and how a request becomes a command.
//! * [`role`], [`access`]: who may do what with which key.
//! * [`clock`], [`fault`]: the time as hosts see it, and losses that tests ask for.

pub mod access;
pub mod clock;
pub mod command_queue;
pub mod envelope;
pub mod event_order;
pub mod fault;
pub mod health;
pub mod keys;
pub mod lease;
pub mod ledger;
pub mod payload;
pub mod role;
pub mod schema;
pub mod telemetry;

pub use clock::{Clock, SystemClock};
pub use envelope::{Envelope, Heard, decode, encode, head};
pub use fault::FaultRates;
pub use health::{Health, InputHealth};
pub use role::{Role, Scope};
pub use telemetry::{Description, Shape, Telemetry};
