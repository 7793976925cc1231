//! Certificates by the command line: what it makes, what it refuses, and what it says about those that need a hand.

use crate::support::Place;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt;

fn fleet() -> Place {
    let place = Place::new();
    place.call(&["pki", "init", "--fleet", "rataren"]).well();
    place
}

fn mode(place: &Place, path: &str) -> u32 {
    fs::metadata(place.path().join(path)).expect("exists").permissions().mode() & 0o777
}

#[test]
fn from_nothing_to_the_folder_that_is_handed_over() {
    let place = fleet();
    let said =
        place.call(&["pki", "issue", "vehicle", "argus", "--vehicle", "argus-mini", "--host", "10.0.0.2"]).well();
    assert!(said.out.starts_with("pki/argus: argus is vehicle.argus-mini until 2"), "{said:?}");
    let words = ["pki", "issue", "operator", "anna", "--fleet-wide", "--minutes", "90", "--json"];
    let made = place.call(&words).well().json();
    assert_eq!(made["says"]["common_name"], "operator.fleet");
    assert_eq!(made["key"], "pki/anna/anna.key");
    let files = fs::read_dir(place.path().join("pki/anna")).expect("a folder").flatten();
    let files: BTreeSet<_> = files.map(|entry| entry.file_name()).collect();
    assert_eq!(files, ["anna.key", "anna.pem", "ca.pem"].map(Into::into).into());
    for (path, wanted) in [("pki", 0o700), ("pki/ca.key", 0o600), ("pki/anna", 0o700), ("pki/anna/anna.key", 0o600)] {
        assert_eq!(mode(&place, path), wanted, "{path}");
    }

    let shown = place.call(&["pki", "show", "--json"]).well().json();
    let all = shown["certificates"].as_array().expect("a list");
    assert_eq!(all.len(), 3, "{shown}");
    let argus = all.iter().find(|one| one["holder"] == "argus").expect("is there");
    assert_eq!(argus["hosts"], serde_json::json!(["10.0.0.2", "localhost", "127.0.0.1", "::1"]));
    assert!((29.9..=30.0).contains(&argus["days_left"].as_f64().expect("a number")), "{argus}");
    let table = place.call(&["pki", "show"]).well().out;
    assert!(table.contains("vehicle.argus-mini") && table.contains("rataren"), "{table}");
}

/// Shakes hands in memory, as somebody else's TLS would: the server's holder, the client's, the host that is called.
const HANDSHAKE: &str = r#"
import ssl, sys
def files(holder):
    return f"pki/{holder}/{holder}.pem", f"pki/{holder}/{holder}.key"
_, served, calling, host = sys.argv
server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
server.verify_mode = ssl.CERT_REQUIRED
client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
for context, holder in ((server, served), (client, calling)):
    context.load_cert_chain(*files(holder))
    context.load_verify_locations("pki/ca.pem")
up, down = ssl.MemoryBIO(), ssl.MemoryBIO()
ends = [client.wrap_bio(down, up, server_hostname=host), server.wrap_bio(up, down, server_side=True)]
for _ in range(4):
    for end in ends:
        try:
            end.do_handshake()
        except ssl.SSLWantReadError:
            pass
print(ends[1].getpeercert()["subject"])
"#;

#[test]
fn another_tls_agrees_with_what_was_made() {
    let place = fleet();
    place.call(&["pki", "issue", "vehicle", "argus", "--vehicle", "argus-mini", "--host", "argus.local"]).well();
    place.call(&["pki", "issue", "operator", "anna", "--vehicle", "argus-mini"]).well();
    let shake = |served: &str, calling: &str, host: &str| {
        let done = place.command("python3").args(["-c", HANDSHAKE, served, calling, host]).output().expect("python3");
        let said = String::from_utf8([done.stdout, done.stderr].concat()).expect("text");
        if done.status.success() { Ok(said) } else { Err(said) }
    };
    let said = shake("argus", "anna", "argus.local").expect("they know each other");
    assert!(said.contains("operator.argus-mini") && said.contains("anna"), "{said}");
    shake("argus", "argus", "127.0.0.1").expect("the vehicle calls itself");
    let said = shake("argus", "anna", "other.local").expect_err("is not that host");
    assert!(said.contains("not valid for 'other.local'"), "{said}");
    let said = shake("anna", "argus", "argus.local").expect_err("an operator can't stand for the vehicle");
    assert!(said.contains("purpose"), "{said}");
}

