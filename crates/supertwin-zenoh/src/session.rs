//! Sessions: a JSON5 file of Zenoh's own format, laid over settings that are safe by default, and overrides.

use crate::connect_error;
use crate::zenoh_log::with_connect_failure;
use serde_json::{Map, Value, json};
use std::fmt::Display;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use supertwin_pki::{Credentials, PkiError};
use supertwin_protocol::clock::{Clock, SystemClock};
use zenoh::{Config, Session, Wait};

/// How a process joins the network.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Link {
    /// A JSON5 file in Zenoh's own format.
    pub file: Option<PathBuf>,
    /// Endpoints to listen on, instead of the file's.
    pub listen: Vec<String>,
    /// Endpoints to connect to, instead of the file's.
    pub connect: Vec<String>,
    /// Folder of a certificate's holder, for TLS: instead of the files that the settings name.
    pub credentials: Option<PathBuf>,
    /// `path/to/key=json5`, over everything else.
    pub overrides: Vec<String>,
    /// `router` or `client`, instead of the file's.
    pub mode: Option<&'static str>,
    /// Prefix of every key.
    pub namespace: Option<String>,
    /// How long to try to reach a router, in milliseconds; negative: for ever.
    pub patience_ms: i64,
}

/// A session that could not be opened, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// Certificates or keys can't be used.
    #[error(transparent)]
    Pki(#[from] PkiError),
    /// No router answers, or none with which a connection can be made.
    #[error("no router at {endpoints}: {cause}")]
    NoRouter {
        /// Where it was looked for.
        endpoints: String,
        /// Why no connection came about, and what to do.
        cause: String,
    },
    /// Something else failed.
    #[error("{what}: {cause}")]
    Failed {
        /// The file, setting, listener, key or action that failed.
        what: String,
        /// What the system or Zenoh says against it.
        cause: String,
    },
}

impl LinkError {
    /// What failed, with Zenoh's cause.
    pub fn session(what: impl Into<String>) -> impl FnOnce(zenoh::Error) -> Self {
        let what = what.into();
        move |cause| Self::failed(what, &cause)
    }

    pub(crate) fn failed(what: impl Into<String>, cause: &(impl ToString + ?Sized)) -> Self {
        Self::Failed { what: what.into(), cause: cause.to_string() }
    }
}

