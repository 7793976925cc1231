//! `supertwin list`, `echo` and `hz`: what is alive and what flows.

use crate::cli::{ToolArguments, positive};
use crate::failure::{Failure, INTERRUPTED};
use crate::output;
use crate::tool::{Tool, progress, table};
use clap::Args;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::process::ExitCode;
use std::time::Duration;
use supertwin_lab::Library;
use supertwin_protocol::Heard;
use supertwin_protocol::ledger::{Counts, Ledger};
use supertwin_zenoh::client;

/// Arguments of `list`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin list
  supertwin list --for 5 --json                  also what is seldom published
  supertwin list --connect tcp/192.168.2.2:7447

Exit status: 0 done (also when nobody is up), 2 the call is wrong or there is no router, 130 interrupted.")]
pub(crate) struct ListArguments {
    /// Seconds to listen for keys
    #[arg(long = "for", value_name = "S", default_value = "1.2", value_parser = positive)]
    for_s: f64,

    #[command(flatten)]
    tool: ToolArguments,
}

/// Arguments of `echo`.
#[derive(Debug, Args)]
#[command(mut_arg("json", |json| json.help("Print one JSON object per line")))]
#[command(after_help = "Examples:
  supertwin echo 'event/**'                      what happened so far, and what happens
  supertwin echo estimator/nav --count 1 --json
  supertwin echo 'state/**' --for 10
  supertwin echo 'supertwin/*/health/*'          of all vehicles

Exit status: 0 done or stopped, 1 nothing was heard, 2 the call is wrong or there is no router.")]
pub(crate) struct EchoArguments {
    /// Key below the vehicle's, or a full one from supertwin/ on; * is one part, ** any number
    #[arg(value_name = "KEY")]
    key: String,

    /// End after this many samples
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,

    /// End after this many seconds
    #[arg(long = "for", value_name = "S", value_parser = positive)]
    for_s: Option<f64>,

    #[command(flatten)]
    tool: ToolArguments,
}

/// Arguments of `hz`.
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

/// What of a payload says who sent it, and as which; the rest is not read.
#[derive(Debug, Deserialize)]
struct Stamp {
    source: String,
    #[serde(default)]
    seq: Option<u64>,
}

/// The account of one key.
struct Flow {
    first: Duration,
    last: Duration,
    messages: u64,
    bytes: u64,
    squares_s2: f64,
    longest: Duration,
    writers: BTreeSet<String>,
    ledger: Ledger,
    numbered: bool,
}

impl Flow {
    fn new() -> Self {
        Self {
            first: Duration::ZERO,
            last: Duration::ZERO,
            messages: 0,
            bytes: 0,
            squares_s2: 0.0,
            longest: Duration::ZERO,
            writers: BTreeSet::new(),
            // A second writer that is heard within a second of the first is another, not its successor.
            ledger: Ledger::new(Duration::from_secs(1)),
            numbered: false,
        }
    }

    fn enter(&mut self, heard: &Heard) {
        if self.messages == 0 {
            self.first = heard.at;
        } else {
            let interval = heard.at.saturating_sub(self.last);
            self.longest = self.longest.max(interval);
            self.squares_s2 += interval.as_secs_f64() * interval.as_secs_f64();
        }
        self.last = heard.at;
        self.messages += 1;
        self.bytes += heard.payload.len() as u64;
        if let Ok(stamp) = serde_json::from_slice::<Stamp>(&heard.payload) {
            if let Some(seq) = stamp.seq {
                self.numbered = true;
                self.ledger.enter(&stamp.source, seq, heard.at);
            }
            self.writers.insert(stamp.source);
        }
    }

    fn intervals(&self) -> f64 {
        self.messages.saturating_sub(1) as f64
    }

    fn rate_hz(&self) -> Option<f64> {
        let span_s = (self.last - self.first).as_secs_f64();
        (span_s > 0.0).then(|| self.intervals() / span_s)
    }

    /// Standard deviation of the intervals.
    fn jitter_ms(&self) -> Option<f64> {
        let mean_s = 1.0 / self.rate_hz()?;
        Some((self.squares_s2 / self.intervals() - mean_s * mean_s).max(0.0).sqrt() * 1e3)
    }

    fn counts(&self) -> Option<Counts> {
        self.numbered.then_some(self.ledger.counts)
    }
}

