//! What network tests share: processes that end with their test, a proxy that cuts, stalls and delays, and a listener.
#![allow(dead_code, unreachable_pub, reason = "each test file uses its part")]

use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Duration;
use supertwin_zenoh::{Clock, Heard, Inbox, Link, Session, SystemClock};

/// The program under test.
pub const SUPERTWIN: &str = env!("CARGO_BIN_EXE_supertwin");

/// A process that ends with its test.
pub struct Process {
    child: Child,
    stdout: BufReader<std::process::ChildStdout>,
}

impl Process {
    /// Starts the program under test.
    pub fn supertwin(arguments: &[&str]) -> Self {
        Self::start(SUPERTWIN, arguments)
    }

    /// Starts it in a network namespace.
    pub fn supertwin_in(namespace: Option<&str>, arguments: &[&str]) -> Self {
        match namespace {
            None => Self::supertwin(arguments),
            Some(name) => {
                let mut words = vec!["netns", "exec", name, SUPERTWIN];
                words.extend(arguments);
                Self::start("ip", &words)
            }
        }
    }

    fn start(program: &str, arguments: &[&str]) -> Self {
        let mut child = Command::new(program)
            .args(arguments)
            .env("SUPERTWIN_CONFIG", concat!(env!("CARGO_MANIFEST_DIR"), "/../../config"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .expect("starts");
        let stdout = BufReader::new(child.stdout.take().expect("is piped"));
        Self { child, stdout }
    }

    /// The next line of standard output, as JSON.
    pub fn json_line(&mut self) -> Value {
        let mut line = String::new();
        self.stdout.read_line(&mut line).expect("can be read");
        serde_json::from_str(&line).unwrap_or_else(|error| panic!("no JSON: {error}: {line:?}"))
    }

    /// kill -9, and waits until it is gone.
    pub fn kill(&mut self) {
        self.child.kill().expect("is there to be killed");
        self.child.wait().expect("ends");
    }

    /// Sends a signal by its name, such as STOP.
    pub fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-s", name, &pid]).status().expect("kill exists").success());
    }

    /// Waits for the end; the exit status.
    pub fn wait(&mut self) -> i32 {
        self.child.wait().expect("ends").code().unwrap_or(-1)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Where a router listens: its unix socket and its TCP port.
pub struct Router {
    pub process: Process,
    pub unix: String,
    pub tcp: String,
}

impl Router {
    /// On a socket in `folder` and on `tcp/ADDRESS:0`.
    pub fn start(folder: &Path, namespace: Option<&str>, address: &str) -> Self {
        let unix = format!("unixsock-stream/{}", folder.join("r.sock").display());
        let tcp = format!("tcp/{address}");
        let words = ["serve", "router", "--json", "--listen", &unix, "--listen", &tcp];
        let mut process = Process::supertwin_in(namespace, &words);
        let said = process.json_line();
        let places = said["listening"].as_array().expect("a list");
        let tcp = places.iter().filter_map(Value::as_str).find(|place| place.starts_with("tcp/"));
        Self { tcp: tcp.expect("listens by TCP").to_owned(), unix, process }
    }
}

/// A service of one vehicle.
pub fn serve(service: &str, vehicle: &str, trial: &Path, endpoint: &str, namespace: Option<&str>) -> Process {
    let trial = trial.display().to_string();
    let words = ["serve", service, "--json", "--vehicle", vehicle, "--trial", &trial, "--connect", endpoint];
    Process::supertwin_in(namespace, &words)
}

/// A trial that follows the net from its first second, as a file in `folder`.
pub fn following(folder: &Path) -> PathBuf {
    let fair = include_str!("../../config/trials/fair.toml");
    let (head, _) = fair.split_once("[start]").expect("has a start");
    let head = head.replace(r#"["gsta", "agsta", "pid", "gsta-tuned", "pid-tuned"]"#, r#"["gsta-tuned"]"#);
    let text = format!(
        "{head}[start]\nbearing_rad = 0.5\nnet_distance_m = 3.0\ndepth_m = 4.0\nheading_offset_rad = 0.0\n\
         [score]\nfrom_s = 1.0\n\
         [[mission]]\nat_s = 0.0\ncommand.guidance.depth_m = 4.0\n\
         [[mission]]\nat_s = 0.0\ncommand.guidance.mode = \"follow_net\"\n"
    );
    let path = folder.join("following.toml");
    std::fs::write(&path, text).expect("is written");
    path
}

/// Listens to one vehicle from beside it.
pub struct Listener {
    pub session: Session,
    pub inbox: Inbox,
    pub clock: Arc<dyn Clock>,
    prefix: String,
}

/// Longest wait for anything in these tests.
pub const LIMIT: Duration = Duration::from_secs(40);

impl Listener {
    /// A client of the router at `endpoint`.
    pub fn open(endpoint: &str, vehicle: &str) -> Self {
        let link = Link {
            mode: Some("client"),
            connect: vec![endpoint.to_owned()],
            patience_ms: 20_000,
            overrides: vec!["connect/retry={period_init_ms:100,period_max_ms:300,period_increase_factor:2}".to_owned()],
            ..Link::default()
        };
        let session = link.open().expect("the router is there");
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
        let inbox = Inbox::new(Arc::clone(&clock));
        Self { session, inbox, clock, prefix: format!("supertwin/{vehicle}/") }
    }

    /// Listens to a key of the vehicle.
    pub fn listen(mut self, key: &str) -> Self {
        self.inbox.listen(&self.session, &format!("{}{key}", self.prefix)).expect("may be listened to");
        self
    }

    /// Listens to events, with recovery.
    pub fn events(mut self) -> Self {
        self.inbox.listen_events(&self.session, &format!("{}event/*", self.prefix)).expect("may be listened to");
        self
    }

    /// The next sample: key without the vehicle, and JSON.
    pub fn next(&self) -> (String, Value, Duration) {
        let Heard { key, payload, at, .. } =
            self.inbox.next(Some(self.clock.now() + LIMIT)).expect("something is heard");
        let value = serde_json::from_slice(&payload).unwrap_or(Value::Null);
        (key.strip_prefix(&self.prefix).unwrap_or(&key).to_owned(), value, at)
    }

    /// Reads until `wanted` says that this is it.
    pub fn until(&self, what: &str, mut wanted: impl FnMut(&str, &Value) -> bool) -> (Value, Duration) {
        let give_up = self.clock.now() + LIMIT;
        loop {
            let (key, value, at) = self.next();
            if wanted(&key, &value) {
                return (value, at);
            }
            assert!(self.clock.now() < give_up, "waited in vain for {what}");
        }
    }

    /// Reads what comes for a while; nothing needs to come.
    pub fn during(&self, span: Duration, mut look: impl FnMut(&str, &Value)) {
        let end = self.clock.now() + span;
        while let Some(heard) = self.inbox.next(Some(end)) {
            let value = serde_json::from_slice(&heard.payload).unwrap_or(Value::Null);
            look(heard.key.strip_prefix(&self.prefix).unwrap_or(&heard.key), &value);
        }
    }
}

/// A TCP proxy that cuts, stalls and delays.
pub struct Proxy {
    state: Arc<ProxyState>,
    port: u16,
}

struct ProxyState {
    target: String,
    cut: AtomicBool,
    stalled: AtomicBool,
    delay_ms: AtomicU64,
    open: Mutex<Vec<TcpStream>>,
    clock: SystemClock,
}

impl Proxy {
    /// In front of `endpoint`, `tcp/HOST:PORT`.
    pub fn before(endpoint: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("bound").port();
        let state = Arc::new(ProxyState {
            target: endpoint.strip_prefix("tcp/").expect("TCP").to_owned(),
            cut: AtomicBool::new(false),
            stalled: AtomicBool::new(false),
            delay_ms: AtomicU64::new(0),
            open: Mutex::new(Vec::new()),
            clock: SystemClock::start(),
        });
        let shared = Arc::clone(&state);
        std::thread::spawn(move || {
            for near in listener.incoming().flatten() {
                if shared.cut.load(Ordering::SeqCst) {
                    continue;
                }
                let Ok(far) = TcpStream::connect(&shared.target) else { continue };
                let pair =
                    |a: &TcpStream, b: &TcpStream| (a.try_clone().expect("clones"), b.try_clone().expect("clones"));
                let mut open = shared.open.lock().expect("not poisoned");
                open.extend([near.try_clone().expect("clones"), far.try_clone().expect("clones")]);
                drop(open);
                for (from, to) in [pair(&near, &far), pair(&far, &near)] {
                    forward(from, to, Arc::clone(&shared));
                }
            }
        });
        Self { state, port }
    }

    /// Where to connect instead.
    pub fn endpoint(&self) -> String {
        format!("tcp/127.0.0.1:{}", self.port)
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
        self.state.stalled.store(stalled, Ordering::SeqCst);
    }

    /// Holds everything back for so long, in each direction.
    pub fn delay(&self, delay: Duration) {
        let ms = u64::try_from(delay.as_millis()).expect("short");
        self.state.delay_ms.store(ms, Ordering::SeqCst);
    }
}

fn forward(mut from: TcpStream, mut to: TcpStream, state: Arc<ProxyState>) {
    let (send, receive) = mpsc::channel::<(Duration, Vec<u8>)>();
    let reading = Arc::clone(&state);
    std::thread::spawn(move || {
        let mut buffer = [0; 16 * 1024];
        while let Ok(n @ 1..) = from.read(&mut buffer) {
            while reading.stalled.load(Ordering::SeqCst) {
                std::thread::park_timeout(Duration::from_millis(2));
            }
            let due = reading.clock.now() + Duration::from_millis(reading.delay_ms.load(Ordering::SeqCst));
            if send.send((due, buffer[..n].to_vec())).is_err() {
                break;
            }
        }
    });
    std::thread::spawn(move || {
        for (due, bytes) in receive {
            loop {
                let left = due.saturating_sub(state.clock.now());
                if left.is_zero() {
                    break;
                }
                std::thread::park_timeout(left);
            }
            if to.write_all(&bytes).is_err() {
                break;
            }
        }
        let _ = to.shutdown(Shutdown::Both);
    });
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
            if !ip(&["netns", "add", name]) {
                return None;
            }
        }
        let (v, t) = (format!("sv{number}"), format!("st{number}"));
        let laid = ip(&[
            "link",
            "add",
            &v,
            "netns",
            &cable.vehicle,
            "type",
            "veth",
            "peer",
            "name",
            &t,
            "netns",
            &cable.topside,
        ]) && [(&cable.vehicle, &v, 1), (&cable.topside, &t, 2)].into_iter().all(|(name, device, host)| {
            let address = format!("10.77.{subnet}.{host}/24");
            ip(&["-n", name, "addr", "add", &address, "dev", device])
                && ip(&["-n", name, "link", "set", device, "up"])
                && ip(&["-n", name, "link", "set", "lo", "up"])
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
        assert!(ip(&["-n", &self.topside, "link", "set", &device, state]), "the cable can be {state}");
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        for name in [&self.vehicle, &self.topside] {
            ip(&["netns", "del", name]);
        }
    }
}

fn ip(words: &[&str]) -> bool {
    let done = Command::new("ip").args(words).stdout(Stdio::null()).stderr(Stdio::null()).status();
    done.is_ok_and(|status| status.success())
}
