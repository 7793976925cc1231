//! What does the control law do? The paper's figure 5, with what drives the gains and what comes of them.

use super::Description;
use super::views::{Canvas, Legend, all, only};
use rerun::blueprint::{ContainerLike, Horizontal, Tabs, Vertical};

pub(super) static DASHBOARD: Description = Description {
    name: "adaptation",
    about: "sliding variable, adaptive gains (figure 5), integrator, wrench, chattering",
    suits: |_| true,
    views: Some(views),
};

fn views(canvas: &mut Canvas) -> ContainerLike {
    let mut kinds: Vec<ContainerLike> = Vec::new();
    if canvas.about.has(&["gsta", "agsta"]) {
        kinds.push(super_twisting(canvas));
    }
    if canvas.about.has(&["pid"]) {
        kinds.push(pid(canvas));
    }
    if canvas.about.network && canvas.about.laws.iter().any(|law| law == "external") {
        kinds.push(outside(canvas));
    }
    match kinds.pop() {
        Some(only) if kinds.is_empty() => only,
        last => {
            kinds.extend(last);
            Tabs::new(kinds).with_active_tab("0").with_name("Adaptation").into()
        }
    }
}

fn super_twisting(canvas: &mut Canvas) -> ContainerLike {
    let adaptive = canvas.about.has(&["agsta"]);
    let band = if adaptive { ", with ±α_tol" } else { "" };
    let sigma = [("surge", "m/s"), ("sway", "m/s"), ("heave", "m"), ("yaw", "rad")];
    let sigma = sigma.iter().enumerate().map(|(i, (axis, unit))| {
        let mut curves = vec![only("/controller/sigma", i, 4)];
        if adaptive {
            curves.push(all(&format!("/derived/alpha_tol/{axis}")));
        }
        canvas.plot(&format!("Sliding variable σ, {axis}{band} [{unit}]"), &curves, Legend::None)
    });
    let sigma: Vec<_> = sigma.collect();
    let constant = if adaptive { "" } else { ", constant" };
    let mut wide = |name: &str, path: &str| canvas.plot(name, &[all(path)], Legend::Beside(0.2));
    let gains = [
        wide(&format!("Gain k1{constant} [N/√σ, N m/√σ]"), "/controller/k1"),
        wide(&format!("Gain k2{constant} [N/s, N m/s]"), "/controller/k2"),
    ];
    let mut third = |name: &str, path: &str| canvas.plot(name, &[all(path)], Legend::Beside(0.35));
    let wrench = [
        third("Integrator z [N, N m]", "/controller/z"),
        third("Requested wrench [N, N m]", "/controller/thrust/requested"),
        third("Chattering: wrench variation [N/s, N m/s]", "/derived/chattering"),
    ];
    let rows = [Horizontal::new(sigma).into(), Horizontal::new(gains).into(), Horizontal::new(wrench).into()];
    let name = if canvas.about.has(&["pid"]) { "Adaptation: super-twisting" } else { "Adaptation" };
    Vertical::new(rows).with_row_shares([0.9, 1.2, 1.0]).with_name(name).into()
}

/// A PID has no sliding variable and its gains do not move: its error, its integral, and what comes of them.
fn pid(canvas: &mut Canvas) -> ContainerLike {
    let errors =
        [("Surge error [m/s]", 0), ("Sway error [m/s]", 1), ("Depth error [m]", 2), ("Heading error [rad]", 3)];
    let errors: Vec<_> =
        errors.iter().map(|&(name, i)| canvas.plot(name, &[only("/controller/error", i, 4)], Legend::None)).collect();
    let mut wide = |name: &str, path: &str| canvas.plot(name, &[all(path)], Legend::Beside(0.2));
    let integral = [
        wide("Error integral [m, m s, rad s]", "/controller/integral"),
        wide("Velocity error [m/s, rad/s]", "/controller/velocity_error"),
    ];
    let wrench = [
        wide("Requested wrench [N, N m]", "/controller/thrust/requested"),
        wide("Chattering: wrench variation [N/s, N m/s]", "/derived/chattering"),
    ];
    let rows = [Horizontal::new(errors).into(), Horizontal::new(integral).into(), Horizontal::new(wrench).into()];
    let name = if canvas.about.has(&["gsta", "agsta"]) { "Adaptation: PID" } else { "Adaptation" };
    Vertical::new(rows).with_row_shares([0.9, 1.0, 1.0]).with_name(name).into()
}

/// A controller on the network steers, axis by axis, while the vehicle's own law waits.
fn outside(canvas: &mut Canvas) -> ContainerLike {
    let axes = canvas.lanes("Axes under external control", &["/derived/external/**"]);
    let wrench = canvas.plot("External wrench [N, N m]", &[all("/controller/wrench_request")], Legend::Beside(0.2));
    Vertical::new([axes, wrench]).with_name("Adaptation: external").into()
}
