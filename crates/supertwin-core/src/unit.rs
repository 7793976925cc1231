//! The unit that a name carries at its end: `depth_m` is in metres.

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

#[cfg(test)]
mod tests {
    use super::of;

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
