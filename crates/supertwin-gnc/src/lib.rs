//! The brain: estimator, net plane, guidance, reference models, control laws, allocation.
//!
//! It knows messages and a nominal model, and nothing else: `supertwin-plant` can't be named from here.
//! Paper: "Adaptive Generalized Super-Twisting Tracking Control of an Underwater Vehicle"; the equation numbers in
//! this crate are the paper's, corrected where its print is wrong.
#![allow(non_snake_case, reason = "matrices are capitals, as in the book")]

pub mod allocation;
pub mod control;
pub mod ekf;
pub mod estimator;
pub mod guidance;
pub mod los;
pub mod net_plane;
pub mod reference_model;

pub use allocation::{Allocation, AllocationConfig};
pub use control::{Controller, ControllerConfig, ControllerInput, LawConfig};
pub use estimator::{Estimator, EstimatorConfig, EstimatorInput};
pub use guidance::{Guidance, GuidanceConfig, GuidanceInput};
