//! The brain: estimator, net plane, guidance, reference models, control laws, allocation.
//!
//! It knows messages and a nominal model, and nothing else: `supertwin-plant` can't be named from here.
//! Paper: "Adaptive Generalized Super-Twisting Tracking Control of an Underwater Vehicle"; the equation numbers in
//! this crate are the paper's, corrected where its print is wrong.
//!
//! Where guidance sends a vehicle that looks at a net in the north, from one metre too far away:
//!
//! ```
//! use supertwin_core::message::Direction;
//! use supertwin_gnc::los::{LineOfSight, PortSign};
//!
//! let law = LineOfSight { lookahead_m: 2.0, port_sign: PortSign::Corrected };
//! let (distance_m, desired_m, net_rad, heading_rad, speed_m_per_s) = (4.0, 3.0, 0.0, 0.0, 0.2);
//! let to = law.velocity(distance_m, desired_m, net_rad, heading_rad, speed_m_per_s, Direction::Starboard);
//! assert!(to.surge_m_per_s > 0.0); // nearer to the net
//! assert!(to.sway_m_per_s > 0.0); // along it, to starboard
//! ```
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
