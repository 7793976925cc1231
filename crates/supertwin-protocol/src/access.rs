//! Who may do what with which key: the matrix, once. The router's rules, the documentation, the test over TLS and the
//! doctor all come from it.

use crate::keys;
use crate::role::Role;
use serde::{Deserialize, Serialize};
use std::fmt;
use supertwin_core::Message;
use supertwin_core::message::{Measurements, Nav, Reference, Thrust, Truth, WrenchRequest};

/// What can be done with a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
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
    /// All of them.
    pub const ALL: [Self; 6] = [Self::Put, Self::Subscribe, Self::Get, Self::Queryable, Self::Liveliness, Self::Delete];

    /// Its name, as in the documentation.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Put => "put",
            Self::Subscribe => "subscribe",
            Self::Get => "get",
            Self::Queryable => "queryable",
            Self::Liveliness => "liveliness",
            Self::Delete => "delete",
        }
    }
}

impl fmt::Display for Verb {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
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

const HEAR: &[Verb] = &[Subscribe];
const ASK: &[Verb] = &[Get];
const HEAR_AND_ASK: &[Verb] = &[Subscribe, Get];
const WRITE: &[Verb] = &[Put];
const WRITE_AND_HEAR: &[Verb] = &[Put, Subscribe];
const ANSWER: &[Verb] = &[Queryable];
const LIVE: &[Verb] = &[Liveliness];
/// What an advanced publisher does beside publishing: says its last number, answers for its cache, shows itself.
const KEEP: &[Verb] = &[Put, Queryable, Liveliness];
const KEEP_AND_READ: &[Verb] = &[Put, Subscribe, Get, Queryable, Liveliness];
const SHOW: &[Verb] = &[Put, Get, Queryable];

/// The three that look.
fn readers(verbs: &'static [Verb]) -> Vec<(Role, &'static [Verb])> {
    vec![(Operator, verbs), (Observer, verbs), (Recorder, verbs)]
}

/// The three that look, with other rights for some.
fn readers_and(verbs: &'static [Verb], others: &[(Role, &'static [Verb])]) -> Vec<(Role, &'static [Verb])> {
    let mut rights = readers(verbs);
    rights.retain(|(role, _)| others.iter().all(|(other, _)| other != role));
    rights.extend_from_slice(others);
    rights.sort_by_key(|(role, _)| *role);
    rights
}

