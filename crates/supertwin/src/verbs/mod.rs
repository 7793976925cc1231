//! One file per verb: its grammar, and what it prints.

pub(crate) mod check;
pub(crate) mod compare;
pub(crate) mod dashboard;
pub(crate) mod doctor;
pub(crate) mod echo;
pub(crate) mod export;
pub(crate) mod get;
pub(crate) mod hz;
pub(crate) mod list;
pub(crate) mod pki;
pub(crate) mod record;
pub(crate) mod repair;
pub(crate) mod replay;
pub(crate) mod run;
pub(crate) mod schema;
pub(crate) mod serve;
mod services;
pub(crate) mod set;
pub(crate) mod show;
pub(crate) mod sweep;
mod tables;
pub(crate) mod top;
pub(crate) mod up;
pub(crate) mod verify;
pub(crate) mod zenoh_config;
