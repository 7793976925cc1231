//! Findings from the settings alone: certificates, exposure, rules of the router.

use super::finding::{Finding, ok, warning, wrong};
use serde_json::Value;
use std::path::Path;
use supertwin_pki as pki;
use supertwin_protocol::{Clock, SystemClock};
use supertwin_zenoh::{Link, access_control, diagnose, session};

/// Files that the settings name must be there, be readable, and be what they should be.
pub(super) fn files(settings: &Value) -> Vec<Finding> {
    let named = diagnose::files(settings);
    let bad: Vec<Finding> = named
        .iter()
        .filter_map(|(place, path)| {
            let cause = unreadable(place, path)?;
            let remedy = format!("correct {place}, or make the file readable for this user");
            Some(wrong("certificates", format!("{}: {cause} ({place})", path.display()), remedy))
        })
        .collect();
    match (named.len(), bad.is_empty()) {
        (0, _) => vec![ok("certificates", "none are named: nothing to read")],
        (n, true) => {
            let found = credentials(settings, &SystemClock::start());
            if found.is_empty() { vec![ok("certificates", format!("{n} files, all readable"))] } else { found }
        }
        _ => bad,
    }
}

/// Whether the certificates belong to their keys, until when they are in force, and who else can read the keys.
fn credentials(settings: &Value, clock: &dyn Clock) -> Vec<Finding> {
    let mut found = Vec::new();
    for side in ["listen", "connect"] {
        let Some(files) = session::tls_files(settings, side) else { continue };
        match files.check(clock) {
            Err(error) => found.push(wrong("certificates", error.to_string(), "see `supertwin pki --help`")),
            Ok(certificate) => {
                let left = pki::span(certificate.left_s(clock));
                let what = format!("{}: {}, {left} left", files.certificate.display(), certificate.common_name);
                found.push(match certificate.standing(0, clock) {
                    pki::Standing::Valid => ok("certificates", what),
                    _ => warning("certificates", what, "renew it where the authority is: `supertwin pki renew`"),
                });
            }
        }
        if let Some(text) = pki::loose(&files.key) {
            found.push(warning("certificates", text, "whoever can read the key can be its holder"));
        }
    }
    found.dedup();
    found
}

fn unreadable(place: &str, path: &Path) -> Option<String> {
    match std::fs::read_to_string(path) {
        Err(cause) => Some(cause.to_string()),
        Ok(text) if place.contains("/tls/") && !text.contains("-----BEGIN") => Some("is no PEM file".to_owned()),
        Ok(_) => None,
    }
}

/// Discovery and listeners.
pub(super) fn exposed(settings: &Value) -> Vec<Finding> {
    let exposure = |text: String| {
        let (check, remedy) = if text.contains("discovery") {
            ("discovery", "remove it: strangers on the same network would be joined with the vehicle")
        } else {
            ("listeners", "listen on tls/… with certificates, on loopback, or on a unix socket")
        };
        wrong(check, text, remedy)
    };
    let mut found: Vec<Finding> = session::exposures(settings).into_iter().map(exposure).collect();
    for (check, fine) in [("discovery", "off"), ("listeners", "none beyond this machine without TLS")] {
        if !found.iter().any(|finding| finding.check == check) {
            found.push(ok(check, fine));
        }
    }
    found
}

/// Whether a router's rules are those of this version.
pub(super) fn rules(settings: &Value) -> Vec<Finding> {
    let (Some(vehicle), true) =
        (settings["metadata"]["vehicle"].as_str(), settings["access_control"]["enabled"] == Value::Bool(true))
    else {
        return Vec::new();
    };
    let (found, ours) = (access_control::hash(settings), access_control::current_hash(vehicle));
    if found == ours {
        return vec![ok("rules", format!("{found}, as this version writes them for {vehicle}"))];
    }
    let what = format!("{found}; this version writes {ours} for {vehicle}");
    vec![warning("rules", what, "write them again with `supertwin zenoh-config vehicle`, or know why they differ")]
}

/// A router's file is examined, not obeyed: the doctor is a client of where that router listens.
pub(super) fn as_client(mut link: Link, settings: &Value) -> Link {
    if session::endpoints(settings, "connect").is_empty() {
        let reachable = session::endpoints(settings, "listen")
            .into_iter()
            .filter(|endpoint| !endpoint.ends_with(":0"))
            .map(|endpoint| endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:"));
        link.connect = reachable.collect();
    }
    link.listen.clear();
    link.mode = Some("client");
    link.overrides.extend(
        ["listen/endpoints=[]", "scouting/multicast/enabled=false", "scouting/gossip/enabled=false"].map(str::to_owned),
    );
    link
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_routers_file_makes_a_client_of_that_router() {
        let listen = json!({ "listen": { "endpoints": ["tcp/0.0.0.0:7447", "tcp/127.0.0.1:0"] } });
        let link = as_client(Link { mode: Some("router"), ..Link::default() }, &listen);
        assert_eq!((link.mode, link.connect), (Some("client"), vec!["tcp/127.0.0.1:7447".to_owned()]));
    }
}
