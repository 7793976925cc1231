//! What a user meets, as one program: each module is a subject, and all processes of a test are its own.

mod access;
mod cli;
mod clients;
mod compare;
mod dashboards;
mod deadlines;
mod documents;
mod locked;
mod network;
mod pki;
mod recorder;
mod recordings;
mod renewal;
mod replay;
mod schema;
mod shadow;
mod support;
mod sweep;
mod tools;
