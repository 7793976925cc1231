//! Can the thrusters do what the law asks for?

use super::views::{Canvas, Curves, Legend, all, only_of, siblings};
use crate::{signals, style};
use rerun::blueprint::{ContainerLike, Grid, Horizontal, Vertical};
use supertwin_core::Signal;
use supertwin_core::signal::{Component, controller, link, plant, thrust, truth};

pub(super) fn views(canvas: &mut Canvas) -> ContainerLike {
    let n = canvas.about.thrusters;
    let forces: ContainerLike = if n == 0 {
        // Which of them there are, only a recording knows.
        let mut force = |name: &str, signal| canvas.signal(name, signal, Legend::Beside(0.2));
        Horizontal::new([
            force("Thruster commands", &thrust::FORCE),
            force("Thruster demands after delay and dead band", &plant::THRUSTER_DEMAND),
            force("Thruster forces", &truth::THRUSTER_FORCE),
        ])
        .into()
    } else {
        let columns = n.div_ceil(2).max(3);
        let plots = (0..n).map(|i| {
            let title = format!("Thruster {}: red command, blue demand, green true [N]", i + 1);
            let [command, demand, force] =
                three([&thrust::FORCE, &plant::THRUSTER_DEMAND, &truth::THRUSTER_FORCE], i, n);
            canvas.plot(&title, &[command.broad(), demand, force], Legend::None)
        });
        Grid::new(plots.collect::<Vec<_>>()).with_grid_columns(columns as u32).into()
    };
    let wrench = ["Surge", "Sway", "Heave", "Yaw"].iter().enumerate().map(|(i, axis)| {
        let of = [&thrust::REQUESTED, &thrust::ALLOCATED, &truth::WRENCH];
        let [requested, allocated, real] = three(of, i, thrust::REQUESTED.width());
        let unit = thrust::REQUESTED.unit(i);
        let curves = [requested, allocated.broad(), real];
        canvas.plot(&format!("{axis}: red requested, blue allocated, green true [{unit}]"), &curves, Legend::None)
    });
    let wrench: Vec<_> = wrench.collect();
    let share = canvas.signal("Largest command as a share of its limit", &signals::THRUST_SHARE, Legend::None);
    let limited = canvas.signal("Share of the last second saturated", &signals::LIMITED, Legend::Beside(0.4));
    let neutral = canvas.lanes("Neutral thrust", &[siblings(&signals::NEUTRAL_PLANT)]);
    let counts = [&controller::NON_FINITE, &signals::PINGS_LOST, &signals::REFUSED].map(|signal| all(signal.path));
    let counts = canvas.plot("Refused and lost measurements [count]", &counts, Legend::Beside(0.55));
    let withheld = canvas.signal("Withheld messages", &link::WITHHELD, Legend::Beside(0.7));
    let rows = [
        forces,
        Horizontal::new(wrench).into(),
        Horizontal::new([share, limited, counts, withheld, neutral])
            .with_column_shares([1.1, 1.1, 1.0, 1.0, 0.8])
            .into(),
    ];
    let first = if n == 0 { 1.0 } else { 2.0 };
    Vertical::new(rows).with_row_shares([first, 1.0, 1.0]).with_name("Thrusters").into()
}

/// One component of what is wanted, what is done about it, and what really is.
fn three(of: [&'static Signal; 3], index: usize, width: usize) -> [Curves; 3] {
    let [wanted, done, real] = of.map(|signal| only_of(Component { signal, index }, width));
    [wanted.in_color(style::REFERENCE), done.in_color(style::MEASURED), real.in_color(style::TRUE)]
}