#[test]
fn what_would_replace_a_key_or_is_not_legal_is_refused_with_its_rule() {
    let place = fleet();
    place.call(&["pki", "issue", "operator", "anna", "--vehicle", "argus-mini"]).well();
    for (words, said) in [
        ("init", "a key is never replaced"),
        ("issue operator anna --vehicle argus-mini", "pki/anna: exists"),
        ("issue pilot ben --fleet-wide", "vehicle, guidance, operator, observer, recorder"),
        ("issue operator ben", "--vehicle"),
        ("issue operator ben --vehicle fleet", "stands for all of them"),
        ("issue operator ../ben --fleet-wide", "holder ../ben"),
        ("issue operator ben --fleet-wide --host a.local", "must name no host"),
        ("issue vehicle v --fleet-wide --host a.local:7447", "without a port"),
        ("issue operator ben --fleet-wide --days 3 --minutes 3", "cannot be used"),
        ("renew nobody", "nobody: No such file"),
        ("show nowhere", "no credentials"),
        ("issue operator ben --fleet-wide --dir empty", "supertwin pki init"),
    ] {
        place.call(&[&["pki"][..], &words.split(' ').collect::<Vec<_>>()].concat()).refused(said);
    }
    assert!(!place.path().join("pki/ben").exists(), "nothing is left of a refusal");
}

#[test]
fn what_needs_a_hand_is_shown_with_status_one_and_renewal_mends_it() {
    let place = fleet();
    place.call(&["pki", "issue", "operator", "anna", "--vehicle", "argus-mini"]).well();
    let key = fs::read(place.path().join("pki/anna/anna.key")).expect("the key");
    let shown = place.call(&["pki", "show", "--within", "31", "pki/anna"]);
    assert_eq!(shown.code, Some(1), "{shown:?}");
    assert!(shown.out.contains("warning: pki/anna/anna.pem: expires in "), "{}", shown.out);
    place.call(&["pki", "renew", "anna", "--days", "60"]).well();
    place.call(&["pki", "show", "--within", "31", "pki/anna"]).well();
    assert_eq!(fs::read(place.path().join("pki/anna/anna.key")).expect("the key"), key);
    assert!(place.call(&["pki", "renew"]).well().out.contains("nothing to renew"));

    // A certificate that was sent, without its key, in a folder of its own.
    fs::copy(place.path().join("pki/anna/anna.pem"), place.path().join("sent.pem")).expect("is copied");
    let renewed = place.call(&["pki", "renew", "sent.pem", "--json"]).well().json();
    assert_eq!(renewed["renewed"][0]["certificate"]["common_name"], "operator.argus-mini");

    fs::set_permissions(place.path().join("pki/anna/anna.key"), fs::Permissions::from_mode(0o644)).expect("is ours");
    let shown = place.call(&["pki", "show", "--json"]);
    assert_eq!(shown.code, Some(1), "{shown:?}");
    let list = |value: &Value| value.as_array().expect("a list").clone();
    let problems =
        list(&shown.json()["certificates"]).iter().flat_map(|one| list(&one["problems"])).collect::<Vec<_>>();
    assert_eq!(problems.len(), 1, "{problems:?}");
    assert!(problems[0].as_str().is_some_and(|text| text.contains("chmod 600 pki/anna/anna.key")), "{problems:?}");
    let found = place.call(&["doctor", "--connect", "tls/localhost:1", "--credentials", "pki/anna"]);
    assert!(found.out.contains("warning  certificates: pki/anna/anna.key is open to others"), "{found:?}");
}

#[test]
fn credentials_that_can_not_be_used_are_named_before_anybody_is_called() {
    let place = fleet();
    for (holder, minutes) in [("old", "0.02"), ("good", "60")] {
        place.call(&["pki", "issue", "observer", holder, "--fleet-wide", "--minutes", minutes]).well();
    }
    let tls = |credentials: &str| place.call(&["top", "--connect", "tls/localhost:1", "--credentials", credentials]);
    let mut said = tls("pki/old");
    // It lives for a second.
    while !said.err.contains("expired on") {
        said.refused("no router at");
        said = tls("pki/old");
    }
    said.refused("pki/old/old.pem: expired on").refused("pki renew");
    let found = place.call(&["doctor", "--connect", "tls/localhost:1", "--credentials", "pki/old"]);
    assert_eq!(found.code, Some(1));
    assert!(found.out.contains("wrong    certificates: pki/old/old.pem: expired"), "{found:?}");

    tls("pki/good").refused("no router at tls/localhost:1");
    // A prefix does as well.
    tls("pki/good/good").refused("no router at");
    tls("pki").refused("the authority's own folder");
    tls("nowhere").refused("nowhere: no credentials");
    fs::copy(place.path().join("pki/old/old.key"), place.path().join("pki/good/good.key")).expect("is copied");
    tls("pki/good").refused("good.key: is not the key of");
    let by_environment = place.shell("SUPERTWIN_CREDENTIALS=nowhere supertwin top --connect tls/localhost:1");
    by_environment.refused("nowhere: no credentials");
}
