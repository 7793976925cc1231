//! What happened: an event is data for programs; the sentence for people is made from it here and nowhere else.

use crate::command::Command;
use schemars::JsonSchema;
use serde::ser::SerializeStruct as _;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::fmt;

/// Something that happened at a tick and must not be lost.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(from = "EventWithText")]
pub struct Event {
    /// When.
    pub tick: u64,
    /// Which service says so.
    pub service: Cow<'static, str>,
    /// How grave.
    pub severity: Severity,
    /// What happened.
    pub what: EventKind,
}

/// An event as it stands on a wire: the data for programs, and the sentence for people.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename = "Event")]
struct EventWithText {
    /// When.
    tick: u64,
    /// Which service says so.
    service: Cow<'static, str>,
    /// How grave.
    severity: Severity,
    /// What happened.
    what: EventKind,
    /// The same as a sentence for people; programs read `what`.
    #[expect(dead_code, reason = "made again from the data")]
    text: String,
}

impl From<EventWithText> for Event {
    fn from(written: EventWithText) -> Self {
        let EventWithText { tick, service, severity, what, .. } = written;
        Self { tick, service, severity, what }
    }
}

impl Serialize for Event {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut event = serializer.serialize_struct("Event", 5)?;
        event.serialize_field("tick", &self.tick)?;
        event.serialize_field("service", &self.service)?;
        event.serialize_field("severity", &self.severity)?;
        event.serialize_field("what", &self.what)?;
        event.serialize_field("text", &self.text())?;
        event.end()
    }
}

impl Event {
    /// The sentence for people.
    #[must_use]
    pub fn text(&self) -> String {
        self.what.to_string()
    }
}

/// How grave an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// As planned.
    Info,
    /// Something is not as it should be, and the twin copes.
    Warning,
    /// Something was refused or lost.
    Error,
}

/// A command, as events tell of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EventCommand {
    /// Which service it is for: plant, estimator, guidance, controller; link for the wires of a batch run.
    pub service: Cow<'static, str>,
    /// Its name, as in `command/<service>/<name>`.
    pub name: String,
    /// What it sets; null when it has no value.
    pub value: Value,
    /// Which client asked for it; null for the mission.
    pub by: Option<CommandSource>,
}

/// The request of a client.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CommandSource {
    /// Name of the client.
    pub client: String,
    /// Number of its request; null for a sample of a streaming set-point.
    pub seq: Option<u64>,
}

impl fmt::Display for CommandSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.seq {
            Some(seq) => write!(f, "{} seq {seq}", self.client),
            None => write!(f, "{} streaming", self.client),
        }
    }
}

impl EventCommand {
    /// A command of a mission.
    #[must_use]
    pub fn of_mission(command: &Command) -> Self {
        let whole = serde_json::to_value(command).unwrap_or(Value::Null);
        let [service, inner] = name_and_value(whole);
        Self::new(String::from(service.as_str().unwrap_or_default()), inner, None)
    }

    /// A command of one service, `{name: value}` or its mere name.
    #[must_use]
    pub fn new(service: impl Into<Cow<'static, str>>, command: Value, by: Option<CommandSource>) -> Self {
        let [name, value] = name_and_value(command);
        Self { service: service.into(), name: name.as_str().unwrap_or_default().to_owned(), value, by }
    }

    /// `{name: value}`, or the mere name of a command without a value.
    #[must_use]
    pub fn command(&self) -> Value {
        if self.value.is_null() { json!(self.name) } else { json!({ &*self.name: self.value }) }
    }

    /// A fault that is injected: into the plant, or into the wires of a batch run.
    #[must_use]
    pub fn is_fault(&self) -> bool {
        self.service == "plant" || self.service == "link"
    }
}

/// `{name: value}` or `name`, taken apart.
fn name_and_value(command: Value) -> [Value; 2] {
    match command {
        Value::Object(map) => {
            map.into_iter().next().map_or([Value::Null, Value::Null], |(name, value)| [name.into(), value])
        }
        name => [name, Value::Null],
    }
}

/// What a client asked for is told under the name of its service; a mission names the service itself.
impl fmt::Display for EventCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.by {
            Some(by) => write!(f, "{} by {by}", self.command()),
            None => write!(f, "{}", json!({ &*self.service: self.command() })),
        }
    }
}

