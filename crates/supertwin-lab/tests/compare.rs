//! Metrics of runs beside each other: the same bits as the run's own scores, alignment with known offsets, resampling,
//! and what is wrong with a recording.

use crate::common::kept::keep;
use crate::common::load;
use std::collections::BTreeMap;
use supertwin_core::{Property, RecordedRun, signal};
use supertwin_lab::align::{Alignment, Grid, Window};
use supertwin_lab::metrics::{Evaluated, MetricsError, Selection, all_metrics, evaluate};

fn all() -> Selection {
    Selection::parse(["all"]).expect("is known")
}

/// The trial's own window from the start.
fn own(kept: &RecordedRun) -> Grid {
    let number = |name: &str| match kept.properties["run"][name] {
        Property::Number(number) => number,
        ref other => panic!("{name} = {other:?}"),
    };
    let window = Window { from_s: number("score_from_s"), to_s: number("duration_s") };
    Grid::new(0, number("tick_s"), window, number("tick_s"))
}

fn around(kept: &RecordedRun, align: &Alignment, window: Window) -> Evaluated {
    let origin = align.find(kept).expect("is found");
    evaluate(kept, &Grid::new(origin, 0.02, window, 0.02), &all()).expect("is evaluated")
}

fn bits(values: &BTreeMap<String, f64>) -> Vec<(&str, u64)> {
    values.iter().map(|(name, value)| (name.as_str(), value.to_bits())).collect()
}

/// The same run as if it had begun `later` ticks earlier than its clock says.
fn shifted(kept: &RecordedRun, later: i64) -> RecordedRun {
    let mut moved = kept.clone();
    for columns in moved.signals.values_mut() {
        columns.tick.iter_mut().for_each(|tick| *tick += later);
    }
    moved.labels.values_mut().flatten().for_each(|label| label.tick += later);
    moved.events.iter_mut().for_each(|event| event.tick += later as u64);
    moved
}

#[test]
fn metrics_of_a_run_over_its_own_window_are_its_scores_bit_for_bit() {
    for name in ["paper-gsta", "paper-agsta", "paper-pid"] {
        let (kept, outcome) = keep(&load(name, &["trial.duration_s=60.0"]), 2);
        let found = evaluate(&kept, &own(&kept), &all()).expect("is evaluated");
        let moments = load(name, &[]).score_from_tick().abs_diff(3000);
        assert_eq!((found.moments, found.missing, found.coverage()), (moments, 0, 1.0));
        for (score, value) in outcome.scores.properties() {
            let Property::Number(value) = value else { panic!("{score}: {value:?}") };
            let none = score == "window_s" || (name == "paper-pid" && score.starts_with("k1_"));
            let again = found.values.get(&score).map(|value| value.to_bits());
            assert_eq!(again, (!none).then_some(value.to_bits()), "{name} {score}");
        }
        let usual = evaluate(&kept, &own(&kept), &Selection::default()).expect("is evaluated").values;
        assert!(usual.len() < found.values.len() && usual.iter().all(|(name, value)| found.values[name] == *value));
    }
}

#[test]
fn every_metric_of_a_batch_run_has_a_value_and_the_sizes_make_sense() {
    let mission = "trial.mission=[\
        {at_s=0.0,command.guidance.mode=\"depth_heading_hold\"},{at_s=1.0,command.guidance.depth_m=4.5},\
        {at_s=12.0,command.guidance.heading_rad=1.0},{at_s=30.0,command.guidance.mode=\"follow_net\"},\
        {at_s=45.0,command.guidance.net_distance_m=3.5}]";
    let trial = load("paper-agsta", &[mission, "trial.duration_s=70.0", "trial.score.from_s=0.5"]);
    let (kept, _) = keep(&trial, 1);
    let values = evaluate(&kept, &own(&kept), &all()).expect("is evaluated").values;
    let of_links =
        ["loop_us", "step_us", "transport", "input_age", "messages_lost", "deadlines", "recorder", "unrecorded"];
    for metric in all_metrics() {
        let of_a_link = of_links.iter().any(|prefix| metric.name.starts_with(prefix));
        assert_eq!(values.contains_key(&metric.name), !of_a_link, "{}", metric.name);
    }
    for (name, low, high) in [
        ("measured_settling.depth_s", 2.0, 30.0),
        ("measured_settling.distance_s", 2.0, 30.0),
        ("measured_overshoot.depth_share", 0.0, 0.5),
        ("nis.depth", 0.2, 20.0),
        // The compass is off by a degree and the gyro drifts, of which the filter knows nothing.
        ("nees.heading", 1.0, 200.0),
        ("net_lost_share", 0.0, 0.2),
    ] {
        assert!((low..=high).contains(&values[name]), "{name} = {}", values[name]);
    }
    // Mean absolute is between bias and root mean square.
    let [bias, mae, rms] =
        ["measured_bias", "measured_mae", "measured"].map(|prefix| values[&format!("{prefix}.depth_m")]);
    assert!(bias.abs() <= mae && mae <= rms, "{bias} {mae} {rms}");
}

