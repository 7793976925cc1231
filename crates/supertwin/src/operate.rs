//! `supertwin set` and `supertwin get`: commands and parameters, with acknowledgement.

use crate::cli::{ToolArguments, positive};
use crate::failure::{Failure, INTERRUPTED};
use crate::output;
use crate::tool::{SERVICES, Tool, progress, table};
use clap::Args;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;
use supertwin_lab::Library;
use supertwin_protocol::keys;
use supertwin_protocol::lease::LeaseAction;
use supertwin_protocol::payload::Now;
use supertwin_zenoh::{Client, ClientError, Presence, diagnose};

/// Arguments of `set`.
#[derive(Debug, Args)]
#[command(after_help = "Names:
  mode                       neutral, depth_heading_hold, follow_net
  depth_m  heading_rad       set-points; a number, or a profile in JSON: ramp, sine
  net_distance_m  speed_m_per_s
  direction                  starboard, port
  law NAME                   another of the trial's control laws, without a jump in the wrench
  neutral                    true: no force at once, asks for no authority; false: ends it
  estimator restart          forget everything and start from the next measurements
  dvl_silent_for_s SECONDS   the DVL fails
  thruster_gain JSON         e.g. '{\"thruster\":1,\"gain\":0.5}'
  SERVICE.PATH               a parameter, as `supertwin get` lists them

Examples:
  supertwin set depth_m 5
  supertwin set mode follow_net net_distance_m 2 speed_m_per_s 0.3      all at the same tick
  supertwin set depth_m '{\"ramp\":{\"to\":5,\"over_s\":20}}'
  supertwin set controller.law.agsta.beta.surge 4
  supertwin set neutral true                     emergency

Takes the authority, sends, gives it back, and waits until everything has applied.
Exit status: 0 applied, 1 refused or not applied in time, 2 the call is wrong or there is no router, 130 interrupted.")]
pub(crate) struct SetArguments {
    /// Names and values, in turn
    #[arg(value_name = "NAME VALUE", required = true, num_args = 2.., allow_negative_numbers = true)]
    pairs: Vec<String>,

    /// Seconds to wait until it has applied
    #[arg(long, value_name = "S", default_value = "5", value_parser = positive, conflicts_with = "no_wait")]
    wait: f64,

    /// Leave as soon as the services have said when it will apply
    #[arg(long)]
    no_wait: bool,

    #[command(flatten)]
    tool: ToolArguments,
}

/// Arguments of `get`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin get                                  everything
  supertwin get controller                       all parameters of a service
  supertwin get controller.law.agsta.beta --json
  supertwin get depth_m                          the last command of this name that applied
  supertwin get lease                            who has the authority

Exit status: 0 done, 1 there is no such thing or nobody is up, 2 the call is wrong or there is no router.")]
pub(crate) struct GetArguments {
    /// A service, SERVICE.PATH of a parameter, the name of a command, or `lease` [default: everything]
    #[arg(value_name = "NAME")]
    name: Option<String>,

    #[command(flatten)]
    tool: ToolArguments,
}

/// How long the authority is asked for; it is given back as soon as everything has been said.
const LEASE_S: f64 = 30.0;
/// Between two looks at the states of a service, in case its event was lost on the way.
const LOOK: Duration = Duration::from_millis(500);
/// Commands that are not parameters: name, service.
const COMMANDS: [(&str, &str); 10] = [
    ("mode", "guidance"),
    ("depth_m", "guidance"),
    ("heading_rad", "guidance"),
    ("net_distance_m", "guidance"),
    ("speed_m_per_s", "guidance"),
    ("direction", "guidance"),
    ("law", "controller"),
    ("neutral", "controller"),
    ("dvl_silent_for_s", "plant"),
    ("thruster_gain", "plant"),
];

/// One pair of the command line.
#[derive(Clone, Debug, PartialEq)]
struct Order {
    said: String,
    service: &'static str,
    what: What,
    value: Value,
}

#[derive(Clone, Debug, PartialEq)]
enum What {
    Command(String),
    Parameter(String),
}

