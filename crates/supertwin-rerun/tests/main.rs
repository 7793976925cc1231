//! Recordings are written, read, repaired, merged, exported and shown.

mod common;
mod corpus;
mod exporting;
#[path = "../../../tests/support/keeper.rs"]
mod keeper;
mod live;
mod merging;
#[path = "../../../tests/support/python.rs"]
mod python;
mod reading;
mod recording;
#[path = "../../../tests/support/written.rs"]
mod written;
