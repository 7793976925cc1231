//! Findings from what the services of a vehicle answer: who is there, who is heard, second writers, versions, clocks.

use super::finding::{Finding, ok, warning, wrong};
use crate::network::SERVICES;
use std::collections::BTreeMap;
use supertwin_protocol::Health;
use supertwin_zenoh::diagnose;

/// Clocks that differ by more make times of the two ends hard to compare.
const OFFSET_MS: f64 = 50.0;

/// All four, each once.
pub(super) fn services(vehicle: &str, instances: &BTreeMap<&str, Vec<&str>>) -> Vec<Finding> {
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
pub(super) fn access<'a>(services: impl Iterator<Item = (&'a str, bool, bool)>) -> Vec<Finding> {
    let mut found = Vec::new();
    for (service, heard, answers) in services {
        let (what, key) = match (heard, answers) {
            (true, true) => continue,
            (false, true) => ("answers, but its health isn't heard".to_owned(), "health/**"),
            (true, false) => (format!("is heard, but nobody answers state/{service}/now"), "state/**"),
            (false, false) => (
                "is alive, but neither health nor state of it can be read".to_owned(),
                "health/** and supertwin/*/state/**",
            ),
        };
        let remedy = format!(
            "let this client read supertwin/*/{key} in the router's access_control; if it may, the service hangs"
        );
        found.push(wrong("access", format!("{service} {what}"), remedy));
    }
    if found.is_empty() {
        found.push(ok("access", "health and state of all services can be read"));
    }
    found
}

/// Two writers of one key, as their receivers count them.
pub(super) fn writers(healths: &BTreeMap<String, (Health, Health)>) -> Vec<Finding> {
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
pub(super) fn versions<'a>(healths: impl Iterator<Item = &'a Health>, ours: &str) -> Vec<Finding> {
    let others: Vec<Finding> = healths
        .filter(|health| health.version != ours)
        .map(|health| {
            let what = format!("{} is version {}, this is {ours}", health.source, health.version);
            wrong("versions", what, "install the same version on both ends")
        })
        .collect();
    if others.is_empty() { vec![ok("versions", format!("{ours} everywhere"))] } else { others }
}

pub(super) fn clock(offset: Option<diagnose::ClockOffset>) -> Finding {
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
    use super::super::finding::Grade;
    use super::*;
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
}
