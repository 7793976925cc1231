//! What the command line does, as a library: no grammar, no terminal.
//!
//! * [`run`], [`sweep`]: trials in this process, recorded and scored; campaigns of them.
//! * [`placement`]: from a trial to hosts on the network.
//! * [`recorder`]: what flows on the network, into recordings and a live view.
//! * [`compare`]: runs beside each other, with verdicts.
//! * [`orders`]: commands and parameters, with acknowledgement.
//! * [`flows`], [`service_board`]: what is alive, what flows, and how services are.
//! * [`replay`]: recorded inputs into the blocks again.
//! * [`inspect`], [`export`]: what is in a recording; for other programs.
//! * [`verify`]: the same bits in one process and in several.
//! * [`configuration`]: what configuration files say, as it was understood.
//! * [`doctor`]: what is wrong with a set-up, and what to do.
//! * [`router_access`]: whom a router lets in.
//! * [`zenoh_settings`]: configuration files of routers and clients, and who may do what.
//! * [`network`]: a client that asks and listens.
//!
//! Options go in as structs and data comes out; [`OperationError`] says what was wrong, [`Progress`] how far it is, and a
//! flag that is handed in ends what takes long.
//!
//! What `supertwin check` knows of a file, as a table:
//!
//! ```
//! use std::path::Path;
//! use supertwin_lab::Library;
//! use supertwin_operations::configuration;
//!
//! let library = Library::new("../../config", Vec::new());
//! let vehicle = configuration::understand(Path::new("../../config/vehicles/argus-mini.toml"), &library)?;
//! assert!(vehicle["true"]["rigid_body"]["mass_kg"].as_float().is_some());
//! # Ok::<(), supertwin_lab::ConfigError>(())
//! ```

pub mod compare;
pub mod configuration;
pub mod doctor;
mod error;
pub mod export;
pub mod flows;
pub mod inspect;
pub mod network;
pub mod orders;
pub mod placement;
mod progress;
pub mod recorder;
pub mod replay;
pub mod router_access;
pub mod run;
mod save;
pub mod service_board;
pub mod sweep;
pub mod verify;
pub mod zenoh_settings;

pub use error::OperationError;
pub use network::NetworkClient;
pub use progress::Progress;
use save::entries;
pub use save::save;

/// At most `longest` characters of a text, with an ellipsis for the rest.
#[must_use]
pub fn shortened(text: &str, longest: usize) -> String {
    if text.chars().count() <= longest {
        text.to_owned()
    } else {
        text.chars().take(longest - 1).chain(['…']).collect()
    }
}
