//! T11: the paper's three trials over twenty seeds, against the independent reference simulation.

use crate::common::{load, load_all, mean, scores};
use supertwin_lab::Scores;

const SEEDS: u64 = 20;

/// Means of control.md section 6.2, measured against reference: distance, speed, surge, sway, depth, heading.
const REFERENCE: [(&str, [f64; 6]); 3] = [
    ("paper-gsta", [0.399, 0.069, 0.055, 0.084, 0.110, 0.089]),
    ("paper-agsta", [0.378, 0.052, 0.048, 0.053, 0.077, 0.069]),
    ("paper-pid", [0.563, 0.094, 0.066, 0.110, 0.074, 0.157]),
];

fn paper_trials() -> [Vec<Scores>; 3] {
    REFERENCE.map(|(name, _)| scores(&load(name, &[]), SEEDS))
}

#[test]
fn t11_means_lie_within_a_quarter_of_the_reference_simulation_and_the_order_is_the_papers() {
    let [gsta, agsta, pid] = paper_trials();
    for ((name, expected), runs) in REFERENCE.iter().zip([&gsta, &agsta, &pid]) {
        for (i, expected) in expected.iter().enumerate() {
            let ours = mean(runs, |s| s.measured.to_array()[i]);
            let ratio = ours / expected;
            assert!((0.75..=1.25).contains(&ratio), "{name} row {i}: {ours:.3} against {expected} ({ratio:.2})");
        }
    }
    let sway = |s: &Scores| s.measured.sway_m_per_s;
    let best = (0..SEEDS as usize).filter(|&i| sway(&agsta[i]) < sway(&gsta[i]) && sway(&agsta[i]) < sway(&pid[i]));
    assert!(best.count() >= 18, "AGSTA must have the smallest sway error in at least 18 of 20 seeds");
    assert!(mean(&gsta, sway) < mean(&pid, sway), "GSTA's sway error must be below PID's");
    let bias = mean(&pid, |s| s.sway_bias_in_travel_direction_m_per_s);
    assert!((bias + 0.09).abs() <= 0.03, "PID must lag behind by 0.09 ± 0.03 m/s, not {bias}");
    for runs in [&gsta, &agsta, &pid] {
        for s in runs {
            assert!(s.measured_max.to_array().iter().chain(&s.true_max.to_array()).all(|x| x.is_finite()));
            assert!(s.true_max.distance_m < 3.5 && s.true_max.depth_m < 4.0, "diverged: {s:?}");
        }
    }
}

#[test]
fn on_equal_terms_agsta_is_the_best_of_the_papers_three_in_velocity() {
    // control.md 6.2b; hold-out seeds are not needed, nothing was fitted on these.
    let runs: Vec<Vec<Scores>> = load_all("fair", &[]).iter().map(|trial| scores(trial, SEEDS)).collect();
    let [gsta, agsta, pid, gsta_tuned, pid_tuned] = &runs[..] else { panic!("five controllers") };
    for (name, i) in [("speed", 1), ("sway", 3)] {
        let best = (0..SEEDS as usize).filter(|&seed| {
            let value = |runs: &[Scores]| runs[seed].measured.to_array()[i];
            value(agsta) < value(gsta) && value(agsta) < value(pid)
        });
        assert!(best.count() >= 19, "{name}");
    }
    // Tuned fixed gains match or beat adaptation in every measured row but distance, where all are fish-limited.
    for i in 1..6 {
        let row = |runs: &[Scores]| mean(runs, |s| s.measured.to_array()[i]);
        assert!(row(gsta_tuned) <= 1.02 * row(agsta), "row {i}");
        assert!(row(pid_tuned) < 1.5 * row(agsta), "row {i}");
    }
    // The soft PID rides the waves: it looks as good as AGSTA in measured depth and is twice as far off in truth.
    let measured = |runs: &[Scores]| mean(runs, |s| s.measured.depth_m);
    let truth = |runs: &[Scores]| mean(runs, |s| s.truth.depth_m);
    assert!((measured(pid) / measured(agsta) - 1.0).abs() < 0.15);
    assert!(truth(pid) > 1.7 * truth(agsta));
}

#[test]
fn the_plane_filter_takes_the_distance_error_from_decimetres_to_centimetres() {
    let gated = scores(&load("fair", &[]), SEEDS);
    let filtered = scores(&load("plane-filter", &[]), SEEDS);
    let estimation = |runs: &[Scores]| mean(runs, |s| s.estimation.distance_m);
    assert!((0.30..0.45).contains(&estimation(&gated)), "control.md: 0.37 m, here {}", estimation(&gated));
    assert!(estimation(&filtered) < 0.07, "control.md: 0.05 m, here {}", estimation(&filtered));
}

#[test]
fn every_misprint_shows_what_it_does() {
    let seeds = 8;
    let fair = |law: &str| scores(&load("fair", &[&format!("trial.controllers=[{law:?}]")]), seeds);
    let agsta = fair("agsta");
    let distance = |runs: &[Scores]| mean(runs, |s| s.measured.distance_m);
    let port_sign = scores(&load("misprint-port-sign", &[]), seeds);
    assert!(distance(&port_sign) > 2.0 * distance(&agsta), "the printed port sign must leave the net");

    let literal = fair("agsta-literal-acceleration");
    let surge = |runs: &[Scores]| mean(runs, |s| s.measured.surge_m_per_s);
    assert!(surge(&literal) > 1.5 * surge(&agsta), "the literal acceleration must double the surge error");
    assert!(mean(&literal, |s| s.k1_end.surge) < 3.0, "and k1 must stall");
    assert!(mean(&literal, |s| s.measured.depth_m) > 2.0 * mean(&agsta, |s| s.measured.depth_m), "depth limit cycle");

    let k2 = fair("agsta-literal-k2");
    let heading = |runs: &[Scores]| mean(runs, |s| s.measured.heading_rad);
    assert!(heading(&k2) > 1.7 * heading(&agsta), "an integrated k2 must wreck heading");
    assert!(mean(&k2, |s| s.activity.yaw) > 10.0 * mean(&agsta, |s| s.activity.yaw));
}

#[test]
fn the_other_shipped_trials_track_without_divergence() {
    for name in ["bluerov2", "hand-over", "varying-setpoints", "tether-cut", "fair-half-waves"] {
        for trial in load_all(name, &[]) {
            for s in scores(&trial, 3) {
                assert!(s.truth.depth_m < 0.25 && s.truth.sway_m_per_s < 0.2, "{name}: {:?}", s.truth);
                assert!(s.true_max.distance_m < 2.5, "{name}: {:?}", s.true_max);
            }
        }
    }
}
