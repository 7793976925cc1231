//! A run that is kept in memory, to be read again and changed.
#![allow(dead_code, unreachable_pub, reason = "each test file uses its part")]

#[path = "../../../../tests/support/keeper.rs"]
mod keeper;

pub use keeper::Keeper;
use supertwin_core::RecordedRun;
use supertwin_core::run::Properties;
use supertwin_core::source::Columns;
use supertwin_lab::{ResolvedTrial, RunOutcome, run};

/// Runs into memory.
pub fn keep(trial: &ResolvedTrial, seed: u64) -> (RecordedRun, RunOutcome) {
    let mut keeper = Keeper::default();
    let outcome = run(trial, seed, &mut keeper, Some(&Properties::new()), |_| true).expect("runs");
    (keeper.run, outcome)
}

/// The columns without the rows of some ticks.
pub fn without_rows(columns: &Columns, gone: impl Fn(i64) -> bool) -> Columns {
    let mut left = Columns { width: columns.width, names: columns.names.clone(), ..Columns::default() };
    for (row, &tick) in columns.tick.iter().enumerate().filter(|(_, tick)| !gone(**tick)) {
        left.tick.push(tick);
        left.time_ns.push(columns.time_ns[row]);
        left.values.extend_from_slice(columns.row(row).expect("a row"));
    }
    left
}