/// What holds unless a file says otherwise: no discovery, no listener, no admin space, short leases, small messages.
fn base() -> Value {
    json!({
        "mode": "client",
        "listen": { "endpoints": [] },
        "connect": {
            "endpoints": [],
            "exit_on_failure": true,
            "retry": { "period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2 },
        },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        "adminspace": { "enabled": false },
        "timestamping": { "enabled": false },
        "transport": {
            "link": {
                "tx": { "lease": 2000, "queue": queue() },
                "rx": { "max_message_size": 1_048_576 },
            },
            "shared_memory": { "enabled": false },
        },
    })
}

/// The queues of a link. Two batches, the default, are full after two express messages: four services in one process send
/// four at every tick, and the rest would be dropped without a word. And what may be dropped waits 20 ms for room instead of
/// one: a locked router makes all answers such, so that nobody who asks and does not read can hold it up, and a history of
/// ten thousand events must still get through to who does read.
pub(crate) fn queue() -> Value {
    json!({
        "size": { "real_time": 16, "interactive_high": 16, "data": 16, "data_low": 16 },
        "congestion_control": { "drop": { "wait_before_drop": 20_000 } },
    })
}

fn overlay(under: &mut Value, over: Value) {
    match (under, over) {
        (Value::Object(under), Value::Object(over)) => {
            for (name, value) in over {
                overlay(under.entry(name).or_insert(Value::Null), value);
            }
        }
        (under, over) => *under = over,
    }
}

impl Link {
    /// All settings as one JSON document.
    ///
    /// # Errors
    /// When the file can't be read, or an override is no `path=value`.
    pub fn settings(&self) -> Result<Value, LinkError> {
        let mut settings = base();
        if let Some(path) = &self.file {
            overlay(&mut settings, read(path)?);
        }
        let mut set = |path: &str, value: Value| overlay(&mut settings, nested(path, value));
        let list = |endpoints: &[String]| (!endpoints.is_empty()).then(|| json!(endpoints));
        for (path, value) in [
            ("mode", self.mode.map(Value::from)),
            ("listen/endpoints", list(&self.listen)),
            ("connect/endpoints", list(&self.connect)),
            ("connect/timeout_ms", Some(self.patience_ms.into())),
            ("namespace", self.namespace.clone().map(Value::from)),
        ] {
            value.into_iter().for_each(|value| set(path, value));
        }
        if let Some(place) = &self.credentials {
            let found = Credentials::find(place)?;
            let listens = supertwin_pki::read(&found.certificate)?.role.is_some_and(|role| role.listens());
            set("transport/link/tls", tls_settings(&found, listens));
        }
        for text in &self.overrides {
            let wrong = |cause: &dyn Display| LinkError::failed(text, cause);
            let (path, value) = text.split_once('=').ok_or_else(|| wrong(&"must be path/to/key=value"))?;
            let value = json5::from_str(value).map_err(|error| wrong(&error))?;
            set(path, value);
        }
        Ok(settings)
    }

    /// As Zenoh's own type, which knows every legal key.
    ///
    /// # Errors
    /// Names the file and the key that is wrong.
    pub fn config(&self) -> Result<Config, LinkError> {
        let place = self.file.as_ref().map_or_else(|| "settings".to_owned(), |file| file.display().to_string());
        parse(&self.settings()?, place)
    }

    /// Opens the session.
    ///
    /// # Errors
    /// When a setting is wrong, nobody answers, or the place to listen is taken.
    pub fn open(&self) -> Result<Session, LinkError> {
        let settings = self.settings()?;
        let config = self.config()?;
        check_credentials(&settings, &SystemClock::start())?;
        open(&settings, config)
    }
}

/// Opens a session with settings that were parsed.
pub(crate) fn open(settings: &Value, config: Config) -> Result<Session, LinkError> {
    let (listen, connect) = (endpoints(settings, "listen"), endpoints(settings, "connect"));
    for endpoint in &listen {
        prepare_socket(endpoint)?;
    }
    let (opened, reason) = with_connect_failure(|| zenoh::open(config).wait());
    opened.map_err(|error| {
        let cause = error.to_string();
        if connect.is_empty() || cause.contains("listen") {
            LinkError::failed(format!("can't listen on {}", listen.join(", ")), &brief(&cause))
        } else {
            let tls = &settings["transport"]["link"]["tls"];
            let knows = ["", "_base64"].iter().any(|kind| tls[format!("root_ca_certificate{kind}")].is_string());
            let reason = reason.unwrap_or(cause);
            // A router that is there, and can't be spoken with, is not helped by another.
            let cause = connect_error::explain(&reason, knows).map_or_else(
                || format!("{}; start one with `supertwin up` or `supertwin serve router`", brief(&reason)),
                str::to_owned,
            );
            LinkError::NoRouter { endpoints: connect.join(", "), cause }
        }
    })
}

/// Certificates and keys that are about to be used must be good: TLS itself says little, or says it to the other side.
///
/// # Errors
/// Names the file, what is wrong and what to do.
pub fn check_credentials(settings: &Value, clock: &dyn Clock) -> Result<(), PkiError> {
    ["listen", "connect"].iter().filter_map(|side| used_files(settings, side)).try_for_each(|files| {
        files.check(clock)?;
        Ok(())
    })
}

/// The files for TLS of one side, if any of its endpoints needs them.
pub(crate) fn used_files(settings: &Value, side: &str) -> Option<Credentials> {
    let used = endpoints(settings, side).iter().any(|endpoint| endpoint.starts_with("tls/"));
    tls_files(settings, side).filter(|_| used)
}

/// A holder's files as settings below `transport/link/tls`: for those who connect, and for a role that `listens` both.
#[must_use]
pub fn tls_settings(credentials: &Credentials, listens: bool) -> Value {
    let path = |path: &Path| path.display().to_string();
    let (certificate, key) = (path(&credentials.certificate), path(&credentials.key));
    let mut settings = json!({
        "root_ca_certificate": path(&credentials.ca),
        "enable_mtls": true,
        "connect_certificate": certificate,
        "connect_private_key": key,
        "verify_name_on_connect": true,
        "close_link_on_expiration": true,
    });
    if listens {
        settings["listen_certificate"] = certificate.into();
        settings["listen_private_key"] = key.into();
    }
    settings
}

/// The files that settings name for TLS, for one side: `connect` or `listen`.
#[must_use]
pub fn tls_files(settings: &Value, side: &str) -> Option<Credentials> {
    let file = |name: &str| settings.pointer(&format!("/transport/link/tls/{name}"))?.as_str().map(PathBuf::from);
    Some(Credentials {
        ca: file("root_ca_certificate")?,
        certificate: file(&format!("{side}_certificate"))?,
        key: file(&format!("{side}_private_key"))?,
    })
}

/// Zenoh's causes carry source files and lines; people want the words.
pub(crate) fn brief(cause: &str) -> String {
    cause.split(" at ").next().unwrap_or(cause).trim().to_owned()
}

/// The folder of a unix socket is made, for its owner only.
fn prepare_socket(endpoint: &str) -> Result<(), LinkError> {
    let Some(path) = endpoint.strip_prefix("unixsock-stream/") else { return Ok(()) };
    let path = path.split(['?', '#']).next().unwrap_or(path);
    let Some(folder) = Path::new(path).parent().filter(|folder| !folder.exists()) else { return Ok(()) };
    let made = std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder);
    made.map_err(|cause| LinkError::failed(folder.display().to_string(), &cause))
}

