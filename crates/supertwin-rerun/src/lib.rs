//! Recordings: whatever a run shows goes into columns of a Rerun file, with dashboards that explain themselves.
//!
//! * [`RerunSink`]: a [`supertwin_core::RunSink`] that writes one `.rrd` file, or feeds a live view.
//! * [`Live`]: what viewers connect to; it can be slow or stop, and nothing waits for it.
//! * [`blueprint`]: the dashboards that are embedded in every recording.
//! * [`mod@read`]: a recording back as numbers, also when its writer died; [`mod@repair`]: whole again.
//! * [`mod@merge`]: several recordings side by side in one file, with a dashboard that compares them.
//! * [`mod@export`]: for data frames, spreadsheets and Foxglove.
//! * [`signals`]: what recordings have beside what the blocks show.
//! * [`table`]: results of many runs, a row for each.
//!
//! One tick of one signal, written and read back:
//!
//! ```
//! use supertwin_core::run::Properties;
//! use supertwin_core::signal::tracking::DEPTH;
//! use supertwin_core::{Probe, RunHeader, RunSink, Tick};
//! use supertwin_rerun::{Options, RerunSink, read};
//!
//! let folder = tempfile::tempdir()?;
//! let file = folder.path().join("run.rrd");
//! let mut sink = RerunSink::create(&file, Options { dashboards: false, ..Options::default() })?;
//! sink.begin(&RunHeader { name: "first".to_owned(), ..RunHeader::default() })?;
//! sink.tick(Tick { k: 0, dt_s: 0.02 })?;
//! sink.vector(&DEPTH, &[3.1, 3.0, 3.05]); // measured, wanted, true
//! sink.finish(&Properties::new())?;
//! assert_eq!(read(&file)?.signals[DEPTH.path].values, [3.1, 3.0, 3.05]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod atomic_file;
pub mod blueprint;
mod chunk_rows;
mod chunks;
mod compact;
mod derived;
pub mod event;
pub mod export;
mod frames;
mod late_rows;
pub mod live;
pub mod merge;
pub mod read;
pub mod repair;
mod scene;
pub mod signals;
pub mod sink;
pub mod style;
pub mod table;
mod writer;

pub use chunks::Clocks;
pub use compact::compact;
pub use export::{ExportError, Exported, Format, export};
pub use live::Live;
pub use merge::{Merge, MergeError, Merged, MergedRun, merge};
pub use read::{Damage, ReadError, Recording, read, read_parts, read_selected};
pub use repair::{Repair, RepairError, repair};
pub use sink::{Options, RerunSink};
pub use table::{Column, Table, TableError};

/// The application that recordings belong to; a blueprint is only used for recordings of its own application.
pub const APPLICATION: &str = "supertwin";

/// The application of files in which several runs stand side by side; they have a dashboard of their own.
pub const COMPARISON: &str = "supertwin_compare";

/// Timeline of the simulated time, a duration since the start of the run.
pub const TIME: &str = "sim_time";

/// Timeline of the tick number.
pub const TICK: &str = "tick";

/// Timeline of the sender's wall clock; runs in one process have none.
pub const SENDER_CLOCK: &str = "sender_clock";

/// Timeline of the recorder's wall clock; runs in one process have none.
pub const RECORDER_CLOCK: &str = "recorder_clock";
