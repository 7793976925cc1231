//! What is wrong with a set-up, and what to do: settings, router, services, certificates, rights.

pub mod prove;

use crate::network::{NetworkClient, SERVICES};
use crate::{OperationError, Progress};
use prove::{Proof, ProofOptions};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use supertwin_pki as pki;
use supertwin_protocol::{Clock, Health, SystemClock, keys};
use supertwin_zenoh::access_control::{self, Attempt};
use supertwin_zenoh::{Link, LinkError, diagnose, session};

/// Health comes once a second.
const HEALTH_WAIT_S: f64 = 2.5;
/// Clocks that differ by more make times of the two ends hard to compare.
const OFFSET_MS: f64 = 50.0;
/// Questions to the clock.
const PINGS: usize = 9;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Grade {
    /// As it should be.
    Ok,
    /// To be known.
    Warning,
    /// To be mended.
    Wrong,
}

/// The outcome of one check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What was looked at.
    pub check: &'static str,
    /// How bad it is.
    #[serde(rename = "verdict")]
    pub grade: Grade,
    /// What was found.
    pub what: String,
    /// What to do about it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
    /// The matrix as it was found, of a proof of access.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub attempts: Vec<Attempt>,
}

fn ok(check: &'static str, what: impl Into<String>) -> Finding {
    Finding { check, grade: Grade::Ok, what: what.into(), remedy: None, attempts: Vec::new() }
}

fn warning(check: &'static str, what: impl Into<String>, remedy: impl Into<String>) -> Finding {
    Finding { remedy: Some(remedy.into()), grade: Grade::Warning, ..ok(check, what) }
}

fn wrong(check: &'static str, what: impl Into<String>, remedy: impl Into<String>) -> Finding {
    Finding { remedy: Some(remedy.into()), grade: Grade::Wrong, ..ok(check, what) }
}

/// What the doctor has to say as it goes.
pub enum Diagnosis<'a> {
    /// The outcome of a check.
    Finding(&'a Finding),
    /// What each role may, beside what it should.
    Proofs(&'a [Proof]),
    /// A check could not be made as it should.
    Warning(String),
}

/// Collects findings, and hands them on as they come.
pub struct Doctor<'a> {
    found: Vec<Finding>,
    tell: &'a mut dyn FnMut(Diagnosis<'_>),
}

