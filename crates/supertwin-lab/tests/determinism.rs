//! T12: the same trial and seed give the same bits, whoever listens and however the program was built.

mod common;

use common::kept::keep;
use common::{fly, load, outcome};
use supertwin_core::digest::{DigestProbe, RunDigest};
use supertwin_core::{Property, signal};
use supertwin_lab::{Library, trial};

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
    let (kept, heard) = keep(&trial, 1);
    let silent = outcome(&trial, 1);
    assert_eq!((heard.digest, heard.scores), (silent.digest, silent.scores));
    let sway = kept.signal(&signal::tracking::SWAY).expect("is shown");
    assert_eq!(sway.tick.len() as u64, trial.ticks(), "a row per tick");
    assert_eq!(kept.properties["result"]["hash"], silent.digest.to_string().into());
}

#[test]
fn the_run_hash_follows_from_the_block_hashes_tick_by_tick() {
    let trial = load("paper-gsta", &["trial.duration_s=29.5"]);
    let (mut probe, mut ours) = (DigestProbe::default(), RunDigest::default());
    fly(&trial, trial.ticks(), |tick, twin| {
        twin.digest(tick, &mut probe).expect("finite");
        ours.fold(tick, twin.digests);
        assert_eq!(ours, twin.run_digest);
    });
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
    let (kept, first) = keep(&trial, 7);
    let Property::Text(config) = &kept.properties["run"]["config"] else { panic!("text") };
    let Property::Integer(seed) = kept.properties["run"]["seed"] else { panic!("number") };
    // Written to a folder as eight files, the recorded configuration is a trial again.
    let folder = tempfile::tempdir().expect("a folder");
    let whole: toml::Table = config.parse().expect("TOML");
    let places = [
        ("trial", "trials", &trial.name),
        ("vehicle", "vehicles", &trial.trial.vehicle),
        ("environment", "environments", &trial.trial.environment),
        ("sensors", "sensors", &trial.trial.sensors),
        ("estimator", "estimators", &trial.trial.estimator),
        ("guidance", "guidance", &trial.trial.guidance),
        ("safety", "safety", &trial.trial.safety),
        ("controller", "controllers", &trial.controller_name),
    ];
    for (section, place, name) in places {
        std::fs::create_dir_all(folder.path().join(place)).expect("a folder");
        let path = folder.path().join(place).join(format!("{name}.toml"));
        std::fs::write(path, toml::to_string(&whole[section]).expect("TOML")).expect("written");
    }
    let again = trial::load(&Library::new(folder.path(), Vec::new()), &trial.name).expect("legal").remove(0);
    assert_eq!(outcome(&again, seed).digest, first.digest);
}