fn read(path: &Path) -> Result<Value, LinkError> {
    let wrong = |cause: &dyn Display| LinkError::failed(path.display().to_string(), cause);
    let text = std::fs::read_to_string(path).map_err(|error| wrong(&error))?;
    let value: Value = json5::from_str(&text).map_err(|error| wrong(&error))?;
    if value.is_object() { Ok(value) } else { Err(wrong(&"must be an object, { … }")) }
}

/// Settings, which `place` gives, as Zenoh's own type.
pub(crate) fn parse(settings: &Value, place: impl Into<String>) -> Result<Config, LinkError> {
    Config::from_json5(&settings.to_string()).map_err(LinkError::session(place))
}

fn nested(path: &str, value: Value) -> Value {
    path.rsplit('/').fold(value, |value, name| Value::Object(Map::from_iter([(name.to_owned(), value)])))
}

/// Sixteen hexadecimal digits that nobody else has.
#[must_use]
pub fn unique() -> String {
    zenoh::session::ZenohId::default().to_string().chars().take(16).collect()
}

/// Closes a session; what can't be said any more is not said.
pub fn close(session: &Session) {
    // Nobody is left to tell: the process ends or the link is down.
    let _ = session.close().wait();
}

/// Endpoints of one side, `listen` or `connect`.
#[must_use]
pub fn endpoints(settings: &Value, side: &str) -> Vec<String> {
    let list = &settings[side]["endpoints"];
    list.as_array().into_iter().flatten().filter_map(|value| value.as_str().map(str::to_owned)).collect()
}

/// Addresses at which a session really listens, with the ports that were chosen.
#[must_use]
pub fn locators(session: &Session) -> Vec<String> {
    session.info().locators().wait().into_iter().map(|locator| locator.to_string()).collect()
}

