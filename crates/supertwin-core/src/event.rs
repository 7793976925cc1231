//! What happened: an event is data for programs; the sentence for people is made from it in one place.

use crate::command::Command;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::borrow::Cow;

mod sentence;
#[cfg(test)]
mod tests;

/// Something that happened at a tick and must not be lost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(from = "EventWithText", into = "EventWithText")]
pub struct Event {
    /// Tick of the run at which it happened.
    pub tick: u64,
    /// Which service says so.
    pub service: Cow<'static, str>,
    /// How grave.
    pub severity: Severity,
    /// What happened.
    pub what: EventKind,
}

/// An event as it stands on a wire: the data for programs, and the sentence for people.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename = "Event")]
struct EventWithText {
    /// Tick of the run at which it happened.
    tick: u64,
    /// Which service says so.
    service: Cow<'static, str>,
    /// How grave.
    severity: Severity,
    /// What happened.
    what: EventKind,
    /// The same as a sentence for people; programs read `what`.
    text: String,
}

impl From<EventWithText> for Event {
    fn from(written: EventWithText) -> Self {
        let EventWithText { tick, service, severity, what, .. } = written;
        Self { tick, service, severity, what }
    }
}

impl From<Event> for EventWithText {
    fn from(event: Event) -> Self {
        let (text, Event { tick, service, severity, what }) = (event.text(), event);
        Self { tick, service, severity, what, text }
    }
}

impl Event {
    /// What `service` tells of a tick.
    pub fn new(tick: u64, service: impl Into<Cow<'static, str>>, severity: Severity, what: EventKind) -> Self {
        Self { tick, service: service.into(), severity, what }
    }

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

/// What happened. `so_far` counts what a service has refused: a flood makes one event a second. `session` is the Zenoh
/// session that a request names as its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum EventKind {
    /// A state of a block changed: its mode, the reason for it, its status, or the health of something it needs.
    StateChanged {
        /// Name of the state: mode, reason, status, or what the health is of.
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
        /// Tick at which it will apply.
        apply_tick: u64,
        /// Zenoh session that the request names as its own.
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
        /// Zenoh session that the request names as its own.
        session: Option<String>,
        /// Reason, as a sentence for people.
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
        /// Number of commands that waited.
        commands: u64,
    },
    /// A sample of a streaming set-point was refused.
    SetpointRefused {
        /// Name of the set-point.
        name: Cow<'static, str>,
        /// Who sent it, if it could be read.
        client: Option<String>,
        /// Reason, as a sentence for people.
        reason: String,
        /// Refusals of the service.
        so_far: u64,
    },
    /// A client has taken the authority to command.
    LeaseTaken {
        /// Name that the client gives itself.
        client: String,
        /// For how long.
        for_s: f64,
        /// Zenoh session that the request names as its own.
        session: Option<String>,
    },
    /// A client has given the authority back.
    LeaseReturned {
        /// Name that the client gives itself.
        client: String,
        /// Zenoh session that the request names as its own.
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
        /// Zenoh session that the request names as its own.
        session: Option<String>,
        /// Reason, as a sentence for people.
        reason: String,
        /// Refusals of the service.
        so_far: u64,
    },
    /// Who held the lease has disappeared from the network.
    OperatorVanished {
        /// Name that the client gives itself.
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
        /// Sender whose messages are missing.
        source: String,
        /// Number of messages that are missing.
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
        /// Number of ticks.
        ticks: u64,
    },
    /// The owner of time was late: the ticks were simulated, and their messages not sent.
    TicksLate {
        /// Number of ticks.
        ticks: u64,
    },
    /// A service begins another run.
    RunStarted {
        /// Identifier of the run.
        run: String,
        /// At this tick.
        at_tick: u64,
    },
    /// The owner of time was started anew, and goes on with the run that is there.
    RunRejoined {
        /// Identifier of the run.
        run: String,
        /// At this tick.
        at_tick: u64,
    },
    /// The run was stopped.
    RunStopped {
        /// Reason, as a sentence for people.
        reason: String,
    },
    /// The run can't go on.
    RunFailed {
        /// Reason, as a sentence for people.
        reason: String,
    },
    /// A file was opened for the recording.
    RecordingOpened {
        /// Path of the file.
        path: String,
    },
    /// A file of the recording was closed.
    RecordingClosed {
        /// Path of the file.
        path: String,
    },
    /// Nothing is recorded.
    RecordingFailed {
        /// Reason, as a sentence for people.
        reason: String,
    },
    /// Messages are missing from the recording.
    NotRecorded {
        /// On which key.
        key: String,
        /// Number of messages that are missing.
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
        /// Service whose clock was set.
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
        /// Address that the connection comes from.
        from: String,
        /// Number of times that this event stands for.
        times: u64,
    },
    /// Somebody was turned away by the router before a word was said.
    ConnectionRefused {
        /// Reason, as a sentence for people.
        reason: String,
        /// Number of times that this event stands for.
        times: u64,
    },
    /// The certificate of a session has no role here.
    SessionWithoutRole {
        /// The session.
        session: String,
        /// Number of times that this event stands for.
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
        /// Number of times that this event stands for.
        times: u64,
    },
    /// More refusals of the router than are told one by one.
    MoreRefused {
        /// Number of refusals that are not told one by one.
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
        /// Reason, as a sentence for people.
        reason: String,
    },
    /// Only the sentence is known, such as of a recording made before events were data.
    Text {
        /// The sentence.
        text: String,
    },
}