/// What happened. `so_far` counts what a service has refused: a flood makes one event a second. `session` is the Zenoh
/// session that a request names as its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum EventKind {
    /// A state of a block changed: its mode, the reason for it, its status, or the health of something it needs.
    StateChanged {
        /// Which.
        what: Cow<'static, str>,
        /// What it was; empty before the first step.
        from: Cow<'static, str>,
        /// What it is.
        to: Cow<'static, str>,
        /// What the block does about it; empty if nothing.
        consequence: Cow<'static, str>,
    },
    /// A client's command will apply.
    CommandScheduled {
        /// The command.
        command: EventCommand,
        /// When.
        apply_tick: u64,
        /// From where.
        session: Option<String>,
    },
    /// A command has applied.
    CommandApplied {
        /// The command.
        command: EventCommand,
    },
    /// A command was refused: when it was asked for, or, without `so_far`, at its tick.
    CommandRefused {
        /// The command; without value and client when the request could not be read.
        command: EventCommand,
        /// From where.
        session: Option<String>,
        /// Why.
        reason: String,
        /// Refusals of the service.
        so_far: Option<u64>,
    },
    /// A mission's command lies after the end of the run.
    CommandNeverApplied {
        /// The command.
        command: EventCommand,
        /// When it would have applied.
        at_s: f64,
    },
    /// Commands that waited were given up with the run they were for.
    CommandsDiscarded {
        /// How many.
        commands: u64,
    },
    /// A sample of a streaming set-point was refused.
    SetpointRefused {
        /// Name of the set-point.
        name: Cow<'static, str>,
        /// Who sent it, if it could be read.
        client: Option<String>,
        /// Why.
        reason: String,
        /// Refusals of the service.
        so_far: u64,
    },
    /// A client has taken the authority to command.
    LeaseTaken {
        /// Who.
        client: String,
        /// For how long.
        for_s: f64,
        /// From where.
        session: Option<String>,
    },
    /// A client has given the authority back.
    LeaseReturned {
        /// Who.
        client: String,
        /// From where.
        session: Option<String>,
    },
    /// The lease has run out without being given back.
    LeaseExpired {
        /// Who held it.
        client: String,
    },
    /// A request for the authority was refused.
    LeaseRefused {
        /// Who asked, if it could be read.
        client: Option<String>,
        /// From where.
        session: Option<String>,
        /// Why.
        reason: String,
        /// Refusals of the service.
        so_far: u64,
    },
    /// Who held the lease has disappeared from the network.
    OperatorVanished {
        /// Who.
        client: String,
    },
    /// Nobody is in command who should be.
    OperatorLost {
        /// Because a stream of set-points has stopped, rather than because the lease has ended.
        setpoints_stopped: bool,
    },
    /// Somebody is in command again.
    OperatorPresent,
    /// Messages were lost on the way.
    MessagesMissing {
        /// Whose.
        source: String,
        /// How many.
        messages: u64,
    },
    /// What arrived was no message. A recorder does not count these in `so_far`.
    MessageRefused {
        /// What it was to be.
        message: String,
        /// Why it is none.
        reason: String,
        /// Refusals of the service.
        so_far: Option<u64>,
    },
    /// Messages came faster than they were taken.
    MailboxOverflow {
        /// How many were lost.
        messages: u64,
        /// Refusals of the service.
        so_far: u64,
    },
    /// A message comes from another instance than before.
    SourceChanged {
        /// From this one before.
        from: String,
        /// From this one now.
        to: String,
    },
    /// A block put out a quantity that is no number. Its output was kept back; in lock step and in batch the run ends.
    NotFinite {
        /// At this tick.
        at_tick: u64,
        /// Path of the quantity.
        signal: Cow<'static, str>,
        /// Refusals of the service, in real time.
        so_far: Option<u64>,
    },
    /// The owner of time stood still for too long to catch up.
    TicksLeftOut {
        /// How many.
        ticks: u64,
    },
    /// The owner of time was late: the ticks were simulated, and their messages not sent.
    TicksLate {
        /// How many.
        ticks: u64,
    },
    /// A service begins another run.
    RunStarted {
        /// Which.
        run: String,
        /// At this tick.
        at_tick: u64,
    },
    /// The owner of time was started anew, and goes on with the run that is there.
    RunRejoined {
        /// Which.
        run: String,
        /// At this tick.
        at_tick: u64,
    },
    /// The run was stopped.
    RunStopped {
        /// Why.
        reason: String,
    },
    /// The run can't go on.
    RunFailed {
        /// Why.
        reason: String,
    },
    /// A file was opened for the recording.
    RecordingOpened {
        /// Which.
        path: String,
    },
    /// A file of the recording was closed.
    RecordingClosed {
        /// Which.
        path: String,
    },
    /// Nothing is recorded.
    RecordingFailed {
        /// Why.
        reason: String,
    },
    /// Messages are missing from the recording.
    NotRecorded {
        /// On which key.
        key: String,
        /// How many.
        messages: u64,
        /// They were sent after this tick, if it is known.
        after_tick: Option<u64>,
        /// They were sent before this tick.
        before_tick: u64,
    },
    /// The recorder was too slow.
    RecorderOverrun {
        /// How many messages it lost.
        messages: u64,
    },
    /// A clock was set.
    ClockStepped {
        /// Whose.
        service: Cow<'static, str>,
        /// By how much.
        step_s: f64,
    },
    /// The recording does not know the configuration of its run.
    ConfigurationUnknown,
    /// Somebody with a good certificate came to the router.
    ConnectionAccepted {
        /// Common name of the certificate.
        name: String,
        /// Address.
        from: String,
        /// How often.
        times: u64,
    },
    /// Somebody was turned away by the router before a word was said.
    ConnectionRefused {
        /// Why.
        reason: String,
        /// How often.
        times: u64,
    },
    /// The certificate of a session has no role here.
    SessionWithoutRole {
        /// The session.
        session: String,
        /// How often.
        times: u64,
    },
    /// Somebody tried what he may not.
    AccessRefused {
        /// Common name of the certificate; empty when it is not known.
        name: String,
        /// The session.
        session: String,
        /// What he tried.
        action: String,
        /// On which key.
        key: String,
        /// How often.
        times: u64,
    },
    /// More refusals of the router than are told one by one.
    MoreRefused {
        /// How many.
        refusals: u64,
    },
    /// This run is an open-loop replay of another.
    ReplayedOpenLoop {
        /// Name of the recorded run.
        recording: String,
        /// The first service that ran anew.
        from: Cow<'static, str>,
        /// The controller's configuration.
        controller: String,
        /// What was changed.
        changed: Vec<String>,
    },
    /// This run is a closed-loop replay of another.
    ReplayedClosedLoop {
        /// Name of the recorded run.
        recording: String,
        /// What was changed.
        changed: Vec<String>,
    },
    /// What was replayed is not known to be what happened.
    ReplayInexact {
        /// Of this service.
        service: Cow<'static, str>,
        /// From this tick.
        from_tick: u64,
        /// To this one.
        to_tick: u64,
        /// Why.
        reason: String,
    },
    /// Only the sentence is known, such as of a recording made before events were data.
    Text {
        /// The sentence.
        text: String,
    },
}

