//! The protocol on Zenoh: sessions, mailbox and outbox, a host for any block, routers, clients and witnesses.
//!
//! ```text
//! callbacks ─▶ Mailbox ─▶ Engine ─▶ Host<B>: Ledger, Port, CommandQueue, Authority ─▶ B::step ─▶ wire
//!                                                                         └─▶ Outbox ─▶ telemetry, events, health
//! ```
//!
//! The only crate that names zenoh. It knows messages and blocks, and no particular block.
//!
//! What holds for a session unless a file or a flag says otherwise: no discovery, no listener.
//!
//! ```
//! let settings = supertwin_zenoh::Link::default().settings()?;
//! assert_eq!(settings["scouting"]["multicast"]["enabled"], false);
//! assert_eq!(settings["listen"]["endpoints"].as_array().map(Vec::len), Some(0));
//! # Ok::<(), supertwin_zenoh::LinkError>(())
//! ```

pub mod access_control;
pub mod access_log;
pub mod client;
mod connect_error;
pub mod diagnose;
pub mod engine;
pub mod host;
pub mod mailbox;
mod outbox;
pub mod router;
pub mod service_publisher;
pub mod session;
mod transport;
pub mod watch;
pub mod witness;
mod zenoh_log;

pub use client::{Client, ClientError};
pub use engine::{Engine, Finished};
pub use host::{Ending, Host, HostOptions, Pace};
pub use mailbox::Mailbox;
pub use router::Router;
pub use service_publisher::ServicePublisher;
pub use session::{Link, LinkError, close, unique};
pub use watch::{Inbox, Interrupter, Presence};
pub use witness::{Receipts, WitnessError, WitnessOptions, witness};

/// A session, for those who hold one without naming zenoh themselves.
pub use zenoh::Session;
