//! Certificates that end while everything runs, over real TLS: their links close, the renewed ones are back by themselves,
//! and no event is lost.

use crate::support::{Events, LIMIT, Listener, Place, Process, Proxy, ROV, SERVICES, following, listening};
use serde_json::json;
use std::cell::RefCell;
use std::sync::Arc;
use supertwin_pki as pki;
use supertwin_zenoh::{Client, Inbox};

/// A vehicle that is reached by TLS; guidance and a recorder's ears stand topside, behind proxies that count connections.
struct Split {
    place: Place,
    router: Process,
    tls: String,
    guidance: Proxy,
    ears: Proxy,
    /// All events, topside.
    far: Listener,
    beside: Listener,
    pilot: RefCell<Client>,
    presence: Inbox,
    _services: Vec<Process>,
}

impl Split {
    /// With certificates for an hour.
    fn start() -> Self {
        let place = Place::new();
        place.call(&["pki", "init"]).well();
        for [role, holder] in [["vehicle", "argus"], ["recorder", "ben"], ["guidance", "topside"]] {
            place.call(&["pki", "issue", role, holder, "--vehicle", ROV, "--minutes", "60"]).well();
        }
        let words = ["serve", "router", "--json", "--listen", &place.socket, "--listen", "tls/localhost:0"];
        let router = place.start(&[&words[..], &["--credentials", "pki/argus"]].concat());
        let tls = listening(&router.json(), "tls");
        let [guidance, ears] = [Proxy::before(&tls), Proxy::before(&tls)];
        let trial = following(place.path());
        let near = |service| place.serve_rov(service, &trial, &place.socket, &[]);
        let mut services: Vec<Process> = ["estimator", "controller", "plant"].map(near).into();
        let beside = Listener::open(&place.socket, ROV).listen("telemetry/controller");
        let credentials = ["--credentials", "pki/topside"];
        services.push(place.serve_rov("guidance", &trial, &guidance.endpoint(), &credentials));
        let mut presence = Inbox::new(Arc::clone(&beside.clock));
        presence
            .listen_alive(&beside.session, &format!("supertwin/{ROV}/alive/guidance/*"))
            .expect("may be listened to");
        let pilot = RefCell::new(beside.client("pilot"));
        let ben = Some(place.path().join("pki/ben"));
        let far = Listener::open_as(ben, &ears.endpoint(), ROV).events().listen("health/*");
        let split = Self { place, router, tls, guidance, ears, far, beside, pilot, presence, _services: services };
        split.until_guidance_is(true);
        split.beside.until_status("tracking");
        split
    }

    /// When the new certificate ends, in seconds since 1970.
    fn renew(&self, holder: &str, minutes: &str) -> i64 {
        self.place.call(&["pki", "renew", holder, "--minutes", minutes]).well();
        let file = self.place.path().join(format!("pki/{holder}/{holder}.pem"));
        pki::read(&file).expect("a certificate").not_after_s
    }

    /// Connections that both have made so far.
    fn taken(&self) -> [u64; 2] {
        [self.guidance.taken(), self.ears.taken()]
    }

    fn until_both_connect_again(&self, before: [u64; 2]) {
        self.busy_until("both to connect again", || self.taken().iter().zip(before).all(|(now, before)| *now > before));
    }

    fn until_guidance_is(&self, there: bool) {
        let end = self.beside.clock.now() + LIMIT;
        let seen = std::iter::from_fn(|| self.presence.next(Some(end))).any(|heard| heard.gone != there);
        assert!(seen, "guidance is never {}", if there { "there" } else { "gone" });
    }

    /// Waits, and makes events all the while, until `over`: on the vehicle, and of guidance as far as it hears.
    fn busy_until(&self, what: &str, over: impl Fn() -> bool) {
        let mut pilot = self.pilot.borrow_mut();
        let end = self.beside.clock.now() + LIMIT;
        while !over() {
            assert!(self.beside.clock.now() < end, "waited in vain for {what}");
            pilot.acquire(20.0).expect("is granted");
            let healthy = json!({ "thruster": 1, "gain": 1.0 });
            pilot.command("plant", "thruster_gain", healthy, None).expect("the vehicle hears");
            // Guidance may be cut off just now.
            let _ = pilot.command("guidance", "depth_m", json!(4.0), None);
            self.beside.fresh();
        }
    }

    fn now_s(&self) -> i64 {
        (self.beside.clock.unix_ns() / 1_000_000_000) as i64
    }
}

