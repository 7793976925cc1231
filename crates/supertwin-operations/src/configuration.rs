//! What configuration files say, as it was understood.

use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use supertwin_lab::config::Loaded;
use supertwin_lab::limits::Limits;
use supertwin_lab::sweep::Sweep;
use supertwin_lab::trial::{
    self, ControllerConfig, EnvironmentConfig, EstimatorConfig, GuidanceConfig, SafetyConfig, SensorsConfig,
    VehicleConfig,
};
use supertwin_lab::{ConfigError, Library};
use toml::Table;

/// Folders of the library, and the section each holds.
const FOLDERS: &[(&str, &str)] = &[
    ("trials", "trial"),
    ("sweeps", "sweep"),
    ("vehicles", "vehicle"),
    ("environments", "environment"),
    ("sensors", "sensors"),
    ("estimators", "estimator"),
    ("guidance", "guidance"),
    ("safety", "safety"),
    ("controllers", "controller"),
    ("limits", "limits"),
];

/// All configuration files of the library.
#[must_use]
pub fn all(library: &Library) -> Vec<PathBuf> {
    FOLDERS
        .iter()
        .flat_map(|(folder, _)| library.names(folder).into_iter().map(|name| library.path(folder, &name)))
        .collect()
}

/// Reads a file as what its folder says it is; a trial with everything it names.
///
/// # Errors
/// It can't be read, or a value is wrong; file, path, value and rule are named.
pub fn understand(file: &Path, library: &Library) -> Result<Table, ConfigError> {
    let name = file.display().to_string();
    // A bare word is a trial, as for `run`.
    let bare = !name.contains(std::path::MAIN_SEPARATOR) && !name.ends_with(".toml");
    let name = if bare || name.contains(std::path::MAIN_SEPARATOR) { name } else { format!("./{name}") };
    let folder = std::path::absolute(file)
        .ok()
        .and_then(|path| Some(path.parent()?.file_name()?.to_string_lossy().into_owned()))
        .unwrap_or_default();
    let section = FOLDERS.iter().find(|(known, _)| *known == folder).map_or("trial", |(_, section)| section);
    Ok(match section {
        _ if bare => whole_trial(library, &name)?,
        "sweep" => {
            let sweep = Sweep::load(library, &name)?;
            sweep.check(library)?;
            supertwin_lab::config::parse(&name, &sweep.text)?
        }
        "vehicle" => table(library, section, &name, VehicleConfig::check)?,
        "environment" => table(library, section, &name, EnvironmentConfig::check)?,
        "sensors" => table(library, section, &name, SensorsConfig::check)?,
        "estimator" => table(library, section, &name, |_: &EstimatorConfig| Ok(()))?,
        "guidance" => table(library, section, &name, GuidanceConfig::check)?,
        "safety" => table(library, section, &name, |_: &SafetyConfig| Ok(()))?,
        "controller" => table(library, section, &name, |config: &ControllerConfig| config.law.check())?,
        "limits" => table(library, section, &name, Limits::check)?,
        _ => whole_trial(library, &name)?,
    })
}

fn whole_trial(library: &Library, name: &str) -> Result<Table, ConfigError> {
    let mut whole = Table::new();
    for one in trial::load(library, name)? {
        let table: Table = supertwin_lab::config::parse(name, &one.text)?;
        for (key, value) in table {
            let key = if key == "controller" { format!("controller {}", one.controller_name) } else { key };
            whole.insert(key, value);
        }
    }
    Ok(whole)
}

fn table<T: DeserializeOwned>(
    library: &Library,
    section: &str,
    name: &str,
    check: impl Fn(&T) -> Result<(), String>,
) -> Result<Table, ConfigError> {
    let loaded: Loaded<T> = library.load(section, "", name)?;
    trial::fits(&loaded.path, check(&loaded.value))?;
    Ok(loaded.table)
}
