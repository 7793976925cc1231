//! The dashboards show what recordings contain, and every curve can be seen in the real viewer.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod command;
mod comparison;

use crate::support::{CONFIG, python};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use supertwin_core::block::SERVICES;
use supertwin_core::message::{Message, Nav, Thrust};
use supertwin_core::run::{Properties, Scene, ThrusterPlace};
use supertwin_core::signal::link::{self, Account};
use supertwin_core::signal::{
    controller, estimator, guidance, measurements, nav, plant, reference, thrust, truth, wrench_request,
};
use supertwin_core::{Capability, Observe, Probe, RunHeader, RunSink, Signal, Tick};
use supertwin_lab::{LAWS, Library, trial};
use supertwin_rerun::blueprint::{self, About, DASHBOARDS, Dashboard, View};
use supertwin_rerun::{Options, Recording, RerunSink, read, signals, style};

/// Signals that no dashboard shows, and why.
static NOT_SHOWN: [(&str, &[&Signal]); 25] = [
    ("is `measured` in tracking/*", &[&nav::POSE, &nav::VELOCITY, &nav::NET]),
    ("is `reference` in tracking/*", &[&reference::VELOCITY, &reference::DEPTH]),
    ("is `reference` in tracking/*", &[&reference::HEADING, &reference::SETPOINT]),
    ("is `true` in tracking/*, and moves the vehicle in the picture", &[&truth::POSE]),
    ("is `true` in tracking/*", &[&truth::VELOCITY, &truth::NET]),
    ("is an arrow in the picture", &[&truth::CURRENT]),
    ("is the current, an arrow in the picture, and the waves", &[&truth::WATER_VELOCITY]),
    ("is the reference before its filter", &[&guidance::LINE_OF_SIGHT, &guidance::TARGET]),
    ("is in derived/innovation and derived/nis", &[&estimator::INNOVATION_DVL, &estimator::INNOVATION_DEPTH]),
    ("is in derived/innovation and derived/nis", &[&estimator::INNOVATION_HEADING, &estimator::INNOVATION_YAW_RATE]),
    ("is the square of derived/std", &[&nav::VARIANCE]),
    ("is in derived/health", &[&nav::HEALTH]),
    ("is in derived/refused", &[&estimator::COUNTERS]),
    ("is in derived/neutral and derived/pings_lost", &[&plant::HEALTH]),
    ("colours the beams in the picture, and is in derived/beams_used", &[&estimator::NET_PLANE_ACCEPTED]),
    ("is in derived/limited and derived/neutral", &[&thrust::LIMITED, &thrust::EMERGENCY_NEUTRAL]),
    ("is a function of sigma", &[&controller::PHI1, &controller::PHI2]),
    // What goes into a signal that is shown.
    ("is the estimate plus the innovation", &[&measurements::dvl::VELOCITY, &measurements::depth::DEPTH]),
    ("is the estimate plus the innovation", &[&measurements::compass::HEADING, &measurements::gyro::YAW_RATE]),
    ("is the time of the reading; the latency is not estimated", &TAKEN_AT),
    ("is what the filter's model makes of the wrench", &[&nav::ACCELERATION]),
    ("is `measured` in tracking/distance", &[&estimator::NET_PLANE_FIT, &estimator::NET_PLANE_STATE]),
    ("is measured minus reference in tracking/*", &[&controller::ERROR, &controller::VELOCITY_ERROR]),
    ("only goes into sigma of the literal surface", &[&controller::ACCELERATION_ERROR]),
    ("is sigma minus the error", &[&controller::SURFACE_ACCELERATION]),
];

static TAKEN_AT: [&Signal; 4] = {
    use measurements::{compass, depth, dvl, gyro};
    [&dvl::TAKEN_AT, &depth::TAKEN_AT, &compass::TAKEN_AT, &gyro::TAKEN_AT]
};

/// Trials that between them have every law and both net planes.
const TRIALS: [&str; 6] = ["paper-gsta", "paper-agsta", "paper-pid", "plane-filter", "hand-over", "external"];

fn folder() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("dashboards");
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// Recordings of the trials, made once.
static RECORDINGS: LazyLock<BTreeMap<&str, (PathBuf, Recording)>> = LazyLock::new(|| {
    let library = Library::new(CONFIG, Vec::new());
    let made = |name: &'static str| {
        let path = record(&library, name, None, name);
        let recording = read(&path).unwrap();
        (name, (path, recording))
    };
    TRIALS.map(made).into()
});

