//! What a user does with several runs: which one is better, by how much, how sure is that, and does it pass.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod statistics;

use crate::support::{CONFIG, Place, assert_says, following, tampered};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use supertwin_core::run::Properties;
use supertwin_core::{RunHeader, RunSink};
use supertwin_lab::statistics::{mean, standard_deviation};
use supertwin_rerun::table::{Column, Table};
use supertwin_rerun::{Options, RerunSink};

/// Records seeds of trials for 23 s, of which the last six are scored.
fn record(place: &Place, out: &str, trials: &[&str], seeds: u64, more: &[&str]) -> Value {
    let seeds = seeds.to_string();
    let words =
        ["--out", out, "--seeds", &seeds, "--json", "--set", "trial.duration_s=23", "--set", "trial.score.from_s=17"];
    place.call(&[&["run"], trials, &words, more].concat()).well().json()
}

fn compared(place: &Place, arguments: &[&str]) -> Value {
    place.call(&[&["compare", "--json"], arguments].concat()).well().json()
}

fn group<'a>(comparison: &'a Value, name: &str) -> &'a Value {
    let groups = comparison["groups"].as_array().unwrap();
    groups.iter().find(|group| group["name"] == name).unwrap_or_else(|| panic!("no {name}: {comparison:#}"))
}

fn row<'a>(comparison: &'a Value, name: &str, metric: &str) -> &'a Value {
    let rows = group(comparison, name)["metrics"].as_array().unwrap();
    rows.iter().find(|row| row["metric"] == metric).unwrap()
}

/// What is wrong with a file, by its name.
fn reasons(comparison: &Value) -> BTreeMap<String, String> {
    let unusable = comparison["unusable"].as_array().unwrap().iter();
    let name = |file: &Value| Path::new(file.as_str().unwrap()).file_name().unwrap().to_str().unwrap().to_owned();
    unusable.map(|one| (name(&one["file"]), one["reason"].as_str().unwrap().to_owned())).collect()
}

