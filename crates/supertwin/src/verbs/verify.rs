//! `supertwin verify`: the same bits in one process, in separate processes, and over a bad link.

use crate::arguments::{TrialsArguments, positive};
use crate::terminal::{self, Bar, INTERRUPTED};
use clap::Args;
use serde::Serialize;
use std::process::{Command, ExitCode};
use std::sync::atomic::Ordering;
use supertwin_lab::Library;
use supertwin_operations::OperationError;
use supertwin_operations::verify::{self, PlacementCheck, ServiceProcess, VerifyOptions, WITNESS};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin verify                               the paper's three trials, 60 s each
  supertwin verify paper-agsta --duration 10
  supertwin verify --router tcp/127.0.0.1:7447   over a router that runs already, such as a stock zenohd

Each trial runs in one process; as four processes in lock step, connected only through a router; and again with a
tenth of all messages lost and a tenth sent twice.
Exit status: 0 the same bits everywhere, 1 not, 2 the call or its input is wrong, 130 interrupted.")]
pub(crate) struct VerifyArguments {
    #[command(flatten)]
    trials: TrialsArguments,

    /// Simulated seconds
    #[arg(long, value_name = "S", default_value = "60", value_parser = positive)]
    duration: f64,

    /// Use this router instead of starting one
    #[arg(long, value_name = "ENDPOINT")]
    router: Option<String>,

    /// Print one JSON object instead of a table
    #[arg(long)]
    json: bool,
}

/// The JSON object of `--json`.
#[derive(Debug, Serialize)]
struct Report<'a> {
    equal: bool,
    rows: &'a [PlacementCheck],
}

/// Verifies the trials and prints where they were equal.
pub(crate) fn verify(arguments: &VerifyArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let stop = terminal::stop_flag(|| {})?;
    let trials = arguments.trials.load(library)?;
    let program = std::env::current_exe()
        .map_err(|cause| OperationError::Option(format!("this program can't be found: {cause}")))?;
    let command = |process: Option<&ServiceProcess<'_>>| {
        let mut command = Command::new(&program);
        command.args(words(process, library));
        command
    };
    let router = arguments.router.clone();
    let options = VerifyOptions { duration_s: arguments.duration, router, command: &command };
    let checks = verify::verify(&trials, &options, &stop, &Bar::new(arguments.json))?;
    if stop.load(Ordering::Relaxed) {
        return Ok(ExitCode::from(INTERRUPTED));
    }
    let equal = verify::is_equal(&checks);
    report(&checks, equal, arguments.json)?;
    Ok(if equal { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// The words of this program that start a process.
fn words(process: Option<&ServiceProcess<'_>>, library: &Library) -> Vec<String> {
    let mut words = vec!["--config".to_owned(), library.root.display().to_string()];
    for set in &library.overrides {
        words.extend(["--set".to_owned(), set.text.clone()]);
    }
    let Some(process) = process else {
        words.extend(["serve", "router", "--listen", "tcp/127.0.0.1:0", "--json"].map(str::to_owned));
        return words;
    };
    words.extend(["serve", process.service, "--pace", "lockstep", "--connect", process.endpoint].map(str::to_owned));
    words.extend(["--vehicle", process.vehicle, "--controller", &process.trial.controller_name].map(str::to_owned));
    words.extend(["--trial".to_owned(), process.trial.path.display().to_string()]);
    words.extend(["--duration".to_owned(), process.duration_s.to_string()]);
    if process.service == "plant" {
        words.extend(["--witness", WITNESS].map(str::to_owned));
    }
    if let Some((drop, double)) = process.faults {
        words.push(format!("--fault-drop={drop}"));
        words.push(format!("--fault-double={double}"));
    }
    words
}

fn report(checks: &[PlacementCheck], equal: bool, json: bool) -> Result<(), OperationError> {
    if json {
        return terminal::print_json(&Report { equal, rows: checks });
    }
    let mut table = terminal::framed_table(["trial", "placement", "state hash", "ticks", "laps/s"]);
    for row in checks {
        let hash = row.hash.clone().unwrap_or_else(|| "differs".to_owned());
        let laps = format!("{:.0}", row.laps_per_s);
        table.add_row([row.trial.clone(), row.placement.to_owned(), hash, row.ticks.to_string(), laps]);
    }
    terminal::print(&terminal::aligned(table, 3..));
    for row in checks {
        if let Some(d) = &row.first_difference {
            terminal::print(&format!(
                "{}, {}: differs first at tick {} in {} ({}): {} here, {} there",
                row.trial, row.placement, d.tick, d.signal, d.service, d.here, d.there
            ));
        }
        if let Some(error) = &row.error {
            terminal::print(&format!("{}, {}: {error}", row.trial, row.placement));
        }
    }
    terminal::print(if equal { "Equal: the same bits at every tick." } else { "Not equal." });
    Ok(())
}
