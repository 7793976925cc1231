//! What the tests of the brain share: the real configuration files and small builders.
#![allow(dead_code, reason = "every test file uses its own part of it")]

#[path = "../../../../tests/support/config.rs"]
pub(crate) mod config;

pub(crate) use config::{file, put, read};
use nalgebra::Vector4;
use supertwin_core::Tick;
use supertwin_gnc::control::{Law, LawInput, TrackingError};
use supertwin_gnc::{ControllerConfig, EstimatorConfig, GuidanceConfig, LawConfig};
use supertwin_model::{Hydrodynamics, HydrodynamicsConfig, ThrusterConfig, Thrusters};

/// The twin's tick.
pub(crate) const H_S: f64 = 0.02;

/// The nominal model of the Argus-Mini class.
pub(crate) fn nominal() -> Hydrodynamics {
    let config: HydrodynamicsConfig = read(file("vehicles/argus-mini")["nominal"].clone());
    Hydrodynamics::from(&config)
}

/// Its thrusters.
pub(crate) fn thrusters() -> Thrusters {
    let configs: Vec<ThrusterConfig> = read(file("vehicles/argus-mini")["thruster"].clone());
    Thrusters::new(&configs).expect("fully actuated")
}

/// The law of a controller file.
pub(crate) fn law_config(name: &str) -> LawConfig {
    read::<ControllerConfig>(file(&format!("controllers/{name}"))).law
}

/// A law of a controller file on the nominal model.
pub(crate) fn law(name: &str) -> Law {
    law_config(name).build(&nominal()).expect("a legal law")
}

/// The same with one of its values changed, such as `adaptation.k1_cap` of `agsta`.
pub(crate) fn law_with(name: &str, path: &'static str, value: impl Into<toml::Value>) -> Law {
    law_config_with(name, [(path, value)]).build(&nominal()).expect("legal")
}

/// A controller file with some values of its law changed.
pub(crate) fn law_config_with<V: Into<toml::Value>>(
    name: &str,
    changes: impl IntoIterator<Item = (&'static str, V)>,
) -> LawConfig {
    let mut table = file(&format!("controllers/{name}"));
    let kind = table["law"].as_table().and_then(|law| law.keys().next()).expect("a kind of law").clone();
    for (path, value) in changes {
        put(&mut table, &format!("law.{kind}.{path}"), value);
    }
    read::<ControllerConfig>(table).law
}

/// Four axes as they stand in a file.
pub(crate) fn axes(values: [f64; 4]) -> toml::Table {
    ["surge", "sway", "heave", "yaw"].into_iter().map(str::to_owned).zip(values.map(toml::Value::Float)).collect()
}

/// An estimator file.
pub(crate) fn estimator_config(name: &str) -> EstimatorConfig {
    read(file(&format!("estimators/{name}")))
}

/// A guidance file.
pub(crate) fn guidance_config(name: &str) -> GuidanceConfig {
    read(file(&format!("guidance/{name}")))
}

/// Tick `k` of the twin's clock.
pub(crate) fn tick(k: u64) -> Tick {
    Tick { k, dt_s: H_S }
}

/// Tracking errors from `x1` and velocity errors; surge and sway of `x1` are velocities themselves.
pub(crate) fn errors(x1: [f64; 4], heave_rate: f64, yaw_rate: f64) -> TrackingError {
    TrackingError {
        x1: Vector4::from(x1),
        velocity: Vector4::new(x1[0], x1[1], heave_rate, yaw_rate),
        model_acceleration: Vector4::zeros(),
    }
}

/// What a law is given when nothing is limited and nobody asks for a wrench.
pub(crate) fn input(error: &TrackingError) -> LawInput<'_> {
    LawInput { h_s: H_S, error, limited: [false; 4], request: None }
}

/// The Argus-Mini class's tolerance of allocation.
pub(crate) fn tolerance() -> supertwin_gnc::AllocationConfig {
    read(file("vehicles/argus-mini")["allocation"].clone())
}