/// Listeners that other machines can reach and that do not check who comes and what he may do; discovery that is left on:
/// each a sentence.
#[must_use]
pub fn exposures(settings: &Value) -> Vec<String> {
    let mut found = open_listeners(settings);
    for way in ["multicast", "gossip"] {
        if settings["scouting"][way]["enabled"] == json!(true) {
            found.push(format!("discovery by {way} is on (scouting/{way}/enabled)"));
        }
    }
    found
}

/// Listeners that other machines can reach, without TLS that asks for a certificate or without access control.
#[must_use]
pub fn open_listeners(settings: &Value) -> Vec<String> {
    let rules = &settings["access_control"];
    let rules = rules["enabled"] == json!(true) && rules["default_permission"] == json!("deny");
    let asks = settings["transport"]["link"]["tls"]["enable_mtls"] == json!(true);
    let found =
        endpoints(settings, "listen").into_iter().filter(|endpoint| !is_local(endpoint)).filter_map(|endpoint| {
            let lacks = match (endpoint.starts_with("tls/"), asks, rules) {
                (false, ..) => "without TLS",
                (true, false, _) => "without asking for a certificate (transport/link/tls/enable_mtls)",
                (true, true, false) => "without access control that denies by default (access_control)",
                (true, true, true) => return None,
            };
            Some(format!("listens on {endpoint}, beyond loopback and {lacks}"))
        });
    found.collect()
}

