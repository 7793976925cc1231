//! Orders to a vehicle, and what it answers: commands and parameters, with acknowledgement.

use crate::network::{NetworkClient, SERVICES};
use crate::{OperationError, Progress};
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use supertwin_core::event::CommandSource;
use supertwin_core::{Event, EventKind};
use supertwin_protocol::lease::LeaseAction;
use supertwin_protocol::payload::Now;
use supertwin_protocol::{decode, keys};
use supertwin_zenoh::{Client, ClientError, Presence, diagnose};

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
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Order {
    /// Name as it was written.
    pub name: String,
    /// The service that it is for.
    pub service: &'static str,
    #[serde(skip)]
    what: What,
    /// Value that is asked for.
    pub value: Value,
}

#[derive(Clone, Debug, PartialEq)]
enum What {
    Command(String),
    Parameter(String),
}

impl Order {
    /// Reads a name and a value as they are written on a command line.
    ///
    /// # Errors
    /// There is no such name, or the value is broken JSON.
    pub fn read(name: &str, value: &str) -> Result<Self, OperationError> {
        let order =
            |service: &'static str, what: What, value: Value| Ok(Self { name: name.to_owned(), service, what, value });
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
        Err(OperationError::Option(format!(
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
fn read_value(name: &str, text: &str) -> Result<Value, OperationError> {
    match serde_json::from_str(text) {
        Ok(value) => Ok(value),
        Err(cause) if text.starts_with(['{', '[', '"']) => {
            Err(OperationError::Option(format!("{name} {text}: is no JSON: {cause}")))
        }
        Err(_) => Ok(Value::String(text.to_owned())),
    }
}

/// What became of an order.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// What was asked for.
    #[serde(flatten)]
    pub order: Order,
    /// `applied`, `scheduled`, `refused`, `unanswered`.
    pub status: &'static str,
    /// When it is to apply.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub apply_tick: Option<u64>,
    /// When it has applied.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub applied_tick: Option<u64>,
    /// Of a refusal, or of silence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    #[serde(skip)]
    seq: u64,
}

/// What became of orders.
#[derive(Debug)]
pub struct Ordered {
    /// Name of the client that sent them.
    pub client: String,
    /// One for each order that was sent.
    pub outcomes: Vec<Outcome>,
    /// What else went wrong.
    pub warnings: Vec<String>,
}

/// Sends orders to a vehicle: takes the authority, sends, gives it back, and waits up to `wait_s` seconds until
/// everything has applied; without `wait_s` it leaves as soon as the services have said when.
///
/// # Errors
/// The network or the authority fails; an order that is refused is in the result.
pub fn set(
    network: &mut NetworkClient,
    vehicle: &str,
    orders: &[Order],
    wait_s: Option<f64>,
    progress: &dyn Progress,
) -> Result<Ordered, OperationError> {
    let name = format!("cli-{}", supertwin_zenoh::unique());
    // Before anything is sent: no acknowledgement may come too early.
    network.inbox.listen(&network.session, &format!("{}/{}", keys::namespace(vehicle), keys::event("*")))?;
    let mut client = Client::new(network.session.clone(), vehicle, &name, Arc::clone(&network.clock));
    let mut warnings = Vec::new();
    let mut outcomes = send(network, &mut client, orders, &mut warnings)?;
    if let Some(wait_s) = wait_s {
        wait(network, &client, &mut outcomes, wait_s, progress)?;
    }
    Ok(Ordered { client: name, outcomes, warnings })
}

/// Sends everything: emergencies at once, the rest under the authority and, when several, for one tick.
fn send(
    network: &NetworkClient,
    client: &mut Client,
    orders: &[Order],
    warnings: &mut Vec<String>,
) -> Result<Vec<Outcome>, OperationError> {
    let mut outcomes: Vec<Option<Outcome>> = vec![None; orders.len()];
    for (outcome, order) in outcomes.iter_mut().zip(orders).filter(|(_, order)| order.emergency()) {
        *outcome = Some(one(client, order, None)?);
    }
    let rest = orders.iter().filter(|order| !order.emergency()).count();
    if rest > 0 && !network.stop.interrupted() {
        let presence = Presence::show(&network.session, &client.key(&keys::operator(&client.name)))?;
        let before = next_tick(network, client)?;
        client.acquire(LEASE_S)?;
        let sent: Result<(), OperationError> = (|| {
            let at_tick = if rest > 1 { shared_tick(before, next_tick(network, client)?, rest) } else { None };
            for (outcome, order) in outcomes.iter_mut().zip(orders).filter(|(_, order)| !order.emergency()) {
                if network.stop.interrupted() {
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
            warnings.push(format!("the authority could not be given back, and ends by itself: {cause}"));
        }
        sent?;
    }
    Ok(outcomes.into_iter().flatten().collect())
}

/// The next tick of the service that is farthest; `None` when none says.
fn next_tick(network: &NetworkClient, client: &Client) -> Result<Option<u64>, OperationError> {
    let answers = diagnose::ask_all(&network.session, &client.key(&keys::state("*", "now")))?;
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

fn one(client: &mut Client, order: &Order, at_tick: Option<u64>) -> Result<Outcome, OperationError> {
    let value = order.value.clone();
    let answer = match &order.what {
        What::Command(name) => client.command(order.service, name, value, at_tick),
        What::Parameter(path) => client.set_parameter(order.service, path, value, at_tick),
    };
    let (status, apply_tick, reason) = match answer {
        Ok(tick) => ("scheduled", Some(tick), None),
        Err(ClientError::Refused(reason)) => ("refused", None, Some(reason)),
        Err(error @ (ClientError::NoAnswer { .. } | ClientError::Strange { .. })) => {
            ("unanswered", None, Some(error.to_string()))
        }
        Err(error) => return Err(error.into()),
    };
    Ok(Outcome { order: order.clone(), status, apply_tick, applied_tick: None, reason, seq: client.seq })
}

/// Until every scheduled command has applied, or been refused at its tick, or the time is over.
fn wait(
    network: &NetworkClient,
    client: &Client,
    outcomes: &mut [Outcome],
    wait_s: f64,
    progress: &dyn Progress,
) -> Result<(), OperationError> {
    let began = network.clock.now();
    let end = network.after(wait_s);
    progress.begin("waiting until it applies", (wait_s * 10.0).ceil() as u64);
    let open = |outcomes: &[Outcome]| outcomes.iter().any(|outcome| outcome.status == "scheduled");
    while open(outcomes) && network.clock.now() < end && !network.stop.interrupted() {
        let slice = (network.clock.now() + LOOK).min(end);
        while open(outcomes)
            && let Some(message) = network.inbox.next(Some(slice))
        {
            if let Ok(event) = decode::<Event>(&message.payload) {
                acknowledge(&event.data, &client.name, outcomes);
            }
        }
        for outcome in outcomes.iter_mut().filter(|outcome| outcome.status == "scheduled") {
            if network.stop.interrupted() {
                break;
            }
            let by = CommandSource { client: client.name.clone(), seq: Some(outcome.seq) }.to_string();
            let key = client.key(&keys::state(outcome.order.service, &outcome.order.state()));
            for (_, state) in diagnose::ask_all(&network.session, &key)? {
                if state["by"] == by.as_str() {
                    (outcome.status, outcome.applied_tick) = ("applied", state["applied_tick"].as_u64());
                }
            }
        }
        progress.reach((network.clock.now().saturating_sub(began).as_secs_f64() * 10.0) as u64);
    }
    progress.end();
    Ok(())
}

/// Takes over what an event says about our commands.
fn acknowledge(event: &Event, client: &str, outcomes: &mut [Outcome]) {
    let (command, refusal) = match &event.what {
        EventKind::CommandApplied { command } => (command, None),
        // With a count it was refused at once, which its answer has said.
        EventKind::CommandRefused { command, reason, so_far: None, .. } => (command, Some(reason)),
        _ => return,
    };
    let Some(by) = command.by.as_ref().filter(|by| by.client == client) else { return };
    for outcome in outcomes.iter_mut().filter(|outcome| outcome.status == "scheduled") {
        if command.service != outcome.order.service || by.seq != Some(outcome.seq) {
            continue;
        }
        match refusal {
            None => (outcome.status, outcome.applied_tick) = ("applied", Some(event.tick)),
            Some(reason) => {
                (outcome.status, outcome.reason) = ("refused", Some(format!("at tick {}: {reason}", event.tick)));
            }
        }
    }
}

/// What a vehicle says of `name`: a service, SERVICE.PATH of a parameter, a command, or `lease`; of everything without it.
///
/// # Errors
/// There is no such thing, or nobody answers.
pub fn get(network: &NetworkClient, vehicle: &str, name: Option<&str>) -> Result<Value, OperationError> {
    let own_name = format!("cli-{}", supertwin_zenoh::unique());
    let mut client = Client::new(network.session.clone(), vehicle, &own_name, Arc::clone(&network.clock));
    match name {
        None => everything(network, &mut client, vehicle),
        Some("lease") => lease(&mut client),
        Some(name) => match name.split_once('.').unwrap_or((name, "")) {
            (service, path) if SERVICES.contains(&service) => Ok(client.parameter(service, path)?),
            _ => last(network, &client, name),
        },
    }
}

fn lease(client: &mut Client) -> Result<Value, OperationError> {
    let reply = client.lease(LeaseAction::Status, 0.0)?;
    Ok(json!({ "holder": reply.holder, "expires_in_s": reply.expires_in_s }))
}

/// The last commands called `name` that applied, by service.
fn last(network: &NetworkClient, client: &Client, name: &str) -> Result<Value, OperationError> {
    if !keys::is_name(name) {
        return Err(OperationError::Option(format!(
            "NAME {name}: must be a service, SERVICE.PATH, a command or `lease`"
        )));
    }
    let answers = diagnose::ask_all(&network.session, &client.key(&keys::state("*", name)))?;
    match answers.into_iter().next() {
        Some((_, state)) => Ok(state),
        None if COMMANDS.iter().any(|(known, _)| *known == name) => {
            Err(OperationError::Unmet(format!("{name}: no such command has applied yet")))
        }
        None => Err(OperationError::Unmet(format!("{name}: nothing has this name; `supertwin get` shows everything"))),
    }
}

fn everything(network: &NetworkClient, client: &mut Client, vehicle: &str) -> Result<Value, OperationError> {
    let answers = diagnose::ask_all(&network.session, &client.key(&keys::state("*", "*")))?;
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
        return Err(OperationError::Unmet(text));
    }
    // Without its keeper there is no lease to tell of.
    let lease = lease(client).unwrap_or(Value::Null);
    Ok(json!({ "vehicle": vehicle, "lease": lease, "states": states, "parameters": parameters }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use supertwin_core::Severity;
    use supertwin_core::event::EventCommand;

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
            order: Order::read("depth_m", "5").expect("legal"),
            status: "scheduled",
            apply_tick: Some(10),
            applied_tick: None,
            reason: None,
            seq,
        };
        let command = |client: &str, seq| {
            let by = Some(CommandSource { client: client.to_owned(), seq: Some(seq) });
            EventCommand::new("guidance", json!({ "depth_m": 5 }), by)
        };
        let applied = |client, seq| EventKind::CommandApplied { command: command(client, seq) };
        let refused = |seq, so_far| EventKind::CommandRefused {
            command: command("cli-a", seq),
            session: None,
            reason: "too deep".to_owned(),
            so_far,
        };
        let event = |what| Event { tick: 12, service: "guidance".into(), severity: Severity::Info, what };
        let mut outcomes = [outcome(1), outcome(11), outcome(2)];
        acknowledge(&event(applied("cli-a", 11)), "cli-a", &mut outcomes);
        acknowledge(&event(applied("cli-b", 1)), "cli-a", &mut outcomes);
        acknowledge(&event(refused(1, Some(7))), "cli-a", &mut outcomes);
        acknowledge(&event(refused(2, None)), "cli-a", &mut outcomes);
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