impl Order {
    fn read(name: &str, value: &str) -> Result<Self, Failure> {
        let order =
            |service: &'static str, what: What, value: Value| Ok(Self { said: name.to_owned(), service, what, value });
        if name == "estimator" && value == "restart" {
            return order("estimator", What::Command("restart".to_owned()), Value::Null);
        }
        if let Some((_, service)) = COMMANDS.iter().find(|(known, _)| *known == name) {
            return order(service, What::Command(name.to_owned()), read_value(name, value)?);
        }
        if let Some((service, path)) = name.split_once('.')
            && let Some(service) = SERVICES.iter().find(|known| **known == service)
            && path.split('.').all(|part| !part.is_empty() && !part.contains(['/', '*', '$', '#', '?']))
        {
            return order(service, What::Parameter(path.to_owned()), read_value(name, value)?);
        }
        let names: Vec<&str> = COMMANDS.iter().map(|(name, _)| *name).collect();
        let names = names.join(", ");
        Err(Failure::Call(format!(
            "NAME {name}: must be one of {names}, `estimator restart`, or SERVICE.PATH of a parameter (see `supertwin get`)"
        )))
    }

    /// No force at once: anybody may ask for it.
    fn emergency(&self) -> bool {
        self.what == What::Command("neutral".to_owned()) && self.value == Value::Bool(true)
    }

    /// Name of the state that shows it.
    fn state(&self) -> String {
        match &self.what {
            What::Command(name) => name.clone(),
            What::Parameter(path) => format!("parameter.{path}"),
        }
    }
}

/// JSON if it looks like it, else a word.
fn read_value(name: &str, text: &str) -> Result<Value, Failure> {
    match serde_json::from_str(text) {
        Ok(value) => Ok(value),
        Err(cause) if text.starts_with(['{', '[', '"']) => {
            Err(Failure::Call(format!("{name} {text}: is no JSON: {cause}")))
        }
        Err(_) => Ok(Value::String(text.to_owned())),
    }
}

/// What became of an order.
#[derive(Clone, Debug, Serialize)]
struct Outcome {
    name: String,
    service: &'static str,
    value: Value,
    /// `applied`, `scheduled`, `refused`, `unanswered`.
    status: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    apply_tick: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    applied_tick: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
    #[serde(skip)]
    seq: u64,
    #[serde(skip)]
    state: String,
}

/// Commands and parameters.
pub(crate) fn set(arguments: &SetArguments, library: &Library) -> Result<ExitCode, Failure> {
    let [pairs @ .., _] = arguments.pairs.as_slice() else { return Ok(ExitCode::SUCCESS) };
    if pairs.len().is_multiple_of(2) {
        let last = &arguments.pairs[pairs.len()];
        return Err(Failure::Call(format!("NAME {last}: has no value; names and values come in turn")));
    }
    let orders: Vec<Order> =
        arguments.pairs.chunks_exact(2).map(|pair| Order::read(&pair[0], &pair[1])).collect::<Result<_, _>>()?;
    let mut tool = Tool::open(&arguments.tool.link, library)?;
    let vehicle = tool.vehicle(arguments.tool.link.vehicle.as_deref())?;
    let name = format!("cli-{}", supertwin_zenoh::unique());
    // Before anything is sent: no acknowledgement may come too early.
    tool.inbox.listen(&tool.session, &format!("{}/{}", keys::namespace(&vehicle), keys::event("*")))?;
    let mut client = Client::new(tool.session.clone(), &vehicle, &name, Arc::clone(&tool.clock));
    let mut outcomes = send(&tool, &mut client, &orders)?;
    if !arguments.no_wait {
        wait(&tool, &client, &mut outcomes, arguments)?;
    }
    let interrupted = tool.stop.interrupted();
    tool.close();
    if arguments.tool.json {
        output::print(&json!({ "vehicle": vehicle, "client": name, "commands": outcomes }).to_string());
    }
    let mut code = ExitCode::SUCCESS;
    for outcome in &outcomes {
        let (name, value) = (&outcome.name, &outcome.value);
        let what = if value.is_null() { format!("{name} restart") } else { format!("{name} {value}") };
        let tick = outcome.apply_tick.unwrap_or(0);
        let text = match outcome.status {
            "applied" => format!("{what}: applied at tick {}", outcome.applied_tick.unwrap_or(tick)),
            "scheduled" if arguments.no_wait => format!("{what}: applies at tick {tick}"),
            "scheduled" if interrupted => {
                output::warn(&format!("interrupted: {what} applies at tick {tick}"));
                code = ExitCode::from(INTERRUPTED);
                continue;
            }
            "scheduled" => {
                let wait_s = arguments.wait;
                output::warn(&format!("error: {what}: scheduled for tick {tick}, not seen to apply within {wait_s} s"));
                code = ExitCode::from(1);
                continue;
            }
            status => {
                let reason = outcome.reason.as_deref().unwrap_or("");
                let status = if status == "refused" { "refused: " } else { "" };
                output::warn(&format!("error: {what}: {status}{reason}"));
                code = ExitCode::from(1);
                continue;
            }
        };
        if !arguments.tool.json {
            output::print(&text);
        }
    }
    Ok(code)
}

