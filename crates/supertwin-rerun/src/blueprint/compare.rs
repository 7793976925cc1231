//! Which of several runs is better where? Scores, curves over each other, errors, differences, paths.
//!
//! It depends on the names of the runs, so it stands only in files that [`mod@crate::merge`] writes.

use super::About;
use super::views::{Canvas, Curves, Legend};
use rerun::blueprint::{ContainerLike, Grid, Horizontal, Vertical};
use std::collections::BTreeMap;
use supertwin_core::Signal;
use supertwin_core::axes::AXIS_NAMES;
use supertwin_core::signal::controller;
use supertwin_core::signal::tracking::{QUANTITIES, Quantity};

/// What there is to compare, and where it stands in the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Compared {
    /// Which stretch of time the plots show.
    pub(crate) about: About,
    /// Curves by plot: `curve/sway`, `error/sway`, …
    pub(crate) plots: BTreeMap<String, Vec<Curves>>,
    /// Title and entities of every bar chart.
    pub(crate) bars: Vec<(String, Vec<String>)>,
    /// Modes of guidance.
    pub(crate) lanes: Vec<String>,
    /// There is a picture.
    pub(crate) scene: bool,
    /// Labels are groups of several runs.
    pub several: bool,
    /// What the others are held against.
    pub(crate) baseline: Option<String>,
    /// What 0 s is.
    pub(crate) aligned_on: String,
}

/// Tabs of the dashboard of comparisons, from left to right.
pub static TABS: [Tab; 6] = [
    Tab { name: "scores", views: scores },
    Tab { name: "curves", views: curves },
    Tab { name: "errors", views: errors },
    Tab { name: "true errors", views: true_errors },
    Tab { name: "differences", views: differences },
    Tab { name: "adaptation", views: adaptation },
];

/// A tab of the comparison.
#[derive(Debug)]
pub struct Tab {
    /// Title of the tab, as the viewer shows it.
    pub name: &'static str,
    /// Draws it; `None` when nothing of it was recorded.
    views: fn(&mut Canvas, &Compared) -> Option<ContainerLike>,
}

pub(super) fn tabs(canvas: &mut Canvas, compared: &Compared, only: Option<&str>) -> Vec<ContainerLike> {
    let wanted = TABS.iter().filter(|tab| only.is_none_or(|only| only == tab.name));
    wanted.filter_map(|tab| (tab.views)(canvas, compared)).collect()
}

fn scores(canvas: &mut Canvas, compared: &Compared) -> Option<ContainerLike> {
    let mut left = vec![canvas.document("Scores and verdicts", "/compare/scores/text")];
    if compared.scene {
        left.push(canvas.picture(
            "Paths",
            "/compare/scene",
            &["/compare/scene/**"],
            [-36.0, -36.0, -38.0],
            [0.0, 0.0, 9.0],
        ));
    }
    let left = Vertical::new(left).with_row_shares([2.0, 1.0]).into();
    // Bars have no names of their own; the legend of this plot is theirs as well.
    let by_speed = [1_usize, 0, 2, 3, 4, 5].map(|i| &QUANTITIES[i]);
    let there =
        by_speed.iter().find(|quantity| compared.plots.contains_key(&format!("rms/{}", quantity.signal.name())));
    let key = there.map(|quantity| {
        let title =
            format!("Legend; {}: RMS error over 10 s [{}]", quantity.title.to_lowercase(), quantity.signal.unit(0));
        (format!("rms/{}", quantity.signal.name()), title)
    });
    let mut right = plots(canvas, compared, key);
    let charts: Vec<_> = compared.bars.iter().map(|(title, entities)| canvas.bars(title, entities)).collect();
    let rows = charts.len().div_ceil(2) as f32;
    if !charts.is_empty() {
        right.push(Grid::new(charts).with_grid_columns(2).into());
    }
    let right = Vertical::new(right).with_row_shares([1.25, rows]).into();
    Some(Horizontal::new([left, right]).with_column_shares([1.0, 1.0]).with_name("Scores").into())
}

