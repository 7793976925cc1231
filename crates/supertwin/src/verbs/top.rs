//! `supertwin top`: services, rates, ages, gaps, step times, live.

use crate::arguments::ToolArguments;
use crate::terminal::{self, table};
use clap::Args;
use serde_json::json;
use std::io::IsTerminal;
use std::process::ExitCode;
use supertwin_lab::Library;
use supertwin_operations::OperationError;
use supertwin_operations::service_board::{ServiceBoard, ServiceLine};

#[derive(Debug, Args)]
#[command(mut_arg("json", |json| json.help("Print one JSON object per snapshot")))]
#[command(after_help = "Examples:
  supertwin top                                  redraws every second; Ctrl-C ends it
  supertwin top --json                           one snapshot as JSON
  supertwin top --count 60 --json > health.jsonl a minute, one object per line

Columns: age: greatest age of an input at a step, in ticks, during the last second; missing, double, late: messages
of all inputs since the start; step: microseconds; misses: ticks that began too late to be sent.
Exit status: 0 done or stopped, 1 nobody is up, 2 the call is wrong or there is no router.")]
pub(crate) struct TopArguments {
    /// End after this many snapshots [default: on a terminal: never; else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,

    #[command(flatten)]
    tool: ToolArguments,
}

/// Shows how the services are, second by second.
pub(crate) fn top(arguments: &TopArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let mut network = arguments.tool.link.join(library)?;
    let vehicle = network.vehicle(arguments.tool.link.vehicle.as_deref())?;
    let terminal = std::io::stdout().is_terminal() && !arguments.tool.json;
    let count = arguments.count.or((!terminal).then_some(1));
    if std::io::stderr().is_terminal() && !arguments.tool.json {
        terminal::warn(&format!("{vehicle}: waiting for the services to say how they are …"));
    }
    let mut board = ServiceBoard::open(&mut network, &vehicle)?;
    let mut shown = 0;
    while !network.stop.interrupted() {
        show(&board.lines(network.clock.now()), &vehicle, arguments.tool.json, terminal);
        shown += 1;
        if count.is_some_and(|count| shown >= count) {
            break;
        }
        board.listen(&network, 1.0);
    }
    network.close();
    Ok(ExitCode::SUCCESS)
}

fn show(lines: &[ServiceLine<'_>], vehicle: &str, as_json: bool, terminal: bool) {
    if as_json {
        return terminal::print(&json!({ "vehicle": vehicle, "services": lines }).to_string());
    }
    let header = [
        "service",
        "instance",
        "status",
        "run",
        "tick",
        "Hz",
        "age",
        "missing",
        "double",
        "late",
        "step p50/p99",
        "misses",
        "overflow",
        "commands ok/refused",
    ];
    let rows = lines.iter().map(cells).collect();
    // Home, then clear below: what stays the same does not flicker.
    let clear = if terminal { "\u{1b}[H\u{1b}[2J" } else { "" };
    terminal::print(&format!("{clear}{vehicle}\n\n{}", table(&header, rows, 4)));
}

fn cells(line: &ServiceLine<'_>) -> Vec<String> {
    let mut cells = vec![line.service.to_owned(), line.instance.chars().take(8).collect()];
    let status = match (line.status, line.silent_s) {
        ("gone", Some(s)) => format!("gone {s:.0} s"),
        (status, _) => status.to_owned(),
    };
    cells.push(status);
    let Some(health) = line.health else { return cells };
    let sum = |of: &dyn Fn(&supertwin_protocol::InputHealth) -> u64| -> String {
        health.inputs.values().map(of).sum::<u64>().to_string()
    };
    let oldest = health.inputs.iter().max_by_key(|(_, input)| input.age_ticks_max);
    let age = oldest.map_or("-".to_owned(), |(key, input)| match input.age_ticks_max {
        0 => "0".to_owned(),
        age => format!("{age} {}", key.rsplit('/').next().unwrap_or(key)),
    });
    let [median, p99, _] = health.step_us;
    cells.extend([
        health.run.clone(),
        health.tick.to_string(),
        line.rate_hz.map_or("-".to_owned(), |rate| format!("{rate:.1}")),
        age,
        sum(&|input| input.counts.missing),
        sum(&|input| input.counts.duplicates),
        sum(&|input| input.counts.late),
        format!("{median:.0}/{p99:.0}"),
        health.deadline_misses.to_string(),
        (health.overflow[0] + health.overflow[1] + health.telemetry_dropped + health.letters_dropped).to_string(),
        format!("{}/{}", health.commands.applied, health.commands.refused),
    ]);
    cells
}
