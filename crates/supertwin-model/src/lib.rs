//! Fossen's equation of motion in four degrees of freedom, as pure functions of validated parameters.
//!
//! ```text
//! eta' = J(psi) nu,   M nu' + C(nu) nu + D(nu) nu + g = tau + w
//! ```
//!
//! `eta = [north, east, depth, psi]`, `nu = [u, v, w, r]`, `tau = [X, Y, Z, N]`; paper eq. (1)-(3), after
//! T. I. Fossen, *Handbook of Marine Craft Hydrodynamics and Motion Control*, 2nd ed., Wiley 2021.
//! Plant and brain use these same functions with different numbers.
#![allow(non_snake_case, reason = "matrices are capitals, as in the book")]

pub mod hydrodynamics;
pub mod sonar;
pub mod thrusters;

pub use hydrodynamics::{Hydrodynamics, HydrodynamicsConfig};
pub use sonar::SonarArray;
pub use thrusters::{Group, ThrusterConfig, Thrusters};
