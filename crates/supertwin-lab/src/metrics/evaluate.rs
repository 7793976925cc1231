//! The values of the wanted metrics in a window of one run.

use super::consistency::{self, Consistency};
use super::errors::Errors;
use super::steps::{self, Moment, Response, Targets};
use super::{Selection, Source, link};
use crate::align::Grid;
use crate::rescore::{RescoreError, Sample, SampleReader};
use crate::score::Scorer;
use crate::statistics::mean;
use std::collections::BTreeMap;
use supertwin_core::axes::AXIS_NAMES;
use supertwin_core::{Axes, Property, RecordedRun, Tick};

/// What was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluated {
    /// By name; what a run has not is not here.
    pub values: BTreeMap<String, f64>,
    /// Moments of the window that were compared.
    pub moments: u64,
    /// Moments of the window at which something was not recorded.
    pub missing: u64,
}

impl Evaluated {
    /// Share of the window that is there.
    #[must_use]
    pub fn coverage(&self) -> f64 {
        self.moments as f64 / (self.moments + self.missing).max(1) as f64
    }
}

/// A run that can't be compared.
#[derive(Debug, thiserror::Error)]
pub enum MetricsError {
    /// Something is not there.
    #[error(transparent)]
    Scores(#[from] RescoreError),
    /// A number is none.
    #[error("{run}: {path} is not finite at tick {tick}")]
    NotFinite {
        /// Name of the run, as its recording states it.
        run: String,
        /// Path of the signal in the recording.
        path: &'static str,
        /// Tick, from 0 at the start of the run.
        tick: i64,
    },
    /// Nothing of it is in the window.
    #[error("{run}: nothing of it is in the window: it goes from {from_s:.2} to {to_s:.2} s from time zero")]
    NoOverlap {
        /// Name of the run, as its recording states it.
        run: String,
        /// Its first moment, in seconds from time zero.
        from_s: f64,
        /// Its last moment, in seconds from time zero.
        to_s: f64,
    },
}

/// Evaluates the wanted metrics at the moments of `grid`.
///
/// Where the moments are the run's own ticks and the window is its own, the scores equal the run's bit for bit.
///
/// # Errors
/// When the run lacks a signal altogether, has numbers that are none, or does not reach into the window.
pub fn evaluate(source: &RecordedRun, grid: &Grid, wanted: &Selection) -> Result<Evaluated, MetricsError> {
    let run = || source.name.clone();
    let mut reader = SampleReader::new(source, false)?;
    let truth = reader.has_truth;
    if let Some((path, tick)) = reader.not_finite(grid.tick(grid.from), grid.tick(grid.to)) {
        return Err(MetricsError::NotFinite { run: run(), path, tick });
    }
    let last = reader.last();
    // The moment before the window is what its first variation starts from.
    let mut scorer = Scorer::new(1, 1 + grid.len(), grid.tick_s);
    let mut errors = Errors::default();
    let mut consistency = Consistency::default();
    let mut targets = Targets::new(source);
    let mut moments = Vec::new();
    let mut gains: Option<[[f64; 4]; 2]> = None;
    let mut count = 0;
    let doubts = wanted.wants(&[Source::Variances, Source::Health]);
    let responds = wanted.wants(&[Source::Steps, Source::TrueSteps]);
    for moment in grid.within(last) {
        let k = grid.tick(moment);
        let Some(sample) = reader.at(k)? else { continue };
        let number = Tick { k: (moment - (grid.from - 1)) as u64, dt_s: grid.tick_s };
        let Sample { tick, tracking, thrust, made, law } = &sample;
        scorer.add(number, tracking, thrust, made, law);
        if responds {
            let target = targets.at(*tick, tracking.reference[0]);
            let of = |value: &[f64; 6]| [value[0], value[4], value[5]];
            moments.push(Moment { target, measured: of(&tracking.measured), truth: of(&tracking.truth) });
        }
        if moment < grid.from {
            continue;
        }
        count += 1;
        errors.add(tracking);
        gains = law.k1.map(|k1| [gains.map_or(k1, |[first, _]| first), k1]);
        if doubts {
            consistency.add(source, &sample);
        }
    }
    if count == 0 {
        let seconds = |tick: i64| (tick - grid.origin) as f64 * reader.tick_s;
        return Err(MetricsError::NoOverlap { run: run(), from_s: seconds(0), to_s: seconds(last + 1) });
    }

    let mut values = BTreeMap::new();
    for (name, value) in scorer.scores().properties() {
        if let Property::Number(value) = value {
            values.insert(name, value);
        }
    }
    errors.values(grid.tick_s, &mut values);
    match gains {
        Some([first, last]) => {
            let growth = Axes::from(core::array::from_fn(|i| last[i] - first[i]));
            for (name, value) in AXIS_NAMES.iter().zip(growth.to_array()) {
                values.insert(format!("k1_growth.{name}"), value);
            }
        }
        // Laws without gains do not have gains of zero.
        None => values.retain(|name, _| !name.starts_with("k1_")),
    }
    if doubts {
        consistency.values(&mut values);
    }
    if responds {
        add_responses(&moments, grid.tick_s, &mut values);
    }
    if wanted.wants(&[Source::Innovations]) {
        consistency::nis(source, grid, &mut values);
    }
    if wanted.wants(&[Source::Link]) {
        link::values(source, grid, &mut values);
    }
    let chosen = wanted.metrics().filter(|metric| {
        truth || !matches!(metric.family.source, Source::Truth | Source::TrueSteps | Source::Variances)
    });
    let values = chosen.filter_map(|metric| values.remove_entry(&metric.name)).filter(|(_, value)| value.is_finite());
    Ok(Evaluated { values: values.collect(), moments: count, missing: grid.len().saturating_sub(count) })
}

fn add_responses(moments: &[Moment], tick_s: f64, values: &mut BTreeMap<String, f64>) {
    for (which, name) in steps::NAMES.into_iter().enumerate() {
        for (truth, prefix) in [(false, "measured"), (true, "true")] {
            let responses = steps::responses(moments, tick_s, which, truth);
            if responses.is_empty() {
                continue;
            }
            let of = |value: fn(&Response) -> f64| mean(&responses.iter().map(value).collect::<Vec<_>>());
            values.insert(format!("{prefix}_settling.{name}_s"), of(|response| response.settling_s));
            values.insert(format!("{prefix}_overshoot.{name}_share"), of(|response| response.overshoot));
            if !truth {
                let unsettled = responses.iter().filter(|response| !response.settled).count();
                values.insert(format!("unsettled.{name}"), unsettled as f64);
            }
        }
    }
}
