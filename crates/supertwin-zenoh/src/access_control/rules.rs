//! The matrix as rules of a router: default deny, roles by common name of the certificate, the vehicle's own by its socket.
//!
//! A rule lets a message through when one of its keys includes the message's. Three consequences shape them:
//! * Listening is let in broadly and its results are let out narrowly: who listens to everything hears what is his.
//! * `**` never matches `@adv`: those keys stand in each rule by themselves.
//! * Some ask with patterns (`state/*/now`); their rule names the pattern of the whole family, if all of it is theirs.

use super::limits;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use supertwin_protocol::access::{AccessRow, Verb, matrix};
use supertwin_protocol::keys;
use supertwin_protocol::role::{Role, Scope, common_name};

/// Everything of everybody: for what is harmless by itself, because what comes of it is filtered.
fn anything() -> Vec<String> {
    let all = keys::namespace("**");
    vec![keys::advanced(&all), all]
}

/// One direction, the messages, their keys.
struct Permission {
    flow: &'static str,
    messages: &'static [&'static str],
    keys: Vec<String>,
}

fn ingress(messages: &'static [&'static str], keys: Vec<String>) -> Permission {
    Permission { flow: "ingress", messages, keys }
}

fn egress(messages: &'static [&'static str], keys: Vec<String>) -> Permission {
    Permission { flow: "egress", messages, keys }
}

/// Rules of a router of `vehicle`, as Zenoh's `access_control`.
#[must_use]
pub fn router_rules(vehicle: &str) -> Value {
    let rows = matrix();
    let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
    for role in Role::ALL {
        let permissions = if role == Role::Vehicle { own(vehicle) } else { permissions(&rows, role, vehicle) };
        let mut names = Vec::new();
        for permission in permissions.into_iter().filter(|permission| !permission.keys.is_empty()) {
            let name = format!(
                "{role}-{}-{}",
                if permission.flow == "ingress" { "in" } else { "out" },
                permission.messages[0]
            );
            rules.push(json!({
                "id": name, "permission": "allow", "flows": [permission.flow], "messages": permission.messages,
                "key_exprs": permission.keys,
            }));
            names.push(name);
        }
        let scopes = [Scope::Vehicle(vehicle.to_owned()), Scope::Fleet];
        subjects.push(json!({
            "id": role.name(), "link_protocols": ["tls"],
            "cert_common_names": scopes.map(|scope| common_name(role, &scope)),
        }));
        let mut whom = vec![role.name()];
        if role == Role::Vehicle {
            subjects.push(json!({ "id": LOCAL, "link_protocols": ["unixsock-stream"] }));
            whom.push(LOCAL);
        }
        policies.push(json!({ "id": role.name(), "rules": names, "subjects": whom }));
    }
    json!({
        "enabled": true, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies,
    })
}

/// The subject of whoever comes by the router's unix socket: the socket's folder says who that can be.
const LOCAL: &str = "local";

/// The vehicle's own services: everything below their name, and listening to what else they may be told.
fn own(vehicle: &str) -> Vec<Permission> {
    let root = keys::namespace(vehicle);
    let own = vec![format!("{root}/**"), keys::advanced(&format!("{root}/**"))];
    let listening = &["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"];
    let declared =
        &["query", "declare_subscriber", "declare_queryable", "declare_liveliness_subscriber", "liveliness_query"];
    vec![
        ingress(&["put", "delete", "reply", "declare_queryable", "liveliness_token"], own.clone()),
        ingress(listening, anything()),
        egress(&["put", "delete", "reply", "liveliness_token"], own),
        // What comes in was let in by the asker's own rules, perhaps with a pattern for the vehicle's name.
        egress(declared, anything()),
    ]
}

