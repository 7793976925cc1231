//! Figures of a report: intervals per configuration, and scores over a swept parameter. SVG, the same bytes each time.

use plotters::coord::Shift;
use plotters::prelude::*;

/// Colours that people with any colour vision can tell apart (Okabe and Ito).
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(90, 90, 90),
];

/// Panels beside each other.
const ACROSS: usize = 3;
const PANEL_WIDTH: u32 = 380;
/// Height of the strip with the names of colours.
const LEGEND: u32 = 20;
const FONT: &str = "sans-serif";

/// One score, with a row for each configuration.
pub(super) struct IntervalPanel {
    pub(super) title: String,
    pub(super) rows: Vec<IntervalRow>,
}

/// Runs of one configuration.
pub(super) struct IntervalRow {
    pub(super) label: String,
    /// Index of its colour.
    pub(super) colour: usize,
    pub(super) values: Vec<f64>,
    pub(super) mean: f64,
    /// Bounds of the interval of the mean.
    pub(super) interval: Option<(f64, f64)>,
}

/// One score over one parameter.
pub(super) struct ScatterPanel {
    pub(super) title: String,
    pub(super) series: Vec<Series>,
}

/// Points of one controller.
pub(super) struct Series {
    pub(super) label: String,
    pub(super) colour: usize,
    pub(super) points: Vec<(f64, f64)>,
}

type Drawn<T = ()> = Result<T, Box<dyn std::error::Error>>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Every run as a dot, the mean as a bar across, its interval as a thick line.
pub(super) fn intervals(title: &str, panels: &[IntervalPanel]) -> Drawn<String> {
    let rows = panels.iter().map(|panel| panel.rows.len()).max().unwrap_or(0) as u32;
    sheet(title, &[], panels, 70 + 24 * rows.max(2), interval_panel)
}

/// A dot per run.
pub(super) fn scatter(title: &str, panels: &[ScatterPanel]) -> Drawn<String> {
    let mut legend: Vec<(&str, usize)> = Vec::new();
    for series in panels.iter().flat_map(|panel| &panel.series) {
        if !legend.contains(&(series.label.as_str(), series.colour)) {
            legend.push((&series.label, series.colour));
        }
    }
    sheet(title, &legend, panels, 280, scatter_panel)
}

/// Panels below a title; names of colours stand beside each other below it.
fn sheet<P>(
    title: &str,
    legend: &[(&str, usize)],
    panels: &[P],
    height: u32,
    draw: impl Fn(&Area<'_>, &P) -> Drawn,
) -> Drawn<String> {
    let down = panels.len().div_ceil(ACROSS);
    let size = (PANEL_WIDTH * ACROSS as u32, 34 + LEGEND * u32::from(!legend.is_empty()) + height * down as u32);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        let mut root = root.titled(title, (FONT, 18))?;
        if !legend.is_empty() {
            let (strip, rest) = root.split_vertically(LEGEND);
            let mut x = 12;
            for (label, colour) in legend {
                let dot = Circle::new((x, 8), 4, COLOURS[colour % COLOURS.len()].filled());
                let text = Text::new((*label).to_owned(), (x + 10, 2), (FONT, 12));
                strip.draw(&dot).and_then(|()| strip.draw(&text))?;
                x += 36 + 7 * label.chars().count() as i32;
            }
            root = rest;
        }
        for (area, panel) in root.split_evenly((down, ACROSS)).iter().zip(panels) {
            draw(area, panel)?;
        }
        root.present()?;
    }
    Ok(svg)
}

fn interval_panel(area: &Area<'_>, panel: &IntervalPanel) -> Drawn {
    let ends = panel.rows.iter().flat_map(|row| row.interval.into_iter().flat_map(|(low, high)| [low, high]));
    let all = panel.rows.iter().flat_map(|row| row.values.iter().copied()).chain(ends);
    let (from, to) = range(all);
    let n = panel.rows.len() as i32;
    let widest = panel.rows.iter().map(|row| row.label.chars().count()).max().unwrap_or(0) as u32;
    let mut chart = ChartBuilder::on(area)
        .caption(&panel.title, (FONT, 14))
        .margin(6)
        .x_label_area_size(24)
        .y_label_area_size((12 + 7 * widest).min(PANEL_WIDTH / 2))
        // The first configuration is on top.
        .build_cartesian_2d(from..to, (0..n).into_segmented())?;
    let row = |y: &SegmentValue<i32>| match y {
        SegmentValue::CenterOf(i) => usize::try_from(n - 1 - i).ok().and_then(|i| panel.rows.get(i)),
        _ => None,
    };
    chart
        .configure_mesh()
        .disable_y_mesh()
        .light_line_style(TRANSPARENT)
        .x_labels(5)
        .y_labels(panel.rows.len())
        .x_label_formatter(&|x| short(*x))
        .y_label_formatter(&|y| row(y).map(|row| row.label.clone()).unwrap_or_default())
        .label_style((FONT, 12))
        .draw()?;
    for (i, row) in panel.rows.iter().enumerate() {
        let y = SegmentValue::CenterOf(n - 1 - i as i32);
        let colour = COLOURS[row.colour % COLOURS.len()];
        let dots = row.values.iter().map(|x| Circle::new((*x, y.clone()), 3, colour.mix(0.25).filled()));
        chart.draw_series(dots)?;
        if let Some((low, high)) = row.interval {
            let line = PathElement::new(vec![(low, y.clone()), (high, y.clone())], colour.stroke_width(5));
            chart.draw_series([line])?;
        }
        chart.draw_series([Circle::new((row.mean, y.clone()), 4, BLACK.filled())])?;
    }
    Ok(())
}

