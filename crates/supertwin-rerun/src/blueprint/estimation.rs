//! Does the vehicle know where it is? The filter's surprises, its own doubts, and the net in front.

use super::views::{Canvas, Legend, all, only, siblings};
use crate::{signals, style};
use rerun::blueprint::{ContainerLike, Grid, Horizontal, Vertical};
use supertwin_core::signal::measurements::dvl;
use supertwin_core::signal::{Component, estimator, nav, truth};

/// Room for a legend in a narrow plot.
const NARROW: Legend = Legend::Beside(0.5);

pub(super) fn views(canvas: &mut Canvas) -> ContainerLike {
    let mut plots = Vec::new();
    for (title, signal) in [
        ("DVL surge innovation, bounds", &signals::INNOVATION_SURGE),
        ("DVL sway innovation, bounds", &signals::INNOVATION_SWAY),
        ("DVL heave innovation, bounds", &signals::INNOVATION_HEAVE),
    ] {
        plots.push(canvas.signal(title, signal, Legend::None));
    }
    plots.push(canvas.signal("DVL NIS", &signals::NIS_DVL, NARROW));
    for (title, signal) in [
        ("Depth innovation, bounds", &signals::INNOVATION_DEPTH),
        ("Heading innovation, bounds", &signals::INNOVATION_HEADING),
        ("Yaw rate innovation, bounds", &signals::INNOVATION_YAW_RATE),
    ] {
        plots.push(canvas.signal(title, signal, Legend::None));
    }
    let nis = [&signals::NIS_DEPTH, &signals::NIS_HEADING, &signals::NIS_YAW_RATE].map(|signal| all(signal.path));
    plots.push(canvas.plot("Depth, heading, yaw rate NIS [1]", &nis, NARROW));
    for (index, axis) in ["Surge", "Sway", "Heave", "Yaw"].into_iter().enumerate() {
        // The truth is a part of what the filter calls disturbance: current and buoyancy are in it too.
        let estimate = Component { signal: &nav::DISTURBANCE, index };
        let tether = Component { signal: &truth::DISTURBANCE, index };
        let title = format!("{axis} disturbance, green: tether [{}]", estimate.unit());
        let curves = [only(estimate).in_color(style::MEASURED), only(tether).in_color(style::TRUE)];
        plots.push(canvas.plot(&title, &curves, Legend::None));
    }
    plots.push(canvas.signal("DVL ranges, 0: no echo", &dvl::RANGE, NARROW));
    plots.push(canvas.signal("DVL beams used", &signals::BEAMS_USED, Legend::None));
    plots.push(canvas.signal("DVL beam parity", &estimator::NET_PLANE_PARITY, Legend::None));
    plots.push(canvas.signal("Net plane innovations", &estimator::NET_PLANE_INNOVATION, NARROW));
    let grid = Grid::new(plots).with_grid_columns(4);

    let mut narrow = |name: &str, signal| canvas.signal(name, signal, NARROW);
    let velocity = narrow("Velocity std. deviation", &signals::STD_VELOCITY);
    let pose = narrow("Pose std. deviation", &signals::STD_POSE);
    let disturbance = narrow("Disturbance std. deviation", &signals::STD_DISTURBANCE);
    let health = canvas.lanes("Estimator health", &[siblings(&signals::HEALTH_NET)]);
    let column = Vertical::new([velocity, pose, disturbance, health]).with_row_shares([1.0, 0.8, 1.0, 1.5]);
    Horizontal::new([grid.into(), column.into()]).with_column_shares([4.0, 1.05]).with_name("Estimation").into()
}
