//! What viewers connect to while a run goes on: Rerun's own server behind a bounded queue.
//!
//! The server holds back whoever feeds it when a viewer is slow. Here that is a thread of its own; before it stands a
//! queue that drops and counts. The file and the control loop never notice.

use crate::chunks::Problem;
use crate::writer::Job;
use rerun::StoreId;
use rerun::log::LogMsg;
use rerun::sink::LogSink as _;
use std::net::{Ipv4Addr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Batches that wait for the server before the next one is dropped: some seconds of a vehicle.
const WAITING: usize = 64;
/// What the server keeps for viewers that come later.
const MEMORY: u64 = 256 << 20;

/// A server for viewers on this machine. Clones share it.
#[derive(Clone)]
pub struct Live {
    jobs: SyncSender<(StoreId, Job)>,
    dropped: Arc<AtomicU64>,
    /// Port of the server.
    pub port: u16,
    /// The page, for people without a viewer.
    pub page: Option<String>,
    // The page goes with its server, whose type has no public name.
    _web: Option<Arc<dyn core::any::Any + Send + Sync>>,
}

impl core::fmt::Debug for Live {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Live").field("port", &self.port).field("page", &self.page).finish_non_exhaustive()
    }
}

/// A live view could not be served.
#[derive(Debug, thiserror::Error)]
#[error("port {port} on 127.0.0.1: {cause}")]
pub struct LiveError {
    /// TCP port that the live view was to listen on.
    pub port: u16,
    /// What the system says.
    pub cause: String,
}

impl Live {
    /// Serves viewers on `port` of this machine, 0 for any; and a page with Rerun's web viewer on `web`, if given.
    ///
    /// # Errors
    /// When a port is taken.
    pub fn serve(port: u16, web: Option<u16>) -> Result<Self, LiveError> {
        let port = free(port)?;
        let options =
            rerun::ServerOptions { memory_limit: rerun::MemoryLimit::from_bytes(MEMORY), ..Default::default() };
        let failed = |port: u16, cause: String| LiveError { port, cause };
        let server = rerun::grpc_server::GrpcServerSink::new("127.0.0.1", port, options)
            .map_err(|cause| failed(port, cause.to_string()))?;
        let (jobs, inbox) = sync_channel(WAITING);
        std::thread::Builder::new()
            .name("live".to_owned())
            .spawn(move || feed(&inbox, |message| server.send(message)))
            .map_err(|cause| failed(port, cause.to_string()))?;
        let mut live = Self { jobs, dropped: Arc::default(), port, page: None, _web: None };
        if let Some(wanted) = web {
            let wanted = free(wanted)?;
            let config = rerun::web_viewer::WebViewerConfig {
                bind_ip: "127.0.0.1".to_owned(),
                web_port: wanted.to_string().parse().map_err(|cause: String| failed(wanted, cause))?,
                open_browser: false,
                ..Default::default()
            };
            let server = config.host_web_viewer().map_err(|cause| failed(wanted, cause.to_string()))?;
            let source = live.url().replace('+', "%2B").replace(':', "%3A").replace('/', "%2F");
            live.page = Some(format!("http://127.0.0.1:{wanted}?url={source}"));
            live._web = Some(Arc::new(server));
        }
        Ok(live)
    }

    /// What to tell a viewer.
    #[must_use]
    pub fn url(&self) -> String {
        format!("rerun+http://127.0.0.1:{}/proxy", self.port)
    }

    /// Batches that were dropped because viewers were too slow.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Hands over a job; never waits.
    pub(crate) fn offer(&self, store: &StoreId, job: Job) {
        if self.jobs.try_send((store.clone(), job)).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The port, when nobody listens there yet: Rerun's server would only log that it can't.
fn free(port: u16) -> Result<u16, LiveError> {
    TcpListener::bind((Ipv4Addr::LOCALHOST, port))
        .and_then(|listener| listener.local_addr())
        .map(|address| address.port())
        .map_err(|cause| LiveError { port, cause: cause.to_string() })
}

fn feed(inbox: &Receiver<(StoreId, Job)>, send: impl Fn(LogMsg)) {
    for (store, job) in inbox {
        let unpacked: Result<(), Problem> = job.unpack(&store, &mut |message| {
            send(message);
            Ok(())
        });
        // The file reports what can't be made a message; a view goes on without it.
        drop(unpacked);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_is_taken_is_named() {
        let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let port = taken.local_addr().unwrap().port();
        let error = Live::serve(port, None).unwrap_err().to_string();
        assert!(error.contains(&port.to_string()), "{error}");
    }
}
