//! Where is the vehicle, and what is it doing?

use super::views::{Canvas, Legend, entity};
use rerun::blueprint::{ContainerLike, Horizontal, Vertical};
use supertwin_core::signal::{controller, guidance, reference, tracking};

pub(super) fn views(canvas: &mut Canvas) -> ContainerLike {
    // The origin moves with the vehicle, so that it stays in view wherever it goes.
    let vehicle = canvas.picture(
        "Vehicle: thrust (orange), current (cyan), DVL beams accepted (green), rejected (red)",
        "/world/vehicle",
        &["/world/**", "- /world/vehicle/marker"],
        [-3.4, 2.2, -2.0],
        [0.9, 0.0, 0.1],
    );
    let pen = canvas.picture(
        "Net pen and path",
        "/world",
        &["/world/net", "/world/path", "/world/vehicle", "/world/vehicle/marker"],
        [-36.0, -36.0, -38.0],
        [0.0, 0.0, 9.0],
    );
    let modes = [&reference::MODE, &guidance::REASON, &controller::LAW, &controller::STATUS].map(entity);
    let modes = canvas.lanes("Modes", &modes);
    let below = Horizontal::new([pen, modes]).with_column_shares([1.0, 1.15]);
    let left = Vertical::new([vehicle, below.into()]).with_row_shares([3.0, 2.0]);
    let plots =
        [("Distance to net", &tracking::DISTANCE), ("Depth", &tracking::DEPTH), ("Heading", &tracking::HEADING)];
    let mut right: Vec<_> =
        plots.iter().map(|(name, signal)| canvas.signal(name, signal, Legend::Beside(0.18))).collect();
    right.push(canvas.events("Events"));
    let right = Vertical::new(right).with_row_shares([1.0, 1.0, 1.0, 0.9]);
    Horizontal::new([left.into(), right.into()]).with_column_shares([1.1, 0.9]).with_name("Overview").into()
}
