//! A tether to be cut: a TCP proxy that cuts, stalls and delays, and a cable between two network namespaces.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, mpsc};
use std::time::Duration;
use supertwin_protocol::{Clock, SystemClock};

/// A TCP proxy that cuts, stalls and delays.
pub struct Proxy {
    state: Arc<ProxyState>,
    /// In front of the port: `tcp/127.0.0.1` or `tls/localhost`.
    host: &'static str,
    port: u16,
}

#[derive(Default)]
struct ProxyState {
    target: String,
    taken: AtomicU64,
    cut: AtomicBool,
    stalled: Mutex<bool>,
    flows: Condvar,
    delay_ms: AtomicU64,
    open: Mutex<Vec<Arc<TcpStream>>>,
}

impl Proxy {
    /// In front of `endpoint`, `tcp/HOST:PORT` or `tls/HOST:PORT`.
    pub fn before(endpoint: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("bound").port();
        let (protocol, target) = endpoint.split_once('/').expect("a protocol");
        // A certificate names hosts.
        let host = if protocol == "tls" { "tls/localhost" } else { "tcp/127.0.0.1" };
        let state = Arc::new(ProxyState { target: target.to_owned(), ..ProxyState::default() });
        let shared = Arc::clone(&state);
        std::thread::spawn(move || {
            for near in listener.incoming().flatten() {
                if shared.cut.load(Ordering::SeqCst) {
                    continue;
                }
                let Ok(far) = TcpStream::connect(&shared.target) else { continue };
                shared.taken.fetch_add(1, Ordering::SeqCst);
                let (near, far) = (Arc::new(near), Arc::new(far));
                shared.open.lock().expect("not poisoned").extend([&near, &far].map(Arc::clone));
                forward(&near, &far, &shared);
                forward(&far, &near, &shared);
            }
        });
        Self { state, host, port }
    }

    /// Connections that were made through it so far.
    pub fn taken(&self) -> u64 {
        self.state.taken.load(Ordering::SeqCst)
    }

    /// Where to connect instead.
    pub fn endpoint(&self) -> String {
        format!("{}:{}", self.host, self.port)
    }

    /// Breaks all connections and takes no new ones, or takes them again.
    pub fn cut(&self, cut: bool) {
        self.state.cut.store(cut, Ordering::SeqCst);
        if cut {
            for stream in self.state.open.lock().expect("not poisoned").drain(..) {
                // It may have ended by itself.
                let _ = stream.shutdown(Shutdown::Both);
            }
        }
    }

    /// Keeps connections open and forwards nothing, or goes on.
    pub fn stall(&self, stalled: bool) {
        *self.state.stalled.lock().expect("not poisoned") = stalled;
        self.state.flows.notify_all();
    }

    /// Holds everything back for so long, in each direction.
    pub fn delay(&self, delay: Duration) {
        let ms = u64::try_from(delay.as_millis()).expect("short");
        self.state.delay_ms.store(ms, Ordering::SeqCst);
    }
}

fn forward(from: &Arc<TcpStream>, to: &Arc<TcpStream>, state: &Arc<ProxyState>) {
    let (send, receive) = mpsc::channel::<(Duration, Vec<u8>)>();
    let (from, to, state, clock) = (Arc::clone(from), Arc::clone(to), Arc::clone(state), SystemClock::start());
    std::thread::spawn(move || {
        let mut buffer = [0; 16 * 1024];
        while let Ok(n @ 1..) = from.as_ref().read(&mut buffer) {
            let stalled = state.stalled.lock().expect("not poisoned");
            drop(state.flows.wait_while(stalled, |stalled| *stalled).expect("not poisoned"));
            let due = clock.now() + Duration::from_millis(state.delay_ms.load(Ordering::SeqCst));
            if send.send((due, buffer[..n].to_vec())).is_err() {
                break;
            }
        }
    });
    std::thread::spawn(move || {
        for (due, bytes) in receive {
            #[expect(clippy::disallowed_methods, reason = "the delay of the link itself, not a wait for something")]
            std::thread::sleep(due.saturating_sub(clock.now()));
            if to.as_ref().write_all(&bytes).is_err() {
                break;
            }
        }
        let _ = to.shutdown(Shutdown::Both);
    });
}

/// A port of this machine that is free now.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("is bound").port()
}

/// Two network namespaces joined by a cable, if the machine allows it.
pub struct Cable {
    pub vehicle: String,
    pub topside: String,
    subnet: u8,
}

impl Cable {
    /// `None` where namespaces are refused.
    pub fn lay() -> Option<Self> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = u64::from(std::process::id()) * 8 + NEXT.fetch_add(1, Ordering::SeqCst);
        let subnet = u8::try_from(number % 250).expect("small");
        let cable = Self { vehicle: format!("stv{number}"), topside: format!("stt{number}"), subnet };
        for name in [&cable.vehicle, &cable.topside] {
            if !ip(&format!("netns add {name}")) {
                return None;
            }
        }
        let (v, t) = (format!("sv{number}"), format!("st{number}"));
        let laid = ip(&format!("link add {v} netns {} type veth peer name {t} netns {}", cable.vehicle, cable.topside))
            && [(&cable.vehicle, &v, 1), (&cable.topside, &t, 2)].into_iter().all(|(name, device, host)| {
                ip(&format!("-n {name} addr add 10.77.{subnet}.{host}/24 dev {device}"))
                    && [device, "lo"].into_iter().all(|device| ip(&format!("-n {name} link set {device} up")))
            });
        laid.then_some(cable)
    }

    /// The vehicle's address.
    pub fn address(&self) -> String {
        format!("10.77.{}.1", self.subnet)
    }

    /// Pulls the plug topside, or puts it back.
    pub fn plug(&self, plugged: bool) {
        let device = self.topside.replace("stt", "st");
        let state = if plugged { "up" } else { "down" };
        assert!(ip(&format!("-n {} link set {device} {state}", self.topside)), "the cable can be {state}");
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        for name in [&self.vehicle, &self.topside] {
            ip(&format!("netns del {name}"));
        }
    }
}

fn ip(words: &str) -> bool {
    let done = Command::new("ip").args(words.split(' ')).stdout(Stdio::null()).stderr(Stdio::null()).status();
    done.is_ok_and(|status| status.success())
}
