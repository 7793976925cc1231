//! Sessions: a JSON5 file of Zenoh's own format, laid over settings that are safe by default, and overrides.

use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};
use zenoh::{Config, Session, Wait};

/// How a process joins the network.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Link {
    /// A JSON5 file.
    pub file: Option<PathBuf>,
    /// Endpoints to listen on, instead of the file's.
    pub listen: Vec<String>,
    /// Endpoints to connect to, instead of the file's.
    pub connect: Vec<String>,
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
    /// The file can't be read or is no JSON5.
    #[error("{path}: {cause}")]
    File {
        /// Which.
        path: String,
        /// Why.
        cause: String,
    },
    /// A setting is not Zenoh's.
    #[error("{place}: {cause}")]
    Setting {
        /// Where it stands.
        place: String,
        /// Why.
        cause: String,
    },
    /// Nobody answers.
    #[error("no router at {endpoints}: {cause}; start one with `supertwin up` or `supertwin serve router`")]
    NoRouter {
        /// Where it was looked for.
        endpoints: String,
        /// Why.
        cause: String,
    },
    /// Can't listen.
    #[error("can't listen on {endpoints}: {cause}")]
    Listen {
        /// Where.
        endpoints: String,
        /// Why.
        cause: String,
    },
    /// Something that was asked of the session failed.
    #[error("{what}: {cause}")]
    Session {
        /// What.
        what: String,
        /// Why.
        cause: String,
    },
}

impl LinkError {
    /// What failed, with Zenoh's cause.
    pub fn session(what: impl Into<String>) -> impl FnOnce(zenoh::Error) -> Self {
        let what = what.into();
        move |cause| Self::Session { what, cause: cause.to_string() }
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
            "link": { "tx": { "lease": 2000 }, "rx": { "max_message_size": 1_048_576 } },
            "shared_memory": { "enabled": false },
        },
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
        if let Some(mode) = self.mode {
            set("mode", mode.into());
        }
        if !self.listen.is_empty() {
            set("listen/endpoints", json!(self.listen));
        }
        if !self.connect.is_empty() {
            set("connect/endpoints", json!(self.connect));
        }
        if let Some(namespace) = &self.namespace {
            set("namespace", namespace.as_str().into());
        }
        set("connect/timeout_ms", self.patience_ms.into());
        for text in &self.overrides {
            let wrong = |cause: &str| LinkError::Setting { place: text.clone(), cause: cause.to_owned() };
            let (path, value) = text.split_once('=').ok_or_else(|| wrong("must be path/to/key=value"))?;
            let value = json5::from_str(value).map_err(|error| wrong(&error.to_string()))?;
            set(path, value);
        }
        Ok(settings)
    }

    /// As Zenoh's own type, which knows every legal key.
    ///
    /// # Errors
    /// Names the file and the key that is wrong.
    pub fn config(&self) -> Result<Config, LinkError> {
        let settings = self.settings()?;
        Config::from_json5(&settings.to_string()).map_err(|error| {
            let place = self.file.as_ref().map_or_else(|| "settings".to_owned(), |path| path.display().to_string());
            LinkError::Setting { place, cause: error.to_string() }
        })
    }

    /// Opens the session.
    ///
    /// # Errors
    /// When a setting is wrong, nobody answers, or the place to listen is taken.
    pub fn open(&self) -> Result<Session, LinkError> {
        let settings = self.settings()?;
        let config = self.config()?;
        for endpoint in endpoints(&settings, "listen") {
            prepare_socket(&endpoint)?;
        }
        zenoh::open(config).wait().map_err(|error| {
            let cause = error.to_string();
            let (listen, connect) = (endpoints(&settings, "listen"), endpoints(&settings, "connect"));
            if connect.is_empty() || cause.contains("listen") {
                LinkError::Listen { endpoints: listen.join(", "), cause }
            } else {
                LinkError::NoRouter { endpoints: connect.join(", "), cause: brief(&cause) }
            }
        })
    }
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
    let made = {
        use std::os::unix::fs::DirBuilderExt;
        std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)
    };
    made.map_err(|cause| LinkError::File { path: folder.display().to_string(), cause: cause.to_string() })
}

fn read(path: &Path) -> Result<Value, LinkError> {
    let wrong = |cause: String| LinkError::File { path: path.display().to_string(), cause };
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    let value: Value = json5::from_str(&text).map_err(|error| wrong(error.to_string()))?;
    if value.is_object() { Ok(value) } else { Err(wrong("must be an object, { … }".to_owned())) }
}

fn nested(path: &str, value: Value) -> Value {
    path.rsplit('/').fold(value, |value, name| Value::Object(Map::from_iter([(name.to_owned(), value)])))
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

/// Listeners that other machines can reach without TLS, and discovery that is left on: each a sentence.
#[must_use]
pub fn exposures(settings: &Value) -> Vec<String> {
    let mut found = Vec::new();
    for endpoint in endpoints(settings, "listen") {
        let local = ["127.", "localhost", "[::1]"]
            .iter()
            .any(|start| endpoint.split_once('/').is_some_and(|(_, address)| address.starts_with(start)));
        if !endpoint.starts_with("unixsock") && !local && !endpoint.starts_with("tls/") {
            found.push(format!("listens on {endpoint}, beyond loopback and without TLS"));
        }
    }
    for way in ["multicast", "gossip"] {
        if settings["scouting"][way]["enabled"] == json!(true) {
            found.push(format!("discovery by {way} is on (scouting/{way}/enabled)"));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn what_is_exposed_is_found() {
        let link = Link {
            listen: ["tcp/0.0.0.0:7447", "tls/0.0.0.0:7448", "tcp/127.0.0.1:1", "unixsock-stream//tmp/a"]
                .map(str::to_owned)
                .to_vec(),
            overrides: vec!["scouting/multicast/enabled=true".to_owned()],
            ..Link::default()
        };
        let found = exposures(&link.settings().expect("legal"));
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found[0].contains("0.0.0.0:7447") && found[1].contains("multicast"));
    }
}
