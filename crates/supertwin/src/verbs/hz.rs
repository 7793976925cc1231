//! `supertwin hz`: rate, jitter, bytes and gaps of what is published on a key.

use crate::arguments::{ToolArguments, positive};
use crate::terminal::{self, Bar, INTERRUPTED, table};
use clap::Args;
use serde_json::json;
use std::process::ExitCode;
use supertwin_lab::Library;
use supertwin_operations::OperationError;
use supertwin_operations::flows::{self, KeyRate};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin hz estimator/nav
  supertwin hz 'telemetry/*' --for 20
  supertwin hz '**' --json                       everything of the vehicle

Exit status: 0 done, 1 nothing was heard, 2 the call is wrong or there is no router, 130 interrupted.")]
pub(crate) struct HzArguments {
    /// Key below the vehicle's, or a full one from supertwin/ on; * is one part, ** any number
    #[arg(value_name = "KEY")]
    key: String,

    /// Seconds to listen
    #[arg(long = "for", value_name = "S", default_value = "5", value_parser = positive)]
    for_s: f64,

    #[command(flatten)]
    tool: ToolArguments,
}

/// Listens and prints rates.
pub(crate) fn hz(arguments: &HzArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let mut network = arguments.tool.link.join(library)?;
    let key = network.key(arguments.tool.link.vehicle.as_deref(), &arguments.key)?;
    let rates = flows::rates(&mut network, &key, arguments.for_s, &Bar::new(arguments.tool.json))?;
    let interrupted = network.stop.interrupted();
    network.close();
    if rates.lost > 0 {
        let lost = rates.lost;
        terminal::warn(&format!("warning: {lost} samples came faster than they could be counted: gaps are ours"));
    }
    let result = json!({ "for_s": rates.for_s, "keys": rates.keys });
    terminal::print_result(arguments.tool.json, &result, || rates_text(&rates.keys));
    Ok(if interrupted { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS })
}

fn rates_text(rates: &[KeyRate]) -> String {
    let digits = |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |value| format!("{value:.digits$}"));
    let count = |value: Option<u64>| value.map_or("-".to_owned(), |value| value.to_string());
    let rows = rates
        .iter()
        .map(|rate| {
            vec![
                rate.key.splitn(3, '/').nth(2).unwrap_or(&rate.key).to_owned(),
                digits(rate.rate_hz, 2),
                digits(rate.jitter_ms, 2),
                digits(Some(rate.longest_gap_ms), 1),
                digits(Some(rate.bytes_per_s / 1000.0), 2),
                rate.messages.to_string(),
                count(rate.missing),
                count(rate.duplicates),
                if rate.writers.len() > 1 { rate.writers.len().to_string() } else { String::new() },
            ]
        })
        .collect();
    let header =
        ["key", "Hz", "jitter ms", "longest ms", "kB/s", "messages", "missing", "double", "writers, if several"];
    table(&header, rows, 1)
}
