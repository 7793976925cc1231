//! What is in a recording, what is missing, and whether its scores are right.

use serde::Serialize;
use std::collections::BTreeMap;
use supertwin_core::Property;
use supertwin_core::run::Properties;
use supertwin_lab::{Rescored, Scores, rescore};
use supertwin_rerun::Recording;

/// One signal, label or wire.
#[derive(Debug, Serialize)]
pub struct RecordedSignal {
    /// Path of the signal in the recording.
    pub path: String,
    /// Names of its components.
    pub components: Vec<String>,
    /// Rows that were recorded.
    pub rows: usize,
    /// Rows per second.
    pub rate_hz: Option<f64>,
    /// Time of the first row.
    pub first_s: Option<f64>,
    /// Time of the last row.
    pub last_s: Option<f64>,
    /// Rows that an even rate would have between the first and the last; `None` where the rate is not even.
    pub missing: Option<u64>,
}

/// Ticks that nothing was recorded at.
#[derive(Debug, PartialEq, Serialize)]
pub struct TickGap {
    /// The first of them.
    pub from_tick: i64,
    /// The last of them.
    pub to_tick: i64,
}

/// Recorded and recomputed scores.
#[derive(Debug, Default, Serialize)]
pub struct RecordedScores {
    /// The run left scores.
    pub recorded: bool,
    /// Scores from what was recorded.
    pub recomputed: Option<Scores>,
    /// Every score of the recording has the same bits again.
    pub equal: Option<bool>,
    /// Ticks that were scored.
    pub ticks: u64,
    /// Ticks of the window that were not recorded.
    pub missing_ticks: u64,
    /// Why there are none.
    pub problem: Option<String>,
}

/// What was found in a recording.
#[derive(Debug)]
pub struct Inspection {
    /// All of them, by path.
    pub signals: Vec<RecordedSignal>,
    /// The first tick and the last.
    pub ticks: Option<(i64, i64)>,
    /// Ticks between those that nothing was recorded at.
    pub gaps: Vec<TickGap>,
    /// The run's own scores and those that follow from the recording.
    pub scores: RecordedScores,
}

/// Looks at all of a recording.
#[must_use]
pub fn inspect(recording: &Recording) -> Inspection {
    let ticks: Vec<i64> = recording.moments().iter().map(|moment| moment.0).collect();
    Inspection {
        signals: signals(recording),
        ticks: ticks.first().copied().zip(ticks.last().copied()),
        gaps: gaps(&ticks),
        scores: scores(recording),
    }
}

fn signals(recording: &Recording) -> Vec<RecordedSignal> {
    let seconds = |time_ns: &i64| *time_ns as f64 / 1e9;
    // Without ticks: labels are recorded when they change, at no rate.
    let line = |path: String, components: &[String], time_ns: &[i64], ticks: Option<&[i64]>| RecordedSignal {
        path,
        components: components.to_vec(),
        rows: time_ns.len(),
        rate_hz: ticks.and_then(|_| rate(time_ns)),
        first_s: time_ns.first().map(seconds),
        last_s: time_ns.last().map(seconds),
        missing: ticks.and_then(missing),
    };
    let mut lines = Vec::new();
    for (path, columns) in &recording.signals {
        lines.push(line(path.clone(), &columns.names, &columns.time_ns, Some(&columns.tick)));
    }
    for (path, changes) in &recording.labels {
        let times: Vec<i64> = changes.iter().map(|change| change.time_ns).collect();
        lines.push(line(path.clone(), &[], &times, None));
    }
    for (key, messages) in &recording.wires {
        let (ticks, times): (Vec<i64>, Vec<i64>) = messages.iter().map(|one| (one.tick, one.time_ns)).unzip();
        lines.push(line(format!("wire/{key}"), &[], &times, Some(&ticks)));
    }
    lines.sort_by(|a, b| a.path.cmp(&b.path));
    lines
}

fn rate(time_ns: &[i64]) -> Option<f64> {
    let span_s = (time_ns.last()? - time_ns.first()?) as f64 / 1e9;
    (span_s > 0.0).then(|| (time_ns.len() - 1) as f64 / span_s)
}

/// The usual distance between rows, when nine of ten have it.
fn stride(ticks: &[i64]) -> Option<i64> {
    let mut counts = BTreeMap::<i64, usize>::new();
    ticks.windows(2).for_each(|pair| *counts.entry(pair[1].saturating_sub(pair[0])).or_default() += 1);
    let (stride, count) = counts.into_iter().max_by_key(|(_, count)| *count)?;
    (stride > 0 && 10 * count >= 9 * (ticks.len() - 1)).then_some(stride)
}

fn missing(ticks: &[i64]) -> Option<u64> {
    let stride = stride(ticks)?;
    let between = |pair: &[i64]| (pair[1].saturating_sub(pair[0]) / stride - 1).max(0) as u64;
    Some(ticks.windows(2).map(between).sum())
}

fn gaps(ticks: &[i64]) -> Vec<TickGap> {
    let stride = stride(ticks).unwrap_or(1);
    let wide = ticks.windows(2).filter(|pair| pair[1].saturating_sub(pair[0]) > stride);
    wide.map(|pair| TickGap { from_tick: pair[0] + stride, to_tick: pair[1] - stride }).collect()
}

fn scores(recording: &Recording) -> RecordedScores {
    let empty = Properties::new();
    let result = recording.properties.get("result").unwrap_or(&empty);
    let recorded = result.keys().any(|name| name.starts_with("measured."));
    match rescore(recording) {
        Ok(Rescored { scores, ticks, missing }) => {
            let bits = |value: &Property| match value {
                Property::Number(x) => Some(x.to_bits()),
                _ => None,
            };
            let again = scores.properties();
            let same = |(name, value): (&String, &Property)| result.get(name).and_then(bits) == bits(value);
            let equal = recorded.then(|| again.iter().all(same));
            RecordedScores { recorded, recomputed: Some(scores), equal, ticks, missing_ticks: missing, problem: None }
        }
        Err(error) => RecordedScores { recorded, problem: Some(error.to_string()), ..RecordedScores::default() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_told_from_a_slower_rate() {
        let every: Vec<i64> = (0..100).filter(|tick| !(40..43).contains(tick)).collect();
        assert_eq!((missing(&every), gaps(&every)), (Some(3), vec![TickGap { from_tick: 40, to_tick: 42 }]));
        let fifth: Vec<i64> = (0..100).step_by(5).collect();
        assert_eq!((missing(&fifth), gaps(&fifth)), (Some(0), vec![]));
        // Pings come when they come.
        assert_eq!(missing(&[0, 6, 12, 19, 25, 31, 38]), None);
        assert_eq!((missing(&[7]), missing(&[])), (None, None));
    }
}
