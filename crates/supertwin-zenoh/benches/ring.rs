//! The ring over the network beside a ring of plain Zenoh calls: laps per second, latency at 50 Hz, and fleets.
//!
//! ```text
//! cargo build --release && cargo bench -p supertwin-zenoh --bench ring          all of it, about three minutes
//! cargo bench -p supertwin-zenoh --bench ring -- lockstep | realtime | up | fleet
//! ```
//! Both rings have the same processes, hops, fan-out, payload sizes and quality of service, and the same router. Each
//! process of the plain ring waits on Zenoh's own channel and puts from its main thread.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a bench may panic and print")]

use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;
use supertwin_protocol::{Clock, SystemClock};
use supertwin_zenoh::Link;
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};

/// A wire of the plain ring: its name, its typical size in bytes, who waits for it.
const WIRES: [(&str, usize, &[&str]); 4] = [
    ("measurements", 330, &["estimator"]),
    ("nav", 1260, &["guidance", "controller"]),
    ("reference", 490, &["controller"]),
    ("thrust", 640, &["plant", "estimator", "controller"]),
];

/// How often telemetry is sent, and what that is called.
const TELEMETRY: [(u64, &str); 2] = [(0, "telemetry off"), (1, "with telemetry")];

fn main() {
    const ALL: [(&str, fn()); 4] = [("lockstep", lock_step), ("realtime", real_time), ("up", up), ("fleet", fleet)];
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    if let ["participant", name, endpoint, laps, pace_hz] = words[..] {
        return participant(name, endpoint, laps.parse().unwrap(), pace_hz.parse().unwrap());
    }
    let wanted = |name: &str| words.is_empty() || words == [name];
    let asked: Vec<fn()> = ALL.into_iter().filter(|(name, _)| wanted(name)).map(|(_, bench)| bench).collect();
    assert!(!asked.is_empty(), "{words:?}: must be nothing, lockstep, realtime, up or fleet");
    asked.into_iter().for_each(|bench| bench());
}

/// A child that ends with the bench.
struct Process(Child, BufReader<ChildStdout>);

impl Process {
    fn start(program: &std::path::Path, words: &str) -> Self {
        let mut child = Command::new(program)
            .args(words.split(' '))
            .env("SUPERTWIN_CONFIG", concat!(env!("CARGO_MANIFEST_DIR"), "/../../config"))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{}: {error}; run cargo build --release first", program.display()));
        let stdout = BufReader::new(child.stdout.take().unwrap());
        Self(child, stdout)
    }

    fn supertwin(words: &str) -> Self {
        let here = std::env::current_exe().unwrap();
        Self::start(&here.parent().unwrap().parent().unwrap().join("supertwin"), words)
    }

    fn line(&mut self) -> Value {
        let mut line = String::new();
        self.1.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line:?}"))
    }

    /// Processor time used so far, in seconds.
    fn cpu_s(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.0.id())).unwrap();
        let fields: Vec<&str> = stat.rsplit_once(") ").unwrap().1.split(' ').collect();
        (fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap()) / 100.0
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn router() -> (Process, String) {
    let mut router = Process::supertwin("serve router --listen tcp/127.0.0.1:0 --json");
    let endpoint = router.line()["listening"][0].as_str().unwrap().to_owned();
    (router, endpoint)
}

fn client(endpoint: &str) -> zenoh::Session {
    let link = Link { mode: Some("client"), connect: vec![endpoint.to_owned()], patience_ms: 5000, ..Link::default() };
    link.open().unwrap()
}

