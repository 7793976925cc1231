//! Configuration files: found by name, read with overrides, refused with file, line, path, value and rule.

use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Configuration that can't be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// A file that is not there or can't be read.
    #[error("{path}: {cause}")]
    Unreadable {
        /// Path of the file as it was given.
        path: String,
        /// What the system or the parser reported.
        cause: String,
    },
    /// A place in a file that breaks a rule.
    #[error("{path}:{line}:{column}: {message}")]
    Place {
        /// Path of the file as it was given.
        path: String,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// Path of the value, the value and the rule.
        message: String,
    },
    /// An override that breaks a rule.
    #[error("--set {text}: {message}")]
    Override {
        /// The text of `--set`, as it was given.
        text: String,
        /// Rule that the text breaks.
        message: String,
    },
    /// Pieces that are legal alone and do not fit together.
    #[error("{path}: {message}")]
    Combination {
        /// The trial's file.
        path: String,
        /// The value and the rule.
        message: String,
    },
}

/// `--set section.path=value`: replaces one value of one file of a trial.
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    /// The text of `--set`, as it was given.
    pub text: String,
    /// The file: one of [`SECTIONS`].
    pub(crate) section: String,
    /// Names from the outside in, below the section.
    pub(crate) path: Vec<String>,
    value: Value,
    /// The value is a factor: what the file says is multiplied by it.
    times: bool,
}

/// The files a trial is made of; the first word of an override.
pub const SECTIONS: [&str; 8] =
    ["trial", "vehicle", "environment", "sensors", "estimator", "guidance", "safety", "controller"];

impl std::str::FromStr for Override {
    type Err = ConfigError;

    /// The value is TOML; what is not, is text.
    fn from_str(text: &str) -> Result<Self, ConfigError> {
        let error = |message: String| ConfigError::Override { text: text.to_owned(), message };
        let (path, value) =
            text.split_once('=').ok_or_else(|| error("must be written as section.path=value".to_owned()))?;
        let (section, path) = split(path.trim()).map_err(error)?;
        let value = value.trim();
        let value = format!("value = {value}")
            .parse::<Table>()
            .ok()
            .and_then(|mut table| table.remove("value"))
            .unwrap_or_else(|| Value::String(value.to_owned()));
        Ok(Self { text: text.to_owned(), section, path, value, times: false })
    }
}

/// Section, and path inside it.
fn split(path: &str) -> Result<(String, Vec<String>), String> {
    let mut path = path.split('.').map(str::to_owned);
    let section = path.next().unwrap_or_default();
    let path: Vec<String> = path.collect();
    if !SECTIONS.contains(&section.as_str()) {
        return Err(format!(
            "section `{section}`: must be one of {}{}",
            SECTIONS.join(", "),
            suggestion(&section, SECTIONS.iter().copied())
        ));
    }
    if path.is_empty() || path.iter().any(String::is_empty) {
        return Err("must name a value inside the section, such as trial.seed=2".to_owned());
    }
    Ok((section, path))
}

impl Override {
    /// `path` with another value; with `times` the value is a factor of what the file says.
    ///
    /// # Errors
    /// When the path names no value of a section.
    pub fn new(path: &str, value: Value, times: bool) -> Result<Self, String> {
        let text = format!("{path}{}={value}", if times { "*" } else { "" });
        let (section, path) = split(path)?;
        Ok(Self { text, section, path, value, times })
    }

    /// Path of the value that is replaced: section, then keys, joined by dots.
    #[must_use]
    pub fn location(&self) -> String {
        format!("{}.{}", self.section, self.path.join("."))
    }

    /// The law whose files alone have a place for it; `None` when any controller may.
    #[must_use]
    pub fn law(&self) -> Option<&str> {
        let of_law = self.section == "controller" && self.path.len() > 1 && self.path[0] == "law";
        of_law.then(|| self.path[1].as_str())
    }

    /// The value in place of `old`.
    fn put(&self, old: Option<&Value>) -> Result<Value, String> {
        if !self.times {
            return Ok(self.value.clone());
        }
        let number = |value: &Value| value.as_float().or_else(|| value.as_integer().map(|n| n as f64));
        match (old.and_then(number), number(&self.value)) {
            (Some(old), Some(factor)) => Ok(Value::Float(old * factor)),
            _ => Err("only a number can be multiplied, and there is none".to_owned()),
        }
    }

    /// Whether this override has a place in a file: one of a law's parameters has it in the files of that law only, so
    /// that a trial with several controllers can be overridden law by law.
    pub(crate) fn concerns(&self, table: &Table) -> bool {
        let Some(named) = self.law() else { return true };
        table.get("law").and_then(Value::as_table).is_none_or(|law| law.contains_key(named))
    }

