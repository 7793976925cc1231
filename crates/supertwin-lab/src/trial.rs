//! Trials: which vehicle, sea, sensors, estimator, guidance, controllers, mission and seed; and how they become a twin.

use crate::config::{ConfigError, Library, Loaded};
use crate::mission::MissionStep;
use crate::paper::PaperColumn;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use supertwin_core::Property;
use supertwin_core::check::{Fraction, NonNegative, Positive};
use supertwin_core::run::Properties;
use supertwin_gnc::AllocationConfig;
use supertwin_gnc::control::{ControllerLimits, FallbackConfig};
use supertwin_gnc::estimator::EstimatorLimits;
pub use supertwin_gnc::{ControllerConfig, EstimatorConfig, GuidanceConfig};
use supertwin_model::{HydrodynamicsConfig, ThrusterConfig, Thrusters};
pub use supertwin_plant::{EnvironmentConfig, SensorsConfig};
use supertwin_plant::{PropulsionConfig, StartConfig, UnmodelledConfig};

/// A trial file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    /// Timed commands.
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
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScoreWindow {
    /// From here to the end.
    pub from_s: NonNegative,
}

/// A vehicle file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    /// Thruster dynamics.
    pub propulsion: PropulsionConfig,
    /// The thrusters.
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SafetyConfig {
    /// What it is and where its numbers come from.
    pub description: String,
    /// The plant: a thrust command older than this means neutral.
    pub plant: PlantLimits,
    /// The estimator.
    pub estimator: EstimatorLimits,
    /// Guidance.
    pub guidance: GuidanceLimits,
    /// The controller.
    pub controller: ControllerLimits,
    /// How the vehicle brakes when guidance is silent.
    pub fallback: FallbackConfig,
    /// People and programs in command.
    pub operator: OperatorLimits,
}

/// How long people and programs in command may be silent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OperatorLimits {
    /// Between two samples of a streaming set-point (a joystick): after this the vehicle holds depth and heading.
    pub setpoint_s: NonNegative,
}

/// Ages of the plant's inputs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantLimits {
    /// Of the thrust command.
    pub thrust_s: NonNegative,
}

/// Ages of guidance's inputs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
    /// The trial.
    pub trial: TrialConfig,
    /// The vehicle.
    pub vehicle: VehicleConfig,
    /// Sea and pen.
    pub environment: EnvironmentConfig,
    /// Sensors.
    pub sensors: SensorsConfig,
    /// Estimator.
    pub estimator: EstimatorConfig,
    /// Guidance.
    pub guidance: GuidanceConfig,
    /// Stale inputs.
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

/// Reads a trial: one resolved trial per controller.
///
/// # Errors
/// The first thing that is wrong, with its place.
pub fn load(library: &Library, name: &str) -> Result<Vec<ResolvedTrial>, ConfigError> {
    let trial: Loaded<TrialConfig> = library.load("trial", "trials", name)?;
    let config = &trial.value;
    fits(&trial.path, config.check())?;
    let vehicle: Loaded<VehicleConfig> = library.load("vehicle", "vehicles", &config.vehicle)?;
    let environment: Loaded<EnvironmentConfig> = library.load("environment", "environments", &config.environment)?;
    let sensors: Loaded<SensorsConfig> = library.load("sensors", "sensors", &config.sensors)?;
    let estimator: Loaded<EstimatorConfig> = library.load("estimator", "estimators", &config.estimator)?;
    let guidance: Loaded<GuidanceConfig> = library.load("guidance", "guidance", &config.guidance)?;
    let safety: Loaded<SafetyConfig> = library.load("safety", "safety", &config.safety)?;
    fits(&vehicle.path, vehicle.value.check())?;
    fits(&environment.path, environment.value.check())?;
    fits(&sensors.path, sensors.value.check())?;
    fits(&guidance.path, guidance.value.check())?;
    fits(&trial.path, config.start.check(environment.value.cage.radius_m.get()))?;
    let mut standby = Vec::new();
    let mut standby_tables = toml::Table::new();
    for name in config.standby.iter().flatten() {
        let law: Loaded<ControllerConfig> = library.load("controller", "controllers", name)?;
        standby_tables.insert(stem(&law.path), toml::Value::Table(law.table));
        standby.push((stem(&law.path), law.value));
    }
    let mut resolved = Vec::with_capacity(config.controllers.len());
    for name in &config.controllers {
        let controller: Loaded<ControllerConfig> = library.load("controller", "controllers", name)?;
        fits(&controller.path, controller.value.law.check())?;
        let mut text = toml::Table::new();
        for (section, table) in [
            ("trial", &trial.table),
            ("vehicle", &vehicle.table),
            ("environment", &environment.table),
            ("sensors", &sensors.table),
            ("estimator", &estimator.table),
            ("guidance", &guidance.table),
            ("safety", &safety.table),
            ("controller", &controller.table),
        ] {
            text.insert(section.to_owned(), toml::Value::Table(table.clone()));
        }
        if !standby_tables.is_empty() {
            text.insert("standby".to_owned(), toml::Value::Table(standby_tables.clone()));
        }
        let one = ResolvedTrial {
            name: stem(&trial.path),
            path: trial.path.clone(),
            places: Places { vehicle: vehicle.path.clone(), controller: controller.path.clone() },
            trial: config.clone(),
            vehicle: vehicle.value.clone(),
            environment: environment.value.clone(),
            sensors: sensors.value.clone(),
            estimator: estimator.value.clone(),
            guidance: guidance.value.clone(),
            safety: safety.value.clone(),
            controller_name: stem(&controller.path),
            controller: controller.value,
            standby: standby.clone(),
            text: text.to_string(),
        };
        one.check()?;
        resolved.push(one);
    }
    Ok(resolved)
}

