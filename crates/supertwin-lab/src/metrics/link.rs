//! Latency and loss of a run over a network, from the accounts that its services give each second.

use crate::align::Grid;
use crate::statistics::quantile;
use std::collections::BTreeMap;
use supertwin_core::block::SERVICES;
use supertwin_core::signal::link::{AGE, Account, DEADLINE, LOOP_TIME, MISSING, STEP_TIME, TRANSPORT};
use supertwin_core::signal::thrust::REQUESTED;
use supertwin_core::source::Columns;
use supertwin_core::{Property, RecordedRun};

const P99: usize = STEP_TIME.at("p99");
const MISSES: usize = DEADLINE.at("misses");
const SENDER: &str = "sender_clock";
const RECORDER: &str = "recorder_clock";

/// All of them that the recording has.
pub(super) fn values(source: &RecordedRun, grid: &Grid, out: &mut BTreeMap<String, f64>) {
    let (from, to) = (grid.tick(grid.from), grid.tick(grid.to));
    let mut put = |name: &str, value: Option<f64>| {
        if let Some(value) = value {
            out.insert(name.to_owned(), value);
        }
    };
    let account = |service: &str, what: &Account| source.signals.get(&what.path(service));
    let most = |a: Option<f64>, b: Option<f64>| a.into_iter().chain(b).reduce(f64::max);
    let sum = |a: Option<f64>, b: Option<f64>| a.into_iter().chain(b).reduce(|a, b| a + b);

    let loops: Vec<&Columns> = SERVICES.iter().filter_map(|service| account(service, &LOOP_TIME)).collect();
    for (column, name) in LOOP_TIME.components.iter().enumerate() {
        let seconds = sorted(loops.iter().flat_map(|columns| column_of(columns, column, from, to)));
        put(&format!("loop_us.{name}"), quantile(&seconds, if *name == "max" { 1.0 } else { 0.5 }));
    }
    for service in SERVICES {
        let p99 = account(service, &STEP_TIME).map(|columns| sorted(column_of(columns, P99, from, to)));
        put(&format!("step_us.{service}"), p99.and_then(|p99| quantile(&p99, 1.0)));
    }
    let (mut transport, mut age, mut lost, mut missed) = (None, None, None, None);
    for service in SERVICES {
        let greatest = |what: &Account| {
            let columns = account(service, what)?;
            (0..columns.width).flat_map(|column| column_of(columns, column, from, to)).reduce(f64::max)
        };
        transport = most(transport, greatest(&TRANSPORT));
        age = most(age, greatest(&AGE));
        let grown = account(service, &MISSING).map(|columns| {
            (0..columns.width).map(|column| growth(&column_of(columns, column, from, to).collect::<Vec<_>>())).sum()
        });
        lost = sum(lost, grown);
        let misses = account(service, &DEADLINE);
        missed = sum(missed, misses.map(|columns| growth(&column_of(columns, MISSES, from, to).collect::<Vec<_>>())));
    }
    put("transport_ms_max", transport);
    put("input_age_ticks_max", age);
    put("messages_lost", lost);
    put("deadlines_missed", missed);

    // A recording that is scored has a row of it at every tick, with both clocks.
    let lag = source.signal(&REQUESTED).map(|columns| lag_ms(columns, from, to)).unwrap_or_default();
    put("recorder_lag_ms.median", quantile(&lag, 0.5));
    put("recorder_lag_ms.p99", quantile(&lag, 0.99));
    put("unrecorded_share", unrecorded(source));
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values
}

/// One component in the ticks `from..to`.
fn column_of(columns: &Columns, column: usize, from: i64, to: i64) -> impl Iterator<Item = f64> + '_ {
    let rows = columns.tick.iter().enumerate().filter(move |(_, tick)| (from..to).contains(*tick));
    rows.filter_map(move |(row, _)| columns.row(row)?.get(column).copied())
}

/// By how much a counter grew; a service that restarts begins at zero again.
fn growth(counter: &[f64]) -> f64 {
    counter.windows(2).map(|pair| if pair[1] >= pair[0] { pair[1] - pair[0] } else { pair[1] }).sum()
}

fn lag_ms(columns: &Columns, from: i64, to: i64) -> Vec<f64> {
    let (Some(sent), Some(recorded)) = (columns.clocks.get(SENDER), columns.clocks.get(RECORDER)) else {
        return Vec::new();
    };
    let rows = columns.tick.iter().zip(sent).zip(recorded).filter(|((tick, _), _)| (from..to).contains(*tick));
    sorted(rows.filter_map(|((_, sent), recorded)| Some(((*recorded)? - (*sent)?) as f64 / 1e6)))
}

fn unrecorded(source: &RecordedRun) -> Option<f64> {
    let count = |name: &str| match source.property("result", name) {
        Some(Property::Integer(count)) => Some(*count as f64),
        _ => None,
    };
    let missing: Option<f64> = SERVICES.iter().map(|service| count(&format!("missing.{service}"))).sum();
    let ticks = count("ticks").filter(|ticks| *ticks > 0.0)?;
    Some(missing? / (SERVICES.len() as f64 * ticks))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counters_that_begin_again_do_not_shrink_what_was_lost() {
        assert_eq!(growth(&[3.0, 5.0, 0.0, 2.0]), 4.0);
        assert_eq!(growth(&[]), 0.0);
    }

    #[test]
    fn lag_is_between_the_clocks_and_only_where_both_are() {
        let columns = Columns {
            tick: vec![0, 1, 2, 3],
            time_ns: vec![0; 4],
            width: 1,
            values: vec![0.0; 4],
            clocks: BTreeMap::from([
                (SENDER.to_owned(), vec![Some(0), Some(20_000_000), None, Some(60_000_000)]),
                (RECORDER.to_owned(), vec![Some(3_000_000), Some(21_000_000), Some(1), Some(61_500_000)]),
            ]),
            ..Columns::default()
        };
        assert_eq!(lag_ms(&columns, 0, 4), [1.0, 1.5, 3.0]);
        assert_eq!(lag_ms(&columns, 1, 3), [1.0]);
        assert!(lag_ms(&Columns::default(), 0, 4).is_empty());
    }
}
