//! Limits on metrics: a file that says which runs pass.

use crate::metrics::{MetricName, Selection};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use supertwin_core::check::Finite;

/// A file of limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// What they are for, and where their numbers come from.
    pub description: String,
    /// Each holds for every run that it concerns.
    pub limit: Vec<Limit>,
}

/// One metric between its bounds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Limit {
    /// Metric that is limited.
    pub metric: MetricName,
    /// Must be at least.
    pub min: Option<Finite>,
    /// Must be at most.
    pub max: Option<Finite>,
    /// Only runs of this group, by its name as `compare` prints it; without, all.
    pub group: Option<String>,
}

/// What a limit says of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judged {
    /// Name of the metric that is limited.
    pub metric: String,
    /// Its value; `None` when the run has none.
    pub value: Option<f64>,
    /// Must be at least.
    pub min: Option<f64>,
    /// Must be at most.
    pub max: Option<f64>,
    /// Whether the value is within the limits.
    pub outcome: Outcome,
}

/// Whether a run is as it must be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The value is within the limits.
    Pass,
    /// Nobody can say: the metric, or the whole run, is not there.
    Invalid,
    /// It is not.
    Fail,
}

impl Outcome {
    /// In a table.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Invalid => "invalid",
            Self::Fail => "fail",
        }
    }
}

impl Limits {
    /// # Errors
    /// When a limit limits nothing, or nothing can be within it.
    pub fn check(&self) -> Result<(), String> {
        if self.limit.is_empty() {
            return Err("limit = []: must have at least one".to_owned());
        }
        for (i, limit) in self.limit.iter().enumerate() {
            let name = limit.metric.as_str();
            match (limit.min, limit.max) {
                (None, None) => return Err(format!("limit.{i}: {name}: must have min or max")),
                (Some(min), Some(max)) if min.get() > max.get() => {
                    return Err(format!("limit.{i}: {name}: min = {}: must be at most max = {}", min.get(), max.get()));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Adds the metrics that are needed.
    pub fn select(&self, selection: &mut Selection) {
        self.limit.iter().filter_map(|limit| limit.metric.metric()).for_each(|metric| selection.add(metric));
    }

    /// Judges a run of a group by its values.
    #[must_use]
    pub fn judge(&self, group: &str, values: &BTreeMap<String, f64>) -> Vec<Judged> {
        let concerned = self.limit.iter().filter(|limit| limit.group.as_deref().is_none_or(|name| name == group));
        concerned
            .map(|limit| {
                let (min, max) = (limit.min.map(Finite::get), limit.max.map(Finite::get));
                let value = values.get(limit.metric.as_str()).copied();
                let outcome = match value {
                    None => Outcome::Invalid,
                    Some(value) if min.is_none_or(|min| value >= min) && max.is_none_or(|max| value <= max) => {
                        Outcome::Pass
                    }
                    Some(_) => Outcome::Fail,
                };
                Judged { metric: limit.metric.as_str().to_owned(), value, min, max, outcome }
            })
            .collect()
    }
}

/// The worst of all.
#[must_use]
pub fn worst(judged: &[Judged]) -> Outcome {
    judged.iter().map(|judged| judged.outcome).max().unwrap_or(Outcome::Pass)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::parse;

    const TEXT: &str = r#"
description = "a test"
[[limit]]
metric = "measured.depth_m"
max = 0.2
[[limit]]
metric = "nis.depth"
min = 0.5
max = 2.0
group = "b"
"#;

    #[test]
    fn runs_pass_fail_or_are_invalid() {
        let limits: Limits = parse("x.toml", TEXT).expect("is legal");
        limits.check().expect("is sound");
        let values = |depth: f64, nis: f64| {
            BTreeMap::from([("measured.depth_m".to_owned(), depth), ("nis.depth".to_owned(), nis)])
        };
        assert_eq!(worst(&limits.judge("a", &values(0.2, 9.0))), Outcome::Pass);
        assert_eq!(worst(&limits.judge("b", &values(0.1, 9.0))), Outcome::Fail);
        assert_eq!(worst(&limits.judge("b", &values(0.1, 0.4))), Outcome::Fail);
        let unknown = limits.judge("b", &BTreeMap::from([("measured.depth_m".to_owned(), 0.1)]));
        assert_eq!((worst(&unknown), unknown.len()), (Outcome::Invalid, 2));
        let mut selection = Selection::parse(["effort.surge"]).expect("is known");
        limits.select(&mut selection);
        assert_eq!(selection.metrics().count(), 3);
    }

    #[test]
    fn mistakes_are_named_with_place_and_suggestion() {
        let error = |text: &str| parse::<Limits>("x.toml", text).expect_err("is wrong").to_string();
        let typo = error(&TEXT.replace("measured.depth_m", "measured.dept_m"));
        assert!(typo.starts_with("x.toml:4:10: ") && typo.contains("did you mean `measured.depth_m`?"), "{typo}");
        let key = error(&TEXT.replace("max = 0.2", "maxx = 0.2"));
        assert!(key.contains("unknown field `maxx`") && key.contains("did you mean `max`?"), "{key}");
        let no_number = error(&TEXT.replace("max = 0.2", "max = nan"));
        assert!(no_number.starts_with("x.toml:5:"), "{no_number}");
        let nothing: Limits = parse("x.toml", &TEXT.replace("max = 0.2\n", "")).expect("reads");
        assert!(nothing.check().expect_err("limits nothing").contains("must have min or max"));
        let empty: Limits = parse("x.toml", &TEXT.replace("min = 0.5", "min = 5.0")).expect("reads");
        assert!(empty.check().expect_err("nothing is within").contains("must be at most max = 2"));
    }
}
