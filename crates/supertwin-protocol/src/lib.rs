//! What is said on the network, whatever carries it. No session, no thread and no socket stands here.
//!
//! * [`keys`], [`envelope`], [`payload`], [`telemetry`], [`health`]: where what is said stands, and what it looks like;
//!   [`schema`] describes all of it for other languages.
//! * [`ledger`], [`event_order`]: what of it arrived, and in which order it was said.
//! * [`lease`], [`command_queue`]: who may command, and how a request becomes a command.
//! * [`role`], [`access`]: who may do what with which key.
//! * [`clock`], [`fault`]: the time as hosts see it, and losses that tests ask for.
//!
//! A message of tick 7 on its way, and who may listen to it:
//!
//! ```
//! use supertwin_core::Tick;
//! use supertwin_protocol::access::{Verb, matrix};
//! use supertwin_protocol::{Envelope, Role, decode, encode, keys};
//!
//! let envelope = Envelope::new("first", "plant", Tick { k: 7, dt_s: 0.02 }, 8, 0).with(3.5);
//! let mut payload = Vec::new();
//! encode(&envelope, &mut payload)?;
//! assert_eq!(decode::<f64>(&payload)?, envelope);
//!
//! let key = keys::health("guidance");
//! let rights = matrix().into_iter().find(|row| row.keys.contains(&key)).expect("stands in the matrix");
//! assert!(rights.allows(Role::Observer, Verb::Subscribe) && !rights.allows(Role::Observer, Verb::Put));
//! # Ok::<(), supertwin_protocol::envelope::Rejected>(())
//! ```

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
pub use envelope::{Envelope, Received, decode, encode, head};
pub use fault::FaultRates;
pub use health::{Health, InputHealth};
pub use role::{Role, Scope};
pub use telemetry::{Description, Shape, Telemetry};
