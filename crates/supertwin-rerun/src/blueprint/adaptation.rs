//! What does the control law do? The paper's figure 5, with what drives the gains and what comes of them.

use super::views::{Canvas, Legend, all, only, siblings};
use crate::signals;
use rerun::blueprint::{ContainerLike, Horizontal, Tabs, Vertical};
use supertwin_core::Capability;
use supertwin_core::axes::AXIS_NAMES;
use supertwin_core::signal::{Component, controller, thrust, wrench_request};

pub(super) fn views(canvas: &mut Canvas) -> ContainerLike {
    let mut kinds: Vec<ContainerLike> = Vec::new();
    if canvas.about.has(Capability::SlidingVariable) {
        kinds.push(super_twisting(canvas));
    }
    if canvas.about.has(Capability::Integral) || canvas.about.plain_law {
        kinds.push(pid(canvas));
    }
    if canvas.about.network && canvas.about.capabilities.contains(&Capability::External) {
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
    let adaptive = canvas.about.has(Capability::AdaptiveGains);
    let band = if adaptive { ", with ±α_tol" } else { "" };
    let sigma = AXIS_NAMES.iter().zip(signals::ALPHA_TOL).enumerate().map(|(index, (axis, alpha_tol))| {
        let sigma = Component { signal: &controller::SIGMA, index };
        let mut curves = vec![only(sigma)];
        if adaptive {
            curves.push(all(alpha_tol.path));
        }
        canvas.plot(&format!("Sliding variable σ, {axis}{band} [{}]", sigma.unit()), &curves, Legend::None)
    });
    let sigma: Vec<_> = sigma.collect();
    let constant = if adaptive { "" } else { ", constant" };
    let mut wide = |name: &str, signal| canvas.signal(name, signal, Legend::Beside(0.2));
    let gains =
        [wide(&format!("Gain k1{constant}"), &controller::K1), wide(&format!("Gain k2{constant}"), &controller::K2)];
    let mut third = |name: &str, signal| canvas.signal(name, signal, Legend::Beside(0.35));
    let wrench = [
        third("Integrator z", &controller::Z),
        third("Requested wrench", &thrust::REQUESTED),
        third("Chattering: wrench variation", &signals::CHATTERING),
    ];
    let rows = [Horizontal::new(sigma).into(), Horizontal::new(gains).into(), Horizontal::new(wrench).into()];
    let name = if canvas.about.has(Capability::Integral) { "Adaptation: super-twisting" } else { "Adaptation" };
    Vertical::new(rows).with_row_shares([0.9, 1.2, 1.0]).with_name(name).into()
}

/// A PID has no sliding variable and its gains do not move: its error, its integral if it has one, and what comes of them.
fn pid(canvas: &mut Canvas) -> ContainerLike {
    let errors = [("Surge", "surge"), ("Sway", "sway"), ("Depth", "heave"), ("Heading", "yaw")]
        .map(|(title, axis)| canvas.component(&format!("{title} error"), controller::ERROR.at(axis)));
    let integral = canvas.about.has(Capability::Integral);
    let mut wide = |name: &str, signal| canvas.signal(name, signal, Legend::Beside(0.2));
    let mut second = Vec::new();
    if integral {
        second.push(wide("Error integral", &controller::INTEGRAL));
    }
    second.push(wide("Velocity error", &controller::VELOCITY_ERROR));
    let wrench =
        [wide("Requested wrench", &thrust::REQUESTED), wide("Chattering: wrench variation", &signals::CHATTERING)];
    let rows = [Horizontal::new(errors).into(), Horizontal::new(second).into(), Horizontal::new(wrench).into()];
    let name = if canvas.about.has(Capability::SlidingVariable) { "Adaptation: PID" } else { "Adaptation" };
    Vertical::new(rows).with_row_shares([0.9, 1.0, 1.0]).with_name(name).into()
}

/// A controller on the network steers, axis by axis, while the vehicle's own law waits.
fn outside(canvas: &mut Canvas) -> ContainerLike {
    let axes = canvas.lanes("Axes under external control", &[siblings(&signals::EXTERNAL_SURGE)]);
    let wrench = canvas.signal("External wrench", &wrench_request::WRENCH_REQUEST, Legend::Beside(0.2));
    Vertical::new([axes, wrench]).with_name("Adaptation: external").into()
}
