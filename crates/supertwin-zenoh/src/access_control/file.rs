//! The matrix as files: what a router and its clients need to find each other, trust each other, and nothing more.

use super::{hash, limits, rules};
use crate::session::queue;
use serde_json::{Value, json};
use supertwin_protocol::Role;

/// Largest message that a link puts together, in bytes, before anybody looks at what it is.
const LARGEST_ON_A_LINK: usize = 1_048_576;
/// Clients at a time.
const CLIENTS: usize = 64;

/// The file of a vehicle's router; `tls` is Zenoh's section of that name, with certificate and key.
#[must_use]
pub fn router_file(vehicle: &str, listen: &[String], tls: &Value) -> String {
    let settings = json!({
        "mode": "router",
        "metadata": { "role": "vehicle", "vehicle": vehicle },
        "listen": { "endpoints": listen },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        "adminspace": { "enabled": false },
        "timestamping": { "enabled": false },
        "transport": {
            "unicast": { "max_sessions": CLIENTS, "accept_pending": CLIENTS, "accept_timeout": 5000 },
            "link": {
                "tx": { "lease": 2000, "queue": queue() },
                "rx": { "max_message_size": LARGEST_ON_A_LINK },
                "tls": tls,
            },
        },
        "access_control": rules::router_rules(vehicle),
        "low_pass_filter": limits::sizes(vehicle),
        "downsampling": limits::downsampling(vehicle),
        "qos": { "network": [{
            "id": "answers-never-wait", "link_protocols": ["tls"], "flows": ["ingress"], "messages": ["query"],
            "overwrite": { "congestion_control": "drop" },
        }] },
    });
    let heading = format!(
        "The router on {vehicle}, locked: written by `supertwin zenoh-config vehicle`.\n\
         Who may do what is `supertwin zenoh-config --matrix`; `supertwin doctor --credentials DIR` tries it.\n\
         Rules {}. Do not edit: write it again.",
        hash(&settings)
    );
    let comments = [
        ("metadata", "Which vehicle these rules protect; what the router has to tell is told in its name."),
        ("listen", "The socket is for the vehicle's own services: who may open it has full access to this vehicle."),
        ("scouting", "Nobody is found, nobody finds."),
        ("adminspace", "Nobody reads or changes the router itself over the network."),
        ("timestamping", "The vehicle's clock may be wrong; messages carry their own."),
        ("transport/unicast", "Strangers who say nothing do not keep others out."),
        (
            "transport/link/tx",
            "A silent tether counts as cut after two seconds. Whatever may be dropped waits 20 ms for room, so that a long \
             history gets through to whoever reads it.",
        ),
        ("transport/link/rx", "Nobody makes the router put together more than this."),
        ("transport/link/tls", "Both ends show a certificate of the fleet's authority; who has none gets no further."),
        ("access_control", "What is not allowed is denied. Common names are compared literally."),
        ("low_pass_filter", "Requests are looked at up to 4096 bytes, by the services as well."),
        (
            "downsampling",
            "The least distance between two messages of one client on one key, as a frequency: for histories, each of which \
             may be long, and for streams of set-points.",
        ),
        ("qos", "An answer to somebody who does not read is dropped; he asks again. It never holds the router up."),
    ];
    text(&heading, &settings, &comments)
}

