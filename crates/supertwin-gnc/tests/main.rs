//! Estimator, guidance, laws and allocation, each against the equations and the real configuration files.

mod allocation;
mod assumptions;
mod common;
mod controller;
mod estimator;
mod guidance;
mod laws;
mod super_twisting;
