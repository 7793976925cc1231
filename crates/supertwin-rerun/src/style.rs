//! Names and colours of curves.

use rerun::components::InterpolationMode;
use supertwin_core::Signal;

/// Okabe and Ito's colours, distinct also for the colour-blind; lightened where the viewer's background is dark.
const PALETTE: [u32; 8] =
    [0x56B4_E9FF, 0xE69F_00FF, 0x00B0_85FF, 0xD97F_B5FF, 0xF0E4_42FF, 0xE066_20FF, 0x6A8F_FFFF, 0xB8B8_B8FF];

/// What a sensor or the estimator says.
const MEASURED: u32 = 0x4DA6_FFFF;
/// What is wanted.
const REFERENCE: u32 = 0xFF4B_4BFF;
/// What really is.
const TRUE: u32 = 0x9FD1_A4FF;

/// Colour of component `i` with this name.
pub(crate) fn color(name: &str, i: usize) -> u32 {
    match name {
        "measured" => MEASURED,
        "reference" => REFERENCE,
        "true" => TRUE,
        _ => PALETTE[i % PALETTE.len()],
    }
}

/// Names of the first `width` components; with units where these differ.
pub(crate) fn names(signal: &Signal, width: usize) -> Vec<String> {
    let mixed = (1..width).any(|i| signal.unit(i) != signal.unit(0));
    let last = signal.path.rsplit('/').next().unwrap_or(signal.path);
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
    let lines = rerun::SeriesLines::new()
        .with_names(names(signal, width))
        .with_colors((0..width).map(|i| color(name(i), i)))
        .with_widths((0..width).map(|i| if name(i) == "reference" { 2.0 } else { 1.25 }));
    // A flag has no value between 0 and 1.
    if signal.unit(0) == "flag" { lines.with_interpolation_mode(InterpolationMode::StepAfter) } else { lines }
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
        assert_eq!(color("measured", 7), color("measured", 0));
        let three = [color("measured", 0), color("reference", 1), color("true", 2)];
        assert!(three[0] != three[1] && three[1] != three[2] && three[0] != three[2]);
    }
}
