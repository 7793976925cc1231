//! Zenoh's log is still understood: every notice is provoked over a real router, and must be told. An upgrade of Zenoh that
//! moves or rewords a line fails here at once.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc;
use std::time::Duration;
use supertwin_core::EventKind;
use supertwin_pki::{Authority, DAY, Request};
use supertwin_protocol::{Role, Scope, SystemClock, keys};
use supertwin_zenoh::access_control::router_file;
use supertwin_zenoh::access_log::AccessLog;
use supertwin_zenoh::session::tls_settings;
use supertwin_zenoh::{Link, Router, close};
use zenoh::Wait;

/// Long enough for a busy machine; nobody waits for it when all is well.
const PATIENCE: Duration = Duration::from_secs(60);

fn of(vehicle: &str) -> Scope {
    Scope::Vehicle(vehicle.to_owned())
}

#[test]
fn every_line_that_is_listened_for_is_still_recognised() {
    let folder = tempfile::tempdir().expect("a folder");
    let clock = SystemClock::start();
    let fleet = |name: &str| Authority::init(&folder.path().join(name), name, DAY, &clock).expect("new");
    let (ours, others) = (fleet("ours"), fleet("others"));
    let vehicle = Request::new(Role::Vehicle, of("rov"), "rov").at(&["127.0.0.1"]);
    let files = ours.issue(&vehicle, &clock).expect("is legal");
    let settings = folder.path().join("router.json5");
    let listen = ["tls/127.0.0.1:0".to_owned()];
    std::fs::write(&settings, router_file("rov", &listen, &tls_settings(&files, true))).expect("is written");

    let (tell, told) = mpsc::channel();
    // Nobody hears the last reports, after the test.
    let _log = AccessLog::new(Arc::new(clock), move |event| drop(tell.send(event)));
    let link = Link { file: Some(settings), ..Link::default() };
    let router = Router::open(&link, Arc::new(clock), |_| ()).expect("a free port");
    let place = router.locators().into_iter().find(|place| place.starts_with("tls/")).expect("listens on TLS");
    let join = |credentials: &Path| {
        let credentials = Some(credentials.to_owned());
        Link { connect: vec![place.clone()], credentials, patience_ms: 10_000, ..Link::default() }.open()
    };
    let until = |what: &str, is: &dyn Fn(&EventKind) -> bool| loop {
        let event = told.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("the log is not understood: {what}"));
        if is(&event) {
            break;
        }
    };

    let observer = ours.issue(&Request::new(Role::Observer, of("rov"), "olga"), &clock).expect("is legal");
    let session = join(observer.key.parent().expect("a folder")).expect("is of the fleet");
    until(
        "a connection",
        &|event| matches!(event, EventKind::ConnectionAccepted { name, .. } if name == "observer.rov"),
    );
    let lease = format!("{}/{}", keys::namespace("rov"), keys::LEASE);
    let replies = session.get(&lease).timeout(Duration::from_secs(1)).wait().expect("a question");
    assert!(!replies.into_iter().any(|reply| reply.result().is_ok()), "an observer was answered");
    until("a refused message", &|event| {
        let EventKind::AccessRefused { name, action, key, .. } = event else { return false };
        assert_eq!((&**name, &**action, key), ("observer.rov", "query", &lease), "what was allowed was not refused");
        true
    });
    close(&session);

    let guest = ours.issue(&Request::new(Role::Operator, of("nautilus"), "nemo"), &clock).expect("is legal");
    let session = join(guest.key.parent().expect("a folder")).expect("is of the fleet");
    until("a certificate without a role", &|event| matches!(event, EventKind::SessionWithoutRole { .. }));
    close(&session);

    let stranger = others.issue(&Request::new(Role::Operator, of("rov"), "eve"), &clock).expect("is legal");
    let error = join(stranger.key.parent().expect("a folder")).map(drop).expect_err("is of another fleet");
    // Without the log's reason it would only be told to start a router.
    assert!(error.to_string().contains("another authority"), "the log is not understood: {error}");
    // He trusts the router and is not trusted by it.
    std::fs::copy(&observer.ca, &stranger.ca).expect("is written");
    let tls = format!(
        "transport/link/tls={}",
        serde_json::json!({
            "root_ca_certificate": observer.ca, "enable_mtls": true,
            "connect_certificate": stranger.certificate, "connect_private_key": stranger.key,
        })
    );
    let config = Link { connect: vec![place.clone()], overrides: vec![tls], patience_ms: 10_000, ..Link::default() };
    let config = config.config().expect("is legal");
    assert!(zenoh::open(config).wait().is_err(), "a stranger was let in");
    until("a refused handshake", &|event| matches!(event, EventKind::ConnectionRefused { .. }));
    router.close();
}