/// One process of the plain ring. The plant prints its laps per second, or the quantiles of its latency.
fn participant(name: &str, endpoint: &str, laps: u64, pace_hz: f64) {
    let session = client(endpoint);
    let clock = SystemClock::start();
    let inputs: Vec<_> = WIRES
        .iter()
        .filter(|(_, _, who)| who.contains(&name))
        .map(|(wire, _, _)| session.declare_subscriber(format!("raw/{wire}")).wait().unwrap())
        .collect();
    let (wire, size, waiting) =
        WIRES[["plant", "estimator", "guidance", "controller"].iter().position(|service| *service == name).unwrap()];
    let publisher = session
        .declare_publisher(format!("raw/{wire}"))
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::InteractiveHigh)
        .express(true)
        .wait()
        .unwrap();
    let listener = publisher.matching_listener().wait().unwrap();
    if !publisher.matching_status().wait().unwrap().matching() {
        while !listener.recv().unwrap().matching() {}
    }
    assert!(!waiting.is_empty());
    // Everybody says that it is there; who is not waited for by the plant would miss the first lap.
    let _token = session.liveliness().declare_token(format!("raw/alive/{name}")).wait().unwrap();
    if name == "plant" {
        while session.liveliness().get("raw/alive/*").wait().unwrap().into_iter().count() < 4 {}
    }
    let mut payload = vec![b'x'; size];
    let number = |bytes: &[u8]| u64::from_le_bytes(bytes[..8].try_into().unwrap());
    let mut latencies = Vec::new();
    let began = clock.now();
    let mut sent = began;
    for lap in 0..laps {
        for input in &inputs {
            let delayed = name == "plant" || input.key_expr().as_str().ends_with("thrust");
            let Some(wanted) = lap.checked_sub(u64::from(delayed)) else { continue };
            while number(&input.recv().unwrap().payload().to_bytes()) != wanted {}
        }
        if name == "plant" {
            if lap > 0 {
                latencies.push(clock.now().saturating_sub(sent).as_secs_f64() * 1e6);
            }
            if pace_hz > 0.0 {
                let due = began + Duration::from_secs_f64(lap as f64 / pace_hz);
                while clock.now() < due {
                    std::thread::park_timeout(due.saturating_sub(clock.now()));
                }
            }
        }
        payload[..8].copy_from_slice(&lap.to_le_bytes());
        publisher.put(payload.clone()).wait().unwrap();
        sent = clock.now();
    }
    if name == "plant" {
        let wall_s = clock.now().saturating_sub(began).as_secs_f64();
        latencies.sort_by(f64::total_cmp);
        let quantile = |q: f64| latencies[(q * (latencies.len() - 1) as f64) as usize];
        let [p50, p99] = [0.5, 0.99].map(quantile);
        println!("{}", serde_json::json!({ "laps_per_s": laps as f64 / wall_s, "p50_us": p50, "p99_us": p99 }));
    } else {
        // The last output still has to be sent.
        let _ = publisher.matching_status().wait();
    }
    session.close().wait().unwrap();
}

/// One run of the plain ring.
fn plain(endpoint: &str, laps: u64, pace_hz: f64) -> Value {
    let here = std::env::current_exe().unwrap();
    let start = |name: &str| Process::start(&here, &format!("participant {name} {endpoint} {laps} {pace_hz}"));
    let _others = ["controller", "guidance", "estimator"].map(start);
    start("plant").line()
}

/// One run of ours in lock step; telemetry off.
fn ours(endpoint: &str, duration_s: f64) -> f64 {
    let words = format!("--pace lockstep --telemetry-every 0 --json --connect {endpoint} --duration {duration_s}");
    let start = |service: &str| {
        let mut process = Process::supertwin(&format!("serve {service} {words}"));
        process.line();
        process
    };
    let _others = ["controller", "guidance", "estimator"].map(start);
    start("plant").line()["laps_per_s"].as_f64().unwrap()
}

fn lock_step() {
    println!("lock step, four processes through a router by TCP on loopback, telemetry off");
    let (_router, endpoint) = router();
    let mut ratios = Vec::new();
    for _ in 0..5 {
        let plain = plain(&endpoint, 3000, 0.0)["laps_per_s"].as_f64().unwrap();
        let ours = ours(&endpoint, 60.0);
        ratios.push(ours / plain);
        println!("  plain Zenoh {plain:.0} laps/s, supertwin {ours:.0} laps/s, ratio {:.2}", ours / plain);
    }
    ratios.sort_by(f64::total_cmp);
    println!("  median ratio {:.2} (asked: 0.8)", ratios[ratios.len() / 2]);
}