#[test]
fn three_trials_of_several_seeds_make_the_papers_table_with_verdicts() {
    let place = Place::new();
    let ran = record(&place, "runs", &["paper-gsta", "paper-agsta", "paper-pid"], 5, &[]);
    let comparison = compared(&place, &["runs", "--baseline", "runs/paper-gsta-seed3.rrd"]);
    assert_eq!((&comparison["baseline"], &comparison["align"]), (&"paper-gsta".into(), &"start".into()));
    let windows = comparison["runs"].as_array().unwrap().iter().map(|run| &run["window"]);
    assert!(windows.clone().count() == 15 && windows.eq([&json!({ "from_s": 17.0, "to_s": 23.0 }); 15]));
    assert_eq!(comparison["unusable"], json!([]));
    for name in ["paper-gsta", "paper-agsta", "paper-pid"] {
        assert_eq!(group(&comparison, name)["seeds"], json!([1, 2, 3, 4, 5]));
        // The numbers are those of the runs, to the last bit.
        let of = |all: &Value, kind: &str, number: &str| -> Vec<f64> {
            let runs = all["runs"].as_array().unwrap().iter().filter(|run| run[kind] == name);
            runs.map(|run| run.pointer(number).unwrap().as_f64().unwrap()).collect()
        };
        let scores = of(&ran, "trial", "/scores/measured/sway_m_per_s");
        let values = of(&comparison, "group", "/values/measured.sway_m_per_s");
        assert_eq!((scores.len(), &scores), (5, &values), "{name}");
        let summary = &row(&comparison, name, "measured.sway_m_per_s")["summary"];
        assert_eq!(summary["mean"].as_f64(), Some(mean(&scores)));
        assert_eq!(summary["standard_deviation"].as_f64(), standard_deviation(&scores));
    }
    let sway = row(&comparison, "paper-agsta", "measured.sway_m_per_s");
    assert_eq!(sway["paper"], 0.046);
    let difference = &sway["difference"];
    assert_eq!(difference["seeds"], 5);
    let of_it = |place: &str| difference.pointer(place).unwrap().as_f64().unwrap();
    let [low, middle, high] = ["/interval/low", "/mean", "/interval/high"].map(of_it);
    assert!(low <= middle && middle <= high && sway["verdict"].as_str().unwrap().contains(" m/s ["), "{sway}");
    assert_eq!(row(&comparison, "paper-gsta", "measured.sway_m_per_s")["difference"], Value::Null);
    let changes = group(&comparison, "paper-agsta")["changes"].as_array().unwrap();
    let changes: Vec<&str> = changes.iter().map(|change| change["path"].as_str().unwrap()).collect();
    assert!(changes.contains(&"controller.law.gsta") && changes.contains(&"controller.law.agsta"), "{changes:?}");
    assert!(changes.iter().all(|path| !path.contains("seed") && !path.contains("description")), "{changes:?}");

    let comparison_of_all = compared(&place, &["runs"]);

    // The same for people.
    let text = place.call(&["compare", "runs"]).well().out;
    assert_says(&text, &["15 runs, 3 groups, held against paper-agsta; 17.00 to 23.00 s from the start."]);
    assert_says(&text, &["paper-pid against paper-agsta", "paper IV", "of 5 seeds, difference "]);
    assert_says(&text, &["Configured otherwise", "controller.law.agsta: ", "would miss zero by chance alone"]);
    assert_says(&text, &["Of the metrics here: better in ", "and not the same task (trial.mission"]);
    let markdown = place.call(&["compare", "runs", "--markdown"]).well().out;
    assert!(markdown.contains("## paper-pid against paper-agsta") && !markdown.contains('│'), "{markdown}");
    assert!(markdown.lines().filter(|line| line.starts_with("| ")).count() > 60, "{markdown}");

    // A picture: all runs in one recording, which is no run itself.
    let drawn = place.call(&["compare", "runs", "--out", "runs/all.rrd"]).well();
    assert!(drawn.err.contains("runs/all.rrd: 15 runs, "), "{drawn:?}");
    let error = supertwin_rerun::read(&place.path().join("runs/all.rrd")).unwrap_err().to_string();
    assert!(error.contains("a comparison, not a recording of a run"), "{error}");
    let again = place.call(&["compare", "runs", "--json"]).well();
    assert!(again.err.contains("runs/all.rrd: a comparison, not a recording of a run; left out"), "{again:?}");
    assert_eq!(again.json()["runs"], comparison_of_all["runs"]);

    // A table for data frames; never over another file.
    let words = ["compare", "runs", "--metrics", "measured,nis.*", "--parquet", "table.parquet"];
    place.call(&words).well();
    let table = Table::read(&place.path().join("table.parquet")).unwrap();
    assert_eq!((table.rows(), table.about["baseline"].as_str()), (15, "paper-agsta"));
    let Some(Column::Number(sway)) = table.column("measured.sway_m_per_s") else { panic!("{:?}", table.columns()) };
    let Some(Column::Text(groups)) = table.column("group") else { panic!("{:?}", table.columns()) };
    for (value, run) in sway.iter().zip(comparison["runs"].as_array().unwrap().iter()) {
        assert!(value.is_some() && run["values"]["measured.sway_m_per_s"].is_f64());
    }
    assert_eq!(groups.iter().flatten().filter(|group| *group == "paper-pid").count(), 5);
    assert!(table.column("nis.depth").is_some());
    let before = fs::read(place.path().join("table.parquet")).unwrap();
    place.call(&words).refused("table.parquet: exists already; use --force");
    place.call(&[&words[..], &["--force"]].concat()).well();
    assert_eq!(fs::read(place.path().join("table.parquet")).unwrap(), before);
}

#[test]
fn one_run_against_another_has_numbers_and_no_verdict() {
    let place = Place::new();
    record(&place, "a", &["paper-gsta"], 2, &[]);
    record(&place, "b", &["paper-gsta"], 1, &["--set", "controller.law.gsta.k2.surge=2.5"]);
    let comparison = compared(&place, &["a/paper-gsta-seed1.rrd", "b"]);
    let name = "paper-gsta [k2.surge=2.5]";
    let changes = &group(&comparison, name)["changes"];
    assert_eq!(changes.as_array().unwrap().len(), 1, "{changes}");
    assert_eq!(changes[0]["path"], "controller.law.gsta.k2.surge");
    let surge = row(&comparison, name, "measured.surge_m_per_s");
    let difference = &surge["difference"];
    assert_eq!((&difference["verdict"], &difference["interval"]), (&"too_few_seeds".into(), &Value::Null));
    assert!(surge["verdict"].as_str().unwrap().ends_with("1 seed, a verdict needs 5"), "{surge}");

    // Runs of one configuration are one group, unless each is wanted for itself.
    assert_eq!(compared(&place, &["a"])["groups"].as_array().unwrap().len(), 1);
    let each = compared(&place, &["a", "--each"]);
    assert_eq!(each["groups"].as_array().unwrap().len(), 2);
    assert_eq!(row(&each, "paper-gsta-seed2", "measured.depth_m")["difference"]["seeds"], 1);

    // A copy is the same run, and a run against its copy in another version would be equal.
    fs::copy(place.path().join("a/paper-gsta-seed1.rrd"), place.path().join("a/copy.rrd")).unwrap();
    let copied = place.call(&["compare", "a", "--json"]).well();
    assert!(copied.err.contains("the same run as a/copy.rrd; counted once"), "{copied:?}");
    assert_eq!(copied.json()["runs"].as_array().unwrap().len(), 2);
}

