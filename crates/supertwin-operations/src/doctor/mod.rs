//! What is wrong with a set-up, and what to do: settings, router, services, certificates, rights.

mod finding;
pub mod prove;
mod services;
mod settings;

use crate::network::{NetworkClient, SERVICES};
use crate::{OperationError, Progress};
pub use finding::{Finding, Grade};
use finding::{ok, warning, wrong};
use prove::{Proof, ProofOptions};
use services::{access, clock, services, versions, writers};
use settings::{as_client, exposed, files, rules};
use std::collections::BTreeMap;
use supertwin_protocol::{Health, keys};
use supertwin_zenoh::{Link, LinkError, diagnose};

/// Health comes once a second.
const HEALTH_WAIT_S: f64 = 2.5;
/// Questions to the clock.
const PINGS: usize = 9;

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
    /// All findings in the order in which they were made.
    pub found: Vec<Finding>,
    tell: &'a mut dyn FnMut(Diagnosis<'_>),
}

impl<'a> Doctor<'a> {
    /// `tell` hears everything at once.
    pub fn new(tell: &'a mut dyn FnMut(Diagnosis<'_>)) -> Self {
        Self { found: Vec::new(), tell }
    }

    fn add(&mut self, finding: Finding) {
        (self.tell)(Diagnosis::Finding(&finding));
        self.found.push(finding);
    }

    fn extend(&mut self, findings: Vec<Finding>) {
        findings.into_iter().for_each(|finding| self.add(finding));
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
        && let Some(message) = network.inbox.next(Some(end))
    {
        if let Ok(health) = serde_json::from_slice::<Health>(&message.payload) {
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