impl<'a> Doctor<'a> {
    /// `tell` hears everything at once.
    pub fn new(tell: &'a mut dyn FnMut(Diagnosis<'_>)) -> Self {
        Self { found: Vec::new(), tell }
    }

    /// All findings in the order in which they were made.
    #[must_use]
    pub fn found(self) -> Vec<Finding> {
        self.found
    }

    fn add(&mut self, finding: Finding) {
        (self.tell)(Diagnosis::Finding(&finding));
        self.found.push(finding);
    }

    fn extend(&mut self, findings: Vec<Finding>) {
        for finding in findings {
            self.add(finding);
        }
    }

    /// Looks at the settings of `link`; what a client of the router that they mean needs, unless they are wrong.
    pub fn examine_settings(&mut self, link: Link) -> Option<Link> {
        let place = link.file.as_ref().map_or("built-in settings".to_owned(), |path| path.display().to_string());
        let settings = match link.settings().and_then(|settings| link.config().map(|_| settings)) {
            Ok(settings) => settings,
            Err(cause) => {
                self.add(wrong("settings", cause.to_string(), "correct the file, or give another with --zenoh FILE"));
                return None;
            }
        };
        self.add(ok("settings", place));
        self.extend(files(&settings));
        self.extend(exposed(&settings));
        self.extend(rules(&settings));
        Some(as_client(link, &settings))
    }

    /// Joins the network; `None` when that is impossible, which is a finding.
    ///
    /// # Errors
    /// Anything but the link.
    pub fn join(&mut self, link: &Link) -> Result<Option<NetworkClient>, OperationError> {
        let network = match NetworkClient::join(link) {
            Ok(network) => network,
            // Found above already.
            Err(OperationError::Link(LinkError::Pki(_))) => return Ok(None),
            Err(OperationError::Link(cause)) => {
                let remedy = "start one with `supertwin up` or `supertwin serve router`, or say where it is: --connect \
                              tcp/ADDRESS:7447";
                self.add(wrong("router", cause.to_string(), remedy));
                return Ok(None);
            }
            Err(other) => return Err(other),
        };
        self.add(ok("router", format!("reached at {}", diagnose::links(&network.session).join(", "))));
        Ok(Some(network))
    }

    /// Everything that needs somebody to answer; `proof` tells whose rights are tried. Ends early when it is interrupted.
    ///
    /// # Errors
    /// The network fails, or it is not clear which vehicle is meant.
    pub fn examine_vehicle(
        &mut self,
        network: &mut NetworkClient,
        asked_for: Option<&str>,
        proof: &ProofOptions,
        progress: &dyn Progress,
    ) -> Result<(), OperationError> {
        let alive = network.alive()?;
        let vehicle = match network.vehicle(asked_for) {
            Ok(vehicle) => vehicle,
            Err(OperationError::Unmet(_)) => {
                self.add(wrong(
                    "services",
                    "none is up",
                    "start them with `supertwin up`, or one by one with `supertwin serve SERVICE`; if they are up, the \
                     router's access control hides supertwin/*/alive/** from you",
                ));
                return Ok(());
            }
            Err(other) => return Err(other),
        };
        let mut instances: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for (_, service, instance) in alive.iter().filter(|(other, ..)| *other == vehicle) {
            instances.entry(service).or_default().push(instance);
        }
        self.extend(services(&vehicle, &instances));
        let healths = healths(network, &vehicle, instances.values().map(Vec::len).sum(), progress)?;
        if network.stop.interrupted() {
            return Ok(());
        }
        let spoke = |service: &str| healths.keys().any(|source| is_instance_of(source, service));
        let mut readable = Vec::new();
        // A recorder answers nothing.
        for service in instances.keys().filter(|service| SERVICES.contains(service)) {
            let key = format!("{}/{}", keys::namespace(&vehicle), keys::state(service, "now"));
            let answers = !diagnose::ask_all(&network.session, &key)?.is_empty();
            readable.push((*service, spoke(service), answers));
        }
        if !instances.is_empty() {
            self.extend(access(readable.into_iter()));
        }
        self.extend(writers(&healths));
        if !healths.is_empty() {
            self.extend(versions(healths.values().map(|(_, last)| last), env!("CARGO_PKG_VERSION")));
        }
        if instances.contains_key("controller") {
            let key = format!("{}/{}", keys::namespace(&vehicle), keys::PING);
            self.add(clock(diagnose::clock_offset(&network.session, &key, &*network.clock, PINGS)?));
        }
        if !proof.holders.is_empty() {
            let (proofs, seen) = prove::prove(network, proof, &vehicle, self.tell, progress)?;
            (self.tell)(Diagnosis::Proofs(&proofs));
            self.extend(proven(proofs, seen));
        }
        Ok(())
    }
}

/// First and last health of each of `wanted` services: counters that grow are told from those that have grown.
fn healths(
    network: &mut NetworkClient,
    vehicle: &str,
    wanted: usize,
    progress: &dyn Progress,
) -> Result<BTreeMap<String, (Health, Health)>, OperationError> {
    network.inbox.listen(&network.session, &format!("{}/{}", keys::namespace(vehicle), keys::health("*")))?;
    progress.begin("listening to the services", (HEALTH_WAIT_S * 10.0).ceil() as u64);
    let (began, end) = (network.clock.now(), network.after(HEALTH_WAIT_S));
    let mut healths: BTreeMap<String, (Health, Health)> = BTreeMap::new();
    while wanted > 0
        && (healths.len() < wanted || healths.values().any(|(first, last)| first.clock_ns == last.clock_ns))
        && let Some(heard) = network.inbox.next(Some(end))
    {
        if let Ok(health) = serde_json::from_slice::<Health>(&heard.payload) {
            healths
                .entry(health.source.clone())
                .and_modify(|(_, last)| last.clone_from(&health))
                .or_insert_with(|| (health.clone(), health));
        }
        progress.reach((network.clock.now().saturating_sub(began).as_secs_f64() * 10.0) as u64);
    }
    progress.end();
    Ok(healths)
}

/// A health message's source is `service-instance`.
fn is_instance_of(source: &str, service: &str) -> bool {
    source.strip_prefix(service).is_some_and(|rest| rest.starts_with('-'))
}

