//! Do the services keep up with each other? Only recordings made over the network know.

use super::Description;
use super::views::{Canvas, Legend, all, only};
use crate::style;
use rerun::blueprint::{ContainerLike, Horizontal, Vertical};

const SERVICES: [&str; 4] = ["plant", "estimator", "guidance", "controller"];

/// Room for a legend in a narrow plot.
const NARROW: Legend = Legend::Beside(0.5);

pub(super) static DASHBOARD: Description = Description {
    name: "link",
    about: "ages, gaps, rates, step times and deadlines of the services; network recordings only",
    suits: |about| about.network,
    views: Some(views),
};

fn views(canvas: &mut Canvas) -> ContainerLike {
    let rate = SERVICES.iter().enumerate().map(|(i, service)| {
        let rate = only(&format!("/link/{service}/rate"), 0, 1);
        rate.in_color(style::palette(i)).called(service)
    });
    let rate: Vec<_> = rate.collect();
    let whole = [
        canvas.plot("Rate [Hz]", &rate, NARROW),
        canvas.plot("Loop time, plant [µs]", &[all("/link/plant/loop_time")], NARROW),
        canvas.plot("Recording gaps [ticks]", &[all("/link/recorder/gaps")], NARROW),
        canvas.plot("Recorder lag [ms]", &[all("/link/recorder/lag")], Legend::None),
    ];
    let mut row = |what: &str, path: &str, unit: &str| -> ContainerLike {
        let plots = SERVICES.iter().map(|service| {
            canvas.plot(&format!("{what}, {service} [{unit}]"), &[all(&format!("/link/{service}/{path}"))], NARROW)
        });
        Horizontal::new(plots.collect::<Vec<_>>()).into()
    };
    let step_time = row("Step time", "step_time", "µs");
    let age = row("Input age", "age", "ticks");
    let transport = row("Transport time", "transport", "ms");
    let counts = SERVICES.iter().map(|service| -> ContainerLike {
        // Only the first tab names the service: there is room for no more.
        let first = format!("Deadlines, {service} [count]");
        let kinds = [(first.as_str(), "deadline"), ("Missing [count]", "missing"), ("Refused [count]", "refused")];
        let plots = kinds.map(|(name, path)| canvas.plot(name, &[all(&format!("/link/{service}/{path}"))], NARROW));
        canvas.tabs(plots)
    });
    let counts: Vec<_> = counts.collect();
    let rows = [Horizontal::new(whole).into(), step_time, age, transport, Horizontal::new(counts).into()];
    Vertical::new(rows).with_name("Link").into()
}
