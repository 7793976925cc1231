//! The comparison as a Parquet table: a row per run, a column per metric.

use super::{Comparison, Run};
use supertwin_lab::metrics::Selection;
use supertwin_rerun::table::{Column, Table, TableError};

pub(super) fn table(comparison: &Comparison, selection: &Selection) -> Result<Table, TableError> {
    let mut table = Table::default();
    for (name, text) in [("align", comparison.align.clone()), ("baseline", comparison.baseline.clone())] {
        table.about.insert(name.to_owned(), text);
    }
    let runs = &comparison.runs;
    let text = |value: &dyn Fn(&Run) -> Option<String>| Column::Text(runs.iter().map(value).collect());
    let count = |value: &dyn Fn(&Run) -> Option<u64>| Column::Count(runs.iter().map(value).collect());
    table.push("run", text(&|run| Some(run.name.clone())))?;
    table.push("file", text(&|run| Some(run.file.display().to_string())))?;
    table.push("group", text(&|run| Some(run.group.clone())))?;
    table.push("seed", count(&|run| run.seed))?;
    let number = |value: &dyn Fn(&Run) -> f64| Column::Number(runs.iter().map(|run| Some(value(run))).collect());
    table.push("window_from_s", number(&|run| run.window.from_s))?;
    table.push("window_to_s", number(&|run| run.window.to_s))?;
    table.push("moments", count(&|run| Some(run.moments)))?;
    table.push("missing", count(&|run| Some(run.missing)))?;
    table.push("outcome", text(&|run| run.outcome.map(|outcome| outcome.name().to_owned())))?;
    for metric in selection.metrics() {
        let values = runs.iter().map(|run| run.values.get(&metric.name).copied()).collect();
        table.push(metric.name.as_str(), Column::Number(values))?;
    }
    Ok(table)
}