fn scatter_panel(area: &Area<'_>, panel: &ScatterPanel) -> Drawn {
    let points = || panel.series.iter().flat_map(|series| series.points.iter().copied());
    let (from, to) = range(points().map(|point| point.0));
    let (low, high) = range(points().map(|point| point.1));
    let mut chart = ChartBuilder::on(area)
        .caption(&panel.title, (FONT, 14))
        .margin(6)
        .x_label_area_size(24)
        .y_label_area_size(48)
        .build_cartesian_2d(from..to, low..high)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_labels(5)
        .y_labels(5)
        .x_label_formatter(&|x| short(*x))
        .y_label_formatter(&|y| short(*y))
        .label_style((FONT, 12))
        .draw()?;
    for series in &panel.series {
        let colour = COLOURS[series.colour % COLOURS.len()];
        let dots = series.points.iter().map(|point| Circle::new(*point, 3, colour.mix(0.5).filled()));
        chart.draw_series(dots)?;
    }
    Ok(())
}

/// A range with a margin around all values.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    match high - low {
        width if width > 0.0 && width.is_finite() => (low - 0.05 * width, high + 0.05 * width),
        _ if low.is_finite() => (low - 0.5 * low.abs().max(1e-6), low + 0.5 * low.abs().max(1e-6)),
        _ => (0.0, 1.0),
    }
}

/// A number at an axis.
fn short(number: f64) -> String {
    // Three digits that count, without the noise of adding steps up.
    let digits = if number == 0.0 { 0 } else { (2 - number.abs().log10().floor() as i32).clamp(0, 6) };
    let text = format!("{number:.*}", digits as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel() -> IntervalPanel {
        let row = |label: &str, colour, shift: f64| IntervalRow {
            label: label.to_owned(),
            colour,
            values: (0..5).map(|i| shift + 0.01 * f64::from(i)).collect(),
            mean: shift + 0.02,
            interval: Some((shift + 0.01, shift + 0.03)),
        };
        IntervalPanel { title: "Sway [m/s]".to_owned(), rows: vec![row("agsta", 0, 0.05), row("pid", 1, 0.1)] }
    }

    #[test]
    fn a_figure_names_what_it_shows_and_repeats() {
        let first = intervals("fair", &[panel()]).expect("is drawn");
        for word in ["<svg", "fair", "Sway [m/s]", "agsta", "pid"] {
            assert!(first.contains(word), "{word} is missing in {first}");
        }
        assert_eq!(first.matches("<circle").count(), 12, "ten runs and two means");
        assert_eq!(intervals("fair", &[panel()]).expect("is drawn"), first);
        let series =
            |label: &str, colour| Series { label: label.to_owned(), colour, points: vec![(0.1, 1.0), (0.2, 2.0)] };
        let panel = ScatterPanel { title: "Depth [m]".to_owned(), series: vec![series("a", 0), series("b", 1)] };
        let drawn = scatter("over waves", &[panel]).expect("is drawn");
        assert!(
            drawn.contains("over waves") && drawn.matches("<circle").count() == 6 && drawn.contains(">\na\n"),
            "{drawn}"
        );
    }

    #[test]
    fn one_value_or_none_has_a_range_too() {
        assert_eq!(range([2.0].into_iter()), (1.0, 3.0));
        assert_eq!(range([0.0].into_iter()), (-5e-7, 5e-7));
        assert_eq!(range([].into_iter()), (0.0, 1.0));
        assert_eq!([0.1 + 0.2, 0.0, 120.0, -0.05].map(short), ["0.3", "0", "120", "-0.05"]);
    }
}
