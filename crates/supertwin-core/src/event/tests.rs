//! Every kind of event has its sentence, its schema, and comes back as it was.

use super::*;
use crate::command::{PlantCommand, Setpoint};
use crate::signal::controller::SIGMA;
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
        (EventKind::MessagesMissing { source: owned("plant-1"), messages: 9 }, "gap: 9 messages missing from plant-1"),
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
            EventKind::NotFinite { at_tick: 5, signal: SIGMA.path.into(), so_far: None },
            "tick 5: controller/sigma is NaN or infinite",
        ),
        (
            EventKind::NotFinite { at_tick: 5, signal: SIGMA.path.into(), so_far: Some(1) },
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