/// Longest that a sentence quotes of what others wrote.
const QUOTED: usize = 300;

/// Without control characters, and not longer than a sentence may be.
fn quoted(text: &str, most: usize) -> String {
    text.chars().filter(|c| !c.is_control()).take(most).collect()
}

/// `from session …`, if it is known.
fn from_session(session: Option<&String>) -> String {
    session.map_or_else(String::new, |session| format!(" from session {session}"))
}

/// What a service has refused, and how much of it there was.
fn refused(f: &mut fmt::Formatter<'_>, what: &str, so_far: u64) -> fmt::Result {
    write!(f, "refused: {} ({so_far} so far)", quoted(what, QUOTED))
}

fn often(times: u64) -> String {
    if times > 1 { format!(" ({times} times)") } else { String::new() }
}

fn changes(changed: &[String]) -> String {
    if changed.is_empty() { "nothing".to_owned() } else { changed.join("; ") }
}

/// A request as it came: the name of its command, its value and who asked.
fn request(command: &EventCommand) -> String {
    let by = command.by.as_ref().map_or_else(String::new, |by| {
        let value = quoted(&command.value.to_string(), 200);
        format!(" {value} by {by}")
    });
    format!("{}{by}", command.name)
}

/// The sentence for people.
impl fmt::Display for EventKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::StateChanged { what, to, consequence, .. } => {
                // The name of a mode, a reason or a status stands for itself.
                if !matches!(&**what, "mode" | "reason" | "status") {
                    write!(f, "{what} ")?;
                }
                let colon = if consequence.is_empty() { "" } else { ": " };
                write!(f, "{to}{colon}{consequence}")
            }
            Self::CommandScheduled { command, apply_tick, session } => {
                let (request, from) = (request(command), from_session(session.as_ref()));
                write!(f, "command scheduled for tick {apply_tick}: {request}{from}")
            }
            Self::CommandApplied { command } => write!(f, "command applied: {command}"),
            Self::CommandRefused { command, session, reason, so_far: Some(so_far) } => {
                let from = from_session(session.as_ref());
                refused(f, &format!("command {}{from}: {reason}", request(command)), *so_far)
            }
            Self::CommandRefused { command, reason, .. } => write!(f, "command refused: {command}: {reason}"),
            Self::CommandNeverApplied { command, at_s } => {
                write!(f, "never applied, {at_s} s is after the end: {command}")
            }
            Self::CommandsDiscarded { commands } => {
                write!(f, "{commands} commands that waited are discarded with the old run")
            }
            Self::SetpointRefused { name, client, reason, so_far } => {
                let by = client.as_ref().map_or_else(String::new, |client| format!(" by {client}"));
                refused(f, &format!("setpoint/{name}{by}: {reason}"), *so_far)
            }
            Self::LeaseTaken { client, for_s, session } => {
                write!(f, "{client} has the authority for {for_s} s{}", from_session(session.as_ref()))
            }
            Self::LeaseReturned { client, session } => {
                write!(f, "{client} gives the authority back{}", from_session(session.as_ref()))
            }
            Self::LeaseExpired { .. } => f.write_str("the lease has run out without being given back"),
            Self::LeaseRefused { client, session, reason, so_far } => {
                let client = client.as_ref().map_or_else(String::new, |client| format!(" for {client:?}"));
                refused(f, &format!("authority{client}{}: {reason}", from_session(session.as_ref())), *so_far)
            }
            Self::OperatorVanished { client } => write!(f, "operator {client} has vanished; its lease is over"),
            Self::OperatorLost { setpoints_stopped: true } => f.write_str("deadman: set-points stopped"),
            Self::OperatorLost { .. } => f.write_str("operator lost"),
            Self::OperatorPresent => f.write_str("operator present"),
            Self::MessagesMissing { source, messages } => write!(f, "gap: {messages} messages missing from {source}"),
            Self::MessageRefused { message, reason, so_far: Some(so_far) } => {
                refused(f, &format!("{message}: {reason}"), *so_far)
            }
            Self::MessageRefused { message, reason, .. } => {
                f.write_str(&quoted(&format!("{message}: {reason}"), QUOTED))
            }
            Self::MailboxOverflow { messages, so_far } => {
                refused(f, &format!("{messages} messages did not fit into the mailbox"), *so_far)
            }
            Self::SourceChanged { from, to } => write!(f, "{to} takes over from {from}"),
            Self::NotFinite { at_tick, signal, so_far: Some(so_far) } => {
                refused(f, &format!("tick {at_tick}: {signal} is NaN or infinite; not sent"), *so_far)
            }
            Self::NotFinite { at_tick, signal, .. } => write!(f, "tick {at_tick}: {signal} is NaN or infinite"),
            Self::TicksLeftOut { ticks } => write!(f, "stopped for too long: {ticks} ticks are left out"),
            Self::TicksLate { ticks } => write!(f, "{ticks} ticks late: simulated, not sent"),
            Self::RunStarted { run, at_tick } => write!(f, "run {run} begins at tick {at_tick}; starts afresh"),
            Self::RunRejoined { run, at_tick } => write!(f, "rejoins run {run} at tick {at_tick}"),
            Self::RunStopped { reason } | Self::RunFailed { reason } => f.write_str(reason),
            Self::RecordingOpened { path } => write!(f, "recording to {path}"),
            Self::RecordingClosed { path } => write!(f, "closed {path}"),
            Self::RecordingFailed { reason } => write!(f, "NOT RECORDING: {reason}; tried again every few seconds"),
            Self::NotRecorded { key, messages, after_tick: Some(after), before_tick } => {
                write!(f, "gap: {messages} messages of {key} between ticks {after} and {before_tick} are not recorded")
            }
            Self::NotRecorded { key, messages, before_tick, .. } => {
                write!(f, "gap: {messages} messages of {key} before tick {before_tick} are not recorded")
            }
            Self::RecorderOverrun { messages } => write!(f, "gap: the recorder was too slow for {messages} messages"),
            Self::ClockStepped { service, step_s } => write!(f, "the {service}'s clock stepped by {step_s:+.3} s"),
            Self::ConfigurationUnknown => f.write_str("the run's configuration is not known: nobody answered for it"),
            Self::ConnectionAccepted { name, from, times } => write!(f, "{name} has come from {from}{}", often(*times)),
            Self::ConnectionRefused { reason, times } => {
                write!(f, "a connection was refused: {reason}{}", often(*times))
            }
            Self::SessionWithoutRole { session, times } => {
                write!(f, "session {session} has no role here and may do nothing{}", often(*times))
            }
            Self::AccessRefused { name, session, action, key, times } => {
                let space = if name.is_empty() { "" } else { " " };
                write!(f, "{name}{space}(session {session}) may not {action} on {key}{}", often(*times))
            }
            Self::MoreRefused { refusals } => write!(f, "{refusals} more of other kinds"),
            Self::ReplayedOpenLoop { recording, from, controller, changed } => write!(
                f,
                "replay of {recording} from {from} on, with {controller} in command, open loop: the vehicle does not react; \
                 changed: {}",
                changes(changed)
            ),
            Self::ReplayedClosedLoop { recording, changed } => write!(
                f,
                "replay of {recording} in a closed loop: the plant has the estimator's nominal model and is driven by the \
                 disturbance that was found in the recording, in the place of current, waves and tether; changed: {}",
                changes(changed)
            ),
            Self::ReplayInexact { service, from_tick, to_tick, reason } => {
                write!(f, "{service}: not exact from tick {from_tick} to {to_tick}: {reason}")
            }
            Self::Text { text } => f.write_str(text),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::{PlantCommand, Setpoint};
    use std::collections::BTreeSet;

    fn depth(seq: Option<u64>) -> EventCommand {
        let command = serde_json::to_value(crate::command::GuidanceCommand::DepthM(Setpoint::Constant(4.5))).unwrap();
        EventCommand::new("guidance", command, Some(CommandSource { client: "anna".to_owned(), seq }))
    }

    fn changed(what: &'static str, from: &'static str, to: &'static str, consequence: &'static str) -> EventKind {
        EventKind::StateChanged { what: what.into(), from: from.into(), to: to.into(), consequence: consequence.into() }
    }

    /// Events of every kind, and what people read of them.
    fn every_kind() -> Vec<(EventKind, &'static str)> {
        let owned = |text: &str| text.to_owned();
        let gain = EventCommand::of_mission(&Command::Plant(PlantCommand::ThrusterGain { thruster: 1, gain: 0.5 }));
        let restart = EventCommand::new("estimator", json!("restart"), depth(Some(8)).by);
        let unread = EventCommand { service: "guidance".into(), name: owned("depth_m"), value: Value::Null, by: None };
        let session = || Some(owned("ab12"));
        let (client, reason) = (|| owned("anna"), || owned("too deep"));
        vec![
            (changed("mode", "neutral", "follow_net", ""), "follow_net"),
            (changed("net", "lost", "found", ""), "net found"),
            (changed("velocity", "found", "lost", "dead reckoning"), "velocity lost: dead reckoning"),
            (
                EventKind::CommandScheduled { command: depth(Some(7)), apply_tick: 13, session: session() },
                r#"command scheduled for tick 13: depth_m {"constant":4.5} by anna seq 7 from session ab12"#,
            ),
            (
                EventKind::CommandApplied { command: depth(Some(7)) },
                r#"command applied: {"depth_m":{"constant":4.5}} by anna seq 7"#,
            ),
            (EventKind::CommandApplied { command: restart }, r#"command applied: "restart" by anna seq 8"#),
            (
                EventKind::CommandApplied { command: gain.clone() },
                r#"command applied: {"plant":{"thruster_gain":{"gain":0.5,"thruster":1}}}"#,
            ),
            (
                EventKind::CommandRefused { command: depth(None), session: None, reason: reason(), so_far: None },
                r#"command refused: {"depth_m":{"constant":4.5}} by anna streaming: too deep"#,
            ),
            (
                EventKind::CommandRefused { command: unread, session: session(), reason: reason(), so_far: Some(3) },
                "refused: command depth_m from session ab12: too deep (3 so far)",
            ),
            (
                EventKind::CommandNeverApplied { command: gain, at_s: 71.0 },
                r#"never applied, 71 s is after the end: {"plant":{"thruster_gain":{"gain":0.5,"thruster":1}}}"#,
            ),
            (EventKind::CommandsDiscarded { commands: 2 }, "2 commands that waited are discarded with the old run"),
            (
                EventKind::SetpointRefused {
                    name: "depth_m".into(),
                    client: Some(client()),
                    reason: owned("late\n\u{7}"),
                    so_far: 1,
                },
                "refused: setpoint/depth_m by anna: late (1 so far)",
            ),
            (
                EventKind::LeaseTaken { client: client(), for_s: 30.0, session: session() },
                "anna has the authority for 30 s from session ab12",
            ),
            (EventKind::LeaseReturned { client: client(), session: None }, "anna gives the authority back"),
            (EventKind::LeaseExpired { client: client() }, "the lease has run out without being given back"),
            (
                EventKind::LeaseRefused { client: Some(client()), session: None, reason: owned("no"), so_far: 4 },
                r#"refused: authority for "anna": no (4 so far)"#,
            ),
            (EventKind::OperatorVanished { client: client() }, "operator anna has vanished; its lease is over"),
            (EventKind::OperatorLost { setpoints_stopped: true }, "deadman: set-points stopped"),
            (EventKind::OperatorLost { setpoints_stopped: false }, "operator lost"),
            (EventKind::OperatorPresent, "operator present"),
            (
                EventKind::MessagesMissing { source: owned("plant-1"), messages: 9 },
                "gap: 9 messages missing from plant-1",
            ),
            (
                EventKind::MessageRefused { message: owned("event"), reason: owned("no JSON"), so_far: None },
                "event: no JSON",
            ),
            (
                EventKind::MessageRefused { message: owned("message on wire 2"), reason: owned("no"), so_far: Some(5) },
                "refused: message on wire 2: no (5 so far)",
            ),
            (
                EventKind::MailboxOverflow { messages: 6, so_far: 7 },
                "refused: 6 messages did not fit into the mailbox (7 so far)",
            ),
            (EventKind::SourceChanged { from: owned("a-1"), to: owned("a-2") }, "a-2 takes over from a-1"),
            (
                EventKind::NotFinite { at_tick: 5, signal: "controller/sigma".into(), so_far: None },
                "tick 5: controller/sigma is NaN or infinite",
            ),
            (
                EventKind::NotFinite { at_tick: 5, signal: "controller/sigma".into(), so_far: Some(1) },
                "refused: tick 5: controller/sigma is NaN or infinite; not sent (1 so far)",
            ),
            (EventKind::TicksLeftOut { ticks: 90 }, "stopped for too long: 90 ticks are left out"),
            (EventKind::TicksLate { ticks: 2 }, "2 ticks late: simulated, not sent"),
            (EventKind::RunStarted { run: owned("r"), at_tick: 4 }, "run r begins at tick 4; starts afresh"),
            (EventKind::RunRejoined { run: owned("r"), at_tick: 4 }, "rejoins run r at tick 4"),
            (EventKind::RunStopped { reason: owned("interrupted") }, "interrupted"),
            (EventKind::RunFailed { reason: owned("waited 5 s") }, "waited 5 s"),
            (EventKind::RecordingOpened { path: owned("a.rrd") }, "recording to a.rrd"),
            (EventKind::RecordingClosed { path: owned("a.rrd") }, "closed a.rrd"),
            (
                EventKind::RecordingFailed { reason: owned("disk full") },
                "NOT RECORDING: disk full; tried again every few seconds",
            ),
            (
                EventKind::NotRecorded { key: owned("k"), messages: 3, after_tick: Some(1), before_tick: 5 },
                "gap: 3 messages of k between ticks 1 and 5 are not recorded",
            ),
            (
                EventKind::NotRecorded { key: owned("k"), messages: 3, after_tick: None, before_tick: 5 },
                "gap: 3 messages of k before tick 5 are not recorded",
            ),
            (EventKind::RecorderOverrun { messages: 8 }, "gap: the recorder was too slow for 8 messages"),
            (EventKind::ClockStepped { service: "plant".into(), step_s: 0.5 }, "the plant's clock stepped by +0.500 s"),
            (EventKind::ConfigurationUnknown, "the run's configuration is not known: nobody answered for it"),
            (
                EventKind::ConnectionAccepted { name: owned("pilot.rov"), from: owned("10.0.0.7:4711"), times: 1 },
                "pilot.rov has come from 10.0.0.7:4711",
            ),
            (
                EventKind::ConnectionRefused { reason: owned("expired"), times: 2 },
                "a connection was refused: expired (2 times)",
            ),
            (
                EventKind::SessionWithoutRole { session: owned("ab12"), times: 1 },
                "session ab12 has no role here and may do nothing",
            ),
            (
                EventKind::AccessRefused {
                    name: String::new(),
                    session: owned("ab12"),
                    action: owned("put"),
                    key: owned("estimator/nav"),
                    times: 3,
                },
                "(session ab12) may not put on estimator/nav (3 times)",
            ),
            (EventKind::MoreRefused { refusals: 10 }, "10 more of other kinds"),
            (
                EventKind::ReplayedOpenLoop {
                    recording: owned("paper"),
                    from: "controller".into(),
                    controller: owned("pid"),
                    changed: vec![owned("a=1"), owned("b=2")],
                },
                "replay of paper from controller on, with pid in command, open loop: the vehicle does not react; changed: \
                 a=1; b=2",
            ),
            (
                EventKind::ReplayedClosedLoop { recording: owned("paper"), changed: Vec::new() },
                "replay of paper in a closed loop: the plant has the estimator's nominal model and is driven by the \
                 disturbance that was found in the recording, in the place of current, waves and tether; changed: nothing",
            ),
            (
                EventKind::ReplayInexact { service: "plant".into(), from_tick: 1, to_tick: 2, reason: owned("gone") },
                "plant: not exact from tick 1 to 2: gone",
            ),
            (EventKind::Text { text: owned("hello") }, "hello"),
        ]
    }

    #[test]
    fn every_kind_has_its_sentence_and_comes_back_as_it_was() {
        for (what, sentence) in every_kind() {
            let event = Event { tick: 12, service: "guidance".into(), severity: Severity::Warning, what };
            let json = serde_json::to_value(&event).unwrap();
            assert_eq!((json["text"].as_str(), json["severity"].as_str()), (Some(sentence), Some("warning")));
            assert!(json["what"]["kind"].is_string(), "{json}");
            assert_eq!(serde_json::from_value::<Event>(json).unwrap(), event);
        }
        let unknown = json!({ "tick": 1, "service": "a", "severity": "info", "what": { "kind": "dream" }, "text": "" });
        assert!(serde_json::from_value::<Event>(unknown).is_err());
    }

    #[test]
    fn the_schema_has_every_kind_with_all_its_fields() {
        let schema = serde_json::to_value(schemars::schema_for!(EventKind)).unwrap();
        let fields = |properties: &Value| properties.as_object().unwrap().keys().cloned().collect::<BTreeSet<_>>();
        let described: BTreeSet<_> = schema["oneOf"]
            .as_array()
            .unwrap()
            .iter()
            .map(|kind| {
                let properties = &kind["properties"];
                (properties["kind"]["const"].as_str().unwrap().to_owned(), fields(properties))
            })
            .collect();
        let told: BTreeSet<_> = every_kind()
            .into_iter()
            .map(|(what, _)| {
                let json = serde_json::to_value(what).unwrap();
                (json["kind"].as_str().unwrap().to_owned(), fields(&json))
            })
            .collect();
        assert_eq!(described, told);
    }

    #[test]
    fn what_others_wrote_is_quoted_within_limits() {
        let mut command = depth(Some(1));
        command.value = json!("x\u{9b}".repeat(2000));
        let reason = "y".repeat(4000);
        let text = EventKind::CommandRefused { command, session: None, reason, so_far: Some(1) }.to_string();
        assert!(text.len() < 400 && !text.contains('\u{9b}') && text.ends_with("(1 so far)"), "{text}");
    }
}