/// The file of a client in a role.
#[must_use]
pub fn client_file(role: Role, vehicle: &str, connect: &[String], tls: &Value) -> String {
    let settings = json!({
        "mode": "client",
        "metadata": { "role": role.name(), "vehicle": vehicle },
        "connect": {
            "endpoints": connect,
            "timeout_ms": 5000,
            "exit_on_failure": true,
            "retry": { "period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2 },
        },
        "listen": { "endpoints": [] },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        "adminspace": { "enabled": false },
        "timestamping": { "enabled": false },
        "transport": {
            "link": {
                "tx": { "lease": 2000 },
                "rx": { "max_message_size": LARGEST_ON_A_LINK },
                "tls": tls,
            },
        },
    });
    let heading = format!(
        "{role} of {vehicle}: written by `supertwin zenoh-config {role}`.\n\
         For any Zenoh program: supertwin --zenoh THIS, or in Python zenoh.Config.from_file(\"THIS\")."
    );
    let comments = [
        ("metadata", "For people. What one may do is said by the certificate, not here."),
        ("connect", "The name or address must stand in the router's certificate. After a cut the link is back soon."),
        ("listen", "Nobody comes here."),
        ("scouting", "Nobody is found, nobody finds."),
        ("transport/link/tx", "A silent tether counts as cut after two seconds."),
        ("transport/link/tls", "Both ends show a certificate of the fleet's authority."),
    ];
    text(&heading, &settings, &comments)
}

/// Longest line.
const WIDTH: usize = 118;

/// The order in which settings are easiest to read; what is not here follows by the alphabet.
const ORDER: [&str; 24] = [
    "id",
    "mode",
    "metadata",
    "listen",
    "connect",
    "scouting",
    "adminspace",
    "timestamping",
    "transport",
    "access_control",
    "low_pass_filter",
    "downsampling",
    "qos",
    "enabled",
    "default_permission",
    "subjects",
    "rules",
    "policies",
    "permission",
    "link_protocols",
    "flows",
    "messages",
    "key_exprs",
    "key_expr",
];

fn ordered(map: &serde_json::Map<String, Value>) -> Vec<(&String, &Value)> {
    let rank = |name: &str| ORDER.iter().position(|other| *other == name).unwrap_or(ORDER.len());
    let mut entries: Vec<(&String, &Value)> = map.iter().collect();
    entries.sort_by(|(a, _), (b, _)| (rank(a), *a).cmp(&(rank(b), *b)));
    entries
}

/// As JSON5 with comments: `comments` by the path of what they stand above.
fn text(heading: &str, settings: &Value, comments: &[(&str, &str)]) -> String {
    let mut out: String = heading.lines().map(|line| format!("// {line}\n")).collect();
    write(&mut out, settings, "", 0, 0, comments);
    out.push('\n');
    out
}

/// `used` is what stands on the line already, the indentation included.
fn write(out: &mut String, value: &Value, path: &str, depth: usize, used: usize, comments: &[(&str, &str)]) {
    let has_comments = comments.iter().any(|(place, _)| place.starts_with(path) && place.len() > path.len());
    let line = inline(value);
    if !(value.is_object() && has_comments) && used + line.chars().count() < WIDTH {
        out.push_str(&line);
        return;
    }
    let indent = "  ".repeat(depth + 1);
    match value {
        Value::Object(map) => {
            out.push_str("{\n");
            for (name, value) in ordered(map) {
                let place = if path.is_empty() { name.clone() } else { format!("{path}/{name}") };
                if let Some((_, comment)) = comments.iter().find(|(other, _)| *other == place) {
                    for line in wrap(comment, WIDTH - indent.len() - 3) {
                        out.push_str(&format!("{indent}// {line}\n"));
                    }
                }
                out.push_str(&format!("{indent}{name}: "));
                // A path that no comment's path begins with ends the search for comments below it.
                write(out, value, &place, depth + 1, indent.len() + name.len() + 3, comments);
                out.push_str(",\n");
            }
            out.push_str(&format!("{}}}", "  ".repeat(depth)));
        }
        Value::Array(list) => {
            out.push_str("[\n");
            for value in list {
                out.push_str(&indent);
                write(out, value, "-", depth + 1, indent.len() + 1, comments);
                out.push_str(",\n");
            }
            out.push_str(&format!("{}]", "  ".repeat(depth)));
        }
        leaf => out.push_str(&leaf.to_string()),
    }
}

fn inline(value: &Value) -> String {
    match value {
        Value::Object(map) if map.is_empty() => "{}".to_owned(),
        Value::Object(map) => {
            let parts: Vec<String> =
                ordered(map).into_iter().map(|(name, value)| format!("{name}: {}", inline(value))).collect();
            format!("{{ {} }}", parts.join(", "))
        }
        Value::Array(list) => format!("[{}]", list.iter().map(inline).collect::<Vec<_>>().join(", ")),
        leaf => leaf.to_string(),
    }
}

fn wrap(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let line = lines.last_mut().filter(|line| line.is_empty() || line.len() + 1 + word.len() <= width);
        match line {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) => line.push_str(&format!(" {word}")),
            None => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tls() -> Value {
        json!({ "root_ca_certificate": "/etc/ca.pem", "enable_mtls": true, "close_link_on_expiration": true })
    }

    #[test]
    fn the_files_are_zenohs_commented_and_narrow() {
        let listen = ["unixsock-stream//tmp/r.sock".to_owned(), "tls/0.0.0.0:7447".to_owned()];
        let mut files = vec![router_file("rov", &listen, &tls())];
        files.extend(Role::ALL.map(|role| client_file(role, "rov", &["tls/rov:7447".to_owned()], &tls())));
        for file in files {
            let config = zenoh::Config::from_json5(&file);
            assert!(config.is_ok(), "{config:?}: {file}");
            assert!(file.starts_with("// ") && file.lines().all(|line| line.chars().count() <= 120), "{file}");
        }
    }

    #[test]
    fn the_router_wants_certificates_and_ends_links_that_outlive_them() {
        let file = router_file("rov", &["tls/0.0.0.0:7447".to_owned()], &tls());
        let settings: Value = json5::from_str(&file).expect("JSON5");
        let tls = &settings["transport"]["link"]["tls"];
        assert_eq!((&tls["enable_mtls"], &tls["close_link_on_expiration"]), (&json!(true), &json!(true)));
        assert!(file.contains(&format!("Rules {}.", hash(&settings))), "the hash is the file's own");
    }
}
