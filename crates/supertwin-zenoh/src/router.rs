//! A router whose TLS listeners take up renewed certificates while it runs.
//!
//! ```text
//! the vehicle's services ── unix socket, loopback ──▶ router ◀── unix socket ── gate ◀── TLS ── topside
//! ```
//!
//! Zenoh reads the certificate of a listener once, and a client reads its own at every connection. So whoever listens on
//! TLS does it in a second session, the gate: when its files change it is opened anew, and those behind it connect again
//! by themselves. The vehicle's own services are not touched.

use crate::session::{self, Link, LinkError, endpoints, locators, used_files};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;
use supertwin_pki::{Certificate, Credentials, PkiError, Standing, span};
use supertwin_protocol::clock::Clock;
use zenoh::Session;

/// How often the gate's files are looked at.
const LOOK: Duration = Duration::from_secs(1);
/// Between two attempts to listen again.
const RETRY: Duration = Duration::from_millis(100);
/// Longest wait of the gate for its own router.
const PATIENCE_MS: i64 = 5000;

/// What a router's operator should hear about its certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum News {
    /// A renewed certificate is in force.
    Renewed(String),
    /// Something needs a hand.
    Warning(String),
}

/// A router in this process, which takes up a renewed certificate by itself.
pub struct Router {
    /// The session of those inside: not a gate's.
    pub session: Session,
    gate: Option<Gate>,
    /// A socket that only the gate uses.
    own_socket: Option<PathBuf>,
}

impl Router {
    /// Opens the router that `link` describes; `say` is told about certificates, from another thread.
    ///
    /// # Errors
    /// When a setting or a certificate is wrong, or the place to listen is taken.
    pub fn open(link: &Link, clock: Arc<dyn Clock>, say: impl Fn(News) + Send + 'static) -> Result<Self, LinkError> {
        let settings = link.settings()?;
        let (tls, mut local): (Vec<String>, Vec<String>) =
            endpoints(&settings, "listen").into_iter().partition(|endpoint| endpoint.starts_with("tls/"));
        let Some(files) = used_files(&settings, "listen") else {
            return Ok(Self { session: link.open()?, gate: None, own_socket: None });
        };
        let certificate = files.check(&*clock)?;
        let mut own_socket = None;
        let inward = match local.iter().find(|endpoint| endpoint.starts_with("unixsock-stream/")) {
            Some(endpoint) => endpoint.clone(),
            None => {
                let folder = std::env::temp_dir().join(format!("supertwin-{}", session::unique()));
                let endpoint = format!("unixsock-stream/{}", folder.join("gate.sock").display());
                own_socket = Some(folder);
                local.push(endpoint.clone());
                endpoint
            }
        };
        let (mut inside, mut outward) = (settings.clone(), settings);
        inside["listen"]["endpoints"] = json!(local);
        let session = listen(&inside)?;
        outward["mode"] = "router".into();
        outward["listen"]["endpoints"] = json!(tls);
        outward["connect"]["endpoints"] = json!([inward]);
        outward["connect"]["timeout_ms"] = PATIENCE_MS.into();
        outward["connect"]["exit_on_failure"] = true.into();
        if let Some(settings) = outward.as_object_mut() {
            settings.remove("namespace");
        }
        match Gate::open(outward, files, certificate, clock, say) {
            Ok(gate) => Ok(Self { session, gate: Some(gate), own_socket }),
            Err(error) => {
                session::close(&session);
                Err(error)
            }
        }
    }

    /// Addresses at which it really listens.
    #[must_use]
    pub fn locators(&self) -> Vec<String> {
        let own = self.own_socket.as_ref().map(|folder| folder.display().to_string());
        let inside = locators(&self.session).into_iter();
        let inside = inside.filter(|place| own.as_ref().is_none_or(|own| !place.contains(own.as_str())));
        inside.chain(self.gate.iter().flat_map(|gate| gate.places.clone())).collect()
    }

    /// Closes its listeners for others, then its session.
    pub fn close(self) {
        // The gate first: it must not look for a router that is gone.
        drop(self.gate);
        session::close(&self.session);
        if let Some(folder) = self.own_socket {
            // A folder in the way of nobody; its socket is gone with the session.
            let _ = std::fs::remove_dir_all(folder);
        }
    }
}

