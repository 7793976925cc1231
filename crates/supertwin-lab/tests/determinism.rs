//! T12: the same trial and seed give the same bits, whoever listens and however the program was built.

mod common;

use common::{Listener, load, outcome};
use supertwin_core::digest::{DigestProbe, RunDigest};
use supertwin_core::run::Properties;
use supertwin_core::{Tick, signal};
use supertwin_lab::mission::Mission;
use supertwin_lab::{Twin, run};

/// Hash of the first 30 s of each paper trial with seed 1. It must not depend on profile, machine or listener;
/// it changes with every deliberate change of the twin, whose commit says so.
const PINNED: [(&str, &str); 3] =
    [("paper-gsta", "80bf9685568a785e"), ("paper-agsta", "82f85d18d66c9c2c"), ("paper-pid", "283b6a8d6a76dbe7")];

const SHORT: &[&str] = &["trial.duration_s=30.0"];

#[test]
fn hashes_are_the_pinned_ones_in_every_profile() {
    for (name, pinned) in PINNED {
        assert_eq!(outcome(&load(name, SHORT), 1).digest.to_string(), pinned, "{name}");
    }
}

#[test]
fn a_run_repeats_and_seeds_differ() {
    let trial = load("paper-agsta", SHORT);
    let first = outcome(&trial, 1);
    assert_eq!(first, outcome(&trial, 1));
    assert_ne!(first.digest, outcome(&trial, 2).digest);
}

#[test]
fn listening_changes_nothing() {
    let trial = load("paper-agsta", SHORT);
    let mut listener = Listener::to(signal::tracking::SWAY.path);
    let heard = run(&trial, 1, &mut listener, Some(&Properties::new()), |_| true).expect("runs");
    let silent = outcome(&trial, 1);
    assert_eq!((heard.digest, heard.scores), (silent.digest, silent.scores));
    assert_eq!(listener.rows.len() as u64, trial.ticks(), "a row per tick");
    let results = listener.results.expect("finished");
    assert_eq!(results["hash"], silent.digest.to_string().into());
}

#[test]
fn the_run_hash_follows_from_the_block_hashes_tick_by_tick() {
    let trial = load("paper-gsta", &["trial.duration_s=29.5"]);
    let mut twin = Twin::new(&trial, 1).expect("legal");
    let mut mission = Mission::new(&trial.trial.mission, 0.02);
    let (mut probe, mut ours) = (DigestProbe::default(), RunDigest::default());
    for k in 0..trial.ticks() {
        let tick = Tick { k, dt_s: 0.02 };
        while let Some(command) = mission.due(tick) {
            twin.command(tick, command).expect("accepted");
        }
        twin.step(tick);
        twin.digest(tick, &mut probe).expect("finite");
        ours.fold(tick, twin.digests);
    }
    assert_eq!(ours, twin.run_digest);
    assert_eq!(ours, outcome(&trial, 1).digest);
}

#[test]
fn one_bit_of_one_parameter_changes_the_hash() {
    let base = outcome(&load("paper-agsta", SHORT), 1);
    let nudged =
        load("paper-agsta", &["trial.duration_s=30.0", "environment.current.speed_m_per_s=0.22000000000000003"]);
    assert_ne!(base.digest, outcome(&nudged, 1).digest);
}

#[test]
fn a_recording_names_everything_that_repeats_the_run() {
    let trial = load("paper-agsta", &["trial.duration_s=18.0", "controller.law.agsta.beta.surge=5.0"]);
    let mut listener = Listener::default();
    let first = run(&trial, 7, &mut listener, Some(&Properties::new()), |_| true).expect("runs");
    let header = listener.header.expect("begun");
    let supertwin_core::Property::Text(config) = &header.properties["config"] else { panic!("text") };
    let supertwin_core::Property::Integer(seed) = header.properties["seed"] else { panic!("number") };
    // Written to a folder as eight files, the recorded configuration is a trial again.
    let folder = tempfile::tempdir().expect("a folder");
    let whole: toml::Table = config.parse().expect("TOML");
    let places = [
        ("trial", "trials", trial.name.as_str()),
        ("vehicle", "vehicles", trial.trial.vehicle.as_str()),
        ("environment", "environments", trial.trial.environment.as_str()),
        ("sensors", "sensors", trial.trial.sensors.as_str()),
        ("estimator", "estimators", trial.trial.estimator.as_str()),
        ("guidance", "guidance", trial.trial.guidance.as_str()),
        ("safety", "safety", trial.trial.safety.as_str()),
        ("controller", "controllers", trial.controller_name.as_str()),
    ];
    for (section, place, name) in places {
        std::fs::create_dir_all(folder.path().join(place)).expect("a folder");
        let path = folder.path().join(place).join(format!("{name}.toml"));
        std::fs::write(path, toml::to_string(&whole[section]).expect("TOML")).expect("written");
    }
    let again = supertwin_lab::trial::load(&supertwin_lab::Library::new(folder.path(), Vec::new()), &trial.name);
    let again = again.expect("legal").remove(0);
    assert_eq!(outcome(&again, seed).digest, first.digest);
}
