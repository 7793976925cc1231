//! What a trial is: which vehicle, sea, sensors, estimator, guidance, controllers, mission and seed.

use crate::mission::MissionStep;
use crate::paper::PaperColumn;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use supertwin_core::Tick;
use supertwin_core::check::{Fraction, NonNegative, Positive};
use supertwin_gnc::AllocationConfig;
use supertwin_gnc::control::{ControllerLimits, FallbackConfig};
use supertwin_gnc::estimator::EstimatorLimits;
pub use supertwin_gnc::{ControllerConfig, EstimatorConfig, GuidanceConfig};
use supertwin_model::{HydrodynamicsConfig, ThrusterConfig, Thrusters};
pub use supertwin_plant::{EnvironmentConfig, SensorsConfig};
use supertwin_plant::{PropulsionConfig, StartConfig, UnmodelledConfig};

/// A trial file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrialConfig {
    /// What it is and where its numbers come from.
    pub description: String,
    /// Case study of the paper that this trial repeats, if it does: shown beside its scores.
    pub paper_column: Option<PaperColumn>,
    /// File in `vehicles/`.
    pub vehicle: String,
    /// File in `environments/`.
    pub environment: String,
    /// File in `sensors/`.
    pub sensors: String,
    /// File in `estimators/`.
    pub estimator: String,
    /// File in `guidance/`.
    pub guidance: String,
    /// File in `safety/`.
    pub safety: String,
    /// Files in `controllers/`: one run for each.
    pub controllers: Vec<String>,
    /// Further laws that a command may hand over to.
    pub standby: Option<Vec<String>>,
    /// Seed of all random streams.
    pub seed: u64,
    /// Length of the run.
    pub duration_s: Positive,
    /// Length of a tick.
    pub tick_s: Positive,
    /// Runge-Kutta steps per tick.
    pub substeps: u32,
    /// Half-width of the uniform error of every nominal parameter, drawn per seed.
    pub nominal_spread: Fraction,
    /// Where the vehicle starts.
    pub start: StartConfig,
    /// What is scored.
    pub score: ScoreWindow,
    /// Commands in the order of their times, in simulated seconds.
    pub mission: Vec<MissionStep>,
}

impl TrialConfig {
    /// # Errors
    /// The first rule that its own numbers break.
    pub fn check(&self) -> Result<(), String> {
        if self.controllers.is_empty() {
            return Err("controllers = []: must name at least one controller".to_owned());
        }
        if !(1..=1000).contains(&self.substeps) {
            return Err(format!("substeps = {}: must be between 1 and 1000", self.substeps));
        }
        if self.tick_s.get() > 1.0 {
            return Err(format!("tick_s = {}: must be at most 1", self.tick_s.get()));
        }
        let (from_s, duration_s) = (self.score.from_s.get(), self.duration_s.get());
        if from_s >= duration_s {
            return Err(format!("score.from_s = {from_s}: must be less than duration_s = {duration_s}"));
        }
        Ok(())
    }
}

/// The part of a run that is scored.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScoreWindow {
    /// From here to the end.
    pub from_s: NonNegative,
}

/// A vehicle file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VehicleConfig {
    /// What it is and where its numbers come from.
    pub description: String,
    /// Length, breadth, height, for drawing.
    pub size_m: [Positive; 3],
    /// True parameters: the plant's.
    #[serde(rename = "true")]
    pub truth: HydrodynamicsConfig,
    /// Nominal parameters: the brain's.
    pub nominal: HydrodynamicsConfig,
    /// What no nominal model contains.
    pub unmodelled: UnmodelledConfig,
    /// When an axis counts as limited.
    pub allocation: AllocationConfig,
    /// Delay, time constant and dead band that all thrusters share.
    pub propulsion: PropulsionConfig,
    /// Position, direction and group of each thruster, in the order of the thrust signal.
    pub thruster: Vec<ThrusterConfig>,
}

impl VehicleConfig {
    /// # Errors
    /// When the thrusters can't make every wrench.
    pub fn check(&self) -> Result<(), String> {
        Thrusters::new(&self.thruster).map(drop).map_err(|error| error.to_string())
    }
}

/// A safety file: how old inputs may get, and what then.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SafetyConfig {
    /// What it is and where its numbers come from.
    pub description: String,
    /// The plant: a thrust command older than this means neutral.
    pub plant: PlantLimits,
    /// Greatest ages, in seconds, of the inputs that the estimator works with.
    pub estimator: EstimatorLimits,
    /// Greatest ages, in seconds, of the inputs that guidance works with.
    pub guidance: GuidanceLimits,
    /// Greatest ages, in seconds, of the inputs that the controller works with.
    pub controller: ControllerLimits,
    /// How the vehicle brakes when guidance is silent.
    pub fallback: FallbackConfig,
    /// People and programs in command.
    pub operator: OperatorLimits,
}

/// How long people and programs in command may be silent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OperatorLimits {
    /// Between two samples of a streaming set-point (a joystick): after this the vehicle holds depth and heading.
    pub setpoint_s: NonNegative,
}

/// Ages of the plant's inputs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlantLimits {
    /// Of the thrust command.
    pub thrust_s: NonNegative,
}

/// Ages of guidance's inputs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GuidanceLimits {
    /// Of navigation: the reference stops moving.
    pub nav_s: NonNegative,
}

/// Where the pieces of a trial came from.
#[derive(Clone, Debug)]
pub struct Places {
    /// The vehicle's file.
    pub vehicle: PathBuf,
    /// The controller's file.
    pub controller: PathBuf,
}

/// A trial with all its files read: one controller, ready to be built for any seed.
#[derive(Clone, Debug)]
pub struct ResolvedTrial {
    /// Name of the trial: the file's stem.
    pub name: String,
    /// The trial's file.
    pub path: PathBuf,
    /// The files of its pieces, for errors.
    pub places: Places,
    /// Section `trial`: duration, tick, seed, mission.
    pub trial: TrialConfig,
    /// Section `vehicle`: the true vehicle and the model that the controller knows.
    pub vehicle: VehicleConfig,
    /// Sea and pen.
    pub environment: EnvironmentConfig,
    /// Section `sensors`: rates, noise and constant errors of each sensor.
    pub sensors: SensorsConfig,
    /// Section `estimator`: Kalman filter, gates of its measurements, net plane.
    pub estimator: EstimatorConfig,
    /// Section `guidance`: line-of-sight law, reference models, limits of set-points.
    pub guidance: GuidanceConfig,
    /// Section `safety`: how long each block goes on with stale inputs.
    pub safety: SafetyConfig,
    /// Name of the controller of this run.
    pub controller_name: String,
    /// The controller of this run.
    pub controller: ControllerConfig,
    /// Laws to hand over to.
    pub standby: Vec<(String, ControllerConfig)>,
    /// Everything as one TOML text, overrides applied: what a recording keeps.
    pub text: String,
}

impl ResolvedTrial {
    /// Number of ticks of a run.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        Tick::at_or_after(self.trial.duration_s.get(), self.trial.tick_s.get())
    }

    /// First tick that is scored.
    #[must_use]
    pub fn score_from_tick(&self) -> u64 {
        Tick::at_or_after(self.trial.score.from_s.get(), self.trial.tick_s.get())
    }
}
