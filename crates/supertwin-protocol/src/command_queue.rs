//! Where requests become commands: checked, told apart from repetitions, scheduled for a tick, or refused with a reason.

use crate::keys;
use crate::lease::LeaseView;
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;
use supertwin_core::Refusal;
use supertwin_core::event::{CommandSource, EventCommand};
use xxhash_rust::xxh3::xxh3_64;

/// Largest request that is looked at, in bytes.
pub const MAX_REQUEST: usize = 4096;
/// Clients whose last request is remembered.
const MAX_CLIENTS: usize = 64;
/// Farthest into the future that a command may be scheduled, in seconds.
const MAX_AHEAD_S: f64 = 3600.0;
/// Commands that may wait at the same time.
const MAX_WAITING: usize = 1024;

/// What a client sends to `command/<service>/<name>`, or to `param/<service>/<path>` to change it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Name of the client, the same as in its lease.
    pub client: String,
    /// Counts the client's requests: the same number is the same request, sent again.
    pub seq: u64,
    /// Proof of authority, from the lease.
    #[serde(default)]
    pub token: String,
    /// What to set; absent for commands without a value.
    #[serde(default)]
    pub value: Value,
    /// When it shall apply; soon, if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_tick: Option<u64>,
}

/// The answer to a request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "status", rename_all = "snake_case", deny_unknown_fields)]
pub enum Answer {
    /// It will apply.
    Scheduled {
        /// Number of the request.
        seq: u64,
        /// Tick at which it applies.
        apply_tick: u64,
        /// The service's next tick, when it answered.
        tick: u64,
    },
    /// It will not, and nothing has changed.
    Refused {
        /// Number of the request, if it could be read.
        seq: u64,
        /// What is wrong with the request, for people.
        reason: String,
    },
}

/// A command that waits for its tick.
#[derive(Clone, Debug, PartialEq)]
pub struct ScheduledCommand<C> {
    /// The command, as the block takes it.
    pub command: C,
    /// Who asked for it, or nobody for the mission.
    pub by: Option<CommandSource>,
    /// Name of the state it sets.
    pub name: String,
}

/// What the queue did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CommandCounts {
    /// Requests that were scheduled.
    pub scheduled: u64,
    /// Requests that were refused.
    pub refused: u64,
    /// Requests that came again.
    pub repeated: u64,
    /// Commands that applied.
    pub applied: u64,
}

#[derive(Clone, Debug)]
struct LastRequest {
    lease: u64,
    seq: u64,
    body: u64,
    answer: Answer,
    at: Duration,
}

/// Commands of one service that wait for their tick.
#[derive(Clone, Debug)]
pub struct CommandQueue<C> {
    clients: BTreeMap<String, LastRequest>,
    waiting: BTreeMap<u64, Vec<ScheduledCommand<C>>>,
    /// Requests and commands so far.
    pub counts: CommandCounts,
}

/// The time of a request: the wall clock, the next tick, its length, and how far ahead commands are scheduled.
#[derive(Clone, Copy, Debug)]
pub struct RequestTime {
    /// Time of the host's clock.
    pub now: Duration,
    /// The next tick that will be stepped.
    pub next: u64,
    /// Length of a tick.
    pub tick_s: f64,
    /// Ticks from now to when a command applies.
    pub lead: u64,
}

impl<C: Serialize + DeserializeOwned + Clone> CommandQueue<C> {
    /// With the commands of a mission.
    #[must_use]
    pub fn new(mission: &[(u64, C)]) -> Self {
        let mut waiting: BTreeMap<u64, Vec<ScheduledCommand<C>>> = BTreeMap::new();
        for (tick, command) in mission {
            let name = EventCommand::new("", json!(command), None).name;
            waiting.entry(*tick).or_default().push(ScheduledCommand { command: command.clone(), by: None, name });
        }
        Self { clients: BTreeMap::new(), waiting, counts: CommandCounts::default() }
    }