#[test]
fn runs_are_aligned_on_what_happens_in_them() {
    let place = Place::new();
    let mission = |at_s: f64, port: bool| {
        let port = port.then(|| format!(",{{at_s={},command.guidance.direction=\"port\"}}", at_s + 9.0));
        let port = port.unwrap_or_default();
        format!(
            "trial.mission=[{{at_s=0.0,command.guidance.mode=\"depth_heading_hold\"}},\
             {{at_s={at_s},command.guidance.mode=\"follow_net\"}}{port}]"
        )
    };
    for (out, at_s, port) in [("a", 3.0, true), ("b", 7.5, true), ("c", 3.0, false)] {
        record(&place, out, &["paper-gsta"], 1, &["--set", &mission(at_s, port)]);
    }
    let following = compared(&place, &["a", "b", "c", "--align", "following", "--window", "-1:10"]);
    let asked = json!({ "from_s": -1.0, "to_s": 10.0 });
    let whole = |run: &Value| run["window"] == asked && run["moments"] == 550 && run["missing"] == 0;
    assert!(following["runs"].as_array().unwrap().iter().all(whole), "{following:#}");
    // Without a window: from the event to where all of them are.
    let rest = compared(&place, &["a", "b", "--align", "following"]);
    let both = json!({ "from_s": 0.0, "to_s": 15.5 });
    assert!(rest["runs"].as_array().unwrap().iter().all(|run| run["window"] == both), "{rest:#}");

    let reversed = place.call(&["compare", "a", "b", "c", "--align", "reversed", "--window", "0:5", "--json"]);
    let reversed = reversed.refused("c/paper-gsta-seed1.rrd: its direction is never reversed");
    assert_eq!(reversed.json()["runs"].as_array().unwrap().len(), 2);

    let event = "event:command applied: *follow_net";
    let text = place.call(&["compare", "a", "b", "--align", event, "--window", ":4"]).well();
    assert!(text.out.contains("0.00 to 4.00 s from `event:command applied: *follow_net`"), "{text:?}");
    for (words, error) in [
        (["--align", "folowing"], "must be start, following"),
        (["--window", "5:1"], "must begin before it ends"),
        (["--metrics", "measured.dept_m"], "did you mean `measured.depth_m`?"),
        (["--limits", "papr"], "did you mean `paper`?"),
    ] {
        let refused = place.call(&[&["compare", "a"], &words[..]].concat()).refused(error);
        assert!(refused.out.is_empty(), "{refused:?}");
    }
}

