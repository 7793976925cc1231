//! JSON Schemas of everything on the wires, generated from the types that write and read it.

use crate::command_queue::{Answer, Request};
use crate::envelope::Envelope;
use crate::health::Health;
use crate::keys;
use crate::lease::{LeaseReply, LeaseRequest, LeaseState};
use crate::payload::{Applied, Now, Pong, Seen, Stop, StreamedSetpoint};
use crate::telemetry::{Description, Telemetry};
use schemars::generate::SchemaSettings;
use schemars::transform::transform_subschemas;
use schemars::{JsonSchema, Schema};
use serde_json::Value;
use supertwin_core::command::{ControllerCommand, EstimatorCommand, GuidanceCommand, PlantCommand};
use supertwin_core::message::{Measurements, Message, Nav, Reference, Thrust, Truth, WrenchRequest};
use supertwin_core::run::Properties;
use supertwin_core::{Event, unit};

/// A kind of payload.
#[derive(Clone, Debug, PartialEq)]
pub struct Described {
    /// Its name here, and of its file.
    pub name: &'static str,
    /// Where it travels, relative to the vehicle's namespace; `*` stands for one word, `**` for several.
    pub key: String,
    /// What the message tells, in a sentence.
    pub about: &'static str,
    /// JSON Schema, draft 2020-12.
    pub schema: Value,
}

/// All of them: messages of the ring first, then what every service says, then what can be asked.
#[must_use]
pub fn all() -> Vec<Described> {
    let any = "*";
    let measured_beside = "what the sensors of the twin beside a real vehicle deliver";
    let signals = "names and units of a service's signals";
    vec![
        message::<Measurements>("measurements", "what the sensors delivered at a tick"),
        message::<Truth>("truth", "the true state, for recordings and scores"),
        message::<Nav>("nav", "the vehicle's and the net's state as the estimator sees them"),
        message::<Reference>("reference", "smooth references with their derivatives"),
        message::<Thrust>("thrust", "thruster commands, and the wrench wanted and made"),
        message::<WrenchRequest>("wrench_request", "a wrench from outside, for the law external"),
        around::<Measurements>("shadow_measurements", keys::shadow(Measurements::KEY), measured_beside),
        around::<Truth>("shadow_truth", keys::shadow(Truth::KEY), "where that twin is"),
        around::<Telemetry>("telemetry", keys::telemetry(any), "everything a service shows at a tick"),
        around::<Event>("event", keys::event(any), "something that happened and must not be lost"),
        of::<Health>("health", keys::health(any), "a service's counters, once a second"),
        of::<Properties>("run", keys::state(any, "run"), "what is needed to repeat the run"),
        of::<Vec<Description<'static>>>("signals", keys::state(any, "signals"), signals),
        of::<Value>("parameters", keys::state(any, "parameters"), "names and values of what can be tuned, as a tree"),
        of::<Applied>("applied", keys::state(any, any), "the last accepted command of a name"),
        of::<Now>("now", keys::state(any, "now"), "which run and tick it is"),
        of::<Stop>("stop", keys::stop(any), "lock step: the run is over, and why"),
        of::<Seen>("seen", keys::witness(any), "lock step: a witness has seen a tick"),
        of::<LeaseState>("lease_state", keys::LEASE_STATE.to_owned(), "who may command, as all services know it"),
        of::<LeaseRequest>("lease_request", keys::LEASE.to_owned(), "asks for the authority to command"),
        of::<LeaseReply>("lease_reply", keys::LEASE.to_owned(), "the answer to lease_request"),
        of::<Request>("request", keys::command(any, any), "asks for a command, or at param/** for a parameter"),
        of::<Answer>("answer", keys::command(any, any), "the answer to request"),
        command::<PlantCommand>("plant_command", "plant"),
        command::<EstimatorCommand>("estimator_command", "estimator"),
        command::<GuidanceCommand>("guidance_command", "guidance"),
        command::<ControllerCommand>("controller_command", "controller"),
        of::<StreamedSetpoint>("setpoint", keys::setpoint(any), "one sample of a streaming set-point"),
        of::<Pong>("pong", keys::PING.to_owned(), "the vehicle's clock"),
        around::<Value>("envelope", "**".to_owned(), "what is around data in any message of a tick"),
    ]
}

fn message<M: Message + JsonSchema>(name: &'static str, about: &'static str) -> Described {
    around::<M>(name, M::KEY.to_owned(), about)
}

fn around<T: JsonSchema>(name: &'static str, key: String, about: &'static str) -> Described {
    of::<Envelope<'static, T>>(name, key, about)
}

/// A request names the command by its key and carries its value; missions write both as one table.
fn command<C: JsonSchema>(name: &'static str, service: &str) -> Described {
    let about = "commands: the property's name is that of the key, its value is the request's";
    of::<C>(name, keys::command(service, "*"), about)
}

fn of<T: JsonSchema>(name: &'static str, key: String, about: &'static str) -> Described {
    let mut schema = SchemaSettings::draft2020_12().with_transform(units).into_generator().into_root_schema_for::<T>();
    schema.insert("title".to_owned(), name.into());
    schema.insert("description".to_owned(), format!("{about}; on the key {key} of a vehicle").into());
    Described { name, key, about, schema: schema.into() }
}

/// Every number says its unit.
fn units(schema: &mut Schema) {
    if let Some(properties) = schema.get_mut("properties").and_then(Value::as_object_mut) {
        for (name, property) in properties {
            if let (Some(unit), Some(property)) = (unit::of(name), property.as_object_mut()) {
                property.insert("unit".to_owned(), unit.into());
            }
        }
    }
    transform_subschemas(&mut units, schema);
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::collections::BTreeSet;

    #[test]
    fn every_schema_says_what_it_is_and_names_are_unique() {
        let all = all();
        let names: BTreeSet<&str> = all.iter().map(|one| one.name).collect();
        assert_eq!(names.len(), all.len());
        for one in &all {
            assert_eq!(one.schema["$schema"], "https://json-schema.org/draft/2020-12/schema", "{}", one.name);
            assert_eq!(one.schema["title"], one.name);
            assert!(one.schema["description"].as_str().is_some_and(|text| text.contains(&one.key)), "{}", one.name);
        }
    }

    #[test]
    fn fields_have_their_documentation_and_their_unit() {
        let all = all();
        let nav = &all.iter().find(|one| one.name == "nav").expect("there").schema;
        let depth = &nav["$defs"]["Nav"]["properties"]["depth_m"];
        assert_eq!(depth["description"], "Below the mean surface.");
        assert_eq!((&depth["unit"], &depth["type"]), (&json!("m"), &json!("number")));
        assert_eq!(nav["$defs"]["Nav"]["additionalProperties"], false, "what is refused is no message");
        let required = nav["required"].as_array().expect("a list");
        assert!(required.contains(&json!("data")) && required.contains(&json!("tick")));
        assert!(!required.contains(&json!("repeat")), "left out when it is false");
    }
}
