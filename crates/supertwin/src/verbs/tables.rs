//! Tables of scores: the paper's table IV beside ours, and what the accuracy cost.

use crate::terminal::{aligned, framed_table};
use supertwin_core::signal::tracking::QUANTITIES;
use supertwin_lab::Scores;
use supertwin_lab::paper::table_iv;
use supertwin_lab::statistics::{mean, standard_deviation};
use supertwin_operations::run::{FinishedRun, title};

/// Runs of one trial and controller.
struct TrialRuns<'a> {
    title: String,
    runs: Vec<&'a FinishedRun>,
}

impl TrialRuns<'_> {
    /// Mean, and standard deviation when several seeds ran.
    fn cell(&self, digits: usize, value: impl Fn(&Scores) -> f64) -> String {
        let values: Vec<f64> = self.runs.iter().map(|run| value(&run.scores)).collect();
        let deviation = standard_deviation(&values).map_or_else(String::new, |one| format!(" ± {one:.digits$}"));
        format!("{:.digits$}{deviation}", mean(&values))
    }
}

fn groups<'a>(done: &[&'a FinishedRun]) -> Vec<TrialRuns<'a>> {
    let mut groups: Vec<TrialRuns<'_>> = Vec::new();
    for &run in done {
        let title = title(&run.trial, &run.controller);
        match groups.iter_mut().find(|group| group.title == title) {
            Some(group) => group.runs.push(run),
            None => groups.push(TrialRuns { title, runs: vec![run] }),
        }
    }
    groups
}

/// All tables as one text.
pub(crate) fn scores(done: &[&FinishedRun]) -> String {
    let groups = groups(done);
    let seeds = groups.iter().map(|group| group.runs.len()).max().unwrap_or(0);
    let over = if seeds > 1 { format!(", mean ± standard deviation over {seeds} seeds") } else { String::new() };
    let mut text = format!("Root-mean-square error of the measured signals{over}\n");

    let mut header = vec!["measured".to_owned()];
    for group in &groups {
        if group.runs[0].paper.is_some() {
            header.push("paper IV".to_owned());
        }
        header.push(group.title.clone());
    }
    let mut measured = framed_table(header);
    for (i, quantity) in QUANTITIES.iter().enumerate() {
        let mut cells = vec![quantity.label()];
        for group in &groups {
            if let Some(column) = group.runs[0].paper {
                cells.push(format!("{:.3}", table_iv(column)[i]));
            }
            cells.push(group.cell(3, |scores| scores.measured.to_array()[i]));
        }
        measured.add_row(cells);
    }
    text += &aligned(measured, 1..);

    text += "\n\nThe same of the true signals, which no field trial knows, and what it cost\n";
    let mut header = vec!["true".to_owned()];
    header.extend(groups.iter().map(|group| group.title.clone()));
    let mut truth = framed_table(header);
    let mut row = |name: &str, digits: usize, value: &dyn Fn(&Scores) -> f64| {
        let mut cells = vec![name.to_owned()];
        cells.extend(groups.iter().map(|group| group.cell(digits, value)));
        truth.add_row(cells);
    };
    for (i, quantity) in QUANTITIES.iter().enumerate() {
        row(&quantity.label(), 3, &|scores| scores.truth.to_array()[i]);
    }
    row("Sway bias in travel [m/s]", 3, &|scores| scores.sway_bias_in_travel_direction_m_per_s);
    row("Thrust activity surge [N/s]", 1, &|scores| scores.activity.surge);
    row("Thrust activity sway [N/s]", 1, &|scores| scores.activity.sway);
    row("Thrust activity heave [N/s]", 1, &|scores| scores.activity.heave);
    row("Thrust activity yaw [N m/s]", 2, &|scores| scores.activity.yaw);
    for (axis, name) in supertwin_core::axes::AXIS_NAMES.iter().enumerate() {
        row(&format!("k1 {name} at the end"), 1, &|scores| scores.k1_end.to_array()[axis]);
    }
    text + &aligned(truth, 1..)
}