#[test]
fn an_error_as_large_as_its_doubt_is_consistent() {
    let (mut kept, _) = keep(&load("paper-pid", &["trial.duration_s=25.0"]), 1);
    let truth = kept.signals[signal::truth::POSE.path].clone();
    let pose = kept.signals[signal::nav::POSE.path].clone();
    let variance = kept.signals.get_mut(signal::nav::VARIANCE.path).expect("is recorded");
    for (row, (truth, pose)) in truth.values.chunks_exact(4).zip(pose.values.chunks_exact(2)).enumerate() {
        // A quarter of the squared error: four times too sure.
        variance.values[row * 10] = 0.25 * (pose[0] - truth[2]) * (pose[0] - truth[2]);
    }
    let nis = kept.signals.get_mut(signal::estimator::INNOVATION_DEPTH.path).expect("is recorded");
    nis.values.iter_mut().skip(2).step_by(3).for_each(|square| *square = 2.5);
    let values = evaluate(&kept, &own(&kept), &all()).expect("is evaluated").values;
    assert!((values["nees.depth"] - 4.0).abs() < 1e-9, "{}", values["nees.depth"]);
    assert!((values["nis.depth"] - 2.5).abs() < 1e-12, "{}", values["nis.depth"]);
}

#[test]
fn runs_are_aligned_on_events_at_known_ticks() {
    let mission = "trial.mission=[\
        {at_s=0.0,command.guidance.mode=\"depth_heading_hold\"},{at_s=5.0,command.guidance.mode=\"follow_net\"},\
        {at_s=8.5,command.plant.dvl_silent_for_s=1.0},{at_s=12.34,command.guidance.direction=\"port\"},\
        {at_s=14.0,command.link.withhold={wire=\"nav\",for_s=0.2}}]";
    let (kept, outcome) = keep(&load("paper-gsta", &[mission, "trial.duration_s=25.0", "trial.score.from_s=6.0"]), 1);
    assert!(outcome.refused.is_empty(), "{:?}", outcome.refused);
    let ticks = |kept: &RecordedRun| -> Vec<i64> {
        let words = ["start", "following", "fault", "reversed", "event:mission: command applied: *withhold"];
        let find = |word: &&str| word.parse::<Alignment>().expect("is one").find(kept).expect(word);
        words.iter().map(find).collect()
    };
    assert_eq!(ticks(&kept), [0, 250, 425, 617, 700]);
    let later = shifted(&kept, 333);
    assert_eq!(ticks(&later), [0, 583, 758, 950, 1033]);

    // Aligned on an event, the two are one: every metric has the same bits.
    let window = Window { from_s: -2.0, to_s: 7.0 };
    for word in ["following", "fault", "reversed"] {
        let align: Alignment = word.parse().expect("is one");
        let (one, two) = (around(&kept, &align, window), around(&later, &align, window));
        assert_eq!((one.moments, one.missing), (450, 0));
        assert_eq!(bits(&one.values), bits(&two.values), "{word}");
        assert_ne!(one.values, around(&kept, &Alignment::Start, Window { from_s: 2.0, to_s: 11.0 }).values);
    }

    let quiet = ["trial.mission=[]", "trial.duration_s=25.0", "trial.score.from_s=6.0"];
    let (quiet, _) = keep(&load("paper-gsta", &quiet), 1);
    for (word, reason) in [
        ("following", "never follows"),
        ("reversed", "never reversed"),
        ("fault", "no fault"),
        ("event:no such thing", "none of its events contains \"no such thing\""),
    ] {
        let error = word.parse::<Alignment>().expect("is one").find(&quiet).expect_err(word);
        assert!(error.contains(reason), "{error}");
    }
}

