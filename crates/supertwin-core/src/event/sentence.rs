//! The sentence of an event, for people: made from the data here and nowhere else.

use super::{CommandSource, EventCommand, EventKind};
use serde_json::json;
use std::fmt;

impl fmt::Display for CommandSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.seq {
            Some(seq) => write!(f, "{} seq {seq}", self.client),
            None => write!(f, "{} streaming", self.client),
        }
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
