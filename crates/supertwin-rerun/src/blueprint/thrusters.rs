//! Can the thrusters do what the law asks for?

use super::Description;
use super::views::{Canvas, Curves, Legend, all, only};
use crate::style;
use rerun::blueprint::{ContainerLike, Grid, Horizontal, Vertical};

const COMMAND: &str = "/controller/thrust/force";
const DEMAND: &str = "/plant/thruster_demand";
const FORCE: &str = "/plant/truth/thruster_force";

pub(super) static DASHBOARD: Description = Description {
    name: "thrusters",
    about: "commands, forces, saturation, requested against allocated wrench",
    suits: |_| true,
    views: Some(views),
};

fn views(canvas: &mut Canvas) -> ContainerLike {
    let n = canvas.about.thrusters;
    let forces: ContainerLike = if n == 0 {
        // Which of them there are, only a recording knows.
        let mut force = |name: &str, path: &str| canvas.plot(name, &[all(path)], Legend::Beside(0.2));
        Horizontal::new([
            force("Thruster commands [N]", COMMAND),
            force("Thruster demands after delay and dead band [N]", DEMAND),
            force("Thruster forces [N]", FORCE),
        ])
        .into()
    } else {
        let columns = n.div_ceil(2).max(3);
        let plots = (0..n).map(|i| {
            let title = format!("Thruster {}: red command, blue demand, green true [N]", i + 1);
            let [command, demand, force] = three([COMMAND, DEMAND, FORCE], i, n);
            canvas.plot(&title, &[command.broad(), demand, force], Legend::None)
        });
        Grid::new(plots.collect::<Vec<_>>()).with_grid_columns(columns as u32).into()
    };
    let axes = [("Surge", "N"), ("Sway", "N"), ("Heave", "N"), ("Yaw", "N m")];
    let wrench = axes.iter().enumerate().map(|(i, (axis, unit))| {
        let of = ["/controller/thrust/requested", "/controller/thrust/allocated", "/plant/truth/wrench"];
        let [requested, allocated, real] = three(of, i, 4);
        let curves = [requested, allocated.broad(), real];
        canvas.plot(&format!("{axis}: red requested, blue allocated, green true [{unit}]"), &curves, Legend::None)
    });
    let wrench: Vec<_> = wrench.collect();
    let share =
        canvas.plot("Largest command as a share of its limit [%]", &[all("/derived/thrust_share")], Legend::None);
    let limited =
        canvas.plot("Share of the last second saturated [%]", &[all("/derived/limited")], Legend::Beside(0.4));
    let neutral = canvas.lanes("Neutral thrust", &["/derived/neutral/**"]);
    let counts = ["/controller/non_finite", "/derived/pings_lost", "/derived/refused"].map(all);
    let counts = canvas.plot("Refused and lost measurements [count]", &counts, Legend::Beside(0.55));
    let withheld = canvas.plot("Withheld messages [count]", &[all("/link/withheld")], Legend::Beside(0.7));
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
fn three(of: [&str; 3], component: usize, width: usize) -> [Curves; 3] {
    let [wanted, done, real] = of.map(|path| only(path, component, width));
    [wanted.in_color(style::REFERENCE), done.in_color(style::MEASURED), real.in_color(style::TRUE)]
}
