//! Does the vehicle do what it should? The paper's figures 3, 4 and 6, with the truth beside them.

use super::Description;
use super::views::{Canvas, Legend, all};
use rerun::blueprint::{ContainerLike, Grid, Vertical};

pub(super) static DASHBOARD: Description = Description {
    name: "tracking",
    about: "measured, wanted and true signals: the paper's figures 3, 4 and 6",
    suits: |_| true,
    views: Some(views),
};

fn views(canvas: &mut Canvas) -> ContainerLike {
    let plots = [
        ("Distance to net [m]", "/tracking/distance"),
        ("Total speed [m/s]", "/tracking/speed"),
        ("Surge speed [m/s]", "/tracking/surge"),
        ("Sway speed [m/s]", "/tracking/sway"),
        ("Depth [m]", "/tracking/depth"),
        ("Heading [rad]", "/tracking/heading"),
    ];
    let plots: Vec<_> =
        plots.iter().map(|(name, path)| canvas.plot(name, &[all(path)], Legend::Beside(0.16))).collect();
    let mode = canvas.lanes("Guidance mode", &["/guidance/reference/mode"]);
    let six = Grid::new(plots).with_grid_columns(2);
    Vertical::new([six.into(), mode]).with_row_shares([7.0, 1.0]).with_name("Tracking").into()
}
