//! The access matrix on Zenoh: a router's rules and limits, the files of all roles, and trials of what is let through.

mod file;
mod limits;
pub mod probe;
mod prove;
mod rules;

pub use file::{client_file, router_file};
pub use prove::{Attempt, prove};
pub use rules::{current_hash, hash, router_rules};