fn curves(canvas: &mut Canvas, compared: &Compared) -> Option<ContainerLike> {
    let wanted = QUANTITIES.iter().map(|quantity| {
        let what = if compared.several && quantity.is_angle() { " minus reference" } else { "" };
        (format!("curve/{}", quantity.signal.name()), format!("{}{what} [{}]", quantity.title, quantity.signal.unit(0)))
    });
    let plots = plots(canvas, compared, wanted);
    if plots.is_empty() {
        return None;
    }
    let mut rows: Vec<ContainerLike> = vec![Grid::new(plots).with_grid_columns(2).into()];
    if !compared.lanes.is_empty() {
        rows.push(canvas.lanes("Guidance mode", &compared.lanes));
    }
    Some(Vertical::new(rows).with_row_shares([6.0, 1.5]).with_name("Curves").into())
}

fn errors(canvas: &mut Canvas, compared: &Compared) -> Option<ContainerLike> {
    let mut wanted = per_quantity("rms/", |title, unit| format!("{title}: RMS error over 10 s [{unit}]"));
    wanted.extend(per_quantity("error/", |title, unit| format!("{title} minus reference [{unit}]")));
    grid("Errors", 3, plots(canvas, compared, wanted))
}

fn true_errors(canvas: &mut Canvas, compared: &Compared) -> Option<ContainerLike> {
    let wanted = per_quantity("true_rms/", |title, unit| format!("{title}: true RMS error over 10 s [{unit}]"));
    grid("True errors", 2, plots(canvas, compared, wanted))
}

fn differences(canvas: &mut Canvas, compared: &Compared) -> Option<ContainerLike> {
    let baseline = compared.baseline.as_deref().unwrap_or("baseline");
    let mut wanted =
        per_quantity("difference/rms_", |title, unit| format!("{title}: RMS error minus that of {baseline} [{unit}]"));
    wanted.extend(per_quantity("difference/", |title, unit| format!("{title} minus that of {baseline} [{unit}]")));
    grid("Differences", 3, plots(canvas, compared, wanted))
}

fn adaptation(canvas: &mut Canvas, compared: &Compared) -> Option<ContainerLike> {
    let per_axis = |kind: &'static str, title: &'static str, signal: &'static Signal| {
        let plot = move |(i, axis)| (format!("{kind}/{axis}"), format!("{title}, {axis} [{}]", signal.unit(i)));
        AXIS_NAMES.iter().enumerate().map(plot)
    };
    let sigma = per_axis("sigma", "Sliding variable σ", &controller::SIGMA);
    let k1 = per_axis("k1", "Gain k1", &controller::K1);
    let plots = plots(canvas, compared, sigma.chain(k1));
    let columns = if plots.len() > 4 { 4 } else { 2 };
    grid("Adaptation", columns, plots)
}

/// Where the curves of each quantity are, and the title of their plot.
fn per_quantity(kind: &str, title: impl Fn(&str, &str) -> String) -> Vec<(String, String)> {
    let plot = |quantity: &Quantity| {
        (format!("{kind}{}", quantity.signal.name()), title(quantity.title, quantity.signal.unit(0)))
    };
    QUANTITIES.iter().map(plot).collect()
}

/// Plots of those that there are. The colours are the same in all of them, so the first one explains them.
fn plots(
    canvas: &mut Canvas,
    compared: &Compared,
    wanted: impl IntoIterator<Item = (String, String)>,
) -> Vec<ContainerLike> {
    let mut plots = Vec::new();
    for (kind, title) in wanted {
        if let Some(curves) = compared.plots.get(&kind) {
            let legend = if plots.is_empty() { Legend::Over } else { Legend::None };
            plots.push(canvas.plot(&title, curves, legend));
        }
    }
    plots
}

fn grid(name: &str, columns: u32, plots: Vec<ContainerLike>) -> Option<ContainerLike> {
    (!plots.is_empty()).then(|| Grid::new(plots).with_grid_columns(columns).with_name(name).into())
}
