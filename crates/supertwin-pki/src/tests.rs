//! Certificates from their authority to their end, with a clock that is set by hand.

use crate::*;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::time::Duration;
use supertwin_protocol::{Clock, Role, Scope};
use tempfile::TempDir;

struct At(u64);

impl Clock for At {
    fn now(&self) -> Duration {
        Duration::ZERO
    }

    fn unix_ns(&self) -> u64 {
        self.0 * 1_000_000_000
    }
}

/// A day in 2026.
const NOW_S: u64 = 1_780_000_000;
const NOW: At = At(NOW_S);

fn after(days: u64) -> At {
    At(NOW_S + days * 24 * 3600)
}

fn argus() -> Scope {
    Scope::Vehicle("argus-mini".to_owned())
}

fn fleet() -> (TempDir, Authority) {
    let folder = tempfile::tempdir().expect("a folder");
    let place = folder.path().join("pki");
    let authority = Authority::init(&place, "rataren", AUTHORITY_LIFETIME, &NOW).expect("nothing is there");
    (folder, authority)
}

fn says<T>(result: Result<T, PkiError>) -> String {
    result.err().expect("is refused").to_string()
}

#[test]
fn a_certificate_says_who_for_what_where_and_until_when() {
    let (_folder, authority) = fleet();
    let request = Request::new(Role::Vehicle, argus(), "argus").at(&["argus.local", "192.168.2.2", "::1"]);
    let files = authority.issue(&request, &NOW).expect("is legal");
    let certificate = read(&files.certificate).expect("was written");
    assert_eq!(certificate.common_name, "vehicle.argus-mini");
    assert_eq!((certificate.role, certificate.scope.clone()), (Some(Role::Vehicle), Some(argus())));
    assert_eq!((certificate.holder.as_deref(), certificate.fleet.as_deref()), (Some("argus"), Some("rataren")));
    assert_eq!(certificate.hosts, ["argus.local", "192.168.2.2", "::1"]);
    assert_eq!(certificate.issuer, "rataren authority");
    assert_eq!(certificate.not_after_s, (NOW_S + 30 * 24 * 3600) as i64);
    assert_eq!(certificate.not_before_s, (NOW_S - 3600) as i64, "clocks may be behind");
    assert!(!certificate.is_authority && certificate.is_signed_by(&authority.certificate));
    assert_eq!(certificate.not_after(), "2026-06-27 20:26:40 UTC");

    let files = authority.issue(&Request::new(Role::Operator, Scope::Fleet, "anna"), &NOW).expect("is legal");
    let other = read(&files.certificate).expect("was written");
    assert_eq!(other.common_name, "operator.fleet");
    assert!(other.hosts.is_empty());
    assert_ne!(other.serial, certificate.serial);
    assert_eq!(files.check(&NOW), Ok(other));
}

#[test]
fn keys_are_never_replaced() {
    let (folder, authority) = fleet();
    let place = folder.path().join("pki");
    let files = authority.issue(&Request::new(Role::Observer, argus(), "ben"), &NOW).expect("is legal");
    let keys = [fs::read(place.join("ca.key")).expect("key"), fs::read(&files.key).expect("key")];

    assert!(says(Authority::init(&place, "other", AUTHORITY_LIFETIME, &NOW)).contains("never replaced"));
    let again = says(authority.issue(&Request::new(Role::Operator, argus(), "ben"), &NOW));
    assert!(again.contains("pki/ben: exists") && again.contains("renew"), "{again}");
    authority.renew(&files.certificate, None, &after(29)).expect("is ours");
    assert_eq!(keys, [fs::read(place.join("ca.key")).expect("key"), fs::read(&files.key).expect("key")]);
    fs::remove_file(place.join("ca.pem")).expect("is there");
    assert!(says(Authority::init(&place, "other", AUTHORITY_LIFETIME, &NOW)).contains("ca.key"));
}

