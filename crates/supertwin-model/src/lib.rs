//! Fossen's equation of motion in four degrees of freedom, as pure functions of validated parameters.
//!
//! ```text
//! eta' = J(psi) nu,   M nu' + C(nu) nu + D(nu) nu + g = tau + w
//! ```
//!
//! `eta = [north, east, depth, psi]`, `nu = [u, v, w, r]`, `tau = [X, Y, Z, N]`; paper eq. (1)-(3), after
//! T. I. Fossen, *Handbook of Marine Craft Hydrodynamics and Motion Control*, 2nd ed., Wiley 2021.
//! Plant and brain use these same functions with different numbers.
//!
//! ```
//! use nalgebra::Vector4;
//! use supertwin_model::Hydrodynamics;
//!
//! // Unit inertia, no damping: one newton in surge is one metre per second squared.
//! let vehicle = Hydrodynamics::unit();
//! let still = Vector4::zeros();
//! assert_eq!(vehicle.acceleration(&still, &Vector4::new(1.0, 0.0, 0.0, 0.0))[0], 1.0);
//! // Coriolis and centripetal forces do no work.
//! let nu = Vector4::new(0.5, 0.25, 0.125, 2.0);
//! assert_eq!(nu.dot(&vehicle.coriolis(&nu)), 0.0);
//! ```
#![allow(non_snake_case, reason = "matrices are capitals, as in the book")]

pub mod hydrodynamics;
pub mod sonar;
pub mod thrusters;

pub use hydrodynamics::{Hydrodynamics, HydrodynamicsConfig};
pub use sonar::SonarArray;
pub use thrusters::{Group, ThrusterConfig, Thrusters};
