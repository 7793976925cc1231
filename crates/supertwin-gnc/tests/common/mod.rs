//! What the tests of the brain share: the real configuration files and small builders.
#![allow(dead_code, reason = "every test file uses its own part of it")]

use nalgebra::Vector4;
use serde::de::DeserializeOwned;
use supertwin_core::Tick;
use supertwin_gnc::control::{Law, LawInput, TrackingError};
use supertwin_gnc::{ControllerConfig, EstimatorConfig, GuidanceConfig, LawConfig};
use supertwin_model::{Hydrodynamics, HydrodynamicsConfig, ThrusterConfig, Thrusters};

/// The twin's tick.
pub(crate) const H_S: f64 = 0.02;

/// A file under `config/`.
pub(crate) fn file(path: &str) -> toml::Table {
    let path = format!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/{}.toml"), path);
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    text.parse().unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// A file under `config/` as the type it holds.
pub(crate) fn parse<T: DeserializeOwned>(path: &str) -> T {
    file(path).try_into().unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The nominal model of the Argus-Mini class.
pub(crate) fn nominal() -> Hydrodynamics {
    let config: HydrodynamicsConfig = file("vehicles/argus-mini")["nominal"].clone().try_into().expect("a model");
    Hydrodynamics::from(&config)
}

/// Its thrusters.
pub(crate) fn thrusters() -> Thrusters {
    let configs: Vec<ThrusterConfig> =
        file("vehicles/argus-mini")["thruster"].clone().try_into().expect("a list of thrusters");
    Thrusters::new(&configs).expect("fully actuated")
}

/// The law of a controller file.
pub(crate) fn law_config(name: &str) -> LawConfig {
    parse::<ControllerConfig>(&format!("controllers/{name}")).law
}

/// A law of a controller file on the nominal model.
pub(crate) fn law(name: &str) -> Law {
    law_config(name).build(&nominal()).expect("a legal law")
}

/// A controller file with one more line, such as `law.agsta.adaptation.leak_per_s = 0.1`.
pub(crate) fn law_config_with(name: &str, path: &[&str], value: impl Into<toml::Value>) -> LawConfig {
    let mut table = file(&format!("controllers/{name}"));
    let (last, parents) = path.split_last().expect("a path");
    let mut place = &mut table;
    for part in parents {
        place = place.get_mut(*part).and_then(toml::Value::as_table_mut).expect("a table on the way");
    }
    place.insert((*last).to_owned(), value.into());
    table.try_into::<ControllerConfig>().expect("still legal").law
}

/// Four axes as they stand in a file.
pub(crate) fn axes(values: [f64; 4]) -> toml::Table {
    ["surge", "sway", "heave", "yaw"].into_iter().map(str::to_owned).zip(values.map(toml::Value::Float)).collect()
}

/// An estimator file.
pub(crate) fn estimator_config(name: &str) -> EstimatorConfig {
    parse(&format!("estimators/{name}"))
}

/// A guidance file.
pub(crate) fn guidance_config(name: &str) -> GuidanceConfig {
    parse(&format!("guidance/{name}"))
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
    file("vehicles/argus-mini")["allocation"].clone().try_into().expect("a tolerance")
}
