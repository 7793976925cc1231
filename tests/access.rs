//! Who may do what, over real TLS: each role tries each verb on each key, and finds exactly the documented matrix. Who has
//! no business here gets nowhere and leaves a trace.

mod attack;

use crate::support::{CONFIG, Listener, Place, Process, ROV, listening};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Duration;
use supertwin_pki::{Authority, DAY, Request};
use supertwin_protocol::access::{self, AccessRow, Verb};
use supertwin_protocol::role::{Role, Scope};
use supertwin_protocol::{Clock, SystemClock, keys};
use supertwin_zenoh::access_control::probe::{Seen, Witness};
use supertwin_zenoh::{Link, Session};

/// A fleet's authority, and a locked router of a vehicle.
struct Locked {
    place: Place,
    authority: Authority,
    clock: SystemClock,
    router: Process,
    tls: String,
}

impl Locked {
    /// The router is started from a file as users write it.
    fn start() -> Self {
        let (place, clock) = (Place::new(), SystemClock::start());
        let authority = Authority::init(&place.path().join("pki"), "fleet", DAY, &clock).expect("a new folder");
        let request = Request::new(Role::Vehicle, Scope::Vehicle(ROV.to_owned()), "rov-router");
        authority.issue(&request.at(&["localhost", "127.0.0.1"]), &clock).expect("is legal");
        let words =
            ["zenoh-config", "vehicle", "--vehicle", ROV, "--credentials", "pki/rov-router", "--out", "r.json5"];
        place.call(&[&words[..], &["--listen", &place.socket, "--listen", "tls/127.0.0.1:0"]].concat()).well();
        let router = place.start(&["serve", "router", "--json", "--zenoh", "r.json5"]);
        let said = router.json();
        assert!(said["access_rules"].as_str().is_some_and(|hash| hash.len() == 16), "{said}");
        Self { place, authority, clock, router, tls: listening(&said, "tls") }
    }

    /// Credentials of a role for the vehicle.
    fn issue(&self, role: Role) -> PathBuf {
        self.issue_for(role, Scope::Vehicle(ROV.to_owned()), role.name())
    }

    fn issue_for(&self, role: Role, scope: Scope, holder: &str) -> PathBuf {
        let folder = self.authority.folder.join(holder);
        if !folder.exists() {
            let request = Request::new(role, scope, holder);
            let request = if role.listens() { request.at(&["localhost", "127.0.0.1"]) } else { request };
            self.authority.issue(&request, &self.clock).expect("is legal");
        }
        folder
    }

    fn session(&self, role: Role) -> Session {
        self.join(&self.issue(role)).expect("is let in")
    }

    fn join(&self, credentials: &Path) -> Result<Session, String> {
        let (connect, credentials) = (vec![self.tls.clone()], Some(credentials.to_owned()));
        let link = Link { connect, credentials, patience_ms: 20_000, ..Link::default() };
        link.open().map_err(|error| error.to_string())
    }

    /// A session with full access.
    fn local(&self) -> Session {
        let link = Link { connect: vec![self.place.socket.clone()], patience_ms: 20_000, ..Link::default() };
        link.open().expect("the router is there")
    }

    fn witness(&self) -> Witness {
        Witness::open(&self.local(), ROV).expect("may see everything")
    }
}

#[test]
fn each_role_can_do_exactly_what_the_matrix_says() {
    let locked = Locked::start();
    let mut witness = locked.witness();
    let (mut differences, mut tried) = (Vec::new(), 0);
    for role in Role::ALL {
        let subject = locked.session(role);
        assert!(witness.settle(&subject, || Ok(())).expect("sessions live"), "{role} may ask for states");
        for row in access::matrix() {
            for verb in Verb::ALL {
                let seen = witness.attempt(&subject, &row, verb, row.allows(role, verb)).expect("sessions live");
                tried += 1;
                if !seen.is_expected(row.allows(role, verb)) {
                    differences.push(format!("{role} {verb} {}: {seen:?}", row.example(&witness.mark)));
                }
            }
        }
    }
    assert!(differences.is_empty(), "{} of {tried}: {differences:#?}", differences.len());
    assert!(tried > 1000, "{tried}");
}