fn permissions(rows: &[AccessRow], role: Role, vehicle: &str) -> Vec<Permission> {
    let root = keys::namespace(vehicle);
    let full = |key: &String| format!("{root}/{key}");
    // Fleet tools ask all vehicles at once, with `*` for the name.
    let any = |key: &String| format!("{}/{key}", keys::namespace("*"));
    let with = |verb: Verb| rows.iter().filter(move |row| row.allows(role, verb));
    let own_keys = |verb: Verb| with(verb).flat_map(|row| row.keys.iter().map(full)).collect::<Vec<_>>();
    let received = with(Verb::Subscribe).filter(|row| !row.is_liveliness()).flat_map(|row| row.keys.iter().map(full));
    let seen = with(Verb::Subscribe).filter(|row| row.is_liveliness() || !row.bases().is_empty());
    let asked: Vec<String> = with(Verb::Get)
        .filter(|row| !row.is_liveliness())
        .flat_map(|row| [row.keys.clone(), whole_family(rows, row, role).into_iter().collect()].concat())
        .collect();
    let answered: Vec<String> = with(Verb::Queryable)
        .flat_map(|row| [row.keys.clone(), row.family.clone().into_iter().collect()].concat())
        .collect();
    // A cache answers with the keys of the messages that it kept.
    let bases = |verb: Verb| with(verb).flat_map(|row| row.bases()).collect::<Vec<_>>();
    let both = |keys: &[String]| -> Vec<String> { keys.iter().map(full).chain(keys.iter().map(any)).collect() };
    let if_any = |empty: bool| if empty { Vec::new() } else { anything() };
    let (puts, tokens) = (own_keys(Verb::Put), own_keys(Verb::Liveliness));
    let answers = with(Verb::Queryable).flat_map(|row| [row.keys.clone(), row.bases()].concat());
    let answers = answers.map(|key| full(&key)).collect();
    let seen = seen.flat_map(|row| row.keys.iter().map(full)).collect();
    let replies = asked.iter().cloned().chain(bases(Verb::Get)).map(|key| full(&key)).collect();
    let listening = &["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"];
    let all = vec![
        ingress(&["put"], puts.clone()),
        ingress(&["delete"], own_keys(Verb::Delete)),
        ingress(listening, anything()),
        ingress(&["query"], both(&asked)),
        ingress(&["declare_queryable"], own_keys(Verb::Queryable)),
        ingress(&["reply"], answers),
        ingress(&["liveliness_token"], tokens.clone()),
        egress(&["put", "delete"], received.collect()),
        egress(&["liveliness_token"], seen),
        egress(&["reply"], replies),
        egress(&["query"], both(&answered)),
        // Who writes must learn that somebody listens, who asks that somebody answers.
        egress(&["declare_subscriber"], if_any(puts.is_empty())),
        egress(&["declare_queryable"], if_any(asked.is_empty())),
        egress(&["declare_liveliness_subscriber", "liveliness_query"], if_any(tokens.is_empty())),
    ];
    all.into_iter()
        .map(|mut permission| {
            permission.keys.sort();
            permission.keys.dedup();
            permission
        })
        .collect()
}

/// The pattern of a row's family, if the role may ask all of it.
fn whole_family(rows: &[AccessRow], row: &AccessRow, role: Role) -> Option<String> {
    let family = row.family.as_ref()?;
    let theirs = rows.iter().filter(|other| other.family.as_ref() == Some(family));
    theirs.into_iter().all(|other| other.allows(role, Verb::Get)).then(|| family.clone())
}

/// What tells two sets of rules apart: the first half of the SHA-256 of everything that decides what is let through.
#[must_use]
pub fn hash(settings: &Value) -> String {
    let decides = ["access_control", "low_pass_filter", "downsampling"].map(|section| &settings[section]);
    let text: String = decides.iter().map(|section| canonical(section)).collect();
    Sha256::digest(text.as_bytes()).iter().take(8).map(|byte| format!("{byte:02x}")).collect()
}

/// The hash of what this version writes for a vehicle.
#[must_use]
pub fn current_hash(vehicle: &str) -> String {
    hash(&json!({
        "access_control": router_rules(vehicle),
        "low_pass_filter": limits::sizes(vehicle),
        "downsampling": limits::downsampling(vehicle),
    }))
}

/// As text that does not depend on the order of names.
fn canonical(value: &Value) -> String {
    match value {
        Value::Object(map) => {
            let mut permissions: Vec<String> =
                map.iter().map(|(name, value)| format!("{name:?}:{}", canonical(value))).collect();
            permissions.sort();
            format!("{{{}}}", permissions.join(","))
        }
        Value::Array(list) => format!("[{}]", list.iter().map(canonical).collect::<Vec<_>>().join(",")),
        // A file says 500 where a program says 500.0.
        Value::Number(number) => number.as_f64().map_or_else(|| number.to_string(), |number| number.to_string()),
        leaf => leaf.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::watch::overlap;

    #[test]
    fn the_rules_are_zenohs_and_deny_by_default() {
        let rules = router_rules("rov");
        assert_eq!(rules["default_permission"], "deny");
        let config = zenoh::Config::from_json5(&json!({ "access_control": rules }).to_string());
        assert!(config.is_ok(), "{config:?}");
        let ids: Vec<&str> =
            rules["rules"].as_array().expect("a list").iter().filter_map(|rule| rule["id"].as_str()).collect();
        assert!(ids.contains(&"operator-in-query") && !ids.contains(&"observer-in-put"), "{ids:?}");
        assert!(!ids.iter().any(|id| id.ends_with("-in-delete")), "{ids:?}");
    }

    #[test]
    fn a_row_is_included_in_its_family_and_includes_its_example() {
        for row in matrix() {
            for family in row.family.iter() {
                assert!(row.keys.iter().all(|key| overlap(family, key)), "{family} {:?}", row.keys);
            }
            assert!(overlap(&row.example("probe"), &row.keys[0]), "{:?}", row.keys);
        }
    }

    #[test]
    fn another_vehicles_name_stands_in_no_rule() {
        let text = router_rules("rov").to_string();
        assert!(text.contains("operator.rov") && text.contains("operator.fleet") && !text.contains("argus"));
    }

    #[test]
    fn the_hash_sees_every_change_that_matters() {
        let settings =
            |vehicle: &str, size: u64| json!({ "access_control": router_rules(vehicle), "low_pass_filter": size });
        assert_eq!(hash(&settings("rov", 1)), hash(&settings("rov", 1)));
        assert_ne!(hash(&settings("rov", 1)), hash(&settings("rov", 2)));
        assert_ne!(hash(&settings("rov", 1)), hash(&settings("rav", 1)));
        assert_eq!(hash(&json!({})).len(), 16);
    }
}
