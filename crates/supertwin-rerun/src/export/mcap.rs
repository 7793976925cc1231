//! A channel per signal, in JSON with a JSON Schema each; the time of a message is the simulated time.

use super::Exported;
use super::tick_table::{Cursor, State, TickTable, components};
use crate::{APPLICATION, Recording};
use mcap::records::{MessageHeader, Metadata};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::io::{self, Seek, Write};
use supertwin_core::{Event, Property, Severity};

/// Topic of the events.
const EVENTS: &str = "/events";

pub(super) fn write(recording: &Recording, table: &TickTable<'_>, to: impl Write + Seek) -> io::Result<Exported> {
    let library = concat!("supertwin ", env!("CARGO_PKG_VERSION"));
    let mut file = File { writer: mcap::WriteOptions::new().library(library).create(to).map_err(wrong)?, messages: 0 };
    for (group, properties) in &recording.properties {
        let text = |value: &Property| match value {
            Property::Integer(n) => n.to_string(),
            Property::Number(x) => format!("{x:?}"),
            Property::Text(text) => text.clone(),
        };
        let metadata = properties.iter().map(|(name, value)| (name.clone(), text(value))).collect();
        let name = format!("{APPLICATION}.{group}");
        file.writer.write_metadata(&Metadata { name, metadata }).map_err(wrong)?;
    }

    let mut signals = Vec::new();
    for (path, columns) in &table.signals {
        let keys: Vec<String> =
            components(path, columns).into_iter().map(|name| name.unwrap_or_else(|| "value".to_owned())).collect();
        let numbers = keys.iter().map(|key| (key.clone(), json!({ "type": ["number", "null"] })));
        let channel = file.channel(path, &format!("/{path}"), &numbers.collect())?;
        signals.push((channel, keys, Cursor::new(columns)));
    }
    let mut labels = Vec::new();
    for (path, changes) in &table.labels {
        let value = Map::from_iter([("value".to_owned(), json!({ "type": "string" }))]);
        labels.push((file.channel(path, &format!("/{path}"), &value)?, State::new(changes)));
    }
    let log = file.channel("foxglove.Log", EVENTS, &log_schema())?;

    let mut events = recording.events.iter().peekable();
    for &(tick, time_ns) in &table.moments {
        while let Some(event) = events.next_if(|event| event.tick as i64 <= tick) {
            file.message(log, time_ns, &log_entry(event, time_ns))?;
        }
        for (channel, keys, cursor) in &mut signals {
            if let Some(row) = cursor.at(tick) {
                // JSON knows no NaN: it becomes null.
                let row = keys.iter().zip(row).map(|(key, value)| (key.clone(), json!(value))).collect();
                file.message(*channel, time_ns, &Value::Object(row))?;
            }
        }
        for (channel, state) in &mut labels {
            if let Some((value, true)) = state.at(tick) {
                file.message(*channel, time_ns, &json!({ "value": value }))?;
            }
        }
    }
    let end_ns = table.moments.last().map_or(0, |moment| moment.1);
    for event in events {
        file.message(log, end_ns, &log_entry(event, end_ns))?;
    }
    file.writer.finish().map_err(wrong)?;
    Ok(Exported { rows: file.messages, columns: signals.len() + labels.len() + 1 })
}

struct File<W: Write + Seek> {
    writer: mcap::Writer<W>,
    messages: u64,
}

impl<W: Write + Seek> File<W> {
    fn channel(&mut self, schema: &str, topic: &str, properties: &Map<String, Value>) -> io::Result<u16> {
        let text = json!({ "title": schema, "type": "object", "properties": properties }).to_string();
        let schema = self.writer.add_schema(schema, "jsonschema", text.as_bytes()).map_err(wrong)?;
        self.writer.add_channel(schema, topic, "json", &BTreeMap::new()).map_err(wrong)
    }

    fn message(&mut self, channel_id: u16, time_ns: i64, content: &Value) -> io::Result<()> {
        let log_time = u64::try_from(time_ns).unwrap_or(0);
        let header = MessageHeader { channel_id, sequence: self.messages as u32, log_time, publish_time: log_time };
        self.messages += 1;
        self.writer.write_to_known_channel(&header, &serde_json::to_vec(content)?).map_err(wrong)
    }
}

/// Foxglove's own schema of a log entry.
fn log_schema() -> Map<String, Value> {
    let whole = json!({ "type": "integer", "minimum": 0 });
    let time = json!({ "type": "object", "title": "time", "properties": { "sec": whole, "nsec": whole } });
    let text = json!({ "type": "string" });
    Map::from_iter([
        ("timestamp".to_owned(), time),
        ("level".to_owned(), whole.clone()),
        ("message".to_owned(), text.clone()),
        ("name".to_owned(), text.clone()),
        ("file".to_owned(), text),
        ("line".to_owned(), whole),
    ])
}

fn log_entry(event: &Event, time_ns: i64) -> Value {
    let time_ns = u64::try_from(time_ns).unwrap_or(0);
    let level = match event.severity {
        Severity::Info => 2,
        Severity::Warning => 3,
        Severity::Error => 4,
    };
    let timestamp = json!({ "sec": time_ns / 1_000_000_000, "nsec": time_ns % 1_000_000_000 });
    json!({
        "timestamp": timestamp, "level": level, "message": event.text(), "name": event.service, "file": "", "line": 0
    })
}

fn wrong(error: mcap::McapError) -> io::Error {
    match error {
        mcap::McapError::Io(error) => error,
        error => io::Error::other(error),
    }
}