/// Zenoh itself, without the checks that our own programs make of their credentials first.
fn raw(endpoint: &str, tls: &Value) -> Result<zenoh::Session, String> {
    use zenoh::Wait;
    let settings = json!({
        "mode": "client",
        "connect": { "endpoints": [endpoint], "timeout_ms": 0, "exit_on_failure": true },
        "scouting": { "multicast": { "enabled": false } },
        "transport": { "link": { "tls": tls } },
    });
    let config = zenoh::Config::from_json5(&settings.to_string()).expect("legal");
    zenoh::open(config).wait().map_err(|error| error.to_string())
}

/// A clock that is wrong.
struct Wrong(SystemClock, Duration);

impl Clock for Wrong {
    fn now(&self) -> Duration {
        self.0.now()
    }
    fn unix_ns(&self) -> u64 {
        self.0.unix_ns() - self.1.as_nanos() as u64
    }
}

/// A certificate that nobody but its holder has signed.
fn self_signed(folder: &Path, name: &str) -> (PathBuf, PathBuf) {
    let mut wanted = rcgen::CertificateParams::default();
    wanted.distinguished_name.push(rcgen::DnType::CommonName, name);
    let key = rcgen::KeyPair::generate().expect("a key");
    let made = wanted.self_signed(&key).expect("is signed");
    let (certificate, key_file) = (folder.join("stolen.pem"), folder.join("stolen.key"));
    std::fs::write(&certificate, made.pem()).expect("is written");
    std::fs::write(&key_file, key.serialize_pem()).expect("is written");
    (certificate, key_file)
}

#[test]
fn who_has_no_certificate_of_the_fleet_gets_no_word_in_and_leaves_a_trace() {
    let locked = Locked::start();
    let ca = locked.authority.folder.join("ca.pem");
    let other_fleet = Authority::init(&locked.place.path().join("other"), "other", DAY, &locked.clock).expect("new");
    let request = || Request::new(Role::Operator, Scope::Vehicle(ROV.to_owned()), "eve");
    let foreign = other_fleet.issue(&request(), &locked.clock).expect("is legal");
    let past = Wrong(SystemClock::start(), DAY / 2);
    let expired =
        locked.authority.issue(&Request { lifetime: Duration::from_secs(3600), ..request() }, &past).expect("is legal");
    let (stolen, stolen_key) = self_signed(locked.place.path(), "operator.rov");
    let with = |certificate: &Path, key: &Path| {
        json!({
            "root_ca_certificate": ca, "enable_mtls": true, "connect_certificate": certificate,
            "connect_private_key": key,
        })
    };
    for (what, tls, trace_of) in [
        ("no certificate", json!({ "root_ca_certificate": ca }), "peer sent no certificates"),
        ("another fleet's", with(&foreign.certificate, &foreign.key), "invalid peer certificate: UnknownIssuer"),
        ("an expired one", with(&expired.certificate, &expired.key), "invalid peer certificate: certificate expired"),
        ("a stolen name", with(&stolen, &stolen_key), "invalid peer certificate"),
    ] {
        let before = locked.router.errors().lines().count();
        let session = raw(&locked.tls, &tls);
        assert!(session.is_err(), "{what}: was let in");
        let line = locked.router.until_error(before, trace_of);
        assert!(line.starts_with("refused: a connection was refused"), "{what}: {line}");
    }
    // The door is no worse for it.
    assert!(locked.witness().settle(&locked.session(Role::Observer), || Ok(())).expect("sessions live"));
}

