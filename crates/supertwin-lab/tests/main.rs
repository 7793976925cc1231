//! Whole runs: what they are scored, compared, replayed and refused by.

#[cfg(feature = "another-law")]
mod another_law;
mod bad_input;
mod common;
mod compare;
mod corpus;
mod field_trials;
#[cfg(not(feature = "another-law"))]
#[path = "../../../tests/support/page.rs"]
mod page;
#[cfg(not(feature = "another-law"))]
mod reference;
mod replay;
mod rescore;
mod safety;
mod sweep;