/// Records a trial with a seed, or its own, into a file of this name.
fn record(library: &Library, trial: &str, seed: Option<u64>, name: &str) -> PathBuf {
    let trial = &trial::load(library, trial).unwrap()[0];
    let path = folder().join(format!("{name}.rrd"));
    let mut sink = RerunSink::create(&path, overwrite()).unwrap();
    let seed = seed.unwrap_or(trial.trial.seed);
    supertwin_lab::run(trial, seed, &mut sink, Some(&Properties::new()), |_| true).unwrap();
    path
}

fn overwrite() -> Options {
    Options { overwrite: true, ..Options::default() }
}

fn about(recording: &Recording) -> About {
    let thrusters = recording.signal(&thrust::FORCE).map_or(0, |force| force.width);
    let scene = Scene { thrusters: vec![ThrusterPlace::default(); thrusters], ..Scene::default() };
    About::run(&RunHeader { properties: recording.properties["run"].clone(), scene, ..RunHeader::default() })
}

/// The accounts of the services and of the recorder.
static LINK_SIGNALS: LazyLock<Vec<&Signal>> = LazyLock::new(|| {
    const WIRES: &[&str] = &[Nav::KEY, Thrust::KEY];
    use link::{AGE, DEADLINE, MISSING, RATE, REFUSED, STEP_TIME, TRANSPORT};
    let one = |account: &Account, service: &str| -> &'static Signal {
        let per_wire = [&AGE, &TRANSPORT, &MISSING].map(|account| account.name);
        let components = if per_wire.contains(&account.name) { WIRES } else { account.components };
        let path: &str = Box::leak(account.path(service).into_boxed_str());
        let units = Box::leak(Box::new([account.unit]));
        Box::leak(Box::new(Signal { path, components, units, about: account.about }))
    };
    let of_each = [&STEP_TIME, &RATE, &DEADLINE, &REFUSED, &AGE, &TRANSPORT, &MISSING];
    let all = SERVICES.iter().flat_map(|service| of_each.map(|account| one(account, service)));
    all.chain([one(&link::LOOP_TIME, SERVICES[0]), &link::GAPS, &link::LAG]).collect()
});

/// What the network adds to a recording, once a second, with numbers that are told apart in a picture.
struct Network;

impl Observe for Network {
    fn observe<P: Probe>(&self, probe: &mut P) {
        for signal in LINK_SIGNALS.iter() {
            probe.vector(signal, &(0..signal.width()).map(|i| 10.0 + 5.0 * i as f64).collect::<Vec<_>>());
        }
    }
}

/// Made once: tests that write one file at a time each would destroy it for the others.
static NETWORK_RECORDING: LazyLock<(PathBuf, Recording)> = LazyLock::new(|| {
    let path = folder().join("network.rrd");
    let mut sink = RerunSink::create(&path, overwrite()).unwrap();
    let properties = Properties::from([
        ("placement".to_owned(), "up".into()),
        ("capabilities".to_owned(), "sliding_variable gains adaptive_gains".into()),
        ("duration_s".to_owned(), 60.0.into()),
    ]);
    sink.begin(&RunHeader { name: "network".to_owned(), properties, scene: Scene::default() }).unwrap();
    for k in 0..3000 {
        sink.tick(Tick { k, dt_s: 0.02 }).unwrap();
        if k % 50 == 0 {
            Network.observe(&mut sink);
        }
    }
    sink.finish(&Properties::new()).unwrap();
    let recording = read(&path).unwrap();
    (path, recording)
});

/// Paths below `entity`, when it ends in `/**`, or itself.
fn matches(entity: &str, path: &str) -> bool {
    let entity = entity.trim_start_matches('/');
    match entity.strip_suffix("/**") {
        Some(below) => path.starts_with(&format!("{below}/")),
        None => path == entity,
    }
}

#[test]
fn every_view_finds_what_it_names_in_a_recording_of_its_kind() {
    for (name, (_, recording)) in RECORDINGS.iter() {
        for view in Dashboard::all(&about(recording)).views() {
            for entity in &view.entities {
                assert!(recording.rows.keys().any(|path| matches(entity, path)), "{name}: {}: {entity}", view.name);
            }
            for curves in &view.curves {
                let Some((component, width)) = curves.only else { continue };
                let columns = &recording.signals[curves.entity.trim_start_matches('/')];
                assert!(component < width && width == columns.width, "{name}: {}: {}", view.name, curves.entity);
            }
        }
    }
    let (_, recording) = &*NETWORK_RECORDING;
    for view in Dashboard::named("link", &about(recording)).unwrap().views() {
        for entity in &view.entities {
            assert!(recording.rows.contains_key(entity.trim_start_matches('/')), "{}: {entity}", view.name);
        }
    }
}