#[test]
fn a_run_with_twice_the_rate_is_looked_at_where_the_other_is() {
    let (kept, _) = keep(&load("paper-agsta", &["trial.duration_s=25.0"]), 1);
    let mut finer = kept.clone();
    finer.properties.get_mut("run").expect("properties").insert("tick_s".to_owned(), 0.01.into());
    for columns in finer.signals.values_mut() {
        // Ticks 2k and 2k + 1 are in tick k of the coarser run; the newest then is 2k.
        let wrong = f64::MAX / 4.0;
        columns.tick = columns.tick.iter().flat_map(|tick| [2 * tick, 2 * tick + 1]).collect();
        columns.time_ns = columns.time_ns.iter().flat_map(|time| [*time, time + 10_000_000]).collect();
        let rows: Vec<Vec<f64>> = columns.values.chunks_exact(columns.width).map(<[f64]>::to_vec).collect();
        columns.values = rows.into_iter().flat_map(|row| [row.clone(), vec![wrong; row.len()]]).flatten().collect();
    }
    finer.labels.values_mut().flatten().for_each(|label| label.tick *= 2);
    let window = Window { from_s: 17.0, to_s: 25.0 };
    let usual = Selection::parse(["usual", "k1_growth", "measured_iae"]).expect("are known");
    let one = evaluate(&kept, &Grid::new(0, 0.02, window, 0.02), &usual).expect("is evaluated");
    let two = evaluate(&finer, &Grid::new(0, 0.01, window, 0.02), &usual).expect("is evaluated");
    assert_eq!((one.moments, two.moments), (400, 400));
    assert_eq!(bits(&one.values), bits(&two.values));
}

#[test]
fn a_run_without_truth_is_compared_by_what_was_measured() {
    let (kept, _) = keep(&load("paper-agsta", &["trial.duration_s=25.0"]), 1);
    let mut real = kept.clone();
    real.signals.retain(|path, _| !path.starts_with("plant/truth/"));
    let [known, measured] = [&kept, &real].map(|kept| evaluate(kept, &own(kept), &all()).expect("is evaluated").values);
    assert!(measured.len() > 60 && measured.iter().all(|(name, value)| known[name].to_bits() == value.to_bits()));
    let gone: Vec<&String> = known.keys().filter(|name| !measured.contains_key(*name)).collect();
    assert!(gone.len() > 40, "{gone:?}");
    let of_truth =
        |name: &&String| ["true", "estimation", "activity", "nees"].iter().any(|word| name.starts_with(word));
    assert!(gone.iter().all(of_truth), "{gone:?}");
}

#[test]
fn what_can_not_be_compared_says_why() {
    let (kept, _) = keep(&load("paper-pid", &["trial.duration_s=25.0"]), 1);
    let mut bad = kept.clone();
    bad.signals.get_mut(signal::thrust::REQUESTED.path).expect("is recorded").values[4 * 1100 + 2] = f64::NAN;
    let error = evaluate(&bad, &own(&bad), &Selection::default()).expect_err("is no number").to_string();
    let path = signal::thrust::REQUESTED.path;
    assert_eq!(error, format!("paper-pid-seed1: {path} is not finite at tick 1100"));
    // Outside of the window it does not matter.
    let later = Grid::new(0, 0.02, Window { from_s: 23.0, to_s: 25.0 }, 0.02);
    assert_eq!(evaluate(&bad, &later, &Selection::default()).expect("is evaluated").moments, 100);

    let beyond = Grid::new(0, 0.02, Window { from_s: 30.0, to_s: 1e15 }, 0.02);
    let error = evaluate(&kept, &beyond, &Selection::default()).expect_err("has no overlap");
    assert!(matches!(error, MetricsError::NoOverlap { .. }), "{error}");
    assert!(error.to_string().contains("from 0.00 to 25.00 s"), "{error}");

    let half = Grid::new(0, 0.02, Window { from_s: 20.0, to_s: 30.0 }, 0.02);
    let found = evaluate(&kept, &half, &Selection::default()).expect("is evaluated");
    assert_eq!((found.moments, found.missing, found.coverage()), (250, 250, 0.5));
}