fn real_time() {
    println!("real time at 50 Hz, from measurements to the thrust they led to, microseconds");
    let (_router, endpoint) = router();
    let plain = plain(&endpoint, 1000, 50.0);
    let [p50, p99] = ["p50_us", "p99_us"].map(|quantile| plain[quantile].as_f64().unwrap());
    println!("  plain Zenoh   p50 {p50:.0}  p99 {p99:.0}");
    for (every, telemetry) in TELEMETRY {
        let session = client(&endpoint);
        let health = session.declare_subscriber("supertwin/bench/health/plant").wait().unwrap();
        let words = format!("--vehicle bench --json --telemetry-every {every} --duration 15 --connect {endpoint}");
        let start = |service: &str| Process::supertwin(&format!("serve {service} {words}"));
        let _services = ["controller", "guidance", "estimator", "plant"].map(start);
        let mut last = Value::Null;
        while let Ok(Some(sample)) = health.recv_timeout(Duration::from_secs(4)) {
            last = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
        }
        let [p50, p99] = [0, 1].map(|i| last["loop_us"][i].as_f64().unwrap());
        println!(
            "  supertwin     p50 {p50:.0}  p99 {p99:.0}  {telemetry}, {} deadline misses",
            last["deadline_misses"]
        );
    }
}

fn up() {
    println!("one process in lock step, router inside");
    for (every, telemetry) in TELEMETRY {
        let [a, b, c] = [(); 3].map(|()| {
            let folder = tempfile::tempdir().unwrap();
            let listen = format!("unixsock-stream/{}/r.sock", folder.path().display());
            let words = format!("up --pace lockstep --json --listen {listen} --telemetry-every {every} --duration 600");
            let mut process = Process::supertwin(&words);
            process.line();
            process.line()["laps_per_s"].as_f64().unwrap()
        });
        println!("  {telemetry}: {a:.0} {b:.0} {c:.0} laps/s (asked: 20,000 with telemetry off)");
    }
}

fn fleet() {
    println!("vehicles at 50 Hz on one router, one process each, telemetry on; ten seconds");
    for count in [1, 5, 10, 20] {
        let (router, endpoint) = router();
        let session = client(&endpoint);
        let health = session.declare_subscriber("supertwin/*/health/plant").wait().unwrap();
        let start = |i| Process::supertwin(&format!("up --json --vehicle v{i} --connect {endpoint}"));
        let mut vehicles: Vec<Process> = (0..count).map(start).collect();
        vehicles.iter_mut().for_each(|vehicle| drop(vehicle.line()));
        let cpu = |vehicles: &[Process]| -> f64 { vehicles.iter().map(Process::cpu_s).sum() };
        let clock = SystemClock::start();
        // The first two seconds are start-up.
        let listen = |for_s: u64| {
            let end = clock.now() + Duration::from_secs(for_s);
            let (mut p99, mut misses) = (0.0_f64, 0);
            while let Ok(Some(sample)) = health.recv_timeout(end.saturating_sub(clock.now())) {
                let value: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
                p99 = p99.max(value["loop_us"][1].as_f64().unwrap());
                misses = misses.max(value["deadline_misses"].as_u64().unwrap());
            }
            (p99, misses)
        };
        let (_, misses_before) = listen(2);
        let (before, router_before, began) = (cpu(&vehicles), router.cpu_s(), clock.now());
        let (p99, misses) = listen(10);
        let wall_s = clock.now().saturating_sub(began).as_secs_f64();
        println!(
            "  {count:2}: {:.0} % of a core for the vehicles, {:.0} % for the router, worst p99 of a lap {:.1} ms, \
             worst deadline misses {}",
            100.0 * (cpu(&vehicles) - before) / wall_s,
            100.0 * (router.cpu_s() - router_before) / wall_s,
            p99 / 1e3,
            misses - misses_before.min(misses)
        );
    }
}