#[test]
fn every_signal_is_in_a_dashboard_or_has_a_reason_not_to_be() {
    let reasons: BTreeSet<&str> =
        NOT_SHOWN.iter().flat_map(|(_, signals)| *signals).map(|signal| signal.path).collect();
    let mut needed = BTreeSet::new();
    let all = RECORDINGS.iter().map(|(name, made)| (*name, made)).chain([("network", &*NETWORK_RECORDING)]);
    for (name, (_, recording)) in all {
        let dashboard = Dashboard::all(&about(recording));
        for path in recording.signals.keys().chain(recording.labels.keys()) {
            if !dashboard.views().iter().any(|view| view.entities.iter().any(|entity| matches(entity, path))) {
                assert!(reasons.contains(path.as_str()), "{name}: {path} is shown nowhere");
                needed.insert(path.clone());
            }
        }
    }
    for path in reasons {
        assert!(needed.contains(path), "{path} needs no reason: it is shown, or no longer recorded");
    }
}

#[test]
fn only_recordings_over_the_network_have_a_tab_for_it() {
    let has_link = |about: &About| Dashboard::all(about).views().iter().any(|view| view.name.starts_with("Rate"));
    assert!(!has_link(&about(&RECORDINGS["paper-pid"].1)));
    assert!(has_link(&about(&NETWORK_RECORDING.1)));
}

#[test]
fn a_law_has_the_plots_that_it_can_fill() {
    let titles = |law: &str| {
        let (_, capabilities) = LAWS.iter().find(|(name, _)| *name == law).unwrap();
        let about = About { capabilities: capabilities.to_vec(), ..About::default() };
        let dashboard = Dashboard::named("adaptation", &about).unwrap();
        dashboard.views().iter().map(|view| view.name.clone()).collect::<Vec<_>>().join("; ")
    };
    assert!(titles("agsta").contains("α_tol") && !titles("agsta").contains("Error integral"));
    assert!(titles("gsta").contains("k1, constant") && !titles("gsta").contains("α_tol"));
    assert!(titles("pid").contains("Error integral") && !titles("pid").contains('σ'));
    // Unknown: all of it.
    assert!(titles("external").contains("α_tol") && titles("external").contains("Error integral"));
    // Only a network has external controllers.
    assert!(!titles("external").contains("External"));
    let capabilities = vec![Capability::External, Capability::Integral];
    let about = About { capabilities, network: true, ..About::default() };
    let dashboard = Dashboard::named("adaptation", &about).unwrap();
    let paths: Vec<&str> = dashboard.views().iter().flat_map(|view| &view.entities).map(String::as_str).collect();
    let shows = |signal: &Signal| paths.iter().any(|path| matches(path, signal.path));
    assert!(shows(&wrench_request::WRENCH_REQUEST) && shows(&signals::EXTERNAL_SURGE));
}

/// One curve that a plot must show.
struct Curve<'a> {
    color: [u8; 3],
    values: Vec<f64>,
    name: &'a str,
}

fn curves<'a>(recording: &'a Recording, view: &View) -> Vec<Curve<'a>> {
    let mut all = Vec::new();
    for curves in &view.curves {
        let path = curves.entity.trim_start_matches('/');
        let Some(columns) = recording.signals.get(path) else { continue };
        for (i, name) in columns.names.iter().enumerate() {
            if curves.only.is_some_and(|(component, _)| component != i) {
                continue;
            }
            let name = name.split(" [").next().unwrap_or_default();
            let [r, g, b, _] = curves.color.unwrap_or_else(|| style::color(path, name, i)).to_be_bytes();
            let values = columns.values.iter().skip(i).step_by(columns.width).copied().collect();
            all.push(Curve { color: [r, g, b], values, name });
        }
    }
    all
}

/// One of two curves that are the same nearly everywhere, as far as a picture can tell, hides the other.
fn hides(one: &Curve<'_>, other: &Curve<'_>, range: f64) -> bool {
    // Signals of different rates are compared at the same share of the run.
    let at = |curve: &Curve<'_>, i: usize| curve.values[i * (curve.values.len() - 1) / 200];
    let same = |i: &usize| (at(one, *i) - at(other, *i)).abs() <= 0.03 * range;
    (0..=200).filter(same).count() > 180
}

/// A colour that nothing has: the look for curves must not find it.
const NO_CURVE: [u8; 3] = [255, 0, 255];

/// Pixels of each curve, by the plot's identifier.
type Counts = BTreeMap<String, Vec<u64>>;