/// Sends everything: emergencies at once, the rest under the authority and, when several, for one tick.
fn send(tool: &Tool, client: &mut Client, orders: &[Order]) -> Result<Vec<Outcome>, Failure> {
    let mut outcomes: Vec<Option<Outcome>> = vec![None; orders.len()];
    for (outcome, order) in outcomes.iter_mut().zip(orders).filter(|(_, order)| order.emergency()) {
        *outcome = Some(one(client, order, None)?);
    }
    let rest = orders.iter().filter(|order| !order.emergency()).count();
    if rest > 0 && !tool.stop.interrupted() {
        let presence = Presence::show(&tool.session, &client.key(&keys::operator(client.name())))?;
        let before = next_tick(tool, client)?;
        client.acquire(LEASE_S)?;
        let sent: Result<(), Failure> = (|| {
            let at_tick = if rest > 1 { shared_tick(before, next_tick(tool, client)?, rest) } else { None };
            for (outcome, order) in outcomes.iter_mut().zip(orders).filter(|(_, order)| !order.emergency()) {
                if tool.stop.interrupted() {
                    break;
                }
                *outcome = Some(one(client, order, at_tick)?);
            }
            Ok(())
        })();
        // The vehicle goes on with what it was told; nobody has to wait for us any longer. Presence goes after the
        // lease: a client that vanishes while it holds the authority is a lost operator.
        let released = client.lease(LeaseAction::Release, 0.0);
        drop(presence);
        if let Err(cause) = released {
            output::warn(&format!("warning: the authority could not be given back, and ends by itself: {cause}"));
        }
        sent?;
    }
    Ok(outcomes.into_iter().flatten().collect())
}

/// The next tick of the service that is farthest; `None` when none says.
fn next_tick(tool: &Tool, client: &Client) -> Result<Option<u64>, Failure> {
    let answers = diagnose::ask_all(&tool.session, &client.key(&keys::state("*", "now")))?;
    let nows = answers.into_iter().filter_map(|(_, value)| serde_json::from_value::<Now>(value).ok());
    Ok(nows.map(|now| now.next).max())
}

/// A tick by which `n` commands will have arrived, judged by how many passed between two questions.
fn shared_tick(before: Option<u64>, now: Option<u64>, n: usize) -> Option<u64> {
    let (before, now) = (before?, now?);
    // A question and the lease took `passed` ticks; a command takes about half of that, and may be repeated.
    let passed = now.saturating_sub(before);
    Some(now + 10 + 2 * (passed + 2) * (n as u64 + 1))
}

