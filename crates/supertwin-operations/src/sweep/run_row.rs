//! A finished run as a row: in the journal as a line of JSON, in the table as a line of columns.

use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use supertwin_core::Property;
use supertwin_lab::sweep::{Plan, Sweep};
use supertwin_lab::{RunError, RunOutcome};
use supertwin_rerun::{Column, Table, TableError};
use toml::Value;

/// What became of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RunVerdict {
    /// It came to its end, and no limits were given.
    #[default]
    Complete,
    /// It keeps all limits.
    Pass,
    /// It breaks a limit.
    Fail,
    /// It has no scores: it ended in NaN, or could not start.
    Invalid,
}

impl RunVerdict {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Complete, Self::Pass, Self::Fail, Self::Invalid];

    /// Its name in journals and tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Complete => "complete",
            Self::Pass => "pass",
            Self::Fail => "fail",
            Self::Invalid => "invalid",
        }
    }

    /// Nothing is wrong with such a run.
    #[must_use]
    pub fn is_well(self) -> bool {
        matches!(self, Self::Complete | Self::Pass)
    }
}

/// A finished run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunRow {
    /// Its place in the plan.
    pub run: usize,
    /// Its name there.
    pub id: String,
    /// What became of it.
    pub verdict: RunVerdict,
    /// Why it is invalid, or which limits it breaks.
    pub error: Option<String>,
    /// State hash of a complete run.
    pub hash: Option<String>,
    /// Ticks that it took.
    pub ticks: u64,
    /// Warnings among its events.
    pub warnings: u64,
    /// Commands that were refused.
    pub refused: u64,
    /// Its recording, seen from the sweep's folder.
    pub recording: Option<String>,
    /// By name; what is no number is left out.
    pub scores: BTreeMap<String, f64>,
}

impl RunRow {
    /// Of a run that came to its end.
    pub(crate) fn complete(run: usize, id: &str, outcome: &RunOutcome) -> Self {
        let number = |(name, value): (String, Property)| match value {
            Property::Number(number) if number.is_finite() => Some((name, number)),
            _ => None,
        };
        Self {
            run,
            id: id.to_owned(),
            hash: Some(outcome.digest.to_string()),
            ticks: outcome.ticks,
            warnings: outcome.warnings,
            refused: outcome.refused.len() as u64,
            scores: outcome.scores.properties().into_iter().filter_map(number).collect(),
            ..Self::default()
        }
    }

    /// Of a run that did not.
    pub(crate) fn invalid(run: usize, id: &str, error: &RunError) -> Self {
        let ticks = match error {
            RunError::NonFinite(at) => at.k + 1,
            _ => 0,
        };
        Self {
            run,
            id: id.to_owned(),
            verdict: RunVerdict::Invalid,
            error: Some(error.to_string()),
            ticks,
            ..Self::default()
        }
    }
}

/// Columns that every table has, beside parameters and scores.
const FIXED: [&str; 14] = [
    "run",
    "id",
    "trial",
    "controller",
    "seed",
    "grid",
    "sample",
    "verdict",
    "error",
    "hash",
    "ticks",
    "warnings",
    "refused",
    "recording",
];

/// A parameter's name that a column has already.
pub(crate) fn taken(sweep: &Sweep) -> Option<&str> {
    let scores = supertwin_lab::Scores::default().properties();
    let is_taken = |name: &str| {
        let group = name.split('.').next().unwrap_or_default();
        FIXED.contains(&name)
            || scores.contains_key(name)
            || scores.keys().any(|score| score.split_once('.').is_some_and(|(of, _)| of == group))
            || group == "outside_alpha_tol_share"
    };
    sweep.parameters.iter().map(|parameter| parameter.name.as_str()).find(|name| is_taken(name))
}