#[test]
fn limits_are_a_gate() {
    let place = Place::new();
    record(&place, "runs", &["paper-gsta", "paper-pid"], 2, &[]);
    let judged = |name: &str, text: &str| {
        fs::write(place.path().join(name), format!("description = \"a test\"\n{text}")).unwrap();
        place.call(&["compare", "runs", "--limits", name])
    };
    let passed = judged("wide.toml", "[[limit]]\nmetric = \"measured.depth_m\"\nmax = 10.0\n").well();
    assert!(passed.out.contains("4 passed, 0 failed, 0 invalid; 0 could not be used."), "{passed:?}");

    let failed = judged(
        "narrow.toml",
        "[[limit]]\nmetric = \"measured.depth_m\"\ngroup = \"paper-pid\"\nmax = 1e-9\n\
         [[limit]]\nmetric = \"effort.surge\"\nmin = 0.0\n",
    );
    assert_eq!(failed.code, Some(1), "{failed:?}");
    assert_says(&failed.out, &["2 passed, 2 failed", "must be at most 0.000000001"]);
    let narrow = place.call(&["compare", "runs", "--limits", "narrow.toml", "--json"]).json();
    let runs = narrow["runs"].as_array().unwrap().iter();
    let outcomes: Vec<_> = runs.map(|run| [&run["name"], &run["outcome"]]).collect();
    let [gsta, pid] = [["paper-gsta-seed1", "paper-gsta-seed2"], ["paper-pid-seed1", "paper-pid-seed2"]];
    assert_eq!(outcomes, [gsta.map(|name| [name, "pass"]), pid.map(|name| [name, "fail"])].concat());

    // What can not be judged has not passed: PID has no gains, and nobody recorded a link.
    let invalid = judged("absent.toml", "[[limit]]\nmetric = \"k1_end.sway\"\nmax = 1e9\n");
    assert_eq!(invalid.code, Some(2), "{invalid:?}");
    assert_says(&invalid.out, &["2 passed, 0 failed, 2 invalid", "k1_end.sway is not there"]);
    let group = "[[limit]]\nmetric = \"measured.depth_m\"\nmax = 9.0\ngroup = \"papr-pid\"\n";
    let nobody = judged("nobody.toml", group).refused("group \"papr-pid\" is not among these runs");
    assert!(nobody.out.contains("no limit concerns it"), "{nobody:?}");

    let typo = judged("typo.toml", "[[limit]]\nmetric = \"measured.depth_m\"\nmaxx = 9.0\n");
    typo.refused("typo.toml:4:1: limit[0]").refused("did you mean `max`?");
    // `check` knows the folder.
    let checked = place.call(&["check", &format!("{CONFIG}/limits/paper.toml")]).well();
    assert!(checked.out.contains("limit.0.metric"), "{checked:?}");
}

#[test]
fn what_can_not_be_compared_is_named_and_the_others_are_compared() {
    let place = Place::new();
    record(&place, "runs", &["paper-gsta"], 2, &[]);
    let at = |name: &str| place.path().join("runs").join(name);
    // Another vehicle, a shorter run, one that never came far.
    let words = ["run", "bluerov2", "--out", "runs", "--set", "trial.duration_s=30", "--set", "trial.score.from_s=20"];
    place.call(&words).well();
    let words = ["run", "paper-pid", "--out", "runs", "--set", "trial.duration_s=18", "--set", "trial.score.from_s=5"];
    place.call(&words).well();
    // Cut in the middle, and near the end; empty; another format altogether; another program's; of the future; of the past.
    let whole = fs::read(at("paper-gsta-seed1.rrd")).unwrap();
    fs::write(at("half.rrd"), &whole[..whole.len() / 2]).unwrap();
    fs::write(at("empty.rrd"), "").unwrap();
    fs::write(at("text.rrd"), "something else altogether, long enough for a header").unwrap();
    fs::create_dir(place.path().join("cut")).unwrap();
    fs::write(place.path().join("cut/most.rrd"), &whole[..whole.len() * 95 / 100]).unwrap();
    let mut other = whole;
    for i in 0..other.len() - 9 {
        if &other[i..i + 9] == b"supertwin" {
            other[i..i + 9].copy_from_slice(b"othertool");
        }
    }
    fs::write(at("other.rrd"), other).unwrap();
    for (name, format) in [("future.rrd", 99u64), ("past.rrd", 0)] {
        let mut sink = RerunSink::create(&at(name), Options::default()).unwrap();
        let properties = Properties::from([("format".to_owned(), format.into())]);
        sink.begin(&RunHeader { name: name.to_owned(), properties, ..RunHeader::default() }).unwrap();
        sink.finish(&Properties::new()).unwrap();
    }
    let spoiled = tampered(&at("nan.rrd"), ["trial.duration_s=23", "trial.score.from_s=17"], 9, |run| {
        run.at = (1000, "estimator/nav/velocity");
        run.number = |_| f64::NAN;
    });
    assert!(spoiled);

    let done = place.call(&["compare", "runs", "--json", "--window", "17:23"]);
    assert_eq!(done.code, Some(2), "{}", done.err);
    let comparison = done.json();
    let reasons = reasons(&comparison);
    for (name, reason) in [
        ("bluerov2-bluerov2-pid-seed1.rrd", "vehicle = \"bluerov2\": the others have \"argus-mini\""),
        ("paper-pid-seed1.rrd", "only 1.00 of 6.00 s of the window were recorded; name a shorter one with --window"),
        ("half.rrd", "was not recorded: scores need it"),
        ("empty.rrd", "the file is empty"),
        ("text.rrd", "not a recording"),
        ("other.rrd", "a recording of \"othertool\""),
        ("future.rrd", "format = 99: must be at most 1; a newer supertwin wrote this"),
        ("past.rrd", "format = 0: must be 1; an older supertwin wrote this"),
        ("nan.rrd", "estimator/nav/velocity is not finite at tick 1000"),
    ] {
        let said = reasons.get(name).unwrap_or_else(|| panic!("{name} is not among {reasons:#?}"));
        assert!(said.contains(reason), "{name}: {said}");
        assert!(done.err.contains(&format!("error: runs/{name}: ")), "{}", done.err);
    }
    assert_eq!(reasons.len(), 9, "{reasons:#?}");
    let names = comparison["runs"].as_array().unwrap().iter().map(|run| run["name"].as_str().unwrap());
    assert!(names.eq(["paper-gsta-seed1", "paper-gsta-seed2"]), "{comparison:#}");

    // With a window that it has, what is left of a damaged file is compared as well, with a warning.
    let most = ["compare", "cut/most.rrd", "runs/paper-gsta-seed2.rrd", "--window", "0:5", "--json"];
    let most = place.call(&most).well();
    assert!(most.err.contains("warning: cut/most.rrd: not closed: "), "{most:?}");
    assert_eq!(most.json()["runs"].as_array().unwrap().len(), 2);

    let nothing = place.call(&["compare", "runs/empty.rrd", "runs/text.rrd"]).refused("text.rrd: not a recording");
    assert!(nothing.refused("none of these runs can be compared").out.is_empty());
    // By their own windows, runs that are scored elsewhere are told from the others.
    let own = place.call(&["compare", "runs/paper-gsta-seed1.rrd", "runs/paper-pid-seed1.rrd"]).well();
    assert!(own.out.contains("(paper-gsta: 17.00 to 23.00 s, paper-pid: 5.00 to 18.00 s; --window makes"), "{own:?}");
    place.call(&["compare", "runs", "--baseline", "runs/nan.rrd"]).refused("not finite at tick 1000");
}