/// Whether only this machine can reach an endpoint.
fn is_local(endpoint: &str) -> bool {
    let Some((protocol, address)) = endpoint.split_once('/') else { return false };
    let address = address.split(['?', '#']).next().unwrap_or(address);
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host).trim_start_matches('[').trim_end_matches(']');
    protocol.starts_with("unixsock")
        || host == "localhost"
        || host.parse::<std::net::IpAddr>().is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;
    use supertwin_protocol::role::{Role, Scope};

    #[test]
    fn a_file_is_laid_over_safe_settings_and_overrides_over_both() {
        let folder = tempfile::tempdir().expect("folder");
        let file = folder.path().join("x.json5");
        std::fs::write(&file, "{ mode: 'router', listen: { endpoints: ['tcp/127.0.0.1:0'] } /* ! */ }").expect("file");
        let link =
            Link { file: Some(file), overrides: vec!["transport/link/tx/lease=700".to_owned()], ..Link::default() };
        let settings = link.settings().expect("legal");
        assert_eq!(settings["mode"], "router");
        assert_eq!(settings["scouting"]["multicast"]["enabled"], false);
        assert_eq!(settings["transport"]["link"]["tx"]["lease"], 700);
        assert_eq!(settings["transport"]["link"]["rx"]["max_message_size"], 1_048_576);
        assert!(link.config().is_ok());
        assert!(exposures(&settings).is_empty());
    }

    #[test]
    fn a_wrong_file_key_or_override_is_named() {
        let folder = tempfile::tempdir().expect("folder");
        let file = folder.path().join("typo.json5");
        std::fs::write(&file, "{ scoutin: {} }").expect("file");
        let says = |link: &Link| link.config().map(drop).expect_err("is wrong").to_string();
        let link = Link { file: Some(file), ..Link::default() };
        assert!(says(&link).contains("typo.json5") && says(&link).contains("scoutin"), "{}", says(&link));
        let link = Link { file: Some(folder.path().join("none.json5")), ..Link::default() };
        assert!(says(&link).contains("none.json5"), "{}", says(&link));
        let link = Link { overrides: vec!["mode".to_owned()], ..Link::default() };
        assert!(says(&link).contains("path/to/key=value"), "{}", says(&link));
    }

    #[test]
    fn credentials_make_the_settings_of_tls_and_are_checked_before_they_are_used() {
        let (folder, clock) = (tempfile::tempdir().expect("folder"), SystemClock::start());
        let day = supertwin_pki::DAY;
        let authority = supertwin_pki::Authority::init(&folder.path().join("pki"), "f", day, &clock).expect("new");
        let vehicle = supertwin_pki::Request::new(Role::Vehicle, Scope::Fleet, "v").at(&["localhost"]);
        authority.issue(&vehicle, &clock).expect("is legal");
        authority.issue(&supertwin_pki::Request::new(Role::Observer, Scope::Fleet, "o"), &clock).expect("is legal");
        let link = |holder: &str| Link {
            credentials: Some(authority.folder.join(holder)),
            connect: vec!["tls/localhost:1".to_owned()],
            overrides: vec!["transport/link/tls/verify_name_on_connect=false".to_owned()],
            ..Link::default()
        };
        let tls = |holder: &str| link(holder).settings().expect("legal")["transport"]["link"]["tls"].clone();
        assert_eq!(tls("o")["enable_mtls"], true);
        assert_eq!(tls("o")["verify_name_on_connect"], false, "overrides are laid over all");
        assert!(tls("o")["listen_certificate"].is_null());
        assert!(tls("v")["listen_certificate"].as_str().is_some_and(|path| path.ends_with("v/v.pem")));
        assert!(link("v").config().is_ok());

        let settings = link("o").settings().expect("legal");
        assert_eq!(check_credentials(&settings, &clock), Ok(()));
        std::fs::remove_file(authority.folder.join("o/ca.pem")).expect("is there");
        let said = check_credentials(&settings, &clock).expect_err("is gone").to_string();
        assert!(said.contains("o/ca.pem: No such file"), "{said}");
        let said = link("o").open().map(drop).expect_err("is gone").to_string();
        assert!(said.contains("o/ca.pem: No such file"), "{said}");
        let local = Link { connect: vec!["tcp/127.0.0.1:1".to_owned()], ..link("o") };
        let settings = local.settings().expect("legal");
        assert_eq!(check_credentials(&settings, &clock), Ok(()), "nothing is needed where there is no TLS");
    }

    #[test]
    fn what_is_exposed_is_found() {
        let link = |overrides: &[&str]| {
            let listen =
                ["tcp/0.0.0.0:7447", "tls/0.0.0.0:7448", "tcp/127.0.0.1:1", "tcp/[::1]:1", "unixsock-stream//tmp/a"];
            Link {
                listen: listen.map(str::to_owned).to_vec(),
                overrides: overrides.iter().map(|&text| text.to_owned()).collect(),
                ..Link::default()
            }
        };
        let found = |overrides: &[&str]| exposures(&link(overrides).settings().expect("legal"));
        let open = found(&["scouting/multicast/enabled=true"]);
        assert_eq!(open.len(), 3, "{open:?}");
        assert!(open[0].contains("0.0.0.0:7447, beyond loopback and without TLS") && open[2].contains("multicast"));
        assert!(open[1].contains("0.0.0.0:7448, beyond loopback and without asking for a certificate"), "{open:?}");
        let certified = found(&["transport/link/tls/enable_mtls=true"]);
        assert!(certified[1].contains("without access control that denies by default"), "{certified:?}");
        let rules = "access_control={enabled:true,default_permission:'deny',rules:[],subjects:[],policies:[]}";
        assert_eq!(found(&["transport/link/tls/enable_mtls=true", rules]).len(), 1, "only TCP is left");
    }

    #[test]
    fn a_host_that_looks_like_loopback_is_none() {
        for local in ["tcp/localhost:7447", "tls/127.1.2.3:1", "tcp/[::1]:7447", "unixsock-stream//a:b/c"] {
            assert!(is_local(local), "{local}");
        }
        for far in ["tcp/localhost.example:7447", "tcp/127.example:1", "tcp/0.0.0.0:1", "tcp/[::]:1", "nonsense"] {
            assert!(!is_local(far), "{far}");
        }
    }
}