#[test]
fn what_was_left_of_an_interrupted_call_is_in_nobodys_way() {
    let (folder, authority) = fleet();
    let place = folder.path().join("pki");
    fs::create_dir(place.join(".ben.new")).expect("a folder");
    fs::write(place.join(".ben.new/ben.key"), "half a key").expect("a file");
    let files = authority.issue(&Request::new(Role::Observer, argus(), "ben"), &NOW).expect("goes on");
    assert!(files.check(&NOW).is_ok() && !place.join(".ben.new").exists());
    fs::write(place.join("ben/ben.pem.new"), "half").expect("a file");
    authority.renew(&files.certificate, None, &after(1)).expect("goes on");
    assert_eq!(fs::read_dir(place.join("ben")).expect("exists").count(), 3);
}

#[test]
fn only_a_role_that_listens_names_hosts() {
    let (_folder, authority) = fleet();
    let request = Request::new(Role::Observer, argus(), "mallory").at(&["192.168.2.2"]);
    let said = says(authority.issue(&request, &NOW));
    assert!(said.contains("observer.argus-mini") && said.contains("must name no host"), "{said}");
    assert!(says(authority.issue(&Request::new(Role::Vehicle, argus(), "v"), &NOW)).contains("must name a host"));
    for host in ["192.168.2.2:7447", "a b", "*.local", "-a.local", ""] {
        let request = Request::new(Role::Vehicle, argus(), "v").at(&[host]);
        assert!(says(authority.issue(&request, &NOW)).contains("without a port"), "{host}");
    }
}

#[test]
fn names_that_would_leave_the_folder_or_replace_the_authority_are_refused() {
    let (_folder, authority) = fleet();
    for holder in ["", "ca", ".", "..", "../evil", "a/b", ".hidden"] {
        let said = says(authority.issue(&Request::new(Role::Operator, argus(), holder), &NOW));
        assert!(said.contains("holder"), "{holder}: {said}");
    }
    let long = Scope::Vehicle("v".repeat(60));
    assert!(says(authority.issue(&Request::new(Role::Operator, long, "o"), &NOW)).contains("at most 64"));
    for lifetime in [Duration::ZERO, Duration::from_millis(900), Duration::from_secs(u64::MAX)] {
        let request = Request { lifetime, ..Request::new(Role::Operator, argus(), "o") };
        assert!(says(authority.issue(&request, &NOW)).contains("lifetime"), "{lifetime:?}");
    }
}

#[test]
fn a_renewed_certificate_is_the_old_one_with_another_end() {
    let (_folder, authority) = fleet();
    let request = Request::new(Role::Vehicle, argus(), "argus").at(&["argus.local"]);
    let request = Request { lifetime: 5 * DAY, ..request };
    let files = authority.issue(&request, &NOW).expect("is legal");
    let old = read(&files.certificate).expect("was written");
    assert!(says(files.check(&after(6))).contains("argus.pem: expired on"), "{}", says(files.check(&after(6))));

    let new = authority.renew(&files.certificate, None, &after(6)).expect("also when it has expired");
    assert_eq!(new.not_after_s, old.not_after_s + 6 * 24 * 3600, "as long as before");
    assert_eq!(files.check(&after(6)), Ok(new.clone()));
    assert_ne!(new.serial, old.serial);
    let Certificate { serial, not_before_s, not_after_s, der, .. } = new.clone();
    assert_eq!(new, Certificate { serial, not_before_s, not_after_s, der, ..old });
    let longer = authority.renew(&files.certificate, Some(20 * DAY), &after(6)).expect("is ours");
    assert_eq!(longer.not_after_s - new.not_after_s, 15 * 24 * 3600);
}

#[test]
fn nothing_outlives_its_authority() {
    let (_folder, authority) = fleet();
    let request = Request { lifetime: 365 * DAY, ..Request::new(Role::Operator, argus(), "o") };
    let files = authority.issue(&request, &after(5 * 365 - 10)).expect("is legal");
    let end_s = authority.certificate.not_after_s;
    assert_eq!(read(&files.certificate).expect("was written").not_after_s, end_s);
    let said = says(authority.issue(&Request::new(Role::Operator, argus(), "late"), &after(5 * 365 + 1)));
    assert!(said.contains("ca.pem: the authority expired on"), "{said}");
    let said = says(authority.renew(&files.certificate, None, &after(5 * 365 + 1)));
    assert!(said.contains("the authority expired on"), "{said}");
}

