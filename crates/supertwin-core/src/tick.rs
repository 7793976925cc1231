//! Time as data: one beat of the twin's clock.

/// One beat of the clock of a run. Blocks never read any other time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tick {
    /// Number of the beat, from 0.
    pub k: u64,
    /// Length of a beat in seconds.
    pub dt_s: f64,
}

impl Tick {
    /// Time since the start of the run in seconds: `k · dt`, one rounding, never accumulated.
    #[must_use]
    pub fn t_s(self) -> f64 {
        self.k as f64 * self.dt_s
    }

    /// The first tick at or after `t_s` seconds (with half a microsecond of grace for decimal fractions).
    #[must_use]
    pub fn at_or_after(t_s: f64, dt_s: f64) -> u64 {
        let ticks = libm::ceil((t_s - 5e-7) / dt_s);
        if ticks > 0.0 { ticks as u64 } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimal_times_hit_their_tick() {
        assert_eq!(Tick::at_or_after(29.0, 0.02), 1450);
        assert_eq!(Tick::at_or_after(0.06, 0.02), 3);
        assert_eq!(Tick::at_or_after(0.061, 0.02), 4);
        assert_eq!(Tick::at_or_after(-1.0, 0.02), 0);
    }
}
