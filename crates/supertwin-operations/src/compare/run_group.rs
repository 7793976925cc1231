//! Runs of one configuration, and how configurations differ.

use super::Run;
use crate::run::title;
use crate::shortened;
use serde::Serialize;
use supertwin_core::Property;
use supertwin_core::run::Properties;
use supertwin_lab::paper::PaperColumn;
use toml::{Table, Value};

/// Longest value in a list of changes.
const LONGEST: usize = 48;

/// What makes runs comparable: everything but the seed.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Facts {
    pub(super) trial: String,
    pub(super) controller: String,
    pub(super) vehicle: String,
    pub(super) placement: String,
    version: String,
    git_commit: String,
    config: Table,
}

/// Runs that only differ in their seeds.
#[derive(Debug)]
pub(super) struct RunGroup {
    pub(super) name: String,
    pub(super) facts: Facts,
    pub(super) runs: Vec<Run>,
}

/// A value that is not the same.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Change {
    /// Path of the value in the configuration.
    pub path: String,
    /// In the baseline; `None`: is not there.
    pub baseline: Option<String>,
    /// Here; `None`: is not there.
    pub here: Option<String>,
}

impl Facts {
    pub(super) fn new(run: &Properties) -> Result<Self, String> {
        let text = |name: &str| match run.get(name) {
            Some(Property::Text(text)) => Ok(text.clone()),
            _ => Err(format!("property {name} is not there: nobody knows what was run")),
        };
        let optional = |name: &str| text(name).unwrap_or_default();
        let mut config: Table = text("config")?
            .parse()
            .map_err(|error: toml::de::Error| format!("property config: {}", error.message()))?;
        if let Some(Value::Table(trial)) = config.get_mut("trial") {
            trial.remove("seed");
        }
        without_descriptions(&mut config);
        Ok(Self {
            trial: text("trial")?,
            controller: text("controller")?,
            vehicle: optional("vehicle"),
            placement: optional("placement"),
            version: optional("version"),
            git_commit: optional("git_commit"),
            config,
        })
    }

    /// Tells equal runs of different places apart.
    pub(super) fn provenance(&self) -> String {
        format!("{} {} {}", self.placement, self.version, self.git_commit)
    }

    /// Column of the paper's table that these runs repeat.
    pub(super) fn paper(&self) -> Option<PaperColumn> {
        self.config.get("trial")?.get("paper_column")?.clone().try_into().ok()
    }

    fn title(&self) -> String {
        title(&self.trial, &self.controller)
    }
}

/// Words about a configuration change nothing.
fn without_descriptions(table: &mut Table) {
    table.retain(|key, _| key != "description");
    table.iter_mut().for_each(|(_, value)| {
        if let Value::Table(inner) = value {
            without_descriptions(inner);
        }
    });
}

/// Gives every group a name of its own: trial and controller, with what differs where that is not enough.
pub(super) fn name(groups: &mut [RunGroup], each: bool) {
    for i in 0..groups.len() {
        let mut name = if each {
            groups[i].runs.first().map_or_else(String::new, |run| run.name.clone())
        } else {
            groups[i].facts.title()
        };
        let title = name.clone();
        if let Some(first) = groups[..i].iter().find(|group| group.facts.title() == title)
            && let Some(change) = changes(&first.facts, &groups[i].facts).first()
        {
            let path: Vec<&str> = change.path.rsplitn(3, '.').take(2).collect();
            let path: Vec<&str> = path.into_iter().rev().collect();
            name += &format!(" [{}={}]", path.join("."), change.here.as_deref().unwrap_or("none"));
        }
        let taken = |name: &str| groups[..i].iter().any(|group| group.name == name);
        let numbered = (2..).map(|n| format!("{name} #{n}"));
        let free = std::iter::once(name.clone()).chain(numbered).find(|name| !taken(name));
        groups[i].name = free.unwrap_or(name);
    }
}

/// What `here` has otherwise than `baseline`.
pub(super) fn changes(baseline: &Facts, here: &Facts) -> Vec<Change> {
    let mut changes = Vec::new();
    compare_tables("", &baseline.config, &here.config, &mut changes);
    for (path, before, after) in [
        ("trial (file)", &baseline.trial, &here.trial),
        ("placement", &baseline.placement, &here.placement),
        ("version", &baseline.version, &here.version),
        ("git_commit", &baseline.git_commit, &here.git_commit),
    ] {
        if before != after {
            let [baseline, here] = [before, after].map(|text| Some(one_line(text)));
            changes.push(Change { path: path.to_owned(), baseline, here });
        }
    }
    changes
}