#[test]
fn a_certificate_counts_for_its_vehicle_alone_and_a_fleets_for_all() {
    let locked = Locked::start();
    let mut witness = locked.witness();
    let other = locked.issue_for(Role::Operator, Scope::Vehicle("nautilus".to_owned()), "pilot");
    let guest = locked.join(&other).expect("is of the fleet");
    assert!(!witness.settle(&guest, || Ok(())).expect("sessions live"), "another vehicle's operator may not even ask");
    for row in access::matrix() {
        for verb in Verb::ALL {
            let seen = witness.attempt(&guest, &row, verb, false).expect("sessions live");
            assert_eq!(seen, Seen::Nothing, "{verb} {:?}", row.keys);
        }
    }
    locked.router.until_error(0, "has no role here and may do nothing");
    let fleet = locked.join(&locked.issue_for(Role::Operator, Scope::Fleet, "anna")).expect("is of the fleet");
    let lease = row(keys::LEASE);
    assert_eq!(witness.attempt(&fleet, &lease, Verb::Get, true).expect("sessions live"), Seen::All);
    assert_eq!(witness.attempt(&fleet, &lease, Verb::Queryable, false).expect("sessions live"), Seen::Nothing);
    // Nobody reaches over to another vehicle, whatever he may do here, not even the vehicle's own.
    let own = locked.session(Role::Vehicle);
    for subject in [&fleet, &own] {
        for verb in [Verb::Put, Verb::Subscribe, Verb::Get, Verb::Queryable, Verb::Liveliness, Verb::Delete] {
            let key = "supertwin/nautilus/estimator/nav";
            assert_eq!(witness.attempt_on(subject, key, false, verb).expect("sessions live"), Seen::Nothing, "{verb}");
        }
    }
}

fn row(key: &str) -> AccessRow {
    let is = |row: &AccessRow| row.keys.iter().any(|other| other == key);
    access::matrix().into_iter().find(is).unwrap_or_else(|| panic!("no row for {key}"))
}

#[test]
fn what_somebody_may_not_is_told_with_his_name_and_honest_clients_cause_no_such_line() {
    let locked = Locked::start();
    let mut witness = locked.witness();
    let listener = Listener::open(&locked.place.socket, ROV).events();
    for role in [Role::Guidance, Role::Operator, Role::Observer, Role::Recorder] {
        let subject = locked.session(role);
        for row in access::matrix() {
            for verb in Verb::ALL.into_iter().filter(|verb| row.allows(role, *verb)) {
                let seen = witness.attempt(&subject, &row, verb, true).expect("sessions live");
                assert_eq!(seen, Seen::All, "{role} {verb} {:?}", row.keys);
            }
        }
    }
    let observer = locked.session(Role::Observer);
    let lease = row(keys::LEASE);
    assert_eq!(witness.attempt(&observer, &lease, Verb::Get, false).expect("sessions live"), Seen::Nothing);
    let told = locked.router.until_error(0, "may not");
    assert!(told.contains("refused: observer.rov (session ") && told.contains("may not query on"), "{told}");
    let first = locked.router.errors().lines().find(|line| line.starts_with("refused")).map(str::to_owned);
    assert_eq!(first, Some(told.clone()), "what was allowed was not refused");
    let text = told.trim_start_matches("refused: ");
    listener.until("the event of the router", |key, value| key == "event/router" && value["data"]["text"] == *text);
    locked.router.until_error(0, "observer.rov has come from 127.0.0.1:");
}

#[test]
fn a_router_that_everybody_could_reach_does_not_start_unless_told_so() {
    let place = Place::new();
    let ended = place.call(&["serve", "router", "--listen", "tcp/0.0.0.0:0"]);
    let ended = ended.refused("listens on tcp/0.0.0.0:0, beyond loopback and without TLS");
    ended.refused("zenoh-config").refused("--open-to-everyone");
    place.call(&["up", "--listen", "tcp/0.0.0.0:0"]).refused("");
    let mut told = place.start(&["serve", "router", "--json", "--listen", "tcp/0.0.0.0:0", "--open-to-everyone"]);
    assert!(told.json()["access_rules"].is_null(), "it says that it has none");
    told.signal("INT");
    let ended = told.finish();
    assert!(ended.err.contains("warning: listens on tcp/0.0.0.0:0"), "{}", ended.err);

    // TLS alone is not enough: whoever has a certificate could do everything.
    let clock = SystemClock::start();
    let authority = Authority::init(&place.path().join("pki"), "fleet", DAY, &clock).expect("new");
    let request = Request::new(Role::Vehicle, Scope::Fleet, "v").at(&["localhost"]);
    authority.issue(&request, &clock).expect("is legal");
    let credentials = authority.folder.join("v").display().to_string();
    let ended = place.call(&["serve", "router", "--listen", "tls/0.0.0.0:0", "--credentials", &credentials]);
    ended.refused("without access control that denies by default");
}

