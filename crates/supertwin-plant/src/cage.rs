//! The net pen: a deformed, moving cylinder, its distance, and rays cast on it.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{Finite, NonNegative, Positive};
use supertwin_core::random::{Draw, Stream};

/// Most undulations that a net can have.
pub const MAX_UNDULATIONS: usize = 4;

/// Fixed-point corrections of the ray caster, each about ten times nearer; the residual is tested.
const CORRECTIONS: usize = 3;

/// Pen of an environment file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CageConfig {
    /// Radius at rest.
    pub radius_m: Positive,
    /// Depth of the net, for drawing.
    pub depth_m: Positive,
    /// Shift of the net per metre of depth, towards `tilt_direction_rad`: the current leans on it.
    pub tilt_m_per_m: Finite,
    /// Direction of the tilt, from North; a range is drawn from per seed.
    pub tilt_direction_rad: Draw,
    /// Folds around the circumference.
    pub undulation: Vec<UndulationConfig>,
    /// Amplitude of the motion with the waves.
    pub motion_amplitude_m: NonNegative,
    /// Period of the motion with the waves.
    pub motion_period_s: Positive,
}

/// A fold of the net: `amplitude cos(lobes θ + wavenumber z)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UndulationConfig {
    /// Amplitude of the radius.
    pub amplitude_m: Finite,
    /// Number of lobes around the circumference.
    pub lobes: u32,
    /// Phase per metre of depth.
    pub wavenumber_rad_per_m: Finite,
}

/// `R(θ, z, t) = R₀ + tilt z cos(θ − θ_c) + Σ a cos(n θ + κ z) + m sin(2πt/T)`, θ the bearing from the pen's axis.
#[derive(Clone, Debug)]
pub struct Cage {
    radius_m: f64,
    tilt: [f64; 2],
    undulation: ArrayVec<UndulationConfig, MAX_UNDULATIONS>,
    motion_amplitude_m: f64,
    motion_rad_per_s: f64,
    /// Radius due to the motion at the present tick.
    breathing_m: f64,
    /// Outward speed of the net.
    pub outward_speed_m_per_s: f64,
}

impl Cage {
    /// Draws from the stream `cage` of the seed.
    ///
    /// # Errors
    /// When there are more than [`MAX_UNDULATIONS`] undulations, or the net folds further in than its radius.
    pub fn new(config: &CageConfig, seed: u64) -> Result<Self, String> {
        if config.undulation.len() > MAX_UNDULATIONS {
            return Err(format!(
                "cage.undulation: {} given, must be at most {MAX_UNDULATIONS}",
                config.undulation.len()
            ));
        }
        let inward: f64 =
            config.undulation.iter().map(|u| u.amplitude_m.get().abs()).sum::<f64>() + config.motion_amplitude_m.get();
        if inward >= config.radius_m.get() {
            return Err(format!(
                "cage.radius_m = {}: must be larger than all amplitudes together ({inward})",
                config.radius_m.get()
            ));
        }
        let (sin, cos) = libm::sincos(config.tilt_direction_rad.sample(&mut Stream::new(seed, "cage")));
        let tilt = config.tilt_m_per_m.get();
        let mut cage = Self {
            radius_m: config.radius_m.get(),
            tilt: [tilt * cos, tilt * sin],
            undulation: config.undulation.iter().copied().collect(),
            motion_amplitude_m: config.motion_amplitude_m.get(),
            motion_rad_per_s: core::f64::consts::TAU / config.motion_period_s.get(),
            breathing_m: 0.0,
            outward_speed_m_per_s: 0.0,
        };
        cage.set_time(0.0);
        Ok(cage)
    }

    /// Moves the net to time `t_s`.
    pub fn set_time(&mut self, t_s: f64) {
        let (sin, cos) = libm::sincos(self.motion_rad_per_s * t_s);
        self.breathing_m = self.motion_amplitude_m * sin;
        self.outward_speed_m_per_s = self.motion_amplitude_m * self.motion_rad_per_s * cos;
    }

    /// Radius towards the horizontal unit vector `bearing = [cos θ, sin θ]` at a depth.
    #[must_use]
    pub fn radius(&self, bearing: [f64; 2], depth_m: f64) -> f64 {
        let [c, s] = bearing;
        let mut radius = self.radius_m + depth_m * (self.tilt[0] * c + self.tilt[1] * s) + self.breathing_m;
        for u in &self.undulation {
            // cos(nθ + κz) from powers of e^{iθ}: no transcendental function but for κz.
            let (n_cos, n_sin) = power((c, s), u.lobes);
            let wavenumber = u.wavenumber_rad_per_m.get();
            let (k_sin, k_cos) = if wavenumber == 0.0 { (0.0, 1.0) } else { libm::sincos(wavenumber * depth_m) };
            radius += u.amplitude_m.get() * (n_cos * k_cos - n_sin * k_sin);
        }
        radius
    }

