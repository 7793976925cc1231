//! Who may do what with which key: the matrix, once. The router's rules, the documentation, the test over TLS and the
//! doctor all come from it.

use crate::keys;
use crate::role::Role;
use serde::{Deserialize, Serialize};
use supertwin_core::Message;
use supertwin_core::message::{Measurements, Nav, Reference, Thrust, Truth, WrenchRequest};

/// What can be done with a key.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, strum::Display, strum::IntoStaticStr,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Verb {
    /// Publish on it.
    Put,
    /// Hear what is published; of `alive/…`: hear who comes and goes.
    Subscribe,
    /// Ask, and get the answer; of `alive/…`: ask who is there.
    Get,
    /// Answer what is asked.
    Queryable,
    /// Show a sign of life under it.
    Liveliness,
    /// Publish its deletion.
    Delete,
}

impl Verb {
    /// All verbs, in the order of their letters in the matrix.
    pub const ALL: [Self; 6] = [Self::Put, Self::Subscribe, Self::Get, Self::Queryable, Self::Liveliness, Self::Delete];

    /// Its name, as in the documentation.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// Keys that are treated alike, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccessRow {
    /// Key expressions, relative to the vehicle's namespace.
    pub keys: Vec<String>,
    /// A pattern that includes them and their relatives, by which some ask for all of them at once.
    pub family: Option<String>,
    /// Why it is as it is.
    pub why: &'static str,
    rights: Vec<(Role, &'static [Verb])>,
}

impl AccessRow {
    /// Whether a role may do this.
    #[must_use]
    pub fn allows(&self, role: Role, verb: Verb) -> bool {
        // The vehicle's own services trust each other; which of them writes what is decided where they are started.
        role == Role::Vehicle || self.verbs(role).contains(&verb)
    }

    /// What a role may do.
    #[must_use]
    pub fn verbs(&self, role: Role) -> &[Verb] {
        if role == Role::Vehicle {
            return &Verb::ALL;
        }
        self.rights.iter().find(|(other, _)| *other == role).map_or(&[], |(_, verbs)| verbs)
    }

    /// Signs of life: subscribing and asking are those of liveliness.
    #[must_use]
    pub fn is_liveliness(&self) -> bool {
        self.keys.iter().all(|key| key.starts_with(ALIVE))
    }

    /// A key of it with `name` where it has a wildcard.
    #[must_use]
    pub fn example(&self, name: &str) -> String {
        let key = self.keys.first().map_or("", String::as_str);
        let parts: Vec<&str> = key.split('/').map(|part| if part.starts_with('*') { name } else { part }).collect();
        parts.join("/")
    }

    /// Letters of the verbs that a role may, in their order; a dot where it may not.
    #[must_use]
    pub fn letters(&self, role: Role) -> String {
        let letter = |verb: Verb| verb.name().to_uppercase().chars().next().filter(|_| self.allows(role, verb));
        Verb::ALL.map(|verb| letter(verb).unwrap_or('·')).iter().collect()
    }

