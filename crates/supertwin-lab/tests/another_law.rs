//! A law that is one file, one arm and one parameter file is run, scored, compared and seen like any other.

use crate::common::kept::keep;
use crate::common::load;
use std::fs;
use supertwin_core::{Capability, Property, RecordedRun, signal};
use supertwin_lab::align::{Grid, Window};
use supertwin_lab::metrics::{Selection, evaluate};
use supertwin_lab::{LAWS, rescore};

/// Its parameter file.
const PARAMETERS: &str = r#"
description = "a law more"
[law.boundary_layer]
surface.lead_filter = { time_constant_s = 0.3 }
k1 = { surge = 10.0, sway = 10.0, heave = 6.0, yaw = 2.0 }
growth = { surge = 0.5, sway = 0.5, heave = 0.5, yaw = 0.1 }
alpha_tol = { surge = 0.2, sway = 0.2, heave = 0.15, yaw = 0.2 }
"#;

fn text<'a>(kept: &'a RecordedRun, name: &str) -> &'a str {
    match &kept.properties["run"][name] {
        Property::Text(text) => text,
        other => panic!("{name} = {other:?}"),
    }
}

#[test]
fn a_law_that_is_added_is_scored_compared_and_seen() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("boundary-layer.toml");
    fs::write(&file, PARAMETERS).expect("is written");
    let controllers = format!("trial.controllers=[{:?}]", file.display().to_string());
    let trial = load("paper-agsta", &[&controllers, "trial.duration_s=40.0"]);
    let (kept, outcome) = keep(&trial, 1);

    // Scored, and from its recording the same.
    let shares = outcome.scores.outside_alpha_tol_share.expect("it adapts");
    assert!(shares.to_array().iter().any(|share| *share > 0.0), "{shares:?}");
    assert!(outcome.scores.k1_end.surge > 10.0 && outcome.scores.measured.distance_m < 5.0, "{:?}", outcome.scores);
    assert_eq!(rescore(&kept).expect("is scored").scores, outcome.scores);

    // Compared.
    let all = Selection::parse(["all"]).expect("is known");
    let window = Window { from_s: 17.0, to_s: 40.0 };
    let values = evaluate(&kept, &Grid::new(0, 0.02, window, 0.02), &all).expect("is evaluated").values;
    assert!(values["k1_growth.surge"] > 0.0 && values.contains_key("outside_alpha_tol_share.yaw"), "{values:?}");

    // Seen: dashboards ask the recording what laws show.
    let (_, capabilities) = LAWS.iter().find(|(name, _)| *name == "boundary_layer").expect("is known by name");
    let recorded: Vec<_> = text(&kept, "capabilities").split(' ').filter_map(Capability::named).collect();
    assert_eq!(recorded, *capabilities);
    for capability in recorded {
        let columns = kept.signal(capability.signal()).expect("is recorded");
        assert_eq!(columns.tick.len() as u64, outcome.ticks, "{capability:?}");
    }
    assert_eq!(kept.label(&signal::controller::LAW)[0].value, "boundary_layer");
}