    /// Radial gap between a point and the net, and the horizontal unit vector that points outwards there.
    #[must_use]
    pub fn gap(&self, position_m: &Vector3<f64>) -> (f64, [f64; 2]) {
        let r = libm::sqrt(position_m.x * position_m.x + position_m.y * position_m.y);
        let bearing = if r > 1e-9 { [position_m.x / r, position_m.y / r] } else { [1.0, 0.0] };
        (self.radius(bearing, position_m.z) - r, bearing)
    }

    /// Distance along the unit vector `ray` to the net, from inside. `None` when the ray is vertical.
    ///
    /// `radius_m` is a first guess of the net's radius where the ray ends.
    #[must_use]
    pub fn range(&self, from_m: &Vector3<f64>, ray: &Vector3<f64>, radius_m: f64) -> Option<f64> {
        let horizontal2 = ray.x * ray.x + ray.y * ray.y;
        if horizontal2 < 1e-12 {
            return None;
        }
        let along = from_m.x * ray.x + from_m.y * ray.y;
        let r2 = from_m.x * from_m.x + from_m.y * from_m.y;
        // |p_h + s d_h| = R, with R taken where the last iteration hit.
        let to_radius = |radius: f64| {
            let discriminant = along * along - horizontal2 * (r2 - radius * radius);
            (libm::sqrt(discriminant.max(0.0)) - along) / horizontal2
        };
        let mut range = to_radius(radius_m);
        for _ in 0..CORRECTIONS {
            let (x, y) = (from_m.x + range * ray.x, from_m.y + range * ray.y);
            let inverse = 1.0 / libm::sqrt((x * x + y * y).max(1e-12));
            range = to_radius(self.radius([x * inverse, y * inverse], from_m.z + range * ray.z));
        }
        (range > 0.0).then_some(range)
    }
}

/// `(cos θ + i sin θ)ⁿ` by repeated squaring.
fn power(unit: (f64, f64), mut n: u32) -> (f64, f64) {
    let (mut base, mut result) = (unit, (1.0, 0.0));
    while n > 0 {
        if n & 1 == 1 {
            result = (result.0 * base.0 - result.1 * base.1, result.0 * base.1 + result.1 * base.0);
        }
        base = (base.0 * base.0 - base.1 * base.1, 2.0 * base.0 * base.1);
        n >>= 1;
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cage(amplitudes: [f64; 2]) -> Cage {
        let finite = |x| Finite::try_from(x).expect("finite");
        let undulation = [(amplitudes[0], 13, 0.0), (amplitudes[1], 31, 0.5)].map(|(a, lobes, k)| UndulationConfig {
            amplitude_m: finite(a),
            lobes,
            wavenumber_rad_per_m: finite(k),
        });
        let config = CageConfig {
            radius_m: Positive::try_from(25.0).expect("positive"),
            depth_m: Positive::try_from(15.0).expect("positive"),
            tilt_m_per_m: finite(if amplitudes[0] == 0.0 { 0.0 } else { 0.06 }),
            tilt_direction_rad: Draw::fixed(0.3),
            undulation: undulation.to_vec(),
            motion_amplitude_m: NonNegative::try_from(0.0).expect("zero"),
            motion_period_s: Positive::try_from(5.0).expect("positive"),
        };
        Cage::new(&config, 1).expect("legal")
    }

    #[test]
    fn the_radius_follows_its_formula() {
        let cage = cage([0.12, 0.048]);
        for i in 0..200 {
            let (theta, z) = (f64::from(i) * 0.05 - 4.0, f64::from(i) * 0.03);
            let expected = 25.0
                + 0.06 * z * (theta - 0.3f64).cos()
                + 0.12 * ((13.0 * theta).cos() + 0.4 * (31.0 * theta + 0.5 * z).cos());
            let radius = cage.radius([theta.cos(), theta.sin()], z);
            assert!((radius - expected).abs() < 1e-12, "θ = {theta}: {radius} against {expected}");
        }
    }

    #[test]
    fn rays_end_on_the_net() {
        let cage = cage([0.12, 0.048]);
        let mut worst: f64 = 0.0;
        for i in 0..400 {
            let (theta, distance) = (f64::from(i) * 0.031, 2.0 + f64::from(i % 7) * 0.5);
            let from = Vector3::new((25.0 - distance) * theta.cos(), (25.0 - distance) * theta.sin(), 4.0);
            let ray = Vector3::new((theta + 0.3).cos() * 0.95, (theta + 0.3).sin() * 0.95, 0.3122499).normalize();
            let range = cage.range(&from, &ray, 25.0).expect("hits");
            let hit = from + ray * range;
            worst = worst.max(cage.gap(&hit).0.abs());
        }
        assert!(worst < 0.005, "worst residual {worst} m");
    }

    #[test]
    fn from_the_axis_of_a_round_pen_every_range_is_the_radius() {
        let cage = cage([0.0, 0.0]);
        for i in 0..12 {
            let theta = f64::from(i) * 0.5;
            let range = cage.range(&Vector3::new(0.0, 0.0, 3.0), &Vector3::new(theta.cos(), theta.sin(), 0.0), 24.0);
            assert!((range.expect("hits") - 25.0).abs() < 1e-12);
        }
        assert_eq!(cage.range(&Vector3::zeros(), &Vector3::z(), 25.0), None);
    }
}