/// The table of these rows, in the order of the plan.
pub(crate) fn table(sweep: &Sweep, plan: &Plan, rows: &[RunRow]) -> Result<Table, TableError> {
    let mut rows: Vec<&RunRow> = rows.iter().collect();
    rows.sort_by_key(|row| row.run);
    let planned: Vec<_> = rows.iter().map(|row| &plan.runs[row.run]).collect();
    let of: Vec<_> = planned.iter().map(|run| &plan.configurations[run.configuration]).collect();
    let count = |value: &dyn Fn(usize) -> u64| Column::Count((0..rows.len()).map(|i| Some(value(i))).collect());
    let text = |value: &dyn Fn(usize) -> Option<String>| Column::Text((0..rows.len()).map(value).collect());

    let mut table = Table::default();
    table.push("run", count(&|i| rows[i].run as u64))?;
    table.push("id", text(&|i| Some(rows[i].id.clone())))?;
    table.push("trial", text(&|i| Some(of[i].trial.name.clone())))?;
    table.push("controller", text(&|i| Some(of[i].trial.controller_name.clone())))?;
    table.push("seed", count(&|i| planned[i].seed))?;
    table.push("grid", count(&|i| of[i].grid as u64))?;
    table.push("sample", count(&|i| of[i].sample as u64))?;
    for (k, parameter) in sweep.parameters.iter().enumerate() {
        let values = of.iter().map(|one| one.values[k].as_ref());
        let numeric = parameter.values.iter().all(|value| value.is_float() || value.is_integer());
        let column = if numeric {
            Column::Number(values.map(|value| value.and_then(number)).collect())
        } else if parameter.values.iter().all(Value::is_bool) {
            Column::Flag(values.map(|value| value.and_then(Value::as_bool)).collect())
        } else {
            Column::Text(values.map(|value| value.map(value_text)).collect())
        };
        table.push(&parameter.name, column)?;
    }
    table.push("verdict", text(&|i| Some(rows[i].verdict.name().to_owned())))?;
    table.push("error", text(&|i| rows[i].error.clone()))?;
    table.push("hash", text(&|i| rows[i].hash.clone()))?;
    table.push("ticks", count(&|i| rows[i].ticks))?;
    table.push("warnings", count(&|i| rows[i].warnings))?;
    table.push("refused", count(&|i| rows[i].refused))?;
    table.push("recording", text(&|i| rows[i].recording.clone()))?;
    let names: BTreeSet<&String> = rows.iter().flat_map(|row| row.scores.keys()).collect();
    for name in names {
        table.push(name, Column::Number(rows.iter().map(|row| row.scores.get(name).copied()).collect()))?;
    }
    Ok(table)
}

/// The rows of a table that [`table`] made.
pub(crate) fn rows(sweep: &Sweep, table: &Table) -> Result<Vec<RunRow>, String> {
    let column = |name: &str| table.column(name).ok_or_else(|| format!("no column {name}"));
    let kind = |name: &str| format!("column {name} is of another kind");
    let counts = |name: &str| match column(name)? {
        Column::Count(values) => values.iter().map(|value| value.ok_or_else(|| kind(name))).collect(),
        _ => Err(kind(name)),
    };
    let texts = |name: &str| match column(name)? {
        Column::Text(values) => Ok(values.clone()),
        _ => Err(kind(name)),
    };
    let (run, ticks, warnings, refused): (Vec<u64>, Vec<u64>, Vec<u64>, Vec<u64>) =
        (counts("run")?, counts("ticks")?, counts("warnings")?, counts("refused")?);
    let [id, verdict, error, hash, recording] = ["id", "verdict", "error", "hash", "recording"].map(texts);
    let (id, verdict, error, hash, recording) = (id?, verdict?, error?, hash?, recording?);
    let is_parameter = |name: &str| sweep.parameters.iter().any(|parameter| parameter.name == name);
    let scores = table.columns().iter().filter_map(|(name, column)| match column {
        Column::Number(values) if !FIXED.contains(&name.as_str()) && !is_parameter(name) => Some((name, values)),
        _ => None,
    });
    let scores: Vec<_> = scores.collect();
    let row = |i: usize| {
        let said = verdict[i].as_deref();
        let verdict = RunVerdict::ALL.into_iter().find(|one| Some(one.name()) == said);
        Ok(RunRow {
            run: usize::try_from(run[i]).map_err(|_| kind("run"))?,
            id: id[i].clone().ok_or_else(|| kind("id"))?,
            verdict: verdict.ok_or_else(|| format!("verdict {said:?} is unknown"))?,
            error: error[i].clone(),
            hash: hash[i].clone(),
            ticks: ticks[i],
            warnings: warnings[i],
            refused: refused[i],
            recording: recording[i].clone(),
            scores: scores.iter().filter_map(|(name, values)| Some(((*name).clone(), values[i]?))).collect(),
        })
    };
    (0..table.rows()).map(row).collect()
}

/// A parameter's value as a number.
pub(crate) fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|n| n as f64))
}

/// A parameter's value as a person writes it.
pub(crate) fn value_text(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}
