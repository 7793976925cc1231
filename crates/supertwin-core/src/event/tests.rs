//! Every kind of event has its sentence, its schema, and comes back as it was.

use super::*;
use crate::command::{GuidanceCommand, PlantCommand, Setpoint};
use std::collections::BTreeSet;

/// An event of every kind, as it stands on a wire: the data, and what people read of it.
const EVERY_KIND: &str = include_str!("kinds.jsonl");

fn every_kind() -> impl Iterator<Item = Value> {
    EVERY_KIND.lines().map(|line| serde_json::from_str(line).unwrap())
}

fn by_anna(service: &'static str, command: Value, seq: u64) -> EventCommand {
    EventCommand::new(service, command, Some(CommandSource { client: "anna".to_owned(), seq: Some(seq) }))
}

fn depth() -> EventCommand {
    by_anna("guidance", json!(GuidanceCommand::DepthM(Setpoint::Constant(4.5))), 7)
}

#[test]
fn every_kind_has_its_sentence_and_comes_back_as_it_was() {
    for written in every_kind() {
        let event: Event = serde_json::from_value(written.clone()).unwrap();
        assert_eq!(serde_json::to_value(event).unwrap(), written);
    }
    let unknown = json!({ "tick": 1, "service": "a", "severity": "info", "what": { "kind": "dream" }, "text": "" });
    assert!(serde_json::from_value::<Event>(unknown).is_err());
}

#[test]
fn commands_are_told_by_service_name_and_value() {
    let written: Vec<Value> = every_kind().map(|event| event["what"]["command"].clone()).collect();
    let gain = EventCommand::of_mission(&Command::Plant(PlantCommand::ThrusterGain { thruster: 1, gain: 0.5 }));
    for command in [gain, depth(), by_anna("estimator", json!("restart"), 8)] {
        assert!(written.contains(&json!(command)), "{command}");
    }
}

#[test]
fn the_schema_has_every_kind_with_all_its_fields() {
    let schema = serde_json::to_value(schemars::schema_for!(EventKind)).unwrap();
    let fields = |properties: &Value| properties.as_object().unwrap().keys().cloned().collect::<BTreeSet<_>>();
    let kinds = schema["oneOf"].as_array().unwrap().iter().map(|kind| &kind["properties"]);
    let described: BTreeSet<_> =
        kinds.map(|kind| (kind["kind"]["const"].as_str().unwrap().to_owned(), fields(kind))).collect();
    let told: BTreeSet<_> = every_kind()
        .map(|event| (event["what"]["kind"].as_str().unwrap().to_owned(), fields(&event["what"])))
        .collect();
    assert_eq!(described, told);
}

#[test]
fn what_others_wrote_is_quoted_within_limits() {
    let mut command = depth();
    command.value = json!("x\u{9b}".repeat(2000));
    let reason = "y".repeat(4000);
    let text = EventKind::CommandRefused { command, session: None, reason, so_far: Some(1) }.to_string();
    assert!(text.len() < 400 && !text.contains('\u{9b}') && text.ends_with("(1 so far)"), "{text}");
}