/// Draws what `jobs` say of a recording, and cuts the viewer's own bar off the pictures in `crop`.
fn draw(name: &str, recording: &Path, jobs: &[Value], crop: &[&str]) -> Counts {
    let environment = python::environment();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/support/pictures.py");
    let mut command = Command::new(environment.join("bin/python"));
    command.arg(script).arg(python::viewer(&environment)).args([recording, &folder()]).arg(name).args(crop);
    let mut running = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    serde_json::to_writer(running.stdin.take().unwrap(), jobs).unwrap();
    let output = running.wait_with_output().unwrap();
    assert!(output.status.success(), "{command:?}");
    let counts: BTreeMap<String, Counts> = serde_json::from_slice(&output.stdout).unwrap();
    counts.into_values().flatten().collect()
}

/// What the script needs to know to draw a dashboard, and the plots that it will look at.
fn job(name: &str, mut dashboard: Dashboard, colors: impl Fn(&View) -> Vec<[u8; 3]>) -> (Value, Vec<View>) {
    dashboard.mark_plots();
    let has_curves = |view: &&View| !view.curves.is_empty() && !view.behind;
    let plots: Vec<View> = dashboard.views().iter().filter(has_curves).cloned().collect();
    assert!(!plots.is_empty(), "{name}");
    let plot = |view: &View| {
        let colors = [colors(view), vec![NO_CURVE]].concat();
        json!({ "id": view.id, "mark": view.mark, "share": view.share, "colors": colors })
    };
    let looked_at: Vec<_> = plots.iter().map(plot).collect();
    (json!({ "name": name, "file": save(name, dashboard), "plots": looked_at }), plots)
}

fn save(name: &str, dashboard: Dashboard) -> PathBuf {
    let file = folder().join(format!("{name}.rbl"));
    fs::write(&file, blueprint::file(dashboard).unwrap()).unwrap();
    file
}

/// Fewer pixels than these are no curve.
const LEAST: u64 = 40;

/// Curves of a plot that can't be seen.
fn unseen(view: &View, recording: &Recording, pixels: &[u64]) -> Vec<String> {
    let curves = curves(recording, view);
    let all = || curves.iter().flat_map(|curve| curve.values.iter().copied());
    let range = all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min);
    let seen = |i: usize| {
        let same = |j: usize| pixels[j] >= LEAST && hides(&curves[i], &curves[j], range);
        (0..curves.len()).any(same)
    };
    (0..curves.len()).filter(|&i| !seen(i)).map(|i| format!("{} ({} pixels)", curves[i].name, pixels[i])).collect()
}

#[test]
fn every_curve_of_every_plot_can_be_seen() {
    let laws = ["paper-gsta", "paper-agsta", "paper-pid"];
    let recorded = laws.iter().map(|name| (*name, &RECORDINGS[name]));
    let mut wrong = Vec::new();
    for (name, (path, recording)) in recorded.chain([("network", &*NETWORK_RECORDING)]) {
        let about = about(recording);
        // What the network adds stands in a recording of its own.
        let jobs = DASHBOARDS.iter().filter(|described| (described.name == "link") == about.network);
        let colors = |view: &View| curves(recording, view).iter().map(|curve| curve.color).collect();
        let jobs = jobs.filter_map(|described| {
            Some(job(&format!("{name}-{}", described.name), described.dashboard(&about)?, colors))
        });
        let (jobs, plots): (Vec<Value>, Vec<Vec<View>>) = jobs.unzip();
        if !*python::CAN_DRAW {
            continue;
        }
        let counts = draw(name, path, &jobs, &[]);
        for view in plots.iter().flatten() {
            let title = &view.name;
            let (none, of_curves) = counts[&view.id].split_last().unwrap();
            if of_curves.is_empty() || *none >= LEAST {
                wrong.push(format!("{name}: {title}: {} curves, {none} pixels of none", of_curves.len()));
            }
            let unseen = unseen(view, recording, of_curves);
            if !unseen.is_empty() {
                wrong.push(format!("{name}: {title}: can't be seen: {}", unseen.join(", ")));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Leaves `overview.png` and `tracking.png` as they stand in the README.
#[test]
fn the_pictures_of_the_readme_can_be_made() {
    let (path, recording) = &RECORDINGS["paper-agsta"];
    let tracking = Dashboard::named("tracking", &about(recording)).unwrap();
    let job = json!({ "name": "tracking", "file": save("tracking", tracking), "plots": [] });
    if *python::CAN_DRAW {
        draw("overview", path, &[job], &["overview", "tracking"]);
    }
    for picture in ["overview.png", "tracking.png"] {
        let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../dashboards").join(picture);
        let bytes = fs::metadata(&kept).unwrap().len();
        assert!((10_000..400_000).contains(&bytes), "{}: {bytes} bytes", kept.display());
    }
}