fn one(client: &mut Client, order: &Order, at_tick: Option<u64>) -> Result<Outcome, Failure> {
    let value = order.value.clone();
    let answer = match &order.what {
        What::Command(name) => client.command(order.service, name, value, at_tick),
        What::Parameter(path) => client.set_parameter_at(order.service, path, value, at_tick),
    };
    let (status, apply_tick, reason) = match answer {
        Ok(tick) => ("scheduled", Some(tick), None),
        Err(ClientError::Refused(reason)) => ("refused", None, Some(reason)),
        Err(error @ (ClientError::NoAnswer { .. } | ClientError::Strange { .. })) => {
            ("unanswered", None, Some(error.to_string()))
        }
        Err(error) => return Err(error.into()),
    };
    Ok(Outcome {
        name: order.said.clone(),
        service: order.service,
        value: order.value.clone(),
        status,
        apply_tick,
        applied_tick: None,
        reason,
        seq: client.last_seq(),
        state: order.state(),
    })
}

/// An event, as far as acknowledgements need it.
#[derive(Debug, Deserialize)]
struct Said {
    data: SaidEvent,
}

#[derive(Debug, Deserialize)]
struct SaidEvent {
    tick: u64,
    service: String,
    text: String,
}

/// Until every scheduled command has applied, or been refused at its tick, or the time is over.
fn wait(tool: &Tool, client: &Client, outcomes: &mut [Outcome], arguments: &SetArguments) -> Result<(), Failure> {
    let began = tool.clock.now();
    let end = tool.after(arguments.wait);
    let bar = progress(arguments.wait, "waiting until it applies", arguments.tool.json);
    let open = |outcomes: &[Outcome]| outcomes.iter().any(|outcome| outcome.status == "scheduled");
    while open(outcomes) && tool.clock.now() < end && !tool.stop.interrupted() {
        let slice = (tool.clock.now() + LOOK).min(end);
        while open(outcomes)
            && let Some(heard) = tool.inbox.next(Some(slice))
        {
            if let Ok(said) = serde_json::from_slice::<Said>(&heard.payload) {
                acknowledge(&said.data, client.name(), outcomes);
            }
        }
        for outcome in outcomes.iter_mut().filter(|outcome| outcome.status == "scheduled") {
            if tool.stop.interrupted() {
                break;
            }
            let by = format!("{} seq {}", client.name(), outcome.seq);
            let key = client.key(&keys::state(outcome.service, &outcome.state));
            for (_, state) in diagnose::ask_all(&tool.session, &key)? {
                if state["by"] == by.as_str() {
                    (outcome.status, outcome.applied_tick) = ("applied", state["applied_tick"].as_u64());
                }
            }
        }
        bar.set_position((tool.clock.now().saturating_sub(began).as_secs_f64() * 10.0) as u64);
    }
    bar.finish_and_clear();
    Ok(())
}

/// Takes over what an event says about our commands.
fn acknowledge(event: &SaidEvent, client: &str, outcomes: &mut [Outcome]) {
    for outcome in outcomes.iter_mut().filter(|outcome| outcome.status == "scheduled") {
        let by = format!(" by {client} seq {}", outcome.seq);
        if event.service != outcome.service {
            continue;
        }
        if event.text.starts_with("command applied: ") && event.text.ends_with(&by) {
            (outcome.status, outcome.applied_tick) = ("applied", Some(event.tick));
        } else if let Some((_, reason)) = event.text.split_once(&format!("{by}: "))
            && event.text.starts_with("command refused: ")
        {
            (outcome.status, outcome.reason) = ("refused", Some(format!("at tick {}: {reason}", event.tick)));
        }
    }
}

/// Parameters, states, the lease.
pub(crate) fn get(arguments: &GetArguments, library: &Library) -> Result<ExitCode, Failure> {
    let tool = Tool::open(&arguments.tool.link, library)?;
    let vehicle = tool.vehicle(arguments.tool.link.vehicle.as_deref())?;
    let name = format!("cli-{}", supertwin_zenoh::unique());
    let mut client = Client::new(tool.session.clone(), &vehicle, &name, Arc::clone(&tool.clock));
    let found = match arguments.name.as_deref() {
        None => everything(&tool, &mut client, &vehicle)?,
        Some("lease") => lease(&mut client)?,
        Some(name) => match name.split_once('.').unwrap_or((name, "")) {
            (service, path) if SERVICES.contains(&service) => client.parameter(service, path)?,
            _ => last(&tool, &client, name)?,
        },
    };
    tool.close();
    output::print(&if arguments.tool.json { found.to_string() } else { found_text(arguments.name.as_deref(), &found) });
    Ok(ExitCode::SUCCESS)
}

