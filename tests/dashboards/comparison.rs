//! The dashboard of a comparison, in pictures.

use super::{LEAST, RECORDINGS, draw, folder, job, record};
use crate::support::{CONFIG, python};
use serde_json::Value;
use std::path::{Path, PathBuf};
use supertwin_core::Property;
use supertwin_lab::statistics::{mean, standard_deviation};
use supertwin_lab::{Library, metrics};
use supertwin_rerun::blueprint::{Dashboard, TABS, View};
use supertwin_rerun::merge::{Better, Cell, ScoreRow, Scores};
use supertwin_rerun::{Merge, Merged, MergedRun, merge, read_selected};

/// Measured errors that the paper has in its table IV, and what they cost.
const METRICS: &str = "measured.distance_m measured.speed_m_per_s measured.surge_m_per_s measured.sway_m_per_s \
                       measured.depth_m measured.heading_rad activity.surge activity.heave";

/// Mean and standard deviation of what these runs left in their properties.
fn score(paths: &[&Path], name: &str) -> Cell {
    let value = |path: &&Path| match read_selected(path, &|_| false).unwrap().properties["result"][name] {
        Property::Number(value) => value,
        _ => panic!("{name} is no number"),
    };
    let values: Vec<f64> = paths.iter().map(value).collect();
    Cell { value: mean(&values), plus_minus: standard_deviation(&values) }
}

/// Merges the paper's trials, each with as many recordings as there are; GSTA is what the others are held against.
fn compare(name: &str, trials: &[(&str, Vec<&Path>)]) -> (PathBuf, Merged) {
    let mut all = Merge { name: name.to_owned(), ..Merge::default() };
    for (group, (trial, paths)) in trials.iter().enumerate() {
        all.groups.push((*trial).to_owned());
        for (i, path) in paths.iter().enumerate() {
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            let against = (group > 0).then_some(i);
            all.runs.push(MergedRun { name, paths: vec![path.to_path_buf()], offset_ns: 0, group, against });
        }
    }
    let row = |name: &str| ScoreRow {
        name: name.to_owned(),
        title: metrics::named(name).unwrap().title.clone(),
        unit: metrics::named(name).unwrap().unit.to_owned(),
        cells: trials.iter().map(|(_, paths)| Some(score(paths, name))).collect(),
        better: Better::Lower,
        chart: true,
    };
    all.scores = Scores { rows: METRICS.split(' ').map(row).collect(), ..Scores::default() };
    let best = |row: &ScoreRow| row.cells.iter().flatten().map(|cell| cell.value).fold(f64::INFINITY, f64::min);
    for row in &all.scores.rows {
        let best = row.cells.iter().position(|cell| cell.unwrap().value <= best(row)).unwrap();
        all.scores.verdicts.push(format!("{}: **{}** has least.", row.title, all.groups[best]));
    }
    let path = folder().join(format!("{name}.rrd"));
    let merged = merge(&all, &path, true).unwrap();
    (path, merged)
}

/// Colours of the curves in a plot of a comparison, which has them written down.
fn colors(view: &View) -> Vec<[u8; 3]> {
    let bytes = view.curves.iter().map(|curves| curves.color.unwrap_or_default().to_be_bytes());
    bytes.map(|[r, g, b, _]| [r, g, b]).collect()
}

/// Draws every tab of a comparison to `<name>-<tab>.png`, and says which curves can't be seen.
fn look(name: &str, path: &Path, merged: &Merged) -> Vec<String> {
    let tabs = TABS.iter().map(|tab| {
        let dashboard = Dashboard::compare(&merged.compared, Some(tab.name));
        job(&format!("{name}-{}", tab.name.replace(' ', "-")), dashboard, colors)
    });
    let (jobs, plots): (Vec<Value>, Vec<Vec<View>>) = tabs.unzip();
    if !*python::CAN_DRAW {
        return Vec::new();
    }
    let counts = draw(name, path, &jobs, &[]);
    let mut wrong = Vec::new();
    for view in plots.iter().flatten() {
        let (none, of_curves) = counts[&view.id].split_last().unwrap();
        for (curves, pixels) in view.curves.iter().zip(of_curves).filter(|(_, pixels)| **pixels < LEAST) {
            wrong.push(format!("{name}: {}: {} has {pixels} pixels", view.name, curves.entity));
        }
        if *none >= LEAST {
            wrong.push(format!("{name}: {}: {none} pixels of none", view.name));
        }
    }
    wrong
}

#[test]
fn a_comparison_shows_who_is_better_where() {
    let laws = ["paper-gsta", "paper-agsta", "paper-pid"];
    let one = |law| (law, vec![RECORDINGS[law].0.as_path()]);
    let (path, merged) = compare("compare-one", &laws.map(one));
    assert_eq!((merged.runs, merged.every_ticks, merged.compared.several), (3, 1, false));
    let mut wrong = look("compare-one", &path, &merged);

    // Several seeds of each, half a minute long.
    let shorter = "trial.duration_s=40".parse().unwrap();
    let library = Library::new(CONFIG, vec![shorter]);
    let record = |law: &str, seed: u64| record(&library, law, Some(seed), &format!("compare-{law}-seed{seed}"));
    let seeds = laws.map(|law| (1..=4).map(|seed| record(law, seed)).collect::<Vec<_>>());
    let many: Vec<_> =
        laws.iter().zip(&seeds).map(|(law, paths)| (*law, paths.iter().map(PathBuf::as_path).collect())).collect();
    let (path, merged) = compare("compare-many", &many);
    assert_eq!((merged.runs, merged.compared.several), (12, true));
    wrong.extend(look("compare-many", &path, &merged));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
