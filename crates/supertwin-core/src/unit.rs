//! The unit that a name carries at its end: `depth_m` is in metres; and units of what has one by its place.

use crate::axes::AXIS_NAMES;
use crate::signal::controller::{K1, K2, SIGMA};

/// Longer endings before those that they end with.
const UNITS: &[(&str, &str)] = &[
    ("_n_s2_per_m2", "N s²/m²"),
    ("_nm_s2_per_rad2", "N m s²/rad²"),
    ("_n_s_per_m", "N s/m"),
    ("_nm_s_per_rad", "N m s/rad"),
    ("_rad_per_s2", "rad/s²"),
    ("_rad_per_s", "rad/s"),
    ("_m_per_s2", "m/s²"),
    ("_m_per_s", "m/s"),
    ("_rad_per_m", "rad/m"),
    ("_m_per_m", "m/m"),
    ("_per_s", "1/s"),
    ("_per_m", "1/m"),
    ("_kg_m2", "kg m²"),
    ("_kg", "kg"),
    ("_nm", "N m"),
    ("_n", "N"),
    ("_rad2", "rad²"),
    ("_rad", "rad"),
    ("_m2", "m²"),
    ("_m", "m"),
    ("_ns", "ns"),
    ("_us", "µs"),
    ("_ms", "ms"),
    ("_s", "s"),
];

/// The unit of a quantity of this name, if it carries one.
#[must_use]
pub fn of(name: &str) -> Option<&'static str> {
    // What follows the unit says which of several numbers it is: `transport_ms_max`.
    let name = name.strip_suffix("_max").unwrap_or(name);
    UNITS.iter().find(|(ending, _)| name.ends_with(ending)).map(|(_, unit)| *unit)
}

/// Per axis, by the name of what has axes.
const OF_AXES: [(&str, &[&str]); 8] = [
    ("alpha_tol", SIGMA.units),
    ("k1", K1.units),
    ("k1_initial", K1.units),
    ("k2", K2.units),
    ("lambda", K2.units),
    ("kp", &["N s/m", "N s/m", "N/m", "N m/rad"]),
    ("ki", &["N/m", "N/m", "N/(m s)", "N m/(rad s)"]),
    ("kd", &["N s²/m", "N s²/m", "N s/m", "N m s/rad"]),
];

/// By the last two words of a path.
const OF_PLACES: [(&str, &str, &str); 10] = [
    ("dvl", "std", "m/s"),
    ("depth", "std", "m"),
    ("compass", "std", "rad"),
    ("gyro", "std", "rad/s"),
    ("velocity", "max_rate", "m/s²"),
    ("velocity", "max_acceleration", "m/s³"),
    ("depth", "max_rate", "m/s"),
    ("depth", "max_acceleration", "m/s²"),
    ("heading", "max_rate", "rad/s"),
    ("heading", "max_acceleration", "rad/s²"),
];

/// The unit of the number at a path of a configuration, `law.pid.kp.surge`.
#[must_use]
pub fn of_place(path: &str) -> Option<&'static str> {
    let (before, name) = path.rsplit_once('.').unwrap_or(("", path));
    let place = before.rsplit('.').next().unwrap_or_default();
    let by_axis = || {
        let (_, units) = OF_AXES.iter().find(|(other, _)| *other == place)?;
        AXIS_NAMES.iter().position(|axis| *axis == name).map(|axis| units[axis])
    };
    let by_place = || OF_PLACES.iter().find(|(at, known, _)| (*at, *known) == (place, name)).map(|(.., unit)| *unit);
    of(path).or_else(by_axis).or_else(by_place)
}

#[cfg(test)]
mod tests {
    use super::{of, of_place};

    #[test]
    fn what_carries_no_unit_has_one_by_its_place() {
        for (path, unit) in [
            ("law.agsta.adaptation.alpha_tol.heave", Some("m")),
            ("controller.law.pid.ki.yaw", Some("N m/(rad s)")),
            ("measurement.dvl.std", Some("m/s")),
            ("reference.depth.max_acceleration", Some("m/s²")),
            ("cage.depth_m", Some("m")),
            ("law.gsta.beta.surge", None),
            ("seed", None),
        ] {
            assert_eq!(of_place(path), unit, "{path}");
        }
    }

    #[test]
    fn a_name_carries_its_unit() {
        for (name, unit) in [
            ("depth_m", Some("m")),
            ("yaw_rate_rad_per_s", Some("rad/s")),
            ("surge_m_per_s2", Some("m/s²")),
            ("surge_n_s_per_m", Some("N s/m")),
            ("distance_variance_m2", Some("m²")),
            ("clock_ns", Some("ns")),
            ("transport_ms_max", Some("ms")),
            ("yaw_inertia_kg_m2", Some("kg m²")),
            ("by_timer", None),
            ("ticks", None),
            ("status", None),
        ] {
            assert_eq!(of(name), unit, "{name}");
        }
    }
}