    /// Keys without the advanced publishers' suffix.
    #[must_use]
    pub fn bases(&self) -> Vec<String> {
        self.keys.iter().filter_map(|key| key.strip_suffix(keys::ADVANCED).map(str::to_owned)).collect()
    }
}

/// Where signs of life stand.
const ALIVE: &str = "alive/";

/// The services that stand on the vehicle whatever happens; guidance may stand topside.
pub const ABOARD: [&str; 4] = ["plant", "estimator", "controller", "shadow"];

use Role::{Guidance, Observer, Operator, Recorder};
use Verb::{Get, Liveliness, Put, Queryable, Subscribe};

const NONE: &[Verb] = &[];
const SUBSCRIBE: &[Verb] = &[Subscribe];
const GET: &[Verb] = &[Get];
const SUBSCRIBE_GET: &[Verb] = &[Subscribe, Get];
const SUBSCRIBE_GET_LIVELINESS: &[Verb] = &[Subscribe, Get, Liveliness];
const PUT: &[Verb] = &[Put];
const PUT_SUBSCRIBE: &[Verb] = &[Put, Subscribe];
const QUERYABLE: &[Verb] = &[Queryable];
const LIVELINESS: &[Verb] = &[Liveliness];
/// What an advanced publisher does beside publishing: says its last number, answers for its cache, shows itself.
const ADVANCED_PUBLISHER: &[Verb] = &[Put, Queryable, Liveliness];
/// The same, of one that also reads what others publish there.
const ADVANCED_PUBLISHER_READER: &[Verb] = &[Put, Subscribe, Get, Queryable, Liveliness];
const STATE: &[Verb] = &[Put, Get, Queryable];

/// A row in which those who look, the operator, the observer and the recorder, may do `readers`, but for the rights of
/// `others`.
fn row(keys: &[String], readers: &'static [Verb], others: &[(Role, &'static [Verb])], why: &'static str) -> AccessRow {
    let readers = [Operator, Observer, Recorder].map(|role| (role, readers)).into_iter();
    let readers = readers.filter(|(role, _)| others.iter().all(|(other, _)| other != role));
    AccessRow { keys: keys.to_vec(), family: None, why, rights: readers.chain(others.iter().copied()).collect() }
}

/// The same rows below a pattern that includes them and their relatives.
fn family<const N: usize>(pattern: &str, rows: [AccessRow; N]) -> [AccessRow; N] {
    rows.map(|row| AccessRow { family: Some(pattern.to_owned()), ..row })
}

/// The whole matrix. What stands in no row is for the vehicle's own services alone; another vehicle's keys are for nobody.
#[must_use]
pub fn matrix() -> Vec<AccessRow> {
    let mut rows = wires();
    rows.extend(published_by_services());
    rows.extend(queried());
    rows.extend(liveliness());
    rows
}

/// The ring's wires and what steers them.
fn wires() -> Vec<AccessRow> {
    let one = |key: &str| [key.to_owned()];
    let missed = |key: &str| row(&[keys::advanced(key)], SUBSCRIBE_GET, &[], "what was missed of it can be asked for");
    let (measurements, truth) = (keys::shadow(Measurements::KEY), keys::shadow(Truth::KEY));
    let missed_shadow = missed(&truth);
    let steers = "an external controller is an operator: it steers, and its messages carry no token";
    let joystick = "a joystick; each message carries the holder's token, so that not even a recorder may read it";
    vec![
        row(
            &one(Measurements::KEY),
            SUBSCRIBE,
            &[],
            "only the plant, or a real vehicle's driver, says what was measured",
        ),
        row(&one(Truth::KEY), SUBSCRIBE, &[], "for recordings and scores; the brain never sees it"),
        missed(Truth::KEY),
        row(&[measurements, truth], SUBSCRIBE, &[], "the twin beside a real vehicle: for those who look"),
        missed_shadow,
        row(&one(Nav::KEY), SUBSCRIBE, &[(Guidance, SUBSCRIBE)], "whoever forges navigation steers the vehicle"),
        row(&one(Reference::KEY), SUBSCRIBE, &[(Guidance, PUT)], "guidance alone writes where to go"),
        row(&one(Thrust::KEY), SUBSCRIBE, &[], "the controller alone drives the thrusters"),
        row(&one(WrenchRequest::KEY), NONE, &[(Operator, PUT_SUBSCRIBE), (Recorder, SUBSCRIBE)], steers),
        row(&[keys::setpoint("*")], NONE, &[(Guidance, SUBSCRIBE), (Operator, PUT)], joystick),
    ]
}

