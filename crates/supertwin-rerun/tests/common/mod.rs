//! A run that looks like a real one, made up from a few sines, and what is done with recordings of it.
#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use crate::python;
use std::path::{Path, PathBuf};
use std::process::Command;
use supertwin_core::run::{Properties, Scene};
use supertwin_core::signal::measurements::dvl;
use supertwin_core::signal::{controller, nav, reference, thrust, tracking, truth};
use supertwin_core::{Event, EventKind, RunHeader, RunSink, Severity, SinkError, Tick};
use supertwin_rerun::{Options, Recording, RerunSink, read};
use tempfile::TempDir;

/// Length of a tick in the made-up run.
pub(crate) const DT_S: f64 = 0.02;

const RADIUS_M: f64 = 25.0;
const DEPTH_M: f64 = 15.0;

/// A cylinder of net around the origin, with the DVL's four beams 25° off the bow.
pub(crate) fn header(name: &str) -> RunHeader {
    let point = |angle: f64, depth: f64| [RADIUS_M * angle.cos(), RADIUS_M * angle.sin(), depth];
    let turn = std::f64::consts::TAU;
    let rings = (0..=5).map(|i| (0..=72).map(|j| point(turn * f64::from(j) / 72.0, 3.0 * f64::from(i))).collect());
    let ribs = (0..36).map(|j| [0.0, DEPTH_M].map(|depth| point(turn * f64::from(j) / 36.0, depth)).to_vec());
    let (s, c) = (25f64.to_radians().sin() / 2f64.sqrt(), 25f64.to_radians().cos());
    let properties = [("controller", "adaptive".into()), ("seed", u64::MAX.into()), ("dt_s", DT_S.into())];
    RunHeader {
        name: name.to_owned(),
        properties: properties.map(|(name, value)| (name.to_owned(), value)).into(),
        scene: Scene {
            net_lines_m: rings.chain(ribs).collect(),
            body_half_size_m: [0.4, 0.3, 0.2],
            beams: [[c, s, s], [c, s, -s], [c, -s, -s], [c, -s, s]],
            ..Scene::default()
        },
    }
}

