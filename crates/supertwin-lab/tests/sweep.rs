//! Campaigns: what a file says becomes a list of runs, and what is wrong in it is named with its place.

use crate::common::library;
use std::collections::BTreeSet;
use std::path::Path;
use supertwin_lab::ConfigError;
use supertwin_lab::sweep::{KeepRecordings, Plan, Sweep};
use tempfile::TempDir;
use toml::Value;

/// A sweep's file in a folder of its own.
fn file(text: &str) -> (TempDir, String) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("mine.toml");
    std::fs::write(&path, text).expect("written");
    let name = path.display().to_string();
    (folder, name)
}

fn load(text: &str) -> Result<Sweep, ConfigError> {
    let (_folder, name) = file(text);
    Sweep::load(&library(&[]), &name)
}

fn plan_with(text: &str, overrides: &[&str]) -> Result<(Sweep, Plan), ConfigError> {
    let (_folder, name) = file(text);
    let library = library(overrides);
    let sweep = Sweep::load(&library, &name)?;
    let points = sweep.points()?;
    let of_trial = |trial: &String| points.iter().map(|point| sweep.resolve(&library, trial, point)).collect();
    let resolved: Result<Vec<_>, ConfigError> = sweep.trials.iter().map(of_trial).collect();
    let plan = sweep.plan(resolved?, &points)?;
    Ok((sweep, plan))
}

fn plan(text: &str) -> (Sweep, Plan) {
    plan_with(text, &[]).unwrap_or_else(|error| panic!("{error}"))
}

/// The message of a wrong file, which is `mine.toml`; its trials are read too.
fn wrong(text: &str) -> String {
    let (_folder, name) = file(text);
    let library = library(&[]);
    let error = Sweep::load(&library, &name).and_then(|sweep| sweep.check(&library)).expect_err("must be refused");
    let folder = Path::new(&name).parent().expect("a folder").display().to_string();
    error.to_string().replace(&format!("{folder}/"), "")
}

const HEAD: &str = "description = \"a test\"\ntrials = [\"paper-pid\"]\nseeds = { start = 1, count = 2 }\n";

#[test]
fn a_grid_is_every_value_with_every_other_in_a_fixed_order() {
    let text = "description = \"a test\"\n\
        trials = [\"paper-pid\", \"paper-agsta\"]\n\
        recordings = \"on-fail\"\n\
        [seeds]\nlist = [7, 3]\n\
        [[parameter]]\nname = \"hs\"\npath = \"environment.waves.significant_height_m\"\nvalues = [0.2, 0.4]\n\
        [[parameter]]\nname = \"mass\"\npaths = [\"vehicle.true.rigid_body.mass_kg\", \"vehicle.nominal.rigid_body.mass_kg\"]\n\
        from = 0.5\nto = 2.0\nsteps = 3\nspacing = \"logarithmic\"\ntimes = true\n";
    let (sweep, plan) = plan(text);
    assert_eq!((sweep.seeds.as_slice(), sweep.keep_recordings), (&[7, 3][..], KeepRecordings::OnFail));
    assert_eq!(plan.configurations.len(), 2 * 2 * 3);
    assert_eq!(plan.runs.len(), 24);
    for (i, id) in [(0, "pid-grid0-seed7"), (1, "pid-grid0-seed3"), (2, "pid-grid1-seed7"), (23, "agsta-grid5-seed3")] {
        assert_eq!(plan.runs[i].id, format!("paper-{id}"));
    }
    let ids: BTreeSet<&String> = plan.runs.iter().map(|run| &run.id).collect();
    assert_eq!(ids.len(), 24);
    // The last parameter changes fastest, and both masses are multiplied.
    let mass_kg = |i: usize| plan.configurations[i].trial.vehicle.truth.rigid_body.mass_kg.get();
    for (i, expected) in [45.0, 90.0, 180.0, 45.0].into_iter().enumerate() {
        assert!((mass_kg(i) - expected).abs() < 1e-9, "configuration {i}: {}", mass_kg(i));
    }
    let heights = plan.configurations.iter().map(|one| one.trial.environment.waves.significant_height_m.get());
    assert_eq!(heights.take(4).collect::<Vec<_>>(), [0.2, 0.2, 0.2, 0.4]);
    let nominal = plan.configurations[2].trial.vehicle.nominal.rigid_body.mass_kg.get();
    assert_eq!(nominal, 180.0, "the end of a range is exact");
    assert_eq!(plan.configurations[5].values[0], Some(Value::Float(0.4)));
}