/// Files that the settings name must be there, be readable, and be what they should be.
fn files(settings: &Value) -> Vec<Finding> {
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
fn exposed(settings: &Value) -> Vec<Finding> {
    let mut found: Vec<Finding> = session::exposures(settings)
        .into_iter()
        .map(|text| {
            if text.contains("discovery") {
                let remedy = "remove it: strangers on the same network would be joined with the vehicle";
                wrong("discovery", text, remedy)
            } else {
                let remedy = "listen on tls/… with certificates, on loopback, or on a unix socket";
                wrong("listeners", text, remedy)
            }
        })
        .collect();
    for (check, fine) in [("discovery", "off"), ("listeners", "none beyond this machine without TLS")] {
        if !found.iter().any(|finding| finding.check == check) {
            found.push(ok(check, fine));
        }
    }
    found
}

/// Whether a router's rules are those of this version.
fn rules(settings: &Value) -> Vec<Finding> {
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

/// What each role may and may not, as it was found.
fn proven(proofs: Vec<Proof>, seen: bool) -> Vec<Finding> {
    let mut found: Vec<Finding> = proofs
        .into_iter()
        .map(|proof| {
            let (all, tried, differences) = (proof.attempts.len(), proof.tried(), proof.differences());
            let finding = if differences.is_empty() {
                ok("rights", format!("{}: {tried} of {all} tried, all as documented", proof.who))
            } else {
                let n = differences.len();
                let what = format!("{}: {n} of {tried} are not as documented: {}", proof.who, differences.join("; "));
                wrong(
                    "rights",
                    what,
                    "write the router's file again with `supertwin zenoh-config vehicle`, and restart it",
                )
            };
            Finding { attempts: proof.attempts, ..finding }
        })
        .collect();
    if !seen {
        let what = "nobody here sees what arrives at the vehicle: most could not be tried";
        let remedy = "run it on the vehicle's computer, or give the vehicle's own credentials as well";
        found.push(warning("rights", what, remedy));
    }
    found
}

/// A router's file is examined, not obeyed: the doctor is a client of where that router listens.
fn as_client(mut link: Link, settings: &Value) -> Link {
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

/// All four, each once.
fn services(vehicle: &str, instances: &BTreeMap<&str, Vec<&str>>) -> Vec<Finding> {
    let mut found = Vec::new();
    for service in SERVICES {
        if !instances.contains_key(service) {
            let remedy = format!("start it: supertwin serve {service} --vehicle {vehicle}");
            found.push(wrong("services", format!("{service} of {vehicle} is missing"), remedy));
        }
    }
    if found.is_empty() {
        found.push(ok("services", format!("{vehicle}: {}", SERVICES.join(", "))));
    }
    for (service, several) in instances.iter().filter(|(_, several)| several.len() > 1) {
        let names: Vec<String> = several.iter().map(|instance| format!("{service}-{instance}")).collect();
        let what = format!("{} write the same keys", names.join(" and "));
        found.push(wrong("writers", what, format!("end all but one {service}")));
    }
    found
}

/// Whether what is alive can also be heard and asked.
fn access<'a>(services: impl Iterator<Item = (&'a str, bool, bool)>) -> Vec<Finding> {
    let mut found = Vec::new();
    for (service, heard, answers) in services {
        let remedy = |key: &str| {
            format!(
                "let this client read supertwin/*/{key} in the router's access_control; if it may, the service hangs"
            )
        };
        match (heard, answers) {
            (true, true) => {}
            (false, true) => {
                let what = format!("{service} answers, but its health isn't heard");
                found.push(wrong("access", what, remedy("health/**")));
            }
            (true, false) => {
                let what = format!("{service} is heard, but nobody answers state/{service}/now");
                found.push(wrong("access", what, remedy("state/**")));
            }
            (false, false) => {
                let what = format!("{service} is alive, but neither health nor state of it can be read");
                found.push(wrong("access", what, remedy("health/** and supertwin/*/state/**")));
            }
        }
    }
    if found.is_empty() {
        found.push(ok("access", "health and state of all services can be read"));
    }
    found
}

/// Two writers of one key, as their receivers count them.
fn writers(healths: &BTreeMap<String, (Health, Health)>) -> Vec<Finding> {
    let mut found: BTreeMap<&str, Finding> = BTreeMap::new();
    for (first, last) in healths.values() {
        for (key, input) in &last.inputs {
            let before = first.inputs.get(key).map_or(0, |input| input.counts.rivals);
            let (n, source) = (input.counts.rivals, &input.source);
            if n > before {
                let what = format!("{key}: somebody writes it beside {source} ({n} messages so far)");
                let remedy = "end the other one; `supertwin hz KEY --json` names the writers";
                found.insert(key, wrong("writers", what, remedy));
            } else if n > 0 {
                let what = format!("{key}: {n} messages came from somebody beside {source}, not any more");
                let remedy = "nothing to do now; `supertwin echo 'event/**'` tells when";
                found.entry(key).or_insert_with(|| warning("writers", what, remedy));
            }
        }
    }
    if found.is_empty() && !healths.is_empty() {
        return vec![ok("writers", "nobody hears a second one")];
    }
    found.into_values().collect()
}

/// Everybody the same version.
fn versions<'a>(healths: impl Iterator<Item = &'a Health>, ours: &str) -> Vec<Finding> {
    let others: Vec<Finding> = healths
        .filter(|health| health.version != ours)
        .map(|health| {
            let what = format!("{} is version {}, this is {ours}", health.source, health.version);
            wrong("versions", what, "install the same version on both ends")
        })
        .collect();
    if others.is_empty() { vec![ok("versions", format!("{ours} everywhere"))] } else { others }
}

