//! The scores beside the curves: a text that says who is better where, and a bar per metric and group.

use super::Label;
use crate::chunks::{Problem, fixed};
use rerun::EntityPath;
use rerun::log::Chunk;

/// What was scored, by whoever scored it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scores {
    /// Sentences that come first, such as "agsta is better than pid in sway: …"; Markdown.
    pub verdicts: Vec<String>,
    /// Metrics in their order.
    pub rows: Vec<ScoreRow>,
    /// What comes after the table, such as how the configurations differ; Markdown.
    pub notes: String,
}

/// A metric, with a value for every group.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScoreRow {
    /// Its place in the recording, such as `measured.sway_m_per_s`.
    pub name: String,
    /// What people read, such as `Sway, measured RMS error`.
    pub title: String,
    /// Its unit; empty when it has none.
    pub unit: String,
    /// One per group, in their order; `None` where it can't be said.
    pub cells: Vec<Option<Cell>>,
    /// Which value is the best.
    pub better: Better,
    /// It also stands in a bar chart.
    pub chart: bool,
}

/// A value, of one run or of many.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cell {
    /// Of one run, or the mean.
    pub value: f64,
    /// Standard deviation, or half of an interval, when there is one.
    pub plus_minus: Option<f64>,
}

/// Which values are better.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Better {
    /// Errors and efforts.
    #[default]
    Lower,
    /// Shares of time inside a tolerance.
    Higher,
    /// Biases: the value that is nearest to zero.
    NearZero,
    /// Neither: a fact.
    Neither,
}

impl ScoreRow {
    /// Places of the best; several when they are equal in what is printed, none when all are.
    pub(super) fn best(&self) -> Vec<usize> {
        let worth = |cell: &Cell| match self.better {
            Better::Lower => Some(cell.value),
            Better::Higher => Some(-cell.value),
            Better::NearZero => Some(cell.value.abs()),
            Better::Neither => None,
        };
        let known = |cell: &Option<Cell>| cell.filter(|cell| cell.value.is_finite());
        let worths: Vec<Option<f64>> = self.cells.iter().map(|cell| known(cell).as_ref().and_then(worth)).collect();
        let Some(least) = worths.iter().flatten().copied().reduce(f64::min) else { return Vec::new() };
        let printed = digits(least);
        let best: Vec<usize> =
            (0..worths.len()).filter(|&i| worths[i].is_some_and(|worth| digits(worth) == printed)).collect();
        // Alone, or all the same: nobody is better.
        if best.len() == worths.iter().flatten().count() { Vec::new() } else { best }
    }

    /// Its title with its unit.
    fn heading(&self) -> String {
        if self.unit.is_empty() { self.title.clone() } else { format!("{} [{}]", self.title, self.unit) }
    }

    /// The title of its chart: who is best first, as long titles are cut off.
    pub(super) fn chart_title(&self, labels: &[Label]) -> String {
        let best: Vec<&str> = self.best().into_iter().filter_map(|i| labels.get(i)).map(|label| &*label.name).collect();
        if best.is_empty() { self.heading() } else { format!("{} best: {}", best.join(", "), self.title) }
    }
}

/// Three digits that count.
fn digits(x: f64) -> String {
    let size = x.abs();
    match size {
        _ if !x.is_finite() => "–".to_owned(),
        _ if size >= 1e6 => format!("{x:.2e}"),
        _ if size >= 99.95 => format!("{x:.0}"),
        _ if size >= 9.995 => format!("{x:.1}"),
        _ if size >= 0.995 => format!("{x:.2}"),
        _ if size >= 1e-3 || size == 0.0 => format!("{x:.3}"),
        _ => format!("{x:.1e}"),
    }
}