/// The part that listens on TLS.
struct Gate {
    places: Vec<String>,
    /// Dropping it ends the thread.
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Gate {
    fn open(
        mut settings: Value,
        files: Credentials,
        certificate: Certificate,
        clock: Arc<dyn Clock>,
        say: impl Fn(News) + Send + 'static,
    ) -> Result<Self, LinkError> {
        let loaded = contents(&files);
        let session = listen(&settings)?;
        let places = locators(&session);
        // Ports that were chosen once are kept.
        let kept: Vec<String> =
            endpoints(&settings, "listen").iter().map(|endpoint| with_port(endpoint, &places)).collect();
        settings["listen"]["endpoints"] = json!(kept);
        let (stop, stopped) = channel();
        let mut watcher =
            CertificateWatcher { settings, files, certificate, clock, loaded, session, reported: Standing::Valid, say };
        let thread = std::thread::spawn(move || {
            while !is_stopped_within(&stopped, LOOK) {
                watcher.check(&stopped);
            }
            session::close(&watcher.session);
        });
        Ok(Self { places, stop: Some(stop), thread: Some(thread) })
    }
}

impl Drop for Gate {
    fn drop(&mut self) {
        self.stop = None;
        if let Some(thread) = self.thread.take() {
            // If it panicked there is nothing left to close.
            let _ = thread.join();
        }
    }
}

/// Waits for `span`; true when it is time to stop.
fn is_stopped_within(stop: &Receiver<()>, span: Duration) -> bool {
    stop.recv_timeout(span) != Err(RecvTimeoutError::Timeout)
}

struct CertificateWatcher<S> {
    settings: Value,
    files: Credentials,
    certificate: Certificate,
    clock: Arc<dyn Clock>,
    loaded: [Option<Vec<u8>>; 3],
    session: Session,
    reported: Standing,
    say: S,
}

impl<S: Fn(News)> CertificateWatcher<S> {
    fn check(&mut self, stop: &Receiver<()>) {
        let found = contents(&self.files);
        if found != self.loaded {
            self.loaded = found;
            match self.files.check(&*self.clock) {
                Ok(certificate) => self.take_up(certificate, stop),
                // Half a copy, or the wrong one: the certificate in force stays, and the next change is looked at.
                Err(error) => (self.say)(News::Warning(format!("{error}; the certificate in force stays"))),
            }
        }
        let standing = self.certificate.standing(0, &*self.clock);
        if core::mem::replace(&mut self.reported, standing) != standing {
            self.warn(standing);
        }
    }

    fn take_up(&mut self, certificate: Certificate, stop: &Receiver<()>) {
        session::close(&self.session);
        let mut told = false;
        self.session = loop {
            let error = match listen(&self.settings) {
                Ok(session) => break session,
                Err(error) => error,
            };
            if !core::mem::replace(&mut told, true) {
                (self.say)(News::Warning(format!("{error}; trying again")));
            }
            if is_stopped_within(stop, RETRY) {
                return;
            }
        };
        self.certificate = certificate;
        (self.say)(News::Renewed(format!(
            "{}: in force until {}",
            self.files.certificate.display(),
            self.certificate.not_after()
        )));
    }

    fn warn(&self, standing: Standing) {
        let left_s = self.certificate.left_s(&*self.clock);
        let what = match standing {
            Standing::Valid => return,
            Standing::ExpiresSoon => format!("expires in {}", span(left_s)),
            Standing::Expired => "has expired: nobody can connect".to_owned(),
            Standing::NotYetValid => "is not valid yet: is this machine's clock right?".to_owned(),
        };
        let path = self.files.certificate.display();
        (self.say)(News::Warning(format!("{path}: {what}; a renewed one in its place is taken up at once")));
    }
}

fn contents(files: &Credentials) -> [Option<Vec<u8>>; 3] {
    [&files.ca, &files.certificate, &files.key].map(|path: &PathBuf| std::fs::read(Path::new(path)).ok())
}

fn listen(settings: &Value) -> Result<Session, LinkError> {
    session::open(settings, session::parse(settings, "settings")?)
}

/// An endpoint with port 0 with the port that was chosen for it.
fn with_port(endpoint: &str, places: &[String]) -> String {
    let (address, rest) = endpoint.split_at(endpoint.find(['?', '#']).unwrap_or(endpoint.len()));
    let Some(host) = address.strip_suffix(":0") else { return endpoint.to_owned() };
    let mut same = places.iter().filter_map(|place| place.rsplit_once(':'));
    let found = same.clone().find(|(other, _)| *other == host).or_else(|| same.next());
    found.map_or_else(|| endpoint.to_owned(), |(_, port)| format!("{host}:{port}{rest}"))
}

/// What a certificate's file is, or why it is none; for those who only connect.
///
/// # Errors
/// When a file is not what it should be.
pub fn expiring(settings: &Value, clock: &dyn Clock) -> Result<Option<String>, PkiError> {
    let Some(files) = used_files(settings, "connect") else { return Ok(None) };
    let certificate = files.check(clock)?;
    let soon = certificate.standing(0, clock) == Standing::ExpiresSoon;
    Ok(soon.then(|| {
        let left = span(certificate.left_s(clock));
        format!("{}: expires in {left}; a renewed one in its place is taken up at once", files.certificate.display())
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_was_chosen_is_kept() {
        let places = ["tls/127.0.0.1:4711".to_owned(), "tls/localhost:4712".to_owned()];
        assert_eq!(with_port("tls/localhost:0", &places), "tls/localhost:4712");
        assert_eq!(with_port("tls/127.0.0.1:0#iface=lo", &places), "tls/127.0.0.1:4711#iface=lo");
        assert_eq!(with_port("tls/0.0.0.0:0", &places), "tls/0.0.0.0:4711");
        assert_eq!(with_port("tls/0.0.0.0:7447", &places), "tls/0.0.0.0:7447");
        assert_eq!(with_port("tls/localhost:0", &[]), "tls/localhost:0");
    }
}