/// Puts the file's name to a rule that its pieces break together.
///
/// # Errors
/// The broken rule.
pub fn fits(path: &Path, checked: Result<(), String>) -> Result<(), ConfigError> {
    checked.map_err(|message| ConfigError::Combination { path: path.display().to_string(), message })
}

fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(|| "unnamed".to_owned(), |stem| stem.to_string_lossy().into_owned())
}

/// [`ResolvedTrial::text`] read again.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Whole {
    trial: TrialConfig,
    vehicle: VehicleConfig,
    environment: EnvironmentConfig,
    sensors: SensorsConfig,
    estimator: EstimatorConfig,
    guidance: GuidanceConfig,
    safety: SafetyConfig,
    controller: ControllerConfig,
    /// In the order of the text.
    standby: Option<toml::Table>,
}

impl ResolvedTrial {
    /// The trial that a recording keeps in its properties: the same run again, with the property `seed`.
    ///
    /// # Errors
    /// Names `place`, the line and the rule, or the property that is missing.
    pub fn from_properties(run: &Properties, place: &str) -> Result<Self, ConfigError> {
        let text = |name: &str| match run.get(name) {
            Some(Property::Text(text)) => Ok(text.as_str()),
            Some(other) => Err(format!("property {name} = {other:?}: must be a text")),
            None => Err(format!("property {name} is not there: the run can't be repeated without")),
        };
        let text =
            |name: &str| text(name).map_err(|message| ConfigError::Combination { path: place.to_owned(), message });
        Self::from_text(text("trial")?, text("controller")?, text("config")?, place)
    }

    /// A trial from its [`Self::text`].
    ///
    /// # Errors
    /// Names `place`, line, column, path, value and rule.
    pub fn from_text(name: &str, controller_name: &str, text: &str, place: &str) -> Result<Self, ConfigError> {
        let whole: Whole = crate::config::parse(place, text)?;
        let path = PathBuf::from(place);
        let mut standby = Vec::new();
        for (name, table) in whole.standby.into_iter().flatten() {
            let config = table.try_into().map_err(|error: toml::de::Error| ConfigError::Combination {
                path: place.to_owned(),
                message: format!("standby.{name}: {}", error.message()),
            })?;
            standby.push((name, config));
        }
        fits(&path, whole.trial.check())?;
        fits(&path, whole.vehicle.check())?;
        fits(&path, whole.environment.check())?;
        fits(&path, whole.sensors.check())?;
        fits(&path, whole.guidance.check())?;
        fits(&path, whole.trial.start.check(whole.environment.cage.radius_m.get()))?;
        fits(&path, whole.controller.law.check())?;
        let trial = Self {
            name: name.to_owned(),
            places: Places { vehicle: path.clone(), controller: path.clone() },
            path,
            trial: whole.trial,
            vehicle: whole.vehicle,
            environment: whole.environment,
            sensors: whole.sensors,
            estimator: whole.estimator,
            guidance: whole.guidance,
            safety: whole.safety,
            controller_name: controller_name.to_owned(),
            controller: whole.controller,
            standby,
            text: text.to_owned(),
        };
        trial.check()?;
        Ok(trial)
    }

    /// Number of ticks of a run.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        supertwin_core::Tick::at_or_after(self.trial.duration_s.get(), self.trial.tick_s.get())
    }

    /// First tick that is scored.
    #[must_use]
    pub fn score_from_tick(&self) -> u64 {
        supertwin_core::Tick::at_or_after(self.trial.score.from_s.get(), self.trial.tick_s.get())
    }

    /// Builds the twin once and tries every command of the mission on it, so that nothing is refused half-way.
    fn check(&self) -> Result<(), ConfigError> {
        let mut twin = crate::Twin::new(self, self.trial.seed)?;
        let mission = crate::mission::Mission::new(&self.trial.mission, self.trial.tick_s.get());
        for (k, command) in mission.steps() {
            let tick = supertwin_core::Tick { k: *k, dt_s: self.trial.tick_s.get() };
            twin.command(tick, command).map_err(|refusal| ConfigError::Combination {
                path: self.path.display().to_string(),
                message: format!("mission at {:.2} s: {refusal}", tick.t_s()),
            })?;
        }
        Ok(())
    }
}