/// The text in Markdown; `after` is what the file itself has to say.
pub(super) fn markdown(scores: &Scores, labels: &[Label], after: &str) -> String {
    let mut text = String::new();
    if !scores.rows.is_empty() {
        text += "# Scores\n\n|  |";
        labels.iter().for_each(|label| text += &format!(" {} |", cell(&label.name)));
        text += &format!("\n|---|{}\n", "---|".repeat(labels.len()));
        for row in &scores.rows {
            let best = row.best();
            text += &format!("| {} |", cell(&row.heading()));
            for i in 0..labels.len() {
                let value = row.cells.get(i).copied().flatten();
                let said = value.map_or_else(|| "–".to_owned(), |cell| cell_text(&cell));
                text += &if best.contains(&i) { format!(" **{said}** |") } else { format!(" {said} |") };
            }
            text += "\n";
        }
        text += "\n";
    }
    if !scores.verdicts.is_empty() {
        text += "# Verdicts\n\n";
        scores.verdicts.iter().for_each(|verdict| text += &format!("- {}\n", verdict.trim()));
        text += "\n";
    }
    if !scores.notes.trim().is_empty() {
        text += &format!("{}\n\n", scores.notes.trim());
    }
    text + after
}

fn cell_text(cell: &Cell) -> String {
    match cell.plus_minus {
        Some(spread) => format!("{} ± {}", digits(cell.value), digits(spread)),
        None => digits(cell.value),
    }
}

/// Text that does not end its cell.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

/// Where the bars of a metric are.
pub(super) fn bars_entity(row: &ScoreRow) -> EntityPath {
    EntityPath::from("compare/scores/metric").join(&EntityPath::from_single_string(row.name.as_str()))
}

/// A bar for every group that has a value, each in its colour and at its place.
pub(super) fn bars(row: &ScoreRow, labels: &[Label]) -> Result<Vec<Chunk>, Problem> {
    let bar = |(i, label): (usize, &Label)| {
        let cell = row.cells.get(i).copied().flatten().filter(|cell| cell.value.is_finite())?;
        let bar = rerun::BarChart::new(vec![cell.value])
            .with_abscissa(vec![i as f64])
            .with_widths([0.8_f32])
            .with_color(label.color);
        Some(fixed(bars_entity(row).join(&EntityPath::from_single_string(label.name.as_str())), &bar))
    };
    labels.iter().enumerate().filter_map(bar).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(values: &[Option<f64>], better: Better) -> ScoreRow {
        let cells = values.iter().map(|value| value.map(|value| Cell { value, plus_minus: None })).collect();
        let (name, title, unit) = ("sway".to_owned(), "Sway".to_owned(), "m/s".to_owned());
        ScoreRow { name, title, unit, cells, better, chart: true }
    }

    fn labels() -> Vec<Label> {
        ["a", "b|c", "d"].map(|name| Label { name: name.to_owned(), color: 0x56B4_E9FF }).into()
    }

    #[test]
    fn the_best_is_known_whatever_better_means() {
        let values = [Some(-0.5), None, Some(0.2)];
        assert_eq!(row(&values, Better::Lower).best(), [0]);
        assert_eq!(row(&values, Better::Higher).best(), [2]);
        assert_eq!(row(&values, Better::NearZero).best(), [2]);
        assert!(row(&values, Better::Neither).best().is_empty());
        // What prints alike is alike, and nobody is better than all the same.
        assert_eq!(row(&[Some(0.1), Some(0.100_01), Some(0.2)], Better::Lower).best(), [0, 1]);
        assert!(row(&[Some(0.1), Some(0.1), None], Better::Lower).best().is_empty());
        assert!(row(&[Some(f64::NAN), None], Better::Lower).best().is_empty());
    }

    #[test]
    fn the_text_has_the_best_in_bold_and_then_the_verdicts() {
        let mut scores = Scores {
            verdicts: vec!["a is better".to_owned()],
            rows: vec![row(&[Some(0.05), Some(12.345), None], Better::Lower)],
            notes: "They differ.".to_owned(),
        };
        scores.rows[0].cells[1].as_mut().unwrap().plus_minus = Some(0.5);
        let text = markdown(&scores, &labels(), "The end.");
        assert!(text.starts_with("# Scores\n\n|  | a |"), "{text}");
        assert!(text.contains("\n\n# Verdicts\n\n- a is better\n"), "{text}");
        assert!(text.contains("|  | a | b\\|c | d |\n|---|---|---|---|\n"), "{text}");
        assert!(text.contains("| Sway [m/s] | **0.050** | 12.3 ± 0.500 | – |\n"), "{text}");
        assert!(text.ends_with("They differ.\n\nThe end."), "{text}");
        assert_eq!(scores.rows[0].chart_title(&labels()), "a best: Sway");
        assert_eq!(bars(&scores.rows[0], &labels()).unwrap().len(), 2);
    }
}