fn row(keys: &[String], family: Option<String>, rights: Vec<(Role, &'static [Verb])>, why: &'static str) -> AccessRow {
    AccessRow { keys: keys.to_vec(), family, why, rights }
}

fn one(key: &str, rights: Vec<(Role, &'static [Verb])>, why: &'static str) -> AccessRow {
    row(&[key.to_owned()], None, rights, why)
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
    let truth = Truth::KEY.to_owned();
    vec![
        one(Measurements::KEY, readers(HEAR), "only the plant, or a real vehicle's driver, says what was measured"),
        one(&truth, readers(HEAR), "for recordings and scores; the brain never sees it"),
        row(&[keys::advanced(&truth)], None, readers(HEAR_AND_ASK), "what was missed of it can be asked for"),
        row(
            &[keys::shadow(Measurements::KEY), keys::shadow(Truth::KEY)],
            None,
            readers(HEAR),
            "the twin beside a real vehicle: for those who look",
        ),
        row(
            &[keys::advanced(&keys::shadow(Truth::KEY))],
            None,
            readers(HEAR_AND_ASK),
            "what was missed of it can be asked for",
        ),
        one(Nav::KEY, readers_and(HEAR, &[(Guidance, HEAR)]), "whoever forges navigation steers the vehicle"),
        one(Reference::KEY, readers_and(HEAR, &[(Guidance, WRITE)]), "guidance alone writes where to go"),
        one(Thrust::KEY, readers(HEAR), "the controller alone drives the thrusters"),
        one(
            WrenchRequest::KEY,
            vec![(Operator, WRITE_AND_HEAR), (Recorder, HEAR)],
            "an external controller is an operator: it steers, and its messages carry no token",
        ),
        one(
            &keys::setpoint("*"),
            vec![(Guidance, HEAR), (Operator, WRITE)],
            "a joystick; each message carries the holder's token, so that not even a recorder may read it",
        ),
    ]
}

/// What services say about themselves.
fn published_by_services() -> Vec<AccessRow> {
    let aboard = |key: fn(&str) -> String| ABOARD.map(key).to_vec();
    let with_router = |key: fn(&str) -> String| [aboard(key), vec![key("router")]].concat();
    let advanced = |keys: &[String]| keys.iter().map(|key| keys::advanced(key)).collect::<Vec<_>>();
    let (telemetry, event) = (aboard(keys::telemetry), with_router(keys::event));
    let (telemetry_all, event_all) = (keys::advanced(&keys::telemetry("*")), keys::advanced(&keys::event("*")));
    let guidance = |key: fn(&str) -> String| key("guidance");
    let state = |service: &str| keys::state(service, "**");
    vec![
        one(
            &guidance(keys::telemetry),
            readers_and(HEAR, &[(Guidance, WRITE)]),
            "everything that guidance shows at a tick",
        ),
        row(&telemetry, None, readers(HEAR), "everything that a service shows at a tick"),
        row(
            &[keys::advanced(&guidance(keys::telemetry))],
            Some(telemetry_all.clone()),
            readers_and(HEAR_AND_ASK, &[(Guidance, KEEP)]),
            "guidance answers for what was missed",
        ),
        row(&advanced(&telemetry), Some(telemetry_all), readers(HEAR_AND_ASK), "what was missed can be asked for"),
        one(&guidance(keys::event), readers_and(HEAR, &[(Guidance, WRITE)]), "guidance writes its own history"),
        one(
            &keys::event("recorder"),
            readers_and(HEAR, &[(Recorder, WRITE_AND_HEAR)]),
            "a recorder writes its own history",
        ),
        row(&event, None, readers(HEAR), "what happened; nobody writes another's history"),
        row(
            &[keys::advanced(&guidance(keys::event))],
            Some(event_all.clone()),
            readers_and(HEAR_AND_ASK, &[(Guidance, KEEP)]),
            "guidance answers for what was missed",
        ),
        row(
            &[keys::advanced(&keys::event("recorder"))],
            Some(event_all.clone()),
            readers_and(HEAR_AND_ASK, &[(Recorder, KEEP_AND_READ)]),
            "a recorder answers for what was missed",
        ),
        row(&advanced(&event), Some(event_all), readers(HEAR_AND_ASK), "what was missed can be asked for"),
        one(&guidance(keys::health), readers_and(HEAR, &[(Guidance, WRITE)]), "guidance's own counters"),
        one(&keys::health("recorder"), readers_and(HEAR, &[(Recorder, WRITE_AND_HEAR)]), "a recorder's own counters"),
        row(&with_router(keys::health), None, readers(HEAR), "counters, once a second"),
        one(
            keys::LEASE_STATE,
            readers_and(HEAR_AND_ASK, &[(Guidance, HEAR_AND_ASK)]),
            "the services believe it: its keeper on the vehicle alone writes and answers it",
        ),
        row(
            &[state("guidance")],
            Some(state("*")),
            readers_and(HEAR_AND_ASK, &[(Guidance, SHOW)]),
            "last commands, parameters, run and tick, as guidance knows them",
        ),
        row(
            &ABOARD.map(state),
            Some(state("*")),
            readers_and(HEAR_AND_ASK, &[(Guidance, ASK)]),
            "last commands, parameters, run and tick; guidance asks when it starts anew",
        ),
    ]
}

/// Questions that services answer.
fn queried() -> Vec<AccessRow> {
    let command = |service: &str| keys::command(service, "*");
    let param = |service: &str| keys::param(service, "**");
    vec![
        one(
            &keys::command("controller", "neutral"),
            vec![(Operator, ASK)],
            "the emergency stop: any operator, with or without the lease",
        ),
        one(
            &command("guidance"),
            vec![(Guidance, ANSWER), (Operator, ASK)],
            "guidance obeys whom the lease allows; who answers in its place learns the token",
        ),
        row(&ABOARD.map(command), None, vec![(Operator, ASK)], "the services obey whom the lease allows"),
        one(
            &param("guidance"),
            vec![(Guidance, ANSWER), (Operator, ASK)],
            "setting needs the lease; reading and setting are one key, others read the state called parameters",
        ),
        row(
            &ABOARD.map(param),
            None,
            vec![(Operator, ASK)],
            "setting needs the lease; reading and setting are one key, others read the state called parameters",
        ),
        one(keys::LEASE, vec![(Operator, ASK)], "one operator at a time; the keeper on the vehicle decides"),
        one(keys::PING, readers(ASK), "clock offset and round trip"),
    ]
}

/// Signs of life, and lock step.
fn liveliness() -> Vec<AccessRow> {
    let alive = |service: &str| keys::alive(service, "*");
    let family = Some(keys::alive("*", "*"));
    vec![
        row(
            &[keys::operator("*")],
            family.clone(),
            readers_and(HEAR_AND_ASK, &[(Operator, &[Subscribe, Get, Liveliness])]),
            "a lease ends with its holder's sign of life",
        ),
        row(
            &[alive("guidance")],
            family.clone(),
            readers_and(HEAR_AND_ASK, &[(Guidance, LIVE)]),
            "guidance shows that it is up",
        ),
        row(
            &[alive("recorder")],
            family.clone(),
            readers_and(HEAR_AND_ASK, &[(Recorder, &[Subscribe, Get, Liveliness])]),
            "a recorder shows that it is up",
        ),
        row(
            &ABOARD.into_iter().chain(["router"]).map(alive).collect::<Vec<_>>(),
            family,
            readers(HEAR_AND_ASK),
            "who is up",
        ),
        one(
            &keys::stop("guidance"),
            readers_and(HEAR, &[(Guidance, WRITE_AND_HEAR)]),
            "lock step: guidance may end the run",
        ),
        row(
            &ABOARD.map(keys::stop),
            None,
            readers_and(HEAR, &[(Guidance, HEAR)]),
            "lock step: the run is over, and why",
        ),
        one(&keys::witness("*"), vec![(Recorder, WRITE_AND_HEAR)], "lock step: receipts that the ring waits for"),
        one(UNLISTED, Vec::new(), "whatever else: the vehicle's own services only"),
    ]
}

/// Stands for every key that the matrix does not name.
const UNLISTED: &str = "unlisted/**";

/// The roles that the matrix distinguishes, in the order of its columns.
pub const COLUMNS: [Role; 5] = [Role::Vehicle, Guidance, Operator, Observer, Recorder];

/// Letters of the verbs, in their order; a dot where it may not.
#[must_use]
pub fn letters(row: &AccessRow, role: Role) -> String {
    let letter = |verb: Verb| match verb {
        Put => 'P',
        Subscribe => 'S',
        Get => 'G',
        Queryable => 'Q',
        Liveliness => 'L',
        Verb::Delete => 'D',
    };
    Verb::ALL.iter().map(|verb| if row.allows(role, *verb) { letter(*verb) } else { '·' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let mut keys: Vec<&String> = rows.iter().flat_map(|row| &row.keys).collect();
        let n = keys.len();
        keys.sort();
        keys.dedup();
        assert_eq!(keys.len(), n);
    }

    #[test]
    fn an_example_has_no_wildcard() {
        for row in matrix() {
            assert!(!row.example("probe").contains('*'), "{:?}", row.keys);
        }
        assert_eq!(rights("param/guidance/**").example("x"), "param/guidance/x");
    }
}
