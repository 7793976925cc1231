//! `supertwin top`: services, rates, ages, gaps, step times, live.

use crate::cli::ToolArguments;
use crate::failure::Failure;
use crate::output;
use crate::tool::{Tool, table};
use clap::Args;
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::process::ExitCode;
use std::time::Duration;
use supertwin_lab::Library;
use supertwin_protocol::{Health, Heard, keys};

/// Arguments of `top`.
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

/// Health comes once a second; a rate needs two.
const FIRST_WAIT_S: f64 = 3.0;
/// Without health for this long a service that is alive counts as silent.
const SILENT: Duration = Duration::from_millis(2500);

/// What is known of one instance of a service.
#[derive(Debug, Default)]
struct Row {
    service: String,
    instance: String,
    alive: bool,
    gone_at: Option<Duration>,
    heard_at: Option<Duration>,
    health: Option<Health>,
    rate_hz: Option<f64>,
}

/// One line of the table, as JSON.
#[derive(Debug, Serialize)]
struct Line<'a> {
    service: &'a str,
    instance: &'a str,
    status: &'static str,
    silent_s: Option<f64>,
    rate_hz: Option<f64>,
    health: Option<&'a Health>,
}

impl Row {
    fn heard(&mut self, health: Health, at: Duration) {
        if let Some(before) = &self.health
            && before.run == health.run
            && health.clock_ns > before.clock_ns
        {
            // By the sender's own clock: the way here may vary.
            let passed_s = (health.clock_ns - before.clock_ns) as f64 / 1e9;
            self.rate_hz = Some(health.tick.saturating_sub(before.tick) as f64 / passed_s);
        }
        (self.health, self.heard_at) = (Some(health), Some(at));
    }

    fn status(&self, now: Duration) -> &'static str {
        let silent = self.heard_at.is_none_or(|at| now.saturating_sub(at) > SILENT);
        match (self.alive, silent) {
            (false, _) => "gone",
            (true, true) => "silent",
            (true, false) => "up",
        }
    }

    fn line(&self, now: Duration) -> Line<'_> {
        let since = if self.alive { self.heard_at } else { self.gone_at };
        Line {
            service: &self.service,
            instance: &self.instance,
            status: self.status(now),
            silent_s: since.map(|at| now.saturating_sub(at).as_secs_f64()),
            rate_hz: self.rate_hz,
            health: self.health.as_ref(),
        }
    }

    fn cells(&self, now: Duration) -> Vec<String> {
        let mut cells = vec![self.service.clone(), self.instance.chars().take(8).collect()];
        let status = match (self.status(now), self.gone_at) {
            ("gone", Some(at)) => format!("gone {:.0} s", now.saturating_sub(at).as_secs_f64()),
            (status, _) => status.to_owned(),
        };
        cells.push(status);
        let Some(health) = &self.health else { return cells };
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
            self.rate_hz.map_or("-".to_owned(), |rate| format!("{rate:.1}")),
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
}

/// The services of one vehicle by name and instance.
#[derive(Debug, Default)]
struct Board(BTreeMap<(String, String), Row>);

impl Board {
    fn row(&mut self, service: &str, instance: &str) -> &mut Row {
        self.0.entry((service.to_owned(), instance.to_owned())).or_insert_with(|| Row {
            service: service.to_owned(),
            instance: instance.to_owned(),
            ..Row::default()
        })
    }

    fn enter(&mut self, heard: &Heard) {
        let mut parts = heard.key.split('/').skip(2);
        match (parts.next(), parts.next(), parts.next()) {
            (Some("alive"), Some(service), Some(instance)) if service != "operator" => {
                let row = self.row(service, instance);
                row.alive = !heard.gone;
                row.gone_at = heard.gone.then_some(heard.at);
            }
            (Some("health"), Some(service), _) => {
                if let Ok(health) = serde_json::from_slice::<Health>(&heard.payload)
                    && let Some(instance) = health.source.strip_prefix(service).and_then(|rest| rest.strip_prefix('-'))
                {
                    let instance = instance.to_owned();
                    self.row(service, &instance).heard(health, heard.at);
                }
            }
            _ => {}
        }
    }

