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

/// Reads the file of a name, and checks it.
type Read = fn(&Library, &str) -> Result<Table, ConfigError>;

/// Folders of the library, and how their files are read.
const FOLDERS: [(&str, Read); 10] = [
    ("trials", whole_trial),
    ("sweeps", whole_sweep),
    ("vehicles", |library, name| table(library, "vehicle", name, VehicleConfig::check)),
    ("environments", |library, name| table(library, "environment", name, EnvironmentConfig::check)),
    ("sensors", |library, name| table(library, "sensors", name, SensorsConfig::check)),
    ("estimators", |library, name| table(library, "estimator", name, |_: &EstimatorConfig| Ok(()))),
    ("guidance", |library, name| table(library, "guidance", name, GuidanceConfig::check)),
    ("safety", |library, name| table(library, "safety", name, |_: &SafetyConfig| Ok(()))),
    ("controllers", |library, name| table(library, "controller", name, |config: &ControllerConfig| config.law.check())),
    ("limits", |library, name| table(library, "limits", name, Limits::check)),
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
    let read = FOLDERS.into_iter().find(|(known, _)| *known == folder && !bare);
    read.map_or(whole_trial as Read, |(_, read)| read)(library, &name)
}

fn whole_sweep(library: &Library, name: &str) -> Result<Table, ConfigError> {
    let sweep = Sweep::load(library, name)?;
    sweep.check(library)?;
    supertwin_lab::config::parse(name, &sweep.text)
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