/// What services say about themselves.
fn published_by_services() -> Vec<AccessRow> {
    let with_router = |key: fn(&str) -> String| [&ABOARD.map(key)[..], &[key("router")]].concat();
    let telemetry_cache = |service: &str| keys::advanced(&keys::telemetry(service));
    let event_cache = |service: &str| keys::advanced(&keys::event(service));
    let state = |service: &str| keys::state(service, "**");
    let (guidance, recorder) = (|verbs| [(Guidance, verbs)], |verbs| [(Recorder, verbs)]);
    let (missed, answers) = ("what was missed can be asked for", "guidance answers for what was missed");
    let mut rows = vec![
        row(&[keys::telemetry("guidance")], SUBSCRIBE, &guidance(PUT), "everything that guidance shows at a tick"),
        row(&ABOARD.map(keys::telemetry), SUBSCRIBE, &[], "everything that a service shows at a tick"),
    ];
    let caches = [
        row(&[telemetry_cache("guidance")], SUBSCRIBE_GET, &guidance(ADVANCED_PUBLISHER), answers),
        row(&ABOARD.map(telemetry_cache), SUBSCRIBE_GET, &[], missed),
    ];
    rows.extend(family(&telemetry_cache("*"), caches));
    rows.extend([
        row(&[keys::event("guidance")], SUBSCRIBE, &guidance(PUT), "guidance writes its own history"),
        row(&[keys::event("recorder")], SUBSCRIBE, &recorder(PUT_SUBSCRIBE), "a recorder writes its own history"),
        row(&with_router(keys::event), SUBSCRIBE, &[], "what happened; nobody writes another's history"),
    ]);
    let recorders = recorder(ADVANCED_PUBLISHER_READER);
    let caches = [
        row(&[event_cache("guidance")], SUBSCRIBE_GET, &guidance(ADVANCED_PUBLISHER), answers),
        row(&[event_cache("recorder")], SUBSCRIBE_GET, &recorders, "a recorder answers for what was missed"),
        row(&with_router(event_cache), SUBSCRIBE_GET, &[], missed),
    ];
    rows.extend(family(&event_cache("*"), caches));
    let believed = "the services believe it: its keeper on the vehicle alone writes and answers it";
    rows.extend([
        row(&[keys::health("guidance")], SUBSCRIBE, &guidance(PUT), "guidance's own counters"),
        row(&[keys::health("recorder")], SUBSCRIBE, &recorder(PUT_SUBSCRIBE), "a recorder's own counters"),
        row(&with_router(keys::health), SUBSCRIBE, &[], "counters, once a second"),
        row(&[keys::LEASE_STATE.to_owned()], SUBSCRIBE_GET, &guidance(SUBSCRIBE_GET), believed),
    ]);
    let own = "last commands, parameters, run and tick, as guidance knows them";
    let others = "last commands, parameters, run and tick; guidance asks when it starts anew";
    let states = [
        row(&[state("guidance")], SUBSCRIBE_GET, &guidance(STATE), own),
        row(&ABOARD.map(state), SUBSCRIBE_GET, &guidance(GET), others),
    ];
    rows.extend(family(&state("*"), states));
    rows
}

/// Questions that services answer.
fn queried() -> Vec<AccessRow> {
    let command = |service: &str| keys::command(service, "*");
    let param = |service: &str| keys::param(service, "**");
    let (asked, of_guidance) = (&[(Operator, GET)], &[(Guidance, QUERYABLE), (Operator, GET)]);
    let stop = "the emergency stop: any operator, with or without the lease";
    let commands = "guidance obeys whom the lease allows; who answers in its place learns the token";
    let parameters =
        "setting needs the lease; reading and setting are one key, others read the state called parameters";
    vec![
        row(&[keys::command("controller", "neutral")], NONE, asked, stop),
        row(&[command("guidance")], NONE, of_guidance, commands),
        row(&ABOARD.map(command), NONE, asked, "the services obey whom the lease allows"),
        row(&[param("guidance")], NONE, of_guidance, parameters),
        row(&ABOARD.map(param), NONE, asked, parameters),
        row(&[keys::LEASE.to_owned()], NONE, asked, "one operator at a time; the keeper on the vehicle decides"),
        row(&[keys::PING.to_owned()], GET, &[], "clock offset and round trip"),
    ]
}

