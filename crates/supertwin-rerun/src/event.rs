//! Events in a recording, at `event/<service>`: the sentence for the viewer, and beside it the data as JSON for programs.

use crate::chunk_rows::{labels, strings};
use crate::chunks::{Clocks, Problem, Times, columns, nanos, text};
use rerun::external::arrow::array::StringArray;
use rerun::log::Chunk;
use rerun::{ComponentDescriptor, ComponentIdentifier, EntityPath, SerializedComponentBatch};
use std::iter;
use std::sync::Arc;
use supertwin_core::event::{CommandSource, EventCommand};
use supertwin_core::{Event, EventKind, Severity, Tick};

/// Component of `event/<service>` that holds the data of an event.
pub const DATA: &str = "data";

/// Events of one service, as a chunk.
pub(crate) fn chunk(service: &str, events: &[(Event, Option<Clocks>)], dt_s: f64) -> Result<Chunk, Problem> {
    let ticks: Vec<i64> = events.iter().map(|(event, _)| event.tick as i64).collect();
    let nanos = events.iter().map(|(event, _)| nanos(Tick { k: event.tick, dt_s })).collect();
    let clocks: Vec<Clocks> = events.iter().filter_map(|(_, clocks)| *clocks).collect();
    let level = |(event, _): &(Event, Option<Clocks>)| match event.severity {
        Severity::Info => rerun::TextLogLevel::INFO,
        Severity::Warning => rerun::TextLogLevel::WARN,
        Severity::Error => rerun::TextLogLevel::ERROR,
    };
    let log = rerun::TextLog::update_fields()
        .with_many_text(events.iter().map(|(event, _)| event.text()))
        .with_many_level(events.iter().map(level));
    let data = events.iter().map(|(event, _)| serde_json::to_string(&event.what)).collect::<Result<Vec<_>, _>>();
    let data = StringArray::from_iter_values(data.map_err(text)?);
    let data = SerializedComponentBatch::new(Arc::new(data), ComponentDescriptor::partial(DATA))
        .partitioned(iter::repeat_n(1, events.len()))
        .map_err(text)?;
    let entity = EntityPath::from_single_string("event").join(&EntityPath::from_single_string(service));
    let components = log.columns_of_unit_batches().map(|log| log.chain([data]));
    columns(entity, Times::new(ticks, nanos).with_clocks(&clocks), components)
}

/// The events of a chunk of `event/<service>`.
pub(crate) fn read(service: &str, chunk: &Chunk) -> Result<Vec<Event>, Problem> {
    let sentences = labels(chunk, rerun::TextLog::descriptor_text().component)?;
    let levels = strings(chunk, rerun::TextLog::descriptor_level().component);
    let data = strings(chunk, ComponentIdentifier::from(DATA)).chain(iter::repeat(None));
    let rows = sentences.into_iter().zip(levels).zip(data);
    Ok(rows
        .map(|((sentence, level), data)| {
            let severity = match level.as_deref() {
                Some("INFO") => Severity::Info,
                Some("WARN") => Severity::Warning,
                _ => Severity::Error,
            };
            let tick = u64::try_from(sentence.tick).unwrap_or(0);
            // Of an event of a later version the sentence is left.
            let known = data.and_then(|data| serde_json::from_str(&data).ok());
            let what = known.unwrap_or_else(|| from_old_sentence(service, sentence.value));
            Event { tick, service: service.to_owned().into(), severity, what }
        })
        .collect())
}

/// The event of a recording made before events were data. Of its sentence is read what alignment and replay ask for: a
/// command that applied, of the mission of a batch run or of a client. Everything else stays a sentence.
fn from_old_sentence(service: &str, sentence: String) -> EventKind {
    let applied = sentence.strip_prefix("command applied: ").and_then(|rest| {
        if let Ok(command) = serde_json::from_str(rest) {
            return Some(EventCommand::of_mission(&command));
        }
        let (command, by) = rest.rsplit_once(" by ")?;
        let (client, seq) = by.rsplit_once(" seq ")?;
        let by = CommandSource { client: client.to_owned(), seq: seq.parse().ok() };
        Some(EventCommand::new(service.to_owned(), serde_json::from_str(command).ok()?, Some(by)))
    });
    applied.map_or(EventKind::Text { text: sentence }, |command| EventKind::CommandApplied { command })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(tick: u64, service: &'static str, severity: Severity, what: EventKind) -> (Event, Option<Clocks>) {
        (Event { tick, service: service.into(), severity, what }, None)
    }

    fn restart() -> EventCommand {
        EventCommand::of_mission(&serde_json::from_str(r#"{"estimator":"restart"}"#).unwrap())
    }

    #[test]
    fn events_come_back_as_data_and_have_their_sentences_for_the_viewer() {
        let text = "only a sentence".to_owned();
        let events = [
            event(7, "mission", Severity::Info, EventKind::CommandApplied { command: restart() }),
            event(8, "mission", Severity::Warning, EventKind::OperatorLost { setpoints_stopped: true }),
            event(9, "mission", Severity::Error, EventKind::Text { text }),
        ];
        let chunk = chunk("mission", &events, 0.02).unwrap();
        assert_eq!(read("mission", &chunk).unwrap(), events.map(|(event, _)| event));
        let sentences = labels(&chunk, rerun::TextLog::descriptor_text().component).unwrap();
        assert_eq!((sentences[1].value.as_str(), sentences[1].time_ns), ("deadman: set-points stopped", 160_000_000));
    }

    #[test]
    fn of_an_old_recording_the_commands_that_applied_are_understood() {
        let fault = r#"command applied: {"plant":{"thruster_gain":{"thruster":1,"gain":0.5}}}"#;
        let asked = r#"command applied: {"depth_m":{"constant":4.5}} by anna seq 7"#;
        let sentences =
            [fault, r#"command applied: {"estimator":"restart"}"#, asked, "command applied: what?", "net lost"];
        let log = rerun::TextLog::update_fields().with_many_text(sentences).with_many_level(["INFO"; 5]);
        let times = Times::new((0..5).collect(), vec![0; 5]);
        let old = columns("event/guidance", times, log.columns_of_unit_batches()).unwrap();
        let events = read("guidance", &old).unwrap();
        let command = |i: usize| match &events[i].what {
            EventKind::CommandApplied { command } => command.clone(),
            other => panic!("{other:?}"),
        };
        assert!(command(0).is_fault() && command(0).name == "thruster_gain", "{:?}", command(0));
        assert_eq!(command(1), restart());
        let by = Some(CommandSource { client: "anna".to_owned(), seq: Some(7) });
        assert_eq!((command(2).service.as_ref(), command(2).name.as_str(), command(2).by), ("guidance", "depth_m", by));
        let texts: Vec<String> = events.iter().map(Event::text).collect();
        assert_eq!(texts[1..], sentences[1..], "what people read stays");
        assert!(events[3..].iter().all(|event| matches!(event.what, EventKind::Text { .. })));
    }
}