#[test]
fn another_authoritys_certificates_are_neither_renewed_nor_believed() {
    let (_here, ours) = fleet();
    let (_there, theirs) = fleet();
    let request = Request::new(Role::Operator, argus(), "anna");
    let (mine, other) = (ours.issue(&request, &NOW).expect("legal"), theirs.issue(&request, &NOW).expect("legal"));
    let before = fs::read(&other.certificate).expect("is there");
    let said = says(ours.renew(&other.certificate, None, &NOW));
    assert!(said.contains("was not signed by the authority in"), "{said}");
    assert_eq!(fs::read(&other.certificate).expect("is there"), before);
    assert!(says(ours.renew(&ours.folder.join("ca.pem"), None, &NOW)).contains("is an authority's"));

    let mixed = Credentials { certificate: other.certificate.clone(), ..mine.clone() };
    assert!(says(mixed.check(&NOW)).contains("was not signed by the authority"));
    let mixed = Credentials { key: other.key, ..mine.clone() };
    assert!(says(mixed.check(&NOW)).contains("is not the key of"));
    let mixed = Credentials { certificate: mine.key.clone(), ..mine };
    assert!(says(mixed.check(&NOW)).contains("holds a private key and no certificate"), "{}", says(mixed.check(&NOW)));
}

#[test]
fn credentials_are_found_by_folder_certificate_or_name() {
    let (_folder, authority) = fleet();
    let files = authority.issue(&Request::new(Role::Operator, argus(), "anna"), &NOW).expect("is legal");
    let place = authority.folder.join("anna");
    for path in [place.clone(), place.join("anna"), place.join("anna.pem"), place.join("anna.key")] {
        assert_eq!(Credentials::find(&path).as_ref(), Ok(&files), "{}", path.display());
    }
    assert!(says(Credentials::find(&authority.folder)).contains("the authority's own folder"));
    assert!(says(Credentials::find(&place.join("ben"))).contains("no credentials"));
    let none = tempfile::tempdir().expect("a folder");
    assert!(says(Credentials::find(none.path())).contains("no NAME.key"));
    for name in ["a.key", "b.key"] {
        fs::write(none.path().join(name), "").expect("a file");
    }
    assert!(says(Credentials::find(none.path())).contains("say whose"));
    assert!(says(Authority::open(none.path())).contains("supertwin pki init"));
    assert!(says(Authority::open(&place)).contains("this folder can't sign"));
}

#[test]
fn what_needs_a_hand_is_said_with_its_remedy() {
    let (_folder, authority) = fleet();
    let files = authority.issue(&Request::new(Role::Operator, argus(), "anna"), &NOW).expect("is legal");
    let problems = |within_s: i64, clock: &At| -> Vec<String> {
        let all = examine(&authority.folder, within_s, clock).expect("can be read");
        assert_eq!(all.len(), 2, "the authority and anna");
        all.into_iter().flat_map(|one| one.problems).collect()
    };
    assert!(problems(0, &NOW).is_empty() && problems(0, &after(19)).is_empty());
    let soon = problems(0, &after(21));
    assert!(soon.len() == 1 && soon[0].contains("expires in 9 days") && soon[0].contains("pki renew"), "{soon:?}");
    assert!(problems(14 * 24 * 3600, &after(17))[0].contains("expires in 13 days"));
    assert!(problems(0, &after(31))[0].contains("expired 24 hours ago"), "{:?}", problems(0, &after(31)));
    let behind = problems(0, &At(NOW_S - 7200));
    assert!(behind.iter().any(|text| text.contains("clock right")), "{behind:?}");
    let late = problems(0, &after(5 * 365 - 80));
    assert!(late.iter().any(|text| text.contains("make a new authority")), "{late:?}");

    fs::set_permissions(&files.key, fs::Permissions::from_mode(0o640)).expect("is ours");
    let open = problems(0, &NOW);
    assert!(open.len() == 1 && open[0].contains("mode 640") && open[0].contains("chmod 600"), "{open:?}");
    let one: PathBuf = files.certificate.clone();
    assert_eq!(examine(&one, 0, &NOW).expect("can be read")[0].problems, open);
    fs::remove_file(&files.key).expect("is there");
    assert!(examine(&one, 0, &NOW).expect("a certificate alone")[0].problems.is_empty());
}