fn lease(client: &mut Client) -> Result<Value, Failure> {
    let reply = client.lease(LeaseAction::Status, 0.0)?;
    Ok(json!({ "holder": reply.holder, "expires_in_s": reply.expires_in_s }))
}

/// The last commands called `name` that applied, by service.
fn last(tool: &Tool, client: &Client, name: &str) -> Result<Value, Failure> {
    if !keys::is_name(name) {
        return Err(Failure::Call(format!("NAME {name}: must be a service, SERVICE.PATH, a command or `lease`")));
    }
    let answers = diagnose::ask_all(&tool.session, &client.key(&keys::state("*", name)))?;
    match answers.into_iter().next() {
        Some((_, state)) => Ok(state),
        None if COMMANDS.iter().any(|(known, _)| *known == name) => {
            Err(Failure::Verdict(format!("{name}: no such command has applied yet")))
        }
        None => Err(Failure::Verdict(format!("{name}: nothing has this name; `supertwin get` shows everything"))),
    }
}

fn everything(tool: &Tool, client: &mut Client, vehicle: &str) -> Result<Value, Failure> {
    let answers = diagnose::ask_all(&tool.session, &client.key(&keys::state("*", "*")))?;
    let mut states: BTreeMap<String, Map<String, Value>> = BTreeMap::new();
    let mut parameters = Map::new();
    for (key, value) in answers {
        let mut parts = key.split('/').skip(3);
        let (Some(service), Some(name)) = (parts.next(), parts.next()) else { continue };
        if name == "parameters" {
            parameters.insert(service.to_owned(), value);
        } else if service != "authority" {
            states.entry(service.to_owned()).or_default().insert(name.to_owned(), value);
        }
    }
    if states.is_empty() && parameters.is_empty() {
        let text = format!("{vehicle}: nobody answers; `supertwin doctor --vehicle {vehicle}` looks for the cause");
        return Err(Failure::Verdict(text));
    }
    // Without its keeper there is no lease to tell of.
    let lease = lease(client).unwrap_or(Value::Null);
    Ok(json!({ "vehicle": vehicle, "lease": lease, "states": states, "parameters": parameters }))
}

fn found_text(name: Option<&str>, found: &Value) -> String {
    if name == Some("lease") {
        return lease_text(found);
    }
    if let Some(name) = name {
        if let Some(tick) = found["applied_tick"].as_u64() {
            return format!("{name} = {} since tick {tick}, by {}", found["value"], by(found));
        }
        let mut rows = Vec::new();
        flatten(name, found, &mut rows);
        return rows.iter().map(|(path, value)| format!("{path} = {value}")).collect::<Vec<_>>().join("\n");
    }
    let mut text = format!("{}\nauthority: {}", found["vehicle"].as_str().unwrap_or(""), lease_text(&found["lease"]));
    let mut rows = Vec::new();
    for (service, states) in found["states"].as_object().into_iter().flatten() {
        for (name, state) in states.as_object().into_iter().flatten() {
            rows.push(vec![
                service.clone(),
                name.clone(),
                state["value"].to_string(),
                state["applied_tick"].to_string(),
                by(state),
            ]);
        }
    }
    if !rows.is_empty() {
        text += "\n\n";
        text += &table(&["service", "command", "last value", "tick", "by"], rows, 5);
    }
    let mut rows = Vec::new();
    for (service, tree) in found["parameters"].as_object().into_iter().flatten() {
        flatten(service, tree, &mut rows);
    }
    if !rows.is_empty() {
        text += "\n\n";
        let rows = rows.into_iter().map(|(path, value)| vec![path, short(&value)]).collect();
        text += &table(&["parameter", "value"], rows, 2);
    }
    text
}