fn compare_tables(path: &str, baseline: &Table, here: &Table, changes: &mut Vec<Change>) {
    let join = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    for (key, before) in baseline {
        compare_values(&join(key), Some(before), here.get(key), changes);
    }
    for (key, after) in here.iter().filter(|(key, _)| !baseline.contains_key(*key)) {
        compare_values(&join(key), None, Some(after), changes);
    }
}

fn compare_values(path: &str, baseline: Option<&Value>, here: Option<&Value>, changes: &mut Vec<Change>) {
    match (baseline, here) {
        (before, after) if before == after => {}
        (Some(Value::Table(before)), Some(Value::Table(after))) => compare_tables(path, before, after, changes),
        (Some(Value::Array(before)), Some(Value::Array(after))) if before.len() == after.len() => {
            for (i, (before, after)) in before.iter().zip(after).enumerate() {
                compare_values(&format!("{path}.{i}"), Some(before), Some(after), changes);
            }
        }
        (before, after) => {
            let [baseline, here] = [before, after].map(|value| value.map(short_text));
            changes.push(Change { path: path.to_owned(), baseline, here });
        }
    }
}

/// A value in a few characters.
fn short_text(value: &Value) -> String {
    match value {
        Value::Table(table) => {
            let n = leaves(table);
            format!("{n} value{}", if n == 1 { "" } else { "s" })
        }
        Value::String(text) => one_line(text),
        other => one_line(&other.to_string()),
    }
}

fn leaves(table: &Table) -> usize {
    table.values().map(|value| if let Value::Table(inner) = value { leaves(inner) } else { 1 }).sum()
}

fn one_line(text: &str) -> String {
    shortened(&text.split_whitespace().collect::<Vec<_>>().join(" "), LONGEST)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts(controller: &str, config: &str) -> Facts {
        let texts = [("trial", "fair"), ("controller", controller), ("config", config), ("placement", "batch")];
        let properties: Properties = texts.map(|(name, text)| (name.to_owned(), text.into())).into();
        Facts::new(&properties).expect("all is there")
    }

    #[test]
    fn the_seed_and_descriptions_are_no_configuration() {
        let one =
            facts("pid", "[trial]\nseed = 1\nduration_s = 9.0\ndescription = \"a\"\n[vehicle]\ndescription = \"b\"");
        let two = facts("pid", "[trial]\nseed = 2\nduration_s = 9.0\n[vehicle]\n");
        assert_eq!(one, two);
        assert!(Facts::new(&Properties::new()).expect_err("nothing is there").contains("property config"));
    }

    #[test]
    fn changes_are_leaves_and_what_one_side_has_alone_is_one_line() {
        let before = facts("gsta", "[controller.law.gsta]\na = 1\nb = 2\n[sea]\nheight_m = 0.6\nmodes = [1, 2]");
        let after = facts("pid", "[controller.law.pid]\nkp = 1\n[sea]\nheight_m = 0.3\nmodes = [1, 3]");
        let changes = changes(&before, &after);
        let changes = changes.iter().map(|change| (&*change.path, change.baseline.as_deref(), change.here.as_deref()));
        let expected = [
            ("controller.law.gsta", Some("2 values"), None),
            ("controller.law.pid", None, Some("1 value")),
            ("sea.height_m", Some("0.6"), Some("0.3")),
            ("sea.modes.1", Some("2"), Some("3")),
        ];
        assert_eq!(changes.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn groups_of_one_trial_are_named_by_what_differs() {
        let group = |config: &str| RunGroup { name: String::new(), facts: facts("pid", config), runs: Vec::new() };
        let mut groups = vec![
            group("[law.pid]\nkp = 1\nki = 1"),
            group("[law.pid]\nkp = 2\nki = 1"),
            group("[law.pid]\nkp = 2\nki = 3"),
        ];
        name(&mut groups, false);
        let names: Vec<&str> = groups.iter().map(|group| group.name.as_str()).collect();
        assert_eq!(names, ["fair/pid", "fair/pid [pid.kp=2]", "fair/pid [pid.kp=2] #2"]);
    }
}