/// Shows `ticks` ticks of a vehicle that approaches the net and follows it.
pub(crate) fn play(sink: &mut impl RunSink, ticks: u64) -> Result<(), SinkError> {
    for k in 0..ticks {
        sink.tick(Tick { k, dt_s: DT_S })?;
        let t = k as f64 * DT_S;
        let noise = |i: f64| 0.04 * ((k as f64 * 12.9898 + i * 78.233).sin() * 43758.5453).fract();
        let settle = 1.0 - (-t / 4.0).exp();
        let following = t > 20.0;
        let speed = if following { 0.2 } else { 0.0 };
        let wanted = if following { 1.5 } else { 3.0 };
        let since = if following { 1.0 - (-(t - 20.0) / 3.0).exp() } else { 0.0 };
        let distance = 3.0 - 1.5 * since + 0.05 * (0.9 * t).sin();
        let along = speed * (t - 20.0);
        let angle = along / (RADIUS_M - 1.5) - 0.4;
        let depth = 1.0 + 3.0 * settle + 0.05 * (0.8 * t).sin();
        let radius = RADIUS_M - distance;
        let heading = angle + 0.05 * (0.5 * t).sin();

        sink.vector(&truth::POSE, &[radius * angle.cos(), radius * angle.sin(), depth, heading]);
        if k.is_multiple_of(10) {
            let range = |i: f64| if (k / 10 + i as u64).is_multiple_of(17) { 0.0 } else { distance / 0.906 + noise(i) };
            sink.vector(&dvl::RANGE, &[range(1.0), range(2.0), range(3.0), range(4.0)]);
        }
        sink.vector(&nav::NET, &[distance + noise(1.0), angle + noise(2.0), 1e-4, 1e-4]);
        sink.vector(&nav::HEALTH, &[1.0, f64::from(u8::from((300..330).contains(&k))), 0.0, 0.0, 0.0, 0.0]);
        let mode = if following { "follow_net" } else { "depth_heading_hold" };
        sink.label(&reference::MODE, if t < 2.0 { "neutral" } else { mode });
        let three = |wanted: f64, real: f64, i: f64| [real + noise(i), wanted, real];
        sink.vector(&tracking::DISTANCE, &three(wanted, distance, 3.0));
        sink.vector(&tracking::SPEED, &three(speed, 0.2 * since + 0.02 * t.sin().abs(), 4.0));
        sink.vector(&tracking::SURGE, &three(0.0, 0.3 * since * (1.0 - since) + 0.02 * (0.9 * t).cos(), 5.0));
        sink.vector(&tracking::SWAY, &three(speed, 0.2 * since + 0.02 * t.sin(), 6.0));
        sink.vector(&tracking::DEPTH, &three(4.0, depth, 7.0));
        sink.vector(&tracking::HEADING, &three(angle, heading, 8.0));
        let decay = (-t / 6.0).exp() + 0.5 * since * (1.0 - since);
        let four = |scale: f64, i: f64| {
            [1.0, 0.7, -0.6, 0.3].map(|gain| scale * gain * (decay + 0.1 * (0.7 * t + i + gain).sin()))
        };
        sink.vector(&controller::SIGMA, &four(0.3, 0.0));
        sink.vector(&controller::K1, &[8.0, 7.0, 9.0, 3.0].map(|gain| gain * settle));
        sink.vector(&controller::K2, &[0.8, 0.7, 0.9, 0.3].map(|gain| gain * settle));
        sink.vector(&controller::Z, &four(12.0, 1.0));
        let requested = four(60.0, 2.0);
        sink.vector(&thrust::REQUESTED, &requested);
        sink.vector(&thrust::ALLOCATED, &requested.map(|force| force.clamp(-40.0, 40.0)));
        let forces = [1.0, -1.0, 0.8, -0.8, 0.5, 0.4].map(|gain| gain * requested[0].clamp(-40.0, 40.0) / 2.0);
        sink.vector(&thrust::FORCE, &forces);
        for (tick, service, severity, text) in [
            (100, "guidance", Severity::Info, "depth and heading hold"),
            (300, "estimator", Severity::Warning, "no velocity from the DVL for 0.5 s: dead reckoning"),
            (1000, "guidance", Severity::Info, "follow net at 1.5 m, 0.2 m/s to starboard"),
            (1500, "guidance", Severity::Error, "allocation clipped surge: 63 N requested, 40 N possible"),
        ] {
            if tick == k {
                let what = EventKind::Text { text: text.to_owned() };
                sink.event(&Event { tick, service: service.into(), severity, what })?;
            }
        }
    }
    Ok(())
}

/// Scores, as at the end of a run.
pub(crate) fn results() -> Properties {
    let results = [("rmse_distance_m", 0.0123.into()), ("state_hash", "0123456789abcdef".into())];
    results.map(|(name, value)| (name.to_owned(), value)).into()
}

/// A folder of its own, and a file in it that is not there yet.
pub(crate) fn fresh() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    (folder, path)
}

/// Records so many ticks, and reads what was recorded.
pub(crate) fn record(path: &Path, options: Options, header: &RunHeader, ticks: u64) -> Recording {
    let mut sink = RerunSink::create(path, options).unwrap();
    sink.begin(header).unwrap();
    play(&mut sink, ticks).unwrap();
    sink.finish(&results()).unwrap();
    drop(sink);
    read(path).unwrap()
}

/// Rerun's own opinion of a file.
pub(crate) fn assert_viewer_takes(path: &Path) {
    let viewer = python::viewer(&python::environment());
    let said = python::succeed(Command::new(viewer).args(["rrd", "verify"]).arg(path));
    let said = String::from_utf8_lossy(&[said.stdout, said.stderr].concat()).into_owned();
    assert!(said.contains("1 file"), "{said}");
}