/// Listens until `for_s` seconds have passed or it is interrupted; `each` gets every sample.
fn listen(tool: &Tool, for_s: f64, what: &str, quiet: bool, mut each: impl FnMut(&Heard)) {
    let bar = progress(for_s, what, quiet);
    let began = tool.clock.now();
    let end = tool.after(for_s);
    while tool.clock.now() < end && !tool.stop.interrupted() {
        let slice = (tool.clock.now() + Duration::from_millis(100)).min(end);
        while let Some(heard) = tool.inbox.next(Some(slice)) {
            each(&heard);
            if tool.clock.now() >= slice {
                break;
            }
        }
        bar.set_position((tool.clock.now().saturating_sub(began).as_secs_f64() * 10.0) as u64);
    }
    bar.finish_and_clear();
}

/// Vehicles, services, keys.
pub(crate) fn list(arguments: &ListArguments, library: &Library) -> Result<ExitCode, Failure> {
    let mut tool = Tool::open(&arguments.tool.link, library)?;
    let only = arguments.tool.link.vehicle.as_deref();
    tool.inbox.listen(&tool.session, &format!("supertwin/{}/**", only.unwrap_or("*")))?;
    let mut flows: BTreeMap<String, Flow> = BTreeMap::new();
    listen(&tool, arguments.for_s, "listening for keys", arguments.tool.json, |heard| {
        flows.entry(heard.key.clone()).or_insert_with(Flow::new).enter(heard);
    });
    let mut alive = client::alive(&tool.session)?;
    alive.retain(|(vehicle, ..)| only.is_none_or(|only| only == vehicle));
    let vehicle_of = |key: &str| key.split('/').nth(1).unwrap_or("").to_owned();
    let mut vehicles: BTreeSet<String> = alive.iter().map(|(vehicle, ..)| vehicle.clone()).collect();
    vehicles.extend(flows.keys().map(|key| vehicle_of(key)));
    let listed: Vec<Value> = vehicles
        .iter()
        .map(|vehicle| {
            let theirs = || alive.iter().filter(move |(other, ..)| other == vehicle);
            let services: Vec<Value> = theirs()
                .filter(|(_, service, _)| service != "operator")
                .map(|(_, service, instance)| json!({ "service": service, "instance": instance }))
                .collect();
            let operators: Vec<&String> =
                theirs().filter(|(_, service, _)| service == "operator").map(|(_, _, client)| client).collect();
            let keys: Vec<Value> = flows
                .iter()
                .filter(|(key, _)| vehicle_of(key) == *vehicle)
                .map(|(key, flow)| {
                    let relative = key.splitn(3, '/').nth(2).unwrap_or(key);
                    json!({ "key": relative, "writers": flow.writers, "messages": flow.messages, "bytes": flow.bytes })
                })
                .collect();
            json!({ "vehicle": vehicle, "services": services, "operators": operators, "keys": keys })
        })
        .collect();
    if arguments.tool.json {
        output::print(&json!({ "vehicles": listed, "for_s": arguments.for_s }).to_string());
    } else if listed.is_empty() {
        output::print("nobody is up: start a vehicle with `supertwin up`");
    }
    for vehicle in listed.iter().filter(|_| !arguments.tool.json) {
        output::print(&listed_text(vehicle, arguments.for_s));
    }
    let interrupted = tool.stop.interrupted();
    tool.close();
    Ok(if interrupted { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS })
}

fn listed_text(vehicle: &Value, for_s: f64) -> String {
    let text = |value: &Value| value.as_str().unwrap_or("").to_owned();
    let items = |name: &str| vehicle[name].as_array().cloned().unwrap_or_default();
    let services = items("services").iter().map(|one| vec![text(&one["service"]), text(&one["instance"])]).collect();
    let keys = items("keys")
        .iter()
        .map(|flow| {
            let writers: Vec<String> = flow["writers"].as_array().into_iter().flatten().map(text).collect();
            vec![text(&flow["key"]), writers.join(", "), flow["messages"].to_string(), flow["bytes"].to_string()]
        })
        .collect();
    let operators: Vec<String> = items("operators").iter().map(text).collect();
    let by = if operators.is_empty() { String::new() } else { format!("\noperators: {}", operators.join(", ")) };
    format!(
        "{}{by}\n\n{}\n\n{}\n",
        text(&vehicle["vehicle"]),
        table(&["service", "instance"], services, 2),
        table(&["key", "writer", &format!("in {for_s} s"), "bytes"], keys, 2)
    )
}

