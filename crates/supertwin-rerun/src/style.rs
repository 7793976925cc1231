//! Names and colours of curves.

use crate::signals;
use rerun::components::InterpolationMode;
use supertwin_core::Signal;
use supertwin_core::signal::controller;

/// Okabe and Ito's colours, distinct also for the colour-blind; lightened where the viewer's background is dark.
const PALETTE: [u32; 8] =
    [0x56B4_E9FF, 0xE69F_00FF, 0x00B0_85FF, 0xD97F_B5FF, 0xF0E4_42FF, 0xE066_20FF, 0x6A8F_FFFF, 0xB8B8_B8FF];

/// What a sensor or the estimator says.
pub(crate) const MEASURED: u32 = 0x4DA6_FFFF;
/// What is wanted.
pub(crate) const REFERENCE: u32 = 0xFF4B_4BFF;
/// What really is.
pub(crate) const TRUE: u32 = 0x4CD0_72FF;
/// A limit beside the curve that it is for.
const LIMIT: u32 = 0x9A9A_9AFF;

/// Background of pictures.
pub(crate) const WATER: u32 = 0x0A1E_2AFF;
/// A beam of which nothing is known.
pub(crate) const BEAM: u32 = 0xD0D0_D0FF;
/// A beam that the estimator used.
pub(crate) const ACCEPTED: u32 = TRUE;
/// A beam that it refused.
pub(crate) const REJECTED: u32 = REFERENCE;

/// All is as it should be.
pub(crate) const GOOD: u32 = 0x2E7D_46FF;
/// Colour of states in which nothing happens, RGBA.
pub(crate) const IDLE: u32 = 0x4A4A_4AFF;
/// Worth a look.
pub(crate) const ALERT: u32 = 0xC25A_14FF;

/// The `i`-th colour for curves without a meaning of their own.
pub(crate) fn palette(i: usize) -> u32 {
    PALETTE[i % PALETTE.len()]
}

/// Colour of component `i` with this name of the signal at `path`.
#[must_use]
pub fn color(path: &str, name: &str, i: usize) -> u32 {
    // These stand in one plot with others, though each begins with its own first component.
    let before = match path {
        _ if [signals::NIS_HEADING.path, signals::PINGS_LOST.path].contains(&path) => 1,
        _ if [signals::NIS_YAW_RATE.path, signals::REFUSED.path].contains(&path) => 2,
        _ => 0,
    };
    match name {
        "measured" => MEASURED,
        "reference" => REFERENCE,
        "true" => TRUE,
        "gate" | "3 σ" | "α_tol" => LIMIT,
        _ => palette(before + i),
    }
}

/// Names of the first `width` components; with units where these differ.
pub(crate) fn names(signal: &Signal, width: usize) -> Vec<String> {
    let mixed = (1..width).any(|i| signal.unit(i) != signal.unit(0));
    let last = signal.name();
    (0..width)
        .map(|i| {
            let name = match signal.components.get(i) {
                Some(&name) => name.to_owned(),
                None if width == 1 => last.to_owned(),
                None => format!("{last} {}", i + 1),
            };
            let unit = signal.unit(i);
            if mixed && !unit.is_empty() { format!("{name} [{unit}]") } else { name }
        })
        .collect()
}

/// How the curves of a signal look.
pub(crate) fn lines(signal: &Signal, width: usize) -> rerun::SeriesLines {
    let name = |i: usize| signal.components.get(i).copied().unwrap_or_default();
    // What hardly moves may be broad: it hides nothing, and is hidden less.
    let slow = [controller::K1.path, controller::K2.path].contains(&signal.path) || signal.unit(0) == "count";
    let lines = rerun::SeriesLines::new()
        .with_names(names(signal, width))
        .with_colors((0..width).map(|i| color(signal.path, name(i), i)))
        .with_widths((0..width).map(|i| if slow || name(i) == "reference" { 2.0 } else { 1.25 }));
    // A flag and a count have nothing between their values.
    if ["flag", "count"].contains(&signal.unit(0)) {
        lines.with_interpolation_mode(InterpolationMode::StepAfter)
    } else {
        lines
    }
}

/// How the values of a label look: grey for the first, which is the one that does nothing.
pub(crate) fn states(values: &[&'static str]) -> rerun::StateConfiguration {
    rerun::StateConfiguration::new()
        .with_values(values.iter().copied())
        .with_labels(values.iter().map(|value| value.replace('_', " ")))
        .with_colors(values.iter().enumerate().map(|(i, &value)| match value {
            "neutral" => 0x8080_80FF,
            "depth_heading_hold" => 0xB777_00FF,
            "follow_net" => 0x0085_63FF,
            _ => PALETTE[i % PALETTE.len()],
        }))
}

#[cfg(test)]
mod tests {
    use super::*;

    static NET: Signal =
        Signal { path: "a/net", components: &["distance", "heading"], units: &["m", "rad"], about: "" };
    static WRENCH: Signal = Signal { path: "a/force", components: &["t1", "t2", "t3"], units: &["N"], about: "" };
    static DEPTH: Signal = Signal { path: "a/depth", components: &[], units: &["m"], about: "" };

    #[test]
    fn units_are_named_only_where_they_differ() {
        assert_eq!(names(&NET, 2), ["distance [m]", "heading [rad]"]);
        assert_eq!(names(&WRENCH, 2), ["t1", "t2"]);
        assert_eq!(names(&DEPTH, 1), ["depth"]);
    }

    #[test]
    fn the_three_curves_of_tracking_never_change_their_colour() {
        assert_eq!(color("a/b", "measured", 7), color("a/b", "measured", 0));
        let three = [color("a/b", "measured", 0), color("a/b", "reference", 1), color("a/b", "true", 2)];
        assert!(three[0] != three[1] && three[1] != three[2] && three[0] != three[2]);
    }
}