    /// Puts the value in its place.
    pub(crate) fn apply(&self, table: &mut Table) -> Result<(), ConfigError> {
        let error = |message: String| ConfigError::Override { text: self.text.clone(), message };
        let (last, parents) = self.path.split_last().ok_or_else(|| error("must name a value".to_owned()))?;
        let mut here = Value::Table(std::mem::take(table));
        let mut cursor = &mut here;
        for (depth, key) in parents.iter().enumerate() {
            cursor = child(cursor, key, &self.path[..depth]).map_err(error)?;
        }
        if let Value::Table(table) = cursor {
            let value = self.put(table.get(last)).map_err(error)?;
            table.insert(last.clone(), value);
        } else {
            let slot = child(cursor, last, parents).map_err(error)?;
            *slot = self.put(Some(slot)).map_err(error)?;
        }
        if let Value::Table(done) = here {
            *table = done;
        }
        Ok(())
    }
}

/// What stands at `key` in the value at `path`.
fn child<'a>(value: &'a mut Value, key: &str, path: &[String]) -> Result<&'a mut Value, String> {
    match value {
        Value::Table(table) => {
            let known: Vec<String> = table.keys().cloned().collect();
            let hint = suggestion(key, known.iter().map(String::as_str));
            let place: Vec<&str> = path.iter().map(String::as_str).chain([key]).collect();
            table.get_mut(key).ok_or_else(|| format!("`{}` is not there{hint}", place.join(".")))
        }
        Value::Array(array) => {
            let count = array.len();
            let slot = key.parse::<usize>().ok().and_then(|i| array.get_mut(i));
            slot.ok_or_else(|| format!("`{key}`: must be an index below {count}"))
        }
        _ => Err(format!("`{}` is a value, not a table", path.join("."))),
    }
}

/// `; did you mean …?` when something known is close enough.
pub(crate) fn suggestion<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> String {
    known
        .map(|candidate| (strsim::damerau_levenshtein(word, candidate), candidate))
        .min()
        .filter(|(distance, candidate)| *distance <= 1 + candidate.len() / 4)
        .map_or_else(String::new, |(_, candidate)| format!("; did you mean `{candidate}`?"))
}

/// A folder of configuration files, and the overrides of this call.
#[derive(Clone, Debug)]
pub struct Library {
    /// Folder that the configuration files are below.
    pub root: PathBuf,
    /// The overrides of this call.
    pub overrides: Vec<Override>,
}

/// A file as it was understood.
#[derive(Clone, Debug)]
pub struct Loaded<T> {
    /// The legal value.
    pub value: T,
    /// The same as a table, with the overrides applied: for recordings.
    pub table: Table,
    /// Where it came from.
    pub path: PathBuf,
}

impl Library {
    /// The folder with `trials/`, `vehicles/` and so on.
    #[must_use]
    pub fn new(root: impl Into<PathBuf>, overrides: Vec<Override>) -> Self {
        Self { root: root.into(), overrides }
    }

    /// The same folder with further overrides, which come last.
    #[must_use]
    pub fn with(&self, overrides: impl IntoIterator<Item = Override>) -> Self {
        let overrides = self.overrides.iter().cloned().chain(overrides).collect();
        Self { root: self.root.clone(), overrides }
    }

    /// Path of `name` in `folder`: a name stands for `<root>/<folder>/<name>.toml`, a path for itself.
    #[must_use]
    pub fn path(&self, folder: &str, name: &str) -> PathBuf {
        if name.ends_with(".toml") || name.contains(std::path::MAIN_SEPARATOR) {
            PathBuf::from(name)
        } else {
            self.root.join(folder).join(format!("{name}.toml"))
        }
    }

