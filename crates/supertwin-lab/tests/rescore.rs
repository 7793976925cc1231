//! Scores from what was recorded equal the scores of the run, bit for bit.

use crate::common::kept::{keep, without_rows};
use crate::common::load;
use supertwin_core::source::Label;
use supertwin_core::{Property, Tick, signal};
use supertwin_lab::{ResolvedTrial, Scores, rescore};

/// Every field, as bits: NaN and −0 count as well.
fn bits(scores: &Scores) -> Vec<(String, u64)> {
    let number = |value: &Property| if let Property::Number(x) = value { x.to_bits() } else { panic!("{value:?}") };
    scores.properties().iter().map(|(name, value)| (name.clone(), number(value))).collect()
}

#[test]
fn the_scores_of_every_law_come_back_bit_for_bit() {
    for name in ["paper-gsta", "paper-agsta", "paper-pid"] {
        let (kept, outcome) = keep(&load(name, &[]), 1);
        let again = rescore(&kept).expect(name);
        assert_eq!(bits(&again.scores), bits(&outcome.scores), "{name}");
        assert_eq!(again.scores, outcome.scores, "{name}");
        assert_eq!(again.scores.outside_alpha_tol_share.is_some(), name == "paper-agsta", "{name}");
        assert_eq!(again.missing, 0, "{name}");
        assert!(again.ticks > 1000, "{name}");
    }
}

#[test]
fn a_run_that_changes_its_law_and_its_gains_is_scored_by_what_was_in_force() {
    let mission = "trial.mission=[\
        {at_s=0.0,command.guidance.mode=\"follow_net\"},\
        {at_s=20.0,command.controller.law=\"pid\"},\
        {at_s=22.0,command.controller.law=\"agsta\"},\
        {at_s=24.0,command.controller.parameter={path=\"law.agsta.adaptation.alpha_tol.sway\",value=0.5}}]";
    let overrides = ["trial.standby=[\"pid\"]", "trial.duration_s=28.0", "trial.score.from_s=18.0", mission];
    let (kept, outcome) = keep(&load("paper-agsta", &overrides), 3);
    assert!(outcome.refused.is_empty(), "{:?}", outcome.refused);
    assert_eq!(bits(&rescore(&kept).expect("scores").scores), bits(&outcome.scores));

    // The same from the commands that a run over a network records.
    let trial = load("paper-agsta", &overrides);
    let mut recorded = kept;
    recorded.properties.get_mut("run").expect("properties").insert("placement".to_owned(), "split".into());
    let commands = trial.trial.mission.iter().filter_map(|step| match &step.command {
        supertwin_core::command::Command::Controller(command) => Some(Label {
            tick: Tick::at_or_after(step.at_s.get(), 0.02) as i64,
            time_ns: 0,
            value: serde_json::to_string(command).expect("JSON"),
        }),
        _ => None,
    });
    recorded.commands.insert("controller".to_owned(), commands.collect());
    assert_eq!(bits(&rescore(&recorded).expect("scores").scores), bits(&outcome.scores));
    // And they count: without the last one the tolerance would be another.
    recorded.commands.get_mut("controller").expect("there").pop();
    assert_ne!(rescore(&recorded).expect("scores").scores, outcome.scores);
}

#[test]
fn a_substitute_behind_an_external_controller_is_not_taken_for_the_law() {
    let trial = load("fair", &["trial.controllers=[\"external\"]", "trial.duration_s=30.0"]);
    let (kept, outcome) = keep(&trial, 1);
    assert_eq!(kept.labels[signal::controller::LAW.path][0].value, "external");
    assert_eq!(bits(&rescore(&kept).expect("scores").scores), bits(&outcome.scores));
}

#[test]
fn what_is_missing_is_left_out_and_counted() {
    let trial = load("paper-agsta", &["trial.duration_s=30.0"]);
    let (mut kept, outcome) = keep(&trial, 1);
    let whole = rescore(&kept).expect("scores");
    let gone = |tick: i64| (1000..1010).contains(&tick) || tick % 100 == 0;
    let nav = without_rows(&kept.signals[signal::nav::POSE.path], gone);
    kept.signals.insert(signal::nav::POSE.path.to_owned(), nav);
    let some = rescore(&kept).expect("scores");
    let from = trial.score_from_tick() as i64;
    let expected = (from..1500).filter(|tick| gone(*tick)).count() as u64;
    assert!(expected >= 10);
    assert_eq!((some.missing, some.ticks), (expected, whole.ticks - expected));
    let (a, b) = (some.scores.measured.to_array(), outcome.scores.measured.to_array());
    assert!(a != b && a.iter().zip(&b).all(|(a, b)| (a / b - 1.0).abs() < 0.1), "{a:?} {b:?}");
}

#[test]
fn what_can_not_be_scored_says_why() {
    let (kept, _) = keep(&load("paper-pid", &["trial.duration_s=25.0"]), 1);
    let mut real = kept.clone();
    real.signals.remove(signal::truth::POSE.path);
    let error = rescore(&real).expect_err("a real vehicle has no truth").to_string();
    let path = signal::truth::POSE.path;
    assert_eq!(error, format!("paper-pid-seed1: {path} was not recorded: scores need it"));
    let mut bare = kept.clone();
    bare.properties.clear();
    let error = rescore(&bare).expect_err("no properties").to_string();
    assert!(error.contains("property tick_s is not there or not a number"), "{error}");
    let mut edited = kept;
    let run = edited.properties.get_mut("run").expect("properties");
    run.insert("config".to_owned(), "[trial]\ndescription = 3\n".into());
    let error = rescore(&edited).expect_err("no trial").to_string();
    assert!(error.starts_with("paper-pid-seed1: property config:2:15: trial.description: invalid type"), "{error}");
}

#[test]
fn a_recording_is_a_trial_again() {
    for name in ["paper-agsta", "hand-over", "fair"] {
        let trial = load(name, &["trial.duration_s=25.0"]);
        let (kept, outcome) = keep(&trial, 7);
        let again = ResolvedTrial::from_properties(&kept.properties["run"], "a recording").expect("legal");
        let identity = |trial: &ResolvedTrial| (trial.name.clone(), trial.controller_name.clone(), trial.text.clone());
        assert_eq!(identity(&again), identity(&trial));
        let Property::Integer(seed) = kept.properties["run"]["seed"] else { panic!("a number") };
        let (repeated, same) = keep(&again, seed);
        assert_eq!(same.digest, outcome.digest, "{name}");
        assert_eq!(repeated.properties, kept.properties, "{name}");
    }
}
