//! The truth: the vehicle in current, waves, tether and net cage, its thrusters, its sensors and their faults.
//!
//! ```text
//! nu' = M⁻¹ (tau − C(nu_r) nu_r − D(nu_r) nu_r − g + tau_d) + d/dt nu_f,   nu_r = nu − nu_f
//! ```
//!
//! `nu_f` is the velocity of the water in body axes (Fossen 2021, ch. 10). The vehicle is taken as neutrally buoyant
//! in this respect, so that Froude-Krylov and added-mass wave forces together are `M d/dt nu_f`.
//! Nothing in `supertwin-gnc` can name this crate: no estimator and no controller can read the truth.
//!
//! The whole [`Plant`] is built from files, by `supertwin-lab`. A part of it by itself, the spectrum of the waves:
//!
//! ```
//! use supertwin_plant::waves::jonswap_shape;
//!
//! // At its peak a young sea (γ = 3.3) has 3.3 times the energy of a fully grown one (γ = 1).
//! let ratio = jonswap_shape(1.0, 3.3) / jonswap_shape(1.0, 1.0);
//! assert!((ratio - 3.3).abs() < 1e-12);
//! ```
#![allow(non_snake_case, reason = "matrices are capitals, as in the book")]

pub mod cage;
pub mod current;
pub mod environment;
pub mod plant;
pub mod propulsion;
pub mod sensors;
pub mod shadow;
pub mod waves;

pub use environment::EnvironmentConfig;
pub use plant::{Drive, Plant, PlantConfig, PlantInput, StartConfig, UnmodelledConfig};
pub use propulsion::PropulsionConfig;
pub use sensors::SensorsConfig;
pub use shadow::{Shadow, ShadowInput, ShadowMeasurements, ShadowTruth};