    /// Names of the files in a folder, in alphabetical order.
    #[must_use]
    pub fn names(&self, folder: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.root.join(folder)).into_iter().flatten().flatten();
        let mut names: Vec<String> =
            entries.filter_map(|entry| Some(entry.file_name().to_str()?.strip_suffix(".toml")?.to_owned())).collect();
        names.sort();
        names
    }

    /// The text of a file, and its path.
    ///
    /// # Errors
    /// Says what there is instead.
    pub(crate) fn read(&self, section: &str, folder: &str, name: &str) -> Result<(PathBuf, String), ConfigError> {
        let path = self.path(folder, name);
        let text = text_of(&path).map_err(|cause| {
            let known = self.names(folder);
            let cause = if cause.kind() != io::ErrorKind::NotFound {
                cause.to_string()
            } else if known.is_empty() {
                let folder = self.root.join(folder);
                format!("not there, and no other {section} in {}: name the folder with --config", folder.display())
            } else {
                let hint = suggestion(name, known.iter().map(String::as_str));
                format!("no such {section}; known: {}{hint}", known.join(", "))
            };
            ConfigError::Unreadable { path: path.display().to_string(), cause }
        })?;
        Ok((path, text))
    }

    /// Reads a file of a section with this call's overrides.
    ///
    /// # Errors
    /// Names the file, the line and column, the path, the value and the rule.
    pub fn load<T: DeserializeOwned>(&self, section: &str, folder: &str, name: &str) -> Result<Loaded<T>, ConfigError> {
        let (path, text) = self.read(section, folder, name)?;
        let shown = path.display().to_string();
        let value: T = parse(&shown, &text)?;
        let mut table: Table = parse(&shown, &text)?;
        let mine: Vec<&Override> =
            self.overrides.iter().filter(|over| over.section == section && over.concerns(&table)).collect();
        if mine.is_empty() {
            return Ok(Loaded { value, table, path });
        }
        for over in mine {
            over.apply(&mut table)?;
            // One by one, so that an error names the override that broke the rule.
            read::<T>(table.clone()).map_err(|message| ConfigError::Override { text: over.text.clone(), message })?;
        }
        let value = read(table.clone()).map_err(|message| ConfigError::Override { text: String::new(), message })?;
        Ok(Loaded { value, table, path })
    }
}

/// Most bytes of a configuration file: what names a device or a recording by mistake must not fill the memory.
const MOST: u64 = 1 << 20;

fn text_of(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    File::open(path)?.take(MOST + 1).read_to_string(&mut text)?;
    if text.len() as u64 > MOST {
        let rule = format!("must have at most {MOST} bytes; this is no configuration file");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, rule));
    }
    Ok(text)
}

fn read<T: DeserializeOwned>(table: Table) -> Result<T, String> {
    serde_path_to_error::deserialize(Value::Table(table))
        .map_err(|error| described(&error.path().to_string(), error.inner().message()))
}

/// An error at an offset in a text.
pub(crate) fn at(path: &str, text: &str, offset: usize, message: String) -> ConfigError {
    let before = &text[..offset.min(text.len())];
    ConfigError::Place {
        path: path.to_owned(),
        line: before.matches('\n').count() + 1,
        column: before.chars().rev().take_while(|c| *c != '\n').count() + 1,
        message,
    }
}

/// Reads a TOML text; errors point at the place.
///
/// # Errors
/// Names the file, the line and column, the path, the value and the rule.
pub fn parse<T: for<'de> Deserialize<'de>>(path: &str, text: &str) -> Result<T, ConfigError> {
    let place =
        |error: &toml::de::Error, message: String| at(path, text, error.span().map_or(0, |span| span.start), message);
    let deserializer = toml::Deserializer::parse(text).map_err(|error| place(&error, error.message().to_owned()))?;
    serde_path_to_error::deserialize(deserializer)
        .map_err(|error| place(error.inner(), described(&error.path().to_string(), error.inner().message())))
}

/// `path: message`, with a suggestion when a key is unknown.
fn described(path: &str, message: &str) -> String {
    let message = message.trim();
    // A value that knows its place is read as if it were a table.
    let path = &path.replace(".$__serde_spanned_private_value", "");
    let mut quoted = message.split('`').skip(1).step_by(2);
    let hint = if message.starts_with("unknown field") || message.starts_with("unknown variant") {
        quoted.next().map_or_else(String::new, |word| suggestion(word, quoted))
    } else {
        String::new()
    };
    if path.is_empty() || path == "." || path == "?" {
        format!("{message}{hint}")
    } else {
        format!("{path}: {message}{hint}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factor_multiplies_what_the_file_says() {
        let mut table: Table = "mass_kg = 4\n[inner]\ngain = 3.0\nname = \"x\"\n".parse().expect("TOML");
        for (path, expected) in [("vehicle.mass_kg", 2.0), ("vehicle.inner.gain", 1.5)] {
            let half = Override::new(path, Value::Float(0.5), true).expect("legal");
            assert_eq!((half.location().as_str(), half.law()), (path, None));
            half.apply(&mut table).expect("applies");
            let (_, inside) = path.split_once('.').expect("has a section");
            let value = inside.split('.').try_fold(&Value::Table(table.clone()), |at, key| at.get(key)).cloned();
            assert_eq!(value.and_then(|value| value.as_float()), Some(expected), "{path}");
        }
        let word = Override::new("vehicle.inner.name", Value::Float(0.5), true).expect("legal");
        let error = word.apply(&mut table).expect_err("a word").to_string();
        assert!(error.contains("vehicle.inner.name*=0.5: only a number can be multiplied"), "{error}");
    }
}