#[test]
fn a_controller_without_a_place_for_a_parameter_runs_once() {
    let text = "description = \"a test\"\ntrials = [\"fair\"]\nseeds = { start = 1, count = 1 }\n\
        [[parameter]]\npath = \"controller.law.agsta.beta.surge\"\nvalues = [3.0, 6.0, 9.0]\n";
    let (_, plan) = plan(text);
    let runs_of = |name: &str| plan.configurations.iter().filter(|one| one.trial.controller_name == name).count();
    assert_eq!(["agsta", "pid", "gsta", "gsta-tuned", "pid-tuned"].map(runs_of), [3, 1, 1, 1, 1]);
    let pid = plan.configurations.iter().find(|one| one.trial.controller_name == "pid").expect("is there");
    assert_eq!(pid.values, [None]);
}

#[test]
fn samples_fill_their_ranges_and_have_seeds_of_their_own() {
    let text = |extra: &str| {
        format!(
            "description = \"a test\"\ntrials = [\"paper-pid\"]\nseeds = {{ start = 5 }}\n\
             latin_hypercube = {{ samples = 10, seed = 3, seed_per_sample = true }}\n\
             [[parameter]]\npath = \"vehicle.true.net_buoyancy_n\"\nfrom = 0.0\nto = 20.0\n{extra}"
        )
    };
    let (sweep, first) = plan(&text(""));
    assert_eq!((sweep.samples, first.runs.len()), (10, 10));
    assert_eq!(first.runs[9].id, "paper-pid-sample9-seed14");
    let values = |plan: &Plan| -> Vec<f64> {
        let number = |value: &Option<Value>| value.as_ref().and_then(Value::as_float).expect("a number");
        plan.configurations.iter().map(|one| number(&one.values[0])).collect()
    };
    let mut strata: Vec<usize> = values(&first).iter().map(|x| (x / 2.0) as usize).collect();
    strata.sort_unstable();
    assert_eq!(strata, (0..10).collect::<Vec<_>>(), "one in each tenth");
    let buoyancies = first.configurations.iter().map(|one| one.trial.vehicle.truth.net_buoyancy_n.get());
    assert_eq!(buoyancies.collect::<Vec<_>>(), values(&first));
    // Another parameter changes nothing for the first, and a grid meets every sample.
    let more = "[[parameter]]\npath = \"environment.waves.significant_height_m\"\nvalues = [0.2, 0.4]\n";
    let (_, second) = plan(&text(more));
    assert_eq!(values(&second), [values(&first), values(&first)].concat());
    assert_eq!(second.runs[10].id, "paper-pid-grid1-sample0-seed5");
}

/// Changes of the head, and what is said of them.
const OF_THE_HEAD: &str = r#"
trials | trails | mine.toml:2:1: trails: unknown field `trails`
trials | trails | did you mean `trials`?
paper-pid | paper-pdi | did you mean `paper-pid`?
["paper-pid"] | [] | mine.toml:2:10: trials = []: must name at least one
["paper-pid"] | ["fair", "fair"] | mine.toml:2:19: trials: `fair` is named twice
count = 2 | count = 0 | mine.toml:3:9: seeds: count = 0: must be 1 to 1000000
start = 1, count = 2 | list = [1, 2, 1] | mine.toml:3:9: seeds: 1 is there twice
start = 1, | | seeds: must be `start` and `count`, or a `list`
"#;