/// What is published on a key.
pub(crate) fn echo(arguments: &EchoArguments, library: &Library) -> Result<ExitCode, Failure> {
    let mut tool = Tool::open(&arguments.tool.link, library)?;
    let key = tool.key(&arguments.tool.link, &arguments.key)?;
    // Only listeners of events and nothing else ask for the past: a pattern such as ** would fetch it in the middle
    // of everything else.
    let end = arguments.for_s.map(|for_s| tool.after(for_s));
    let mut past = VecDeque::new();
    if key.split('/').nth(2) == Some("event") {
        tool.inbox.listen_events(&tool.session, &key)?;
        past = history(&tool, end);
    } else {
        tool.inbox.listen(&tool.session, &key)?;
    }
    let mut shown = 0;
    while arguments.count.is_none_or(|count| shown < count) {
        let Some(heard) = past.pop_front().or_else(|| tool.inbox.next(end)) else { break };
        output::print(&if arguments.tool.json { sample_json(&heard).to_string() } else { sample_text(&heard) });
        shown += 1;
    }
    let (lost, interrupted) = (tool.inbox.lost(), tool.stop.interrupted());
    if lost > 0 {
        output::warn(&format!("warning: {lost} samples are not shown: they came faster than they could be printed"));
    }
    tool.close();
    if shown == 0 && !interrupted {
        return Err(nothing(&key, arguments.for_s.unwrap_or(0.0)));
    }
    Ok(ExitCode::SUCCESS)
}

/// Past events arrive service by service: waits for all of them and puts them in the order in which they happened.
fn history(tool: &Tool, end: Option<Duration>) -> VecDeque<Heard> {
    let last = tool.after(1.0).min(end.unwrap_or(Duration::MAX));
    let mut past = Vec::new();
    while let Some(heard) = tool.inbox.next(Some(tool.after(if past.is_empty() { 1.0 } else { 0.15 }).min(last))) {
        past.push(heard);
    }
    past.sort_by_key(|heard| {
        serde_json::from_slice::<Value>(&heard.payload).ok().and_then(|value| value["clock_ns"].as_u64())
    });
    past.into()
}

fn nothing(key: &str, for_s: f64) -> Failure {
    Failure::Verdict(format!("{key}: nothing was heard in {for_s} s; `supertwin list` shows the keys that flow"))
}

fn sample_json(heard: &Heard) -> Value {
    if heard.gone {
        return json!({ "key": heard.key, "deleted": true });
    }
    match serde_json::from_slice::<Value>(&heard.payload) {
        Ok(value) => json!({ "key": heard.key, "value": value }),
        Err(_) => json!({ "key": heard.key, "text": String::from_utf8_lossy(&heard.payload) }),
    }
}

fn sample_text(heard: &Heard) -> String {
    let key = heard.key.splitn(3, '/').nth(2).unwrap_or(&heard.key);
    if heard.gone {
        return format!("{key}  deleted");
    }
    let Ok(value) = serde_json::from_slice::<Value>(&heard.payload) else {
        let text: String = String::from_utf8_lossy(&heard.payload).chars().filter(|c| !c.is_control()).collect();
        return format!("{key}  {text}");
    };
    let (tick, data) = (value["tick"].as_u64(), &value["data"]);
    match (tick, data["severity"].as_str(), data["text"].as_str()) {
        (Some(_), Some(severity), Some(text)) => {
            let t_s = value["sim_time_s"].as_f64().unwrap_or(0.0);
            format!("{t_s:9.2} s  {severity:<7}  {}: {text}", data["service"].as_str().unwrap_or(key))
        }
        (Some(tick), ..) if !data.is_null() => {
            format!("{key}  tick {tick}  seq {}  {data}", value["seq"])
        }
        _ => format!("{key}  {value}"),
    }
}

/// One key in the answer of `hz`.
#[derive(Debug, Serialize)]
struct Rate {
    key: String,
    writers: BTreeSet<String>,
    messages: u64,
    rate_hz: Option<f64>,
    jitter_ms: Option<f64>,
    longest_gap_ms: f64,
    bytes_per_s: f64,
    missing: Option<u64>,
    duplicates: Option<u64>,
    rivals: Option<u64>,
}