#[test]
fn every_metric_is_explained() {
    let place = Place::new();
    let help = place.call(&["compare", "--metrics", "help"]).well().out;
    for metric in supertwin_lab::metrics::all_metrics() {
        assert!(help.contains(metric.family.about) && help.contains(metric.family.name), "{}", metric.name);
    }
    assert!(help.contains("measured.distance_m [m], speed_m_per_s [m/s]") && help.contains("√(Σeᵢ²/n)"), "{help}");
    place.call(&["compare"]).refused("name the recordings to compare");
}

#[test]
fn a_deployment_is_compared_by_its_latency_and_loss() {
    let place = Place::new();
    let trial = following(place.path());
    // On a quiet machine real time repeats itself bit for bit, and the same run counts once: other seeds are other runs.
    for (out, seed) in [("one", "1"), ("two", "2")] {
        let words = ["up", "--json", "--vehicle", "rov", "--trial", &trial, "--listen", &place.socket];
        place.call(&[&words[..], &["--duration", "6", "--record", out, "--seed", seed]].concat()).well();
    }
    let metrics = "measured,loop_us,step_us,*_max,messages_lost,recorder_lag_ms,unrecorded_share";
    let words = ["compare", "--json", "--window", "1.5:", "one", "two", "--each", "--metrics", metrics];
    let done = place.call(&words);
    let comparison = done.json();
    let runs = comparison["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 2, "{}", done.err);
    for run in runs {
        let value = |name: &str| run["values"][name].as_f64().unwrap_or_else(|| panic!("no {name} in {run:#}"));
        let [median, p99, max] = ["loop_us.median", "loop_us.p99", "loop_us.max"].map(value);
        assert!(0.0 < median && median <= p99 && p99 <= max, "{run:#}");
        assert!(value("step_us.controller") > 0.0 && value("messages_lost") >= 0.0 && value("transport_ms_max") >= 0.0);
        assert!(value("recorder_lag_ms.median") <= value("recorder_lag_ms.p99"));
        assert!((0.0..0.5).contains(&value("unrecorded_share")), "{run:#}");
    }
    assert!(comparison["groups"].as_array().unwrap().iter().all(|group| group["placement"] == "realtime"));
}
