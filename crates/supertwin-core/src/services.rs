//! The services of the ring.

/// The four services of the ring, in the order in which a lap runs through them.
pub const SERVICES: [&str; 4] = ["plant", "estimator", "guidance", "controller"];
