//! What configuration files may hold: JSON Schemas of the types that read them.

use crate::limits::Limits;
use crate::sweep;
use crate::trial::{
    ControllerConfig, EnvironmentConfig, EstimatorConfig, GuidanceConfig, SafetyConfig, SensorsConfig, TrialConfig,
    VehicleConfig,
};
use schemars::{Schema, schema_for};

/// Every kind of file: its folder in `config/`, the section of `--set` that replaces its values (sweeps and limits have
/// none), and what it may hold.
#[must_use]
pub fn all() -> Vec<(&'static str, Option<&'static str>, Schema)> {
    vec![
        ("trials", Some("trial"), schema_for!(TrialConfig)),
        ("vehicles", Some("vehicle"), schema_for!(VehicleConfig)),
        ("environments", Some("environment"), schema_for!(EnvironmentConfig)),
        ("sensors", Some("sensors"), schema_for!(SensorsConfig)),
        ("estimators", Some("estimator"), schema_for!(EstimatorConfig)),
        ("guidance", Some("guidance"), schema_for!(GuidanceConfig)),
        ("controllers", Some("controller"), schema_for!(ControllerConfig)),
        ("safety", Some("safety"), schema_for!(SafetyConfig)),
        ("sweeps", None, sweep::schema()),
        ("limits", None, schema_for!(Limits)),
    ]
}
