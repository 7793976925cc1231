//! The statistics of comparisons are those of another implementation.

use crate::support::python;
use serde_json::{Value, json};
use std::fs;
use supertwin_lab::statistics::{RESAMPLES, bootstrap_interval, mean, quantile, sign_test, standard_deviation};

/// Another implementation of the same statistics; it reads the numbers and answers in JSON.
const SCIPY: &str = r#"
import json, sys
import numpy as np
from scipy import stats
answers = []
for case in json.load(open(sys.argv[1])):
    x = np.array(case["values"])
    ends = []
    for state in range(20):
        result = stats.bootstrap((x,), np.mean, n_resamples=case["resamples"], confidence_level=0.95,
                                 method="percentile", rng=np.random.default_rng(state))
        ends.append([result.confidence_interval.low, result.confidence_interval.high])
    ends = np.array(ends)
    answers.append({
        "mean": float(np.mean(x)), "sd": float(np.std(x, ddof=1)),
        "quantiles": [float(np.quantile(x, q)) for q in (0.025, 0.5, 0.9)],
        "p": float(stats.binomtest(case["wins"], case["wins"] + case["losses"], 0.5).pvalue),
        "interval": ends.mean(axis=0).tolist(), "error": ends.std(axis=0, ddof=1).tolist(),
    })
print(json.dumps(answers))
"#;

#[test]
fn statistics_are_those_of_scipy() {
    let folder = tempfile::tempdir().unwrap();
    let mut stream = supertwin_core::random::Stream::new(11, "scipy");
    let samples: Vec<Vec<f64>> = [(5, 0), (8, 1), (20, 2), (20, 3), (100, 4), (1000, 5)]
        .into_iter()
        .map(|(n, kind)| {
            // Normal, skewed, and with ties.
            let draw = |_| match kind % 3 {
                0 => 0.031 + 0.01 * stream.normal(),
                1 => stream.exponential(2.0),
                _ => f64::from(stream.below(4)) - 1.0,
            };
            (0..n).map(draw).collect()
        })
        .collect();
    let cases: Vec<Value> = samples
        .iter()
        .map(|values| {
            let [wins, losses] = [1.0, -1.0].map(|sign| values.iter().filter(|value| sign * **value > 0.01).count());
            json!({ "values": values, "wins": wins, "losses": losses, "resamples": RESAMPLES })
        })
        .collect();
    let file = folder.path().join("cases.json");
    fs::write(&file, serde_json::to_string(&cases).unwrap()).unwrap();
    let environment = python::environment_with("python-statistics", &["numpy==2.4.6", "scipy==1.17.1"]);
    let said = python::say_in(&environment, folder.path(), SCIPY, &["cases.json"]);
    let answers: Vec<Value> = serde_json::from_str(&said).unwrap();
    let near = |ours: f64, theirs: &Value, tolerance: f64| {
        let theirs = theirs.as_f64().unwrap();
        assert!((ours - theirs).abs() <= tolerance * theirs.abs().max(1e-3), "{ours} against {theirs}");
    };
    for ((values, case), answer) in samples.iter().zip(&cases).zip(&answers) {
        near(mean(values), &answer["mean"], 1e-13);
        near(standard_deviation(values).unwrap(), &answer["sd"], 1e-13);
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        for (i, share) in [0.025, 0.5, 0.9].into_iter().enumerate() {
            near(quantile(&sorted, share).unwrap(), &answer["quantiles"][i], 1e-13);
        }
        let count = |name: &str| case[name].as_u64().unwrap() as usize;
        near(sign_test(count("wins"), count("losses")), &answer["p"], 1e-10);
        // Two bootstraps differ by the error of resampling, which scipy's own twenty show.
        let interval = bootstrap_interval(values, "scipy").unwrap();
        for (end, ours) in [interval.low, interval.high].into_iter().enumerate() {
            let theirs = answer["interval"][end].as_f64().unwrap();
            let error = answer["error"][end].as_f64().unwrap();
            assert!((ours - theirs).abs() <= 5.0 * error + 1e-12, "{ours} against {theirs} ± {error}");
        }
    }
    assert_eq!(answers.len(), samples.len());
}