    /// Everybody who is alive has said enough for a rate.
    fn complete(&self) -> bool {
        !self.0.is_empty() && self.0.values().all(|row| !row.alive || row.rate_hz.is_some())
    }
}

/// Health of all services, live.
pub(crate) fn top(arguments: &TopArguments, library: &Library) -> Result<ExitCode, Failure> {
    let mut tool = Tool::open(&arguments.tool.link, library)?;
    let vehicle = tool.vehicle(arguments.tool.link.vehicle.as_deref())?;
    let prefix = keys::namespace(&vehicle);
    tool.inbox.listen(&tool.session, &format!("{prefix}/{}", keys::health("*")))?;
    tool.inbox.listen_alive(&tool.session, &format!("{prefix}/{}", keys::alive("*", "*")))?;
    let terminal = std::io::stdout().is_terminal() && !arguments.tool.json;
    let count = arguments.count.or((!terminal).then_some(1));
    let mut board = Board::default();
    let first = tool.after(FIRST_WAIT_S);
    if std::io::stderr().is_terminal() && !arguments.tool.json {
        output::warn(&format!("{vehicle}: waiting for the services to say how they are …"));
    }
    while !board.complete()
        && let Some(heard) = tool.inbox.next(Some(first))
    {
        board.enter(&heard);
    }
    if board.0.is_empty() && !tool.stop.interrupted() {
        tool.close();
        return Err(Failure::Verdict(format!("{vehicle}: no service is up; start them with `supertwin up`")));
    }
    let mut shown = 0;
    while !tool.stop.interrupted() {
        show(&board, &vehicle, tool.clock.now(), arguments.tool.json, terminal);
        shown += 1;
        if count.is_some_and(|count| shown >= count) {
            break;
        }
        let next = tool.after(1.0);
        while let Some(heard) = tool.inbox.next(Some(next)) {
            board.enter(&heard);
        }
    }
    tool.close();
    Ok(ExitCode::SUCCESS)
}

fn show(board: &Board, vehicle: &str, now: Duration, as_json: bool, terminal: bool) {
    if as_json {
        let lines: Vec<Line<'_>> = board.0.values().map(|row| row.line(now)).collect();
        return output::print(&json!({ "vehicle": vehicle, "services": lines }).to_string());
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
    let rows = board.0.values().map(|row| row.cells(now)).collect();
    // Home, then clear below: what stays the same does not flicker.
    let clear = if terminal { "\u{1b}[H\u{1b}[2J" } else { "" };
    output::print(&format!("{clear}{vehicle}\n\n{}", table(&header, rows, 4)));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(key: &str, payload: Vec<u8>, gone: bool) -> Heard {
        Heard { key: key.to_owned(), payload, gone, at: Duration::from_secs(1) }
    }

    #[test]
    fn a_service_comes_speaks_and_goes() {
        let mut board = Board::default();
        let alive = "supertwin/a/alive/plant/1";
        board.enter(&heard(alive, Vec::new(), false));
        board.enter(&heard("supertwin/a/alive/operator/anna", Vec::new(), false));
        assert!(!board.complete());
        for (tick, clock_ns) in [(100, 1_000_000_000), (150, 2_000_000_000)] {
            let health =
                Health { run: "r".to_owned(), source: "plant-1".to_owned(), tick, clock_ns, ..Health::default() };
            let payload = serde_json::to_vec(&health).expect("JSON");
            board.enter(&heard("supertwin/a/health/plant", payload, false));
        }
        assert!(board.complete() && board.0.len() == 1);
        let row = |board: &Board| board.0.values().next().map(|row| row.cells(Duration::from_secs(2))).expect("one");
        assert_eq!(row(&board)[2..6], ["up", "r", "150", "50.0"]);
        board.enter(&heard(alive, Vec::new(), true));
        assert_eq!(row(&board)[2], "gone 1 s");
    }
}