/// Signs of life, and lock step.
fn liveliness() -> Vec<AccessRow> {
    let alive = |service: &str| keys::alive(service, "*");
    let services = [&ABOARD.map(alive)[..], &[alive("router")]].concat();
    let [operator, recorder] = [Operator, Recorder].map(|role| [(role, SUBSCRIBE_GET_LIVELINESS)]);
    let signs = [
        row(&[keys::operator("*")], SUBSCRIBE_GET, &operator, "a lease ends with its holder's sign of life"),
        row(&[alive("guidance")], SUBSCRIBE_GET, &[(Guidance, LIVELINESS)], "guidance shows that it is up"),
        row(&[alive("recorder")], SUBSCRIBE_GET, &recorder, "a recorder shows that it is up"),
        row(&services, SUBSCRIBE_GET, &[], "who is up"),
    ];
    let receipts = "lock step: receipts that the ring waits for";
    let mut rows = family(&alive("*"), signs).to_vec();
    rows.extend([
        row(&[keys::stop("guidance")], SUBSCRIBE, &[(Guidance, PUT_SUBSCRIBE)], "lock step: guidance may end the run"),
        row(&ABOARD.map(keys::stop), SUBSCRIBE, &[(Guidance, SUBSCRIBE)], "lock step: the run is over, and why"),
        row(&[keys::witness("*")], NONE, &[(Recorder, PUT_SUBSCRIBE)], receipts),
        row(&[UNLISTED.to_owned()], NONE, &[], "whatever else: the vehicle's own services only"),
    ]);
    rows
}

/// Stands for every key that the matrix does not name.
const UNLISTED: &str = "unlisted/**";

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn rights(key: &str) -> AccessRow {
        let covers = |row: &AccessRow| row.keys.iter().any(|pattern| pattern == key);
        matrix().into_iter().find(covers).unwrap_or_else(|| panic!("no row for {key}"))
    }

    #[test]
    fn nobody_but_the_vehicle_writes_what_the_services_believe() {
        for key in [keys::LEASE_STATE, Measurements::KEY, Nav::KEY, Thrust::KEY] {
            for role in [Guidance, Operator, Observer, Recorder] {
                for verb in [Put, Queryable, Liveliness, Verb::Delete] {
                    assert!(!rights(key).allows(role, verb), "{role} {verb} {key}");
                }
            }
        }
    }

    #[test]
    fn who_looks_writes_and_answers_nothing_and_is_seen_nowhere() {
        for row in matrix() {
            for verb in [Put, Queryable, Liveliness, Verb::Delete] {
                assert!(!row.allows(Observer, verb), "{verb} {:?}", row.keys);
            }
        }
    }

    #[test]
    fn what_carries_a_token_is_heard_by_those_who_check_it_alone() {
        for key in [keys::setpoint("*"), keys::command("controller", "*"), keys::LEASE.to_owned()] {
            for role in [Operator, Observer, Recorder] {
                assert!(!rights(&key).allows(role, Subscribe) && !rights(&key).allows(role, Queryable), "{role} {key}");
            }
        }
    }

    #[test]
    fn rows_say_why_and_no_key_stands_in_two() {
        let rows = matrix();
        assert!(rows.iter().all(|row| row.why.len() > 8 && !row.keys.is_empty()));
        let keys = || rows.iter().flat_map(|row| &row.keys);
        assert_eq!(keys().collect::<BTreeSet<_>>().len(), keys().count());
    }

    #[test]
    fn an_example_has_no_wildcard() {
        for row in matrix() {
            assert!(!row.example("probe").contains('*'), "{:?}", row.keys);
        }
        assert_eq!(rights("param/guidance/**").example("x"), "param/guidance/x");
    }
}
