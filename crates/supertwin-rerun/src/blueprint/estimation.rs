//! Does the vehicle know where it is? The filter's surprises, its own doubts, and the net in front.

use super::Description;
use super::views::{Canvas, Curves, Legend, all, only};
use crate::style;
use rerun::blueprint::{ContainerLike, Grid, Horizontal, Vertical};

/// Room for a legend in a narrow plot.
const NARROW: Legend = Legend::Beside(0.5);

pub(super) static DASHBOARD: Description = Description {
    name: "estimation",
    about: "innovations with their gates, NIS, deviations, disturbance, beams, net plane",
    suits: |_| true,
    views: Some(views),
};

fn views(canvas: &mut Canvas) -> ContainerLike {
    let mut plots = Vec::new();
    let innovation = |name: &str| vec![all(&format!("/derived/innovation/{name}"))];
    let nis =
        |names: &[&str]| -> Vec<Curves> { names.iter().map(|name| all(&format!("/derived/nis/{name}"))).collect() };
    for (title, name) in [
        ("DVL surge innovation, bounds [m/s]", "surge"),
        ("DVL sway innovation, bounds [m/s]", "sway"),
        ("DVL heave innovation, bounds [m/s]", "heave"),
    ] {
        plots.push(canvas.plot(title, &innovation(name), Legend::None));
    }
    plots.push(canvas.plot("DVL NIS [1]", &nis(&["dvl"]), NARROW));
    for (title, name) in [
        ("Depth innovation, bounds [m]", "depth"),
        ("Heading innovation, bounds [rad]", "heading"),
        ("Yaw rate innovation, bounds [rad/s]", "yaw_rate"),
    ] {
        plots.push(canvas.plot(title, &innovation(name), Legend::None));
    }
    plots.push(canvas.plot("Depth, heading, yaw rate NIS [1]", &nis(&["depth", "heading", "yaw_rate"]), NARROW));
    for (i, axis) in ["Surge", "Sway", "Heave", "Yaw"].into_iter().enumerate() {
        // The truth is a part of what the filter calls disturbance: current and buoyancy are in it too.
        let estimate = only("/estimator/nav/disturbance", i, 4).in_color(style::MEASURED);
        let tether = only("/plant/truth/disturbance", i, 4).in_color(style::TRUE);
        let unit = if axis == "Yaw" { "N m" } else { "N" };
        let title = format!("{axis} disturbance, green: tether [{unit}]");
        plots.push(canvas.plot(&title, &[estimate, tether], Legend::None));
    }
    plots.push(canvas.plot("DVL ranges, 0: no echo [m]", &[all("/plant/measurements/dvl_range")], NARROW));
    plots.push(canvas.plot("DVL beams used [count]", &[all("/derived/beams_used")], Legend::None));
    plots.push(canvas.plot("DVL beam parity [1/m]", &[all("/estimator/net_plane/parity")], Legend::None));
    plots.push(canvas.plot("Net plane innovations [1/m]", &[all("/estimator/net_plane/innovation")], NARROW));
    let grid = Grid::new(plots).with_grid_columns(4);

    let mut narrow = |name: &str, path: &str| canvas.plot(name, &[all(path)], NARROW);
    let velocity = narrow("Velocity std. deviation [m/s, rad/s]", "/derived/std/velocity");
    let pose = narrow("Pose std. deviation [m, rad]", "/derived/std/pose");
    let disturbance = narrow("Disturbance std. deviation [N, N m]", "/derived/std/disturbance");
    let health = canvas.lanes("Estimator health", &["/derived/health/**"]);
    let column = Vertical::new([velocity, pose, disturbance, health]).with_row_shares([1.0, 0.8, 1.0, 1.5]);
    Horizontal::new([grid.into(), column.into()]).with_column_shares([4.0, 1.05]).with_name("Estimation").into()
}