/// Rates.
pub(crate) fn hz(arguments: &HzArguments, library: &Library) -> Result<ExitCode, Failure> {
    let mut tool = Tool::open(&arguments.tool.link, library)?;
    let key = tool.key(&arguments.tool.link, &arguments.key)?;
    tool.inbox.listen(&tool.session, &key)?;
    let began = tool.clock.now();
    let mut flows: BTreeMap<String, Flow> = BTreeMap::new();
    listen(&tool, arguments.for_s, &format!("listening to {key}"), arguments.tool.json, |heard| {
        flows.entry(heard.key.clone()).or_insert_with(Flow::new).enter(heard);
    });
    let listened_s = tool.clock.now().saturating_sub(began).as_secs_f64();
    let (lost, interrupted) = (tool.inbox.lost(), tool.stop.interrupted());
    tool.close();
    if lost > 0 {
        output::warn(&format!("warning: {lost} samples came faster than they could be counted: gaps are ours"));
    }
    if flows.is_empty() && !interrupted {
        return Err(nothing(&key, arguments.for_s));
    }
    let rates: Vec<Rate> = flows
        .into_iter()
        .map(|(key, flow)| Rate {
            key,
            messages: flow.messages,
            rate_hz: flow.rate_hz(),
            jitter_ms: flow.jitter_ms(),
            longest_gap_ms: flow.longest.as_secs_f64() * 1e3,
            bytes_per_s: flow.bytes as f64 / listened_s,
            missing: flow.counts().map(|counts| counts.missing),
            duplicates: flow.counts().map(|counts| counts.duplicates),
            rivals: flow.counts().map(|counts| counts.rivals),
            writers: flow.writers,
        })
        .collect();
    output::print(&if arguments.tool.json {
        json!({ "for_s": listened_s, "keys": rates }).to_string()
    } else {
        rates_text(&rates)
    });
    Ok(if interrupted { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS })
}

fn rates_text(rates: &[Rate]) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(at_ms: u64, payload: &str) -> Heard {
        Heard {
            key: "supertwin/a/estimator/nav".to_owned(),
            payload: payload.as_bytes().to_vec(),
            gone: false,
            at: Duration::from_millis(at_ms),
        }
    }

    #[test]
    fn a_flow_counts_rate_jitter_and_gaps() {
        let mut flow = Flow::new();
        for (at_ms, seq) in [(0, 1), (20, 2), (40, 3), (60, 3), (100, 6)] {
            flow.enter(&heard(at_ms, &format!(r#"{{"source":"estimator-1","seq":{seq},"tick":0,"data":{{}}}}"#)));
        }
        assert_eq!(flow.rate_hz(), Some(40.0));
        let jitter_ms = flow.jitter_ms().expect("several");
        assert!((jitter_ms - 75.0_f64.sqrt()).abs() < 1e-9, "{jitter_ms}");
        assert_eq!(flow.longest, Duration::from_millis(40));
        let counts = flow.counts().expect("numbered");
        assert_eq!((counts.missing, counts.duplicates), (2, 1));
        let mut single = Flow::new();
        single.enter(&heard(5, "not JSON"));
        assert_eq!((single.rate_hz(), single.jitter_ms(), single.counts()), (None, None, None));
    }

    #[test]
    fn samples_are_one_line_whatever_they_are() {
        let event = r#"{"tick":50,"seq":2,"source":"plant-1","sim_time_s":1.0,
            "data":{"tick":50,"service":"plant","severity":"warning","text":"late"}}"#;
        assert_eq!(sample_text(&heard(0, event)), "     1.00 s  warning  plant: late");
        let nav = r#"{"tick":50,"seq":2,"source":"e","data":{"depth_m":1.5}}"#;
        assert_eq!(sample_text(&heard(0, nav)), r#"estimator/nav  tick 50  seq 2  {"depth_m":1.5}"#);
        assert_eq!(sample_text(&heard(0, "a\nb")), "estimator/nav  ab");
        assert_eq!(sample_json(&heard(0, "\u{1}x"))["text"], "\u{1}x");
    }
}