    /// Takes a request for the command `name`; `attempt` tries it on a copy of the block.
    pub fn submit(
        &mut self,
        name: &str,
        payload: &[u8],
        lease: &LeaseView,
        time: RequestTime,
        attempt: impl FnOnce(&C) -> Result<(), Refusal>,
    ) -> Answer {
        let request = match read(payload) {
            Ok(request) => request,
            Err(reason) => return self.refuse(0, reason),
        };
        let body = xxh3_64(payload) ^ xxh3_64(name.as_bytes());
        // Numbers count from one lease to the next: who acquires anew may begin with 1 again.
        let lease_number = xxh3_64(request.token.as_bytes());
        // An emergency stop is obeyed every time, under whatever name and number, and none of it is remembered.
        let emergency = name == "neutral" && request.value == Value::Bool(true);
        let known = self.clients.get(&request.client).filter(|known| known.lease == lease_number);
        if let Some(known) = known.filter(|_| !emergency) {
            if request.seq == known.seq && body == known.body {
                self.counts.repeated += 1;
                return known.answer.clone();
            }
            if request.seq <= known.seq {
                let reason = format!("seq = {}: must be greater than {}, the last one", request.seq, known.seq);
                return self.refuse(request.seq, reason);
            }
        }
        let authority = if emergency { Ok(()) } else { lease.allows(&request.client, &request.token, time.now) };
        let answer = match authority.and_then(|()| self.schedule(name, &request, emergency, time, attempt)) {
            Ok((apply_tick, fresh)) => {
                self.counts.scheduled += u64::from(fresh);
                self.counts.repeated += u64::from(!fresh);
                Answer::Scheduled { seq: request.seq, apply_tick, tick: time.next }
            }
            Err(reason) => return self.refuse(request.seq, reason),
        };
        if !emergency {
            let (seq, at) = (request.seq, time.now);
            self.remember(request.client, LastRequest { lease: lease_number, seq, body, answer: answer.clone(), at });
        }
        answer
    }

    fn refuse(&mut self, seq: u64, reason: String) -> Answer {
        self.counts.refused += 1;
        Answer::Refused { seq, reason }
    }

    fn schedule(
        &mut self,
        name: &str,
        request: &Request,
        emergency: bool,
        time: RequestTime,
        attempt: impl FnOnce(&C) -> Result<(), Refusal>,
    ) -> Result<(u64, bool), String> {
        let command = build(name, &request.value)?;
        attempt(&command).map_err(|refusal| refusal.0)?;
        let soon = if emergency { time.next } else { time.next + time.lead };
        let farthest = time.next.saturating_add((MAX_AHEAD_S / time.tick_s) as u64);
        let tick = match request.at_tick {
            Some(_) if emergency => soon,
            Some(tick) if tick < time.next => {
                return Err(format!("at_tick = {tick}: is over; the next tick is {}", time.next));
            }
            Some(tick) if tick > farthest => {
                return Err(format!("at_tick = {tick}: must be at most {farthest}, an hour ahead"));
            }
            Some(tick) => tick,
            None => soon,
        };
        if emergency && self.waiting.get(&tick).is_some_and(|all| all.iter().any(|other| other.name == name)) {
            return Ok((tick, false));
        }
        if !emergency && self.waiting() >= MAX_WAITING {
            return Err(format!("{MAX_WAITING} commands wait already"));
        }
        let by = Some(CommandSource { client: request.client.clone(), seq: Some(request.seq) });
        self.waiting.entry(tick).or_default().push(ScheduledCommand {
            command,
            by,
            name: name_of_request(name, request),
        });
        Ok((tick, true))
    }

    fn remember(&mut self, client: String, what: LastRequest) {
        if self.clients.len() >= MAX_CLIENTS && !self.clients.contains_key(&client) {
            let oldest = self.clients.iter().min_by_key(|(_, known)| known.at).map(|(name, _)| name.clone());
            oldest.map(|name| self.clients.remove(&name));
        }
        self.clients.insert(client, what);
    }

    /// A command of this very tick, from a stream of set-points.
    ///
    /// # Errors
    /// When there is no such command.
    pub fn stream(&mut self, name: &str, value: f64, client: &str, next: u64) -> Result<(), String> {
        let command = build(name, &value.into())?;
        let by = Some(CommandSource { client: client.to_owned(), seq: None });
        let waiting = self.waiting.entry(next).or_default();
        waiting.retain(|other| other.name != name || other.by != by);
        waiting.push(ScheduledCommand { command, by, name: name.to_owned() });
        Ok(())
    }

    /// The commands that apply at tick `k`, in the order in which they came.
    pub fn due(&mut self, k: u64) -> Vec<ScheduledCommand<C>> {
        if self.waiting.first_key_value().is_none_or(|(tick, _)| *tick > k) {
            return Vec::new();
        }
        let later = self.waiting.split_off(&(k + 1));
        core::mem::replace(&mut self.waiting, later).into_values().flatten().collect()
    }

    /// Number of commands that wait for their tick.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.waiting.values().map(Vec::len).sum()
    }
}