/// Everything that was heard topside is complete, and the vehicle never missed its own services.
fn assert_nothing_is_lost(split: &Split) {
    let mut marked = split.beside.client("marker");
    marked.command("controller", "neutral", json!(true), None).expect("needs no authority");
    let mut events = Events::default();
    split
        .far
        .until("the last event", |key, value| events.enter(key, value).is_some_and(|text| text.contains("by marker")));
    split.far.complete(&mut events, &SERVICES);
    assert!(events.texts.len() > 20, "{:?}", events.texts);
    assert!(!events.texts.iter().any(|text| text == "controller: nav_stale"), "{:?}", events.texts);
}

#[test]
fn certificates_of_clients_that_end_close_their_links_and_the_renewed_ones_are_back() {
    let split = Split::start();
    // Both connect with certificates that end soon.
    let soon = ["topside", "ben"].map(|holder| split.renew(holder, "0.25"));
    let before = split.taken();
    for cut in [true, false] {
        [&split.guidance, &split.ears].into_iter().for_each(|tether| tether.cut(cut));
    }
    split.until_both_connect_again(before);
    split.until_guidance_is(false);
    split.until_guidance_is(true);
    // Renewed in time: nobody notices until the old ones end.
    ["topside", "ben"].iter().for_each(|holder| _ = split.renew(holder, "60"));
    // More than one each if the first attempts came too early.
    let before = split.taken();
    split.busy_until("both to end", || soon.into_iter().all(|end_s| split.now_s() > end_s));
    split.until_both_connect_again(before);
    split.until_guidance_is(false);
    split.until_guidance_is(true);
    split.beside.until_status("tracking");
    assert_nothing_is_lost(&split);
}

#[test]
fn a_router_takes_up_its_renewed_certificate_and_one_that_ended_lets_everybody_back_in() {
    let split = Split::start();
    // Renewed in time: whoever comes by TLS connects again; the vehicle's own services notice nothing.
    let before = split.taken();
    let end_s = split.renew("argus", "0.25");
    let says = |text: &str| split.router.errors().contains(text);
    split.busy_until("the router to say so", || says("in force until"));
    split.until_guidance_is(false);
    split.until_guidance_is(true);
    split.until_both_connect_again(before);
    split.beside.until_status("tracking");

    // Not renewed in time: it closes the links, and nobody believes it any more.
    split.busy_until("its certificate to end", || split.now_s() > end_s);
    split.until_guidance_is(false);
    split.busy_until("the router to say so", || says("has expired: nobody can connect"));
    let late = split.place.call(&["top", "--connect", &split.tls, "--credentials", "pki/ben"]);
    late.refused("its certificate has expired");
    split.renew("argus", "60");
    let taken_up = || split.router.errors().matches("in force until").count();
    split.busy_until("the router to take it up", || taken_up() == 2);
    split.beside.until_status("tracking");
    assert_nothing_is_lost(&split);
}

#[test]
fn a_stranger_is_told_why_and_a_half_copied_certificate_changes_nothing() {
    let place = Place::new();
    for folder in ["pki", "other"] {
        place.call(&["pki", "init", "--dir", folder]).well();
        place.call(&["pki", "issue", "observer", "ben", "--vehicle", ROV, "--dir", folder]).well();
    }
    place.call(&["pki", "issue", "vehicle", "argus", "--vehicle", ROV]).well();
    let words = ["serve", "router", "--json", "--listen", "tls/127.0.0.1:0", "--credentials", "pki/argus"];
    let router = place.start(&words);
    let said = router.json();
    let tls = listening(&said, "tls");
    assert_eq!(said["listening"].as_array().map(Vec::len), Some(1), "the router's own socket is its own: {said}");
    let list = |endpoint: &str, credentials: &str| {
        place.call(&["list", "--for", "0.2", "--connect", endpoint, "--credentials", credentials])
    };
    list(&tls, "pki/ben").well();
    list(&tls, "other/ben").refused("of another authority");
    let port = tls.rsplit_once(':').expect("a port").1;
    list(&format!("tls/0.0.0.0:{port}"), "pki/ben").refused("does not name this host");
    place.call(&["list", "--for", "0.2", "--connect", &tls]).refused("give --credentials");

    let certificate = place.path().join("pki/argus/argus.pem");
    let whole = std::fs::read(&certificate).expect("is there");
    std::fs::write(&certificate, &whole[..100]).expect("is ours");
    router.until_error(0, "the certificate in force stays");
    list(&tls, "pki/ben").well();
    std::fs::write(&certificate, &whole).expect("is ours");
    router.until_error(0, "in force until");
    list(&tls, "pki/ben").well();
}