fn clock(offset: Option<diagnose::ClockOffset>) -> Finding {
    match offset {
        None => warning("clock", "nobody answers clock/ping", "if the controller is up, let this client query it"),
        Some(found) => {
            // Less than the last digit is none, of either sign.
            let offset = if found.offset_ms.abs() < 0.05 { 0.0 } else { found.offset_ms };
            let trip = found.round_trip_ms;
            let what = format!("the vehicle's is {offset:+.1} ms from ours; round trip {trip:.1} ms");
            // Half the round trip is what can't be known.
            if offset.abs() - trip / 2.0 > OFFSET_MS {
                warning("clock", what, "set both clocks, e.g. with chrony; control does not depend on it")
            } else {
                ok("clock", what)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use supertwin_protocol::InputHealth;
    use supertwin_zenoh::diagnose::ClockOffset;

    #[test]
    fn another_version_is_named_on_both_ends() {
        let health =
            |version: &str| Health { source: "plant-1".to_owned(), version: version.to_owned(), ..Health::default() };
        let found = versions([health("0.1.0"), health("0.2.0")].iter(), "0.1.0");
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].grade, found[0].what.as_str()), (Grade::Wrong, "plant-1 is version 0.2.0, this is 0.1.0"));
        assert_eq!(versions([health("0.1.0")].iter(), "0.1.0")[0].grade, Grade::Ok);
    }

    #[test]
    fn clocks_far_apart_are_a_warning_and_a_slow_link_is_not() {
        let verdict = |offset_ms, round_trip_ms| clock(Some(ClockOffset { offset_ms, round_trip_ms })).grade;
        assert_eq!(verdict(-70.0, 2.0), Grade::Warning);
        assert_eq!(verdict(49.0, 2.0), Grade::Ok);
        assert_eq!(verdict(60.0, 300.0), Grade::Ok);
        assert_eq!(clock(None).grade, Grade::Warning);
    }

    #[test]
    fn rivals_that_grow_are_wrong_and_those_of_old_a_warning() {
        let health = |rivals| {
            let mut input = InputHealth { source: "controller-1".to_owned(), ..InputHealth::default() };
            input.counts.rivals = rivals;
            Health { inputs: BTreeMap::from([("controller/thrust".to_owned(), input)]), ..Health::default() }
        };
        let verdict =
            |first, last| writers(&BTreeMap::from([("plant-1".to_owned(), (health(first), health(last)))]))[0].grade;
        assert_eq!(verdict(3, 5), Grade::Wrong);
        assert_eq!(verdict(5, 5), Grade::Warning);
        assert_eq!(verdict(0, 0), Grade::Ok);
        assert!(writers(&BTreeMap::new()).is_empty(), "who heard nothing says nothing");
    }

    #[test]
    fn who_is_alive_and_can_not_be_read_is_found() {
        let found =
            access([("plant", true, true), ("guidance", false, true), ("controller", false, false)].into_iter());
        let services: Vec<&str> = found.iter().map(|finding| finding.what.split(' ').next().expect("word")).collect();
        assert_eq!(services, ["guidance", "controller"]);
        assert!(found.iter().all(|finding| finding.grade == Grade::Wrong && finding.remedy.is_some()));
    }

    #[test]
    fn a_routers_file_makes_a_client_of_that_router() {
        let listen = json!({ "listen": { "endpoints": ["tcp/0.0.0.0:7447", "tcp/127.0.0.1:0"] } });
        let link = as_client(Link { mode: Some("router"), ..Link::default() }, &listen);
        assert_eq!((link.mode, link.connect), (Some("client"), vec!["tcp/127.0.0.1:7447".to_owned()]));
    }
}