#[test]
fn the_shipped_examples_are_what_is_written() {
    let place = Place::new();
    assert_eq!(Role::ALL.len(), 5);
    for role in Role::ALL {
        let shipped = Path::new(CONFIG).join(format!("zenoh/locked-{role}.json5"));
        let mut words = vec!["zenoh-config", role.name(), "--vehicle", "argus-mini"];
        if role != Role::Vehicle {
            words.extend(["--connect", "tls/192.168.2.2:7447"]);
        }
        let written = place.call(&words).well().out;
        let shipped =
            std::fs::read_to_string(&shipped).unwrap_or_else(|error| panic!("{}: {error}", shipped.display()));
        assert_eq!(shipped, written, "write it again: supertwin {}", words.join(" "));
    }
}

#[test]
fn files_are_not_replaced_and_credentials_of_another_are_not_taken() {
    let (place, clock) = (Place::new(), SystemClock::start());
    let authority = Authority::init(&place.path().join("pki"), "fleet", DAY, &clock).expect("new");
    authority.issue(&Request::new(Role::Observer, Scope::Vehicle(ROV.to_owned()), "eva"), &clock).expect("is legal");
    let call = |words: &[&str]| place.call(&[&["zenoh-config"], words].concat());
    let write = ["observer", "--vehicle", ROV, "--credentials", "pki/eva", "--out", "x.json5"];
    call(&write).well();
    let text = std::fs::read_to_string(place.path().join("x.json5")).expect("is written");
    assert!(text.contains(&place.path().join("pki/eva/eva.key").display().to_string()), "absolute paths: {text}");
    call(&write).refused("x.json5: exists already; use --force");
    assert_eq!(call(&[&write[..], &["--force", "--json"]].concat()).well().json()["role"], "observer");
    for (words, says) in [
        (&["operator", "--vehicle", ROV, "--credentials", "pki/eva"][..], "is observer.rov: must be operator.rov or"),
        (&["observer", "--vehicle", "nautilus", "--credentials", "pki/eva"], "must be observer.nautilus or"),
        (&["observer", "--vehicle", "a/b"], "--vehicle a/b: must be 1 to 64 letters"),
        (&["observer", "--vehicle", ROV, "--listen", "tls/0.0.0.0:1"], "nobody connects to observer"),
        (&["vehicle", "--vehicle", ROV, "--connect", "tls/a:1"], "the vehicle's router listens"),
        (&["observer", "--vehicle", ROV, "--connect", "tcp/a:1"], "must be tls/HOST:PORT"),
        (&["pilot", "--vehicle", ROV], "pilot: no such role"),
    ] {
        call(words).refused(says);
    }
}

#[test]
fn the_matrix_is_printed_for_people_for_documentation_and_for_programs() {
    let place = Place::new();
    let json = place.call(&["zenoh-config", "--matrix", "--json"]).well().json();
    let rows = json["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), access::matrix().len());
    let markdown = place.call(&["zenoh-config", "--matrix", "--markdown"]).well().out;
    assert_eq!(markdown.lines().count(), rows.len() + 2);
    let text = place.call(&["zenoh-config", "--matrix"]).well().out;
    for row in rows {
        for key in row["keys"].as_array().expect("keys") {
            let key = key.as_str().expect("a key");
            assert!(markdown.contains(&format!("`{key}`")) && text.contains(key), "{key}");
        }
    }
    let documented = std::fs::read_to_string(Path::new(CONFIG).join("zenoh/access.md")).expect("is shipped");
    assert!(documented.ends_with(&markdown), "config/zenoh/access.md: supertwin zenoh-config --matrix --markdown");
}
