//! Recordings are written, read, repaired, merged, exported and shown.

mod common;
mod corpus;
mod exporting;
mod live;
mod merging;
#[path = "../../../tests/support/python.rs"]
mod python;
mod reading;
mod real_viewer;
mod recording;
