//! The vocabulary of the twin: what every other crate may name, and nothing that does work of its own.
//!
//! * [`Block`]: a discrete-time system `x⁺, y = f(x, u)`; four of them form the ring.
//! * [`message`]: the values on the wires, each type with the key it travels on.
//! * [`Input`] and [`Prev`]: what a block is handed, with its age; the one legal unit delay.
//! * [`Wired`], [`Wires`] and [`Ports`]: which wires end at a block, and what arrives over them.
//! * [`Observe`], [`Probe`], [`Signal`]: a quantity shows itself once, and every listener hears it.
//! * [`signal`]: every signal by its handle.
//! * [`Event`]: what happened, as data for programs and as a sentence for people.
//! * [`RunSink`] and [`RecordedRun`]: where a run is written to and what is read of it, without naming a file format.
//!
//! Conventions: SI units, radians, seconds; frame {n} is North-East-Down, frame {b} is forward-starboard-down.
//!
//! A value that was made at tick 7, looked at in tick 10:
//!
//! ```
//! use supertwin_core::{Input, Tick};
//!
//! let now = Tick { k: 10, dt_s: 0.02 };
//! let depth = Input::Held { value: 3.5, made_at: 7 };
//! assert_eq!(depth.within(now, 3), Some(3.5));
//! assert_eq!(depth.within(now, 2), None); // too old where two ticks are allowed
//! ```

pub mod axes;
pub mod block;
pub mod capability;
pub mod check;
pub mod command;
pub mod digest;
pub mod event;
pub mod frame;
mod handle;
pub mod input;
pub mod integrate;
pub mod message;
pub mod notice;
pub mod observe;
pub mod parameter;
pub mod port;
pub mod random;
mod refusal;
pub mod run;
mod services;
pub mod signal;
pub mod source;
pub mod tick;
pub mod unit;
mod watch;

pub use axes::{Axes, BodyAcceleration, BodyVelocity, Wrench};
pub use block::Block;
pub use capability::Capability;
pub use event::{Event, EventKind, Severity};
pub use handle::Signal;
pub use input::{Input, OperatorLink, Prev};
pub use message::Message;
pub use notice::{Notice, Notices};
pub use observe::{Observe, Probe};
pub use parameter::ParameterChange;
pub use port::{Port, PortRule, Ports, Wired, Wires};
pub use refusal::Refusal;
pub use run::{NoSink, Property, RunHeader, RunSink, SinkError};
pub use source::RecordedRun;
pub use tick::Tick;
pub use watch::Watch;
