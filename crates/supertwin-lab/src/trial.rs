//! Trials: from their files, or from what a recording keeps of them, with every rule checked.

use crate::config::{ConfigError, Library, Loaded, parse};
use crate::mission::Mission;
pub use crate::trial_config::*;
use crate::twin::Twin;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use supertwin_core::run::Properties;
use supertwin_core::{Property, Tick};

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

pub(crate) fn stem(path: &Path) -> String {
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
        let whole: Whole = parse(place, text)?;
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

    /// Builds the twin once and tries every command of the mission on it, so that nothing is refused half-way.
    fn check(&self) -> Result<(), ConfigError> {
        let mut twin = Twin::new(self, self.trial.seed)?;
        let mission = Mission::new(&self.trial.mission, self.trial.tick_s.get());
        for (k, command) in &mission.steps {
            let tick = Tick { k: *k, dt_s: self.trial.tick_s.get() };
            twin.command(tick, command).map_err(|refusal| ConfigError::Combination {
                path: self.path.display().to_string(),
                message: format!("mission at {:.2} s: {refusal}", tick.t_s()),
            })?;
        }
        Ok(())
    }
}

impl Library {
    /// # Errors
    /// When an override of a law's parameter concerns no controller of these trials.
    pub fn all_used(&self, trials: &[ResolvedTrial]) -> Result<(), ConfigError> {
        for over in self.overrides.iter().filter(|over| over.section == "controller") {
            let laws = || {
                trials.iter().flat_map(|trial| {
                    std::iter::once(&trial.controller).chain(trial.standby.iter().map(|(_, law)| law))
                })
            };
            let law_named = |config: &ControllerConfig| over.path.get(1).is_none_or(|law| law == config.law.name());
            if over.path[0] == "law" && !laws().any(law_named) {
                let mut known: Vec<&str> = laws().map(|config| config.law.name()).collect();
                known.dedup();
                let message = format!("no controller here has this law; there are {}", known.join(", "));
                return Err(ConfigError::Override { text: over.text.clone(), message });
            }
        }
        Ok(())
    }
}
