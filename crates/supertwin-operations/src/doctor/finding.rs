//! What a check has found: how bad it is, and what to do about it.

use serde::Serialize;
use supertwin_zenoh::access_control::Attempt;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Grade {
    /// As it should be.
    Ok,
    /// To be known.
    Warning,
    /// To be mended.
    Wrong,
}

/// The outcome of one check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What was looked at.
    pub check: &'static str,
    /// How bad it is.
    #[serde(rename = "verdict")]
    pub grade: Grade,
    /// What was found.
    pub what: String,
    /// What to do about it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
    /// The matrix as it was found, of a proof of access.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub attempts: Vec<Attempt>,
}

pub(super) fn ok(check: &'static str, what: impl Into<String>) -> Finding {
    Finding { check, grade: Grade::Ok, what: what.into(), remedy: None, attempts: Vec::new() }
}

pub(super) fn warning(check: &'static str, what: impl Into<String>, remedy: impl Into<String>) -> Finding {
    Finding { remedy: Some(remedy.into()), grade: Grade::Warning, ..ok(check, what) }
}

pub(super) fn wrong(check: &'static str, what: impl Into<String>, remedy: impl Into<String>) -> Finding {
    Finding { remedy: Some(remedy.into()), grade: Grade::Wrong, ..ok(check, what) }
}