/// Parameters, their lines apart by semicolons, and what is said of them.
const OF_A_PARAMETER: &str = r#"
values = [1.0] | mine.toml:4:1: parameter: must have a `path`
path = "vehicel.true.net_buoyancy_n"; values = [1.0] | mine.toml:5:8: parameter: section `vehicel`
path = "vehicel.true.net_buoyancy_n"; values = [1.0] | did you mean `vehicle`?
path = "vehicle.true.net_bouyancy_n"; values = [1.0] | mine.toml:4:1: parameter vehicle.true.net_bouyancy_n: vehicle.true.net_bouyancy_n=1.0: true.net_bouyancy_n: unknown field
path = "vehicle.true.rigid_body.mass_kg"; values = [90.0, -90.0] | mine.toml:4:1: parameter vehicle.true.rigid_body.mass_kg: vehicle.true.rigid_body.mass_kg=-90.0: true.rigid_body.mass_kg: -90: must be positive
path = "vehicle.true.net_buoyancy_n"; values = [1.0, 1.0] | values: 1.0 is there twice
path = "vehicle.true.net_buoyancy_n"; from = 3.0; to = 1.0; steps = 2 | from = 3: must be less than
path = "vehicle.true.net_buoyancy_n"; from = 1.0; to = 3.0; steps = 1 | steps = 1: must be 2 to
path = "vehicle.true.net_buoyancy_n"; from = 1.0; to = 3.0 | needs `steps`, or a [latin_hypercube]
path = "vehicle.true.net_buoyancy_n"; from = nan; to = 3.0 | mine.toml:6:8: parameter
path = "vehicle.true.net_buoyancy_n"; from = 0.0; to = 3.0; steps = 2; spacing = "logarithmic" | must be positive where the spacing is logarithmic
paths = ["vehicle.true.net_buoyancy_n", "trial.seed"]; values = [1.0] | need a `name`
path = "controller.law.agsta.beta.surge"; values = [3.0] | no controller here has this law
path = "trial.description"; times = true; values = [3.0] | only a number can be multiplied
path = "trial.description"; times = true; values = ["x"] | all values must be numbers
"#;

/// Further lines of the head, and what is said of them.
const MORE: &str = r#"
latin_hypercube = { samples = 3, seed = 1 } | no parameter has a range without `steps`
limits = "papper" | did you mean `paper`?
baseline = "agsta" | baseline: `agsta` is no controller here; there are pid
"#;

/// The cells of a table's lines.
fn rows<const N: usize>(table: &'static str) -> impl Iterator<Item = [&'static str; N]> {
    let cells = |line: &'static str| line.split('|').map(str::trim).collect::<Vec<_>>();
    table.trim().lines().map(move |line| cells(line).try_into().unwrap_or_else(|_| panic!("{line}")))
}

#[test]
fn mistakes_are_named_with_file_line_value_and_rule() {
    let with = |parameter: &str| format!("{HEAD}[[parameter]]\n{}\n", parameter.replace("; ", "\n"));
    let head = rows(OF_THE_HEAD).map(|[was, is, expected]| (HEAD.replace(was, is), expected));
    let parameters = rows(OF_A_PARAMETER).map(|[parameter, expected]| (with(parameter), expected));
    let more = rows(MORE).map(|[line, expected]| (format!("{HEAD}{line}\n"), expected));
    let cases: Vec<_> = head.chain(parameters).chain(more).collect();
    assert_eq!(cases.len(), 26);
    for (text, expected) in cases {
        let said = wrong(&text);
        assert!(said.contains(expected), "{expected}\nis not in\n{said}\nof\n{text}");
        assert!(["mine.toml", "paper-pdi", "papper"].iter().any(|name| said.contains(name)), "{said}");
    }
    let set = plan_with(&with("path = \"trial.duration_s\"; values = [60.0]"), &["trial.duration_s=70"]);
    let said = set.expect_err("both").to_string();
    assert!(said.contains("trial.duration_s: the sweep changes what --set fixes"), "{said}");
    load(HEAD).expect("the rest of it is legal");
}

#[test]
fn what_is_shipped_is_legal() {
    let library = library(&[]);
    let names = library.names("sweeps");
    assert!(names.len() >= 2, "{names:?}");
    for name in names {
        Sweep::load(&library, &name).and_then(|sweep| sweep.check(&library)).unwrap_or_else(|error| panic!("{error}"));
    }
}
