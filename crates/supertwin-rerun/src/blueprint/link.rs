//! Do the services keep up with each other? Only recordings made over the network know.

use super::views::{Canvas, Curves, Legend, all};
use crate::style;
use rerun::blueprint::{ContainerLike, Horizontal, Vertical};
use supertwin_core::block::SERVICES;
use supertwin_core::signal::link::{self, Account};

/// Room for a legend in a narrow plot.
const NARROW: Legend = Legend::Beside(0.5);

pub(super) fn views(canvas: &mut Canvas) -> ContainerLike {
    let rate = SERVICES.iter().enumerate().map(|(i, service)| {
        let rate = Curves { only: Some((0, 1)), ..all(&link::RATE.path(service)) };
        rate.in_color(style::palette(i)).called(service)
    });
    let rate: Vec<_> = rate.collect();
    let whole = [
        canvas.plot(&format!("Rate [{}]", link::RATE.unit), &rate, NARROW),
        counter_plot(canvas, "Loop time", &link::LOOP_TIME, "plant"),
        canvas.signal("Recording gaps", &link::GAPS, NARROW),
        canvas.signal("Recorder lag", &link::LAG, Legend::None),
    ];
    let mut row = |what: &str, of: &Account| -> ContainerLike {
        let plots = SERVICES.iter().map(|service| counter_plot(canvas, what, of, service));
        Horizontal::new(plots.collect::<Vec<_>>()).into()
    };
    let step_time = row("Step time", &link::STEP_TIME);
    let age = row("Input age", &link::AGE);
    let transport = row("Transport time", &link::TRANSPORT);
    let counts = SERVICES.iter().map(|service| -> ContainerLike {
        // Only the first tab names the service: there is room for no more.
        let mut tab = |name: &str, of: &Account| canvas.plot(name, &[all(&of.path(service))], NARROW);
        let plots = [
            tab(&format!("Deadlines, {service} [{}]", link::DEADLINE.unit), &link::DEADLINE),
            tab(&format!("Missing [{}]", link::MISSING.unit), &link::MISSING),
            tab(&format!("Refused [{}]", link::REFUSED.unit), &link::REFUSED),
        ];
        canvas.tabs(plots)
    });
    let counts: Vec<_> = counts.collect();
    let rows = [Horizontal::new(whole).into(), step_time, age, transport, Horizontal::new(counts).into()];
    Vertical::new(rows).with_name("Link").into()
}

/// A service's account over time.
fn counter_plot(canvas: &mut Canvas, what: &str, of: &Account, service: &str) -> ContainerLike {
    canvas.plot(&format!("{what}, {service} [{}]", of.unit), &[all(&of.path(service))], NARROW)
}