fn read(payload: &[u8]) -> Result<Request, String> {
    if payload.len() > MAX_REQUEST {
        return Err(format!("{} bytes: must be at most {MAX_REQUEST}", payload.len()));
    }
    let request: Request = serde_json::from_slice(payload).map_err(|error| format!("request: {error}"))?;
    if keys::is_name(&request.client) {
        Ok(request)
    } else {
        Err("client: must be 1 to 64 letters, digits, '-', '_' or '.'".to_owned())
    }
}

/// `{name: value}` as the service's command; commands without a value are their name.
fn build<C: DeserializeOwned>(name: &str, value: &Value) -> Result<C, String> {
    let whole = if value.is_null() { json!(name) } else { json!({ name: value }) };
    serde_json::from_value(whole).map_err(|error| format!("{name}: {error}"))
}

fn name_of_request(name: &str, request: &Request) -> String {
    match request.value.get("path") {
        Some(Value::String(path)) if name == "parameter" => format!("parameter.{path}"),
        _ => name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lease::{Authority, LeaseAction, LeaseRequest};
    use proptest::prelude::*;
    use supertwin_core::command::{ControllerCommand, GuidanceCommand};

    const NOW: Duration = Duration::from_secs(1);

    fn lease() -> LeaseView {
        lease_of("anna")
    }

    fn lease_of(client: &str) -> LeaseView {
        let mut authority = Authority::default();
        let request =
            LeaseRequest { client: client.to_owned(), action: LeaseAction::Acquire, for_s: 50.0, token: String::new() };
        assert!(authority.answer(&request, "t", NOW).0.granted);
        authority.view.clone()
    }

    fn request_time(next: u64) -> RequestTime {
        RequestTime { now: NOW, next, tick_s: 0.02, lead: 3 }
    }

    fn ask(queue: &mut CommandQueue<GuidanceCommand>, name: &str, body: &Value) -> Answer {
        queue.submit(name, body.to_string().as_bytes(), &lease(), request_time(10), |command| match command {
            GuidanceCommand::DepthM(setpoint) => setpoint.check("depth_m", 0.0, 14.0),
            _ => Ok(()),
        })
    }

    fn reason(answer: Answer) -> String {
        match answer {
            Answer::Refused { reason, .. } => reason,
            Answer::Scheduled { .. } => panic!("{answer:?} should have been refused"),
        }
    }

    #[test]
    fn a_request_is_scheduled_once_however_often_it_comes() {
        let mut queue = CommandQueue::new(&[]);
        let body = json!({"client": "anna", "seq": 1, "token": "t", "value": 5.0});
        let first = ask(&mut queue, "depth_m", &body);
        assert_eq!(first, Answer::Scheduled { seq: 1, apply_tick: 13, tick: 10 });
        assert_eq!(ask(&mut queue, "depth_m", &body), first);
        assert_eq!(queue.waiting(), 1);
        assert!(queue.due(12).is_empty());
        assert_eq!(queue.due(13).len(), 1);
        assert_eq!(queue.waiting(), 0);
        assert!(reason(ask(&mut queue, "speed_m_per_s", &body)).contains("seq = 1: must be greater than 1"));
        let old = json!({"client": "anna", "seq": 0, "token": "t", "value": 6.0});
        assert!(reason(ask(&mut queue, "depth_m", &old)).contains("must be greater"));
    }

    #[test]
    fn what_may_not_be_is_refused_with_its_reason_and_changes_nothing() {
        let mut queue = CommandQueue::new(&[]);
        let good = json!({"client": "anna", "seq": 1, "token": "t", "value": 5.0});
        let with = |name: &str, value: Value| {
            let mut body = good.clone();
            body[name] = value;
            body
        };
        for (name, body, says) in [
            ("depth_m", with("token", json!("guess")), "wrong token"),
            ("depth_m", with("client", json!("ben")), "anna holds"),
            ("depth_m", with("client", json!("a/b")), "client: must be"),
            ("depth_m", with("value", json!(99.0)), "between 0 and 14"),
            ("depth_m", with("value", json!("deep")), "depth_m: "),
            ("depth_m", with("value", json!(null)), "depth_m: "),
            ("depth_m", with("at_tick", json!(9)), "is over"),
            ("depth_m", with("at_tick", json!(u64::MAX)), "an hour ahead"),
            ("depth_m", with("extra", json!(1)), "unknown field"),
            ("dive", good.clone(), "unknown variant"),
            ("mode", with("value", json!("sideways")), "unknown variant"),
        ] {
            let reason = reason(ask(&mut queue, name, &body));
            assert!(reason.contains(says), "{name} {body}: {reason}");
        }
        let huge = "x".repeat(MAX_REQUEST + 1);
        let answer = queue.submit("depth_m", huge.as_bytes(), &lease(), request_time(10), |_| Ok(()));
        assert!(reason(answer).contains("at most"));
        assert_eq!((queue.waiting(), queue.counts.scheduled), (0, 0));
    }

    #[test]
    fn everybody_may_demand_neutral_and_only_the_holder_may_end_it() {
        let mut queue: CommandQueue<ControllerCommand> = CommandQueue::new(&[]);
        let mut ask = |value: bool| {
            let body = json!({"client": "passer-by", "seq": 1, "value": value});
            queue.submit("neutral", body.to_string().as_bytes(), &LeaseView::default(), request_time(10), |_| Ok(()))
        };
        assert!(reason(ask(false)).contains("nobody holds"));
        assert_eq!(ask(true), Answer::Scheduled { seq: 1, apply_tick: 10, tick: 10 });
    }

    #[test]
    fn a_mission_waits_for_its_ticks() {
        let mission = [(5, GuidanceCommand::DepthM(supertwin_core::command::Setpoint::Constant(2.0)))];
        let mut queue = CommandQueue::new(&mission);
        assert!(queue.due(4).is_empty());
        let due = queue.due(7);
        assert_eq!((due.len(), &due[0].by, due[0].name.as_str()), (1, &None, "depth_m"));
    }

    #[test]
    fn an_emergency_stop_is_obeyed_every_time_and_locks_nobody_out() {
        let mut queue: CommandQueue<ControllerCommand> = CommandQueue::new(&[]);
        let mut ask = |seq: u64, token: &str, value: bool, next: u64| {
            let body = json!({"client": "anna", "seq": seq, "token": token, "value": value});
            let answer = queue.submit("neutral", body.to_string().as_bytes(), &lease(), request_time(next), |_| Ok(()));
            let due = queue.due(next + 3).len();
            (matches!(answer, Answer::Scheduled { .. }), due)
        };
        assert_eq!(ask(1, "", true, 10), (true, 1));
        assert_eq!(ask(1, "t", false, 20), (true, 1));
        assert_eq!(ask(1, "", true, 30), (true, 1), "the same words again are a new one");
        assert_eq!(ask(u64::MAX, "", true, 40), (true, 1));
        assert_eq!(ask(2, "t", false, 50), (true, 1), "nobody has used up anna's numbers");
    }

    #[test]
    fn numbers_begin_anew_with_every_lease() {
        let mut queue: CommandQueue<GuidanceCommand> = CommandQueue::new(&[]);
        for (token, granted) in [("t", true), ("other", false)] {
            let body = json!({"client": "anna", "seq": 1, "token": token, "value": "neutral"});
            let answer = queue.submit("mode", body.to_string().as_bytes(), &lease(), request_time(10), |_| Ok(()));
            assert_eq!(matches!(answer, Answer::Scheduled { .. }), granted);
            assert!(granted || reason(answer).contains("wrong token"), "refused for its token, not for its number");
        }
    }

    #[test]
    fn memory_is_bounded_however_many_clients_come() {
        let mut queue: CommandQueue<ControllerCommand> = CommandQueue::new(&[]);
        for i in 0..1000 {
            let client = format!("c{i}");
            let body = json!({"client": client, "seq": 1, "token": "t", "value": false});
            queue.submit("neutral", body.to_string().as_bytes(), &lease_of(&client), request_time(10), |_| Ok(()));
            queue.due(13);
        }
        assert_eq!((queue.clients.len(), queue.counts.scheduled), (MAX_CLIENTS, 1000));
        for i in 0..1000 {
            let body = json!({"client": format!("c{i}"), "seq": 1, "value": true});
            queue.submit("neutral", body.to_string().as_bytes(), &LeaseView::default(), request_time(20), |_| Ok(()));
        }
        assert_eq!(queue.waiting(), 1, "a thousand cries before a tick are one");
    }

    proptest! {
        #[test]
        fn no_bytes_make_a_command_without_authority(payload: Vec<u8>, name in "[a-z_]{1,12}") {
            let mut queue: CommandQueue<GuidanceCommand> = CommandQueue::new(&[]);
            let answer = queue.submit(&name, &payload, &LeaseView::default(), request_time(3), |_| Ok(()));
            let refused = matches!(answer, Answer::Refused { .. });
            prop_assert!(refused);
            prop_assert_eq!(queue.waiting(), 0);
        }
    }
}