/// Descriptions may be long; tables are not.
fn short(text: &str) -> String {
    if text.chars().count() <= 60 { text.to_owned() } else { text.chars().take(59).chain(['…']).collect() }
}

fn by(state: &Value) -> String {
    state["by"].as_str().unwrap_or("the mission").to_owned()
}

fn lease_text(lease: &Value) -> String {
    match (lease["holder"].as_str(), lease["expires_in_s"].as_f64()) {
        (Some(holder), Some(left_s)) => format!("{holder}, for another {left_s:.1} s"),
        _ if lease.is_null() => "unknown: its keeper, the controller, does not answer".to_owned(),
        _ => "nobody".to_owned(),
    }
}

/// Leaves of a tree with their paths.
fn flatten(path: &str, value: &Value, rows: &mut Vec<(String, String)>) {
    match value {
        Value::Object(map) if !map.is_empty() => {
            for (name, value) in map {
                flatten(&format!("{path}.{name}"), value, rows);
            }
        }
        leaf => rows.push((path.to_owned(), leaf.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_services_and_values_become_json() {
        let read = |name, value| Order::read(name, value).expect("legal");
        let depth = read("depth_m", r#"{"ramp":{"to":5,"over_s":20}}"#);
        assert_eq!((depth.service, &depth.value["ramp"]["to"]), ("guidance", &json!(5)));
        assert_eq!(read("direction", "port").value, "port");
        assert_eq!(read("heading_rad", "-1.5").value, -1.5);
        let beta = read("controller.law.agsta.beta.surge", "4");
        assert_eq!((beta.service, beta.state().as_str()), ("controller", "parameter.law.agsta.beta.surge"));
        let restart = read("estimator", "restart");
        assert_eq!((restart.what, restart.value), (What::Command("restart".to_owned()), Value::Null));
        assert!(read("neutral", "true").emergency() && !read("neutral", "false").emergency());
    }

    #[test]
    fn names_and_values_that_are_none_are_named() {
        let says = |name, value| Order::read(name, value).expect_err("wrong").to_string();
        assert!(says("depth", "5").contains("NAME depth: must be one of mode, depth_m"));
        assert!(says("plant/x", "5").contains("NAME plant/x"));
        assert!(says("controller.a..b", "5").contains("NAME controller.a..b"));
        assert!(says("controller.**", "5").contains("NAME"));
        assert!(says("depth_m", "{ramp").contains("depth_m {ramp: is no JSON"));
    }

    #[test]
    fn acknowledgements_are_told_apart() {
        let outcome = |seq| Outcome {
            name: "depth_m".to_owned(),
            service: "guidance",
            value: json!(5),
            status: "scheduled",
            apply_tick: Some(10),
            applied_tick: None,
            reason: None,
            seq,
            state: "depth_m".to_owned(),
        };
        let event = |text: &str| SaidEvent { tick: 12, service: "guidance".to_owned(), text: text.to_owned() };
        let mut outcomes = [outcome(1), outcome(11), outcome(2)];
        acknowledge(&event(r#"command applied: {"depth_m":5} by cli-a seq 11"#), "cli-a", &mut outcomes);
        acknowledge(&event(r#"command applied: {"depth_m":5} by cli-b seq 1"#), "cli-a", &mut outcomes);
        acknowledge(&event(r#"command refused: {"depth_m":5} by cli-a seq 2: too deep"#), "cli-a", &mut outcomes);
        assert_eq!(outcomes.each_ref().map(|outcome| outcome.status), ["scheduled", "applied", "refused"]);
        assert_eq!(outcomes[1].applied_tick, Some(12));
        assert_eq!(outcomes[2].reason.as_deref(), Some("at tick 12: too deep"));
    }

    #[test]
    fn a_shared_tick_lies_ahead_of_all_commands() {
        assert_eq!(shared_tick(Some(100), Some(101), 2), Some(129));
        assert!(shared_tick(Some(100), Some(400), 3) > Some(2000));
        assert_eq!(shared_tick(None, Some(3), 2), None);
    }
}
