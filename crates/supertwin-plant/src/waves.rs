//! First-order waves: a JONSWAP sea of a few regular components, their decay with depth, their dynamic pressure.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::check::{Interval, NonNegative, Positive};
use supertwin_core::random::{Draw, Stream};

/// Number of regular components.
pub const COMPONENTS: usize = 12;

/// Acceleration of gravity in m/s².
const G: f64 = 9.81;

/// Waves of an environment file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WavesConfig {
    /// Significant height `Hs`; zero for a flat sea.
    pub significant_height_m: NonNegative,
    /// Peak period `Tp`.
    pub peak_period_s: Positive,
    /// Peak enhancement of the JONSWAP spectrum.
    pub peak_enhancement: Positive,
    /// Direction towards which the waves travel, from North; a range is drawn from per seed.
    pub direction_rad: Draw,
    /// Band of frequencies, as multiples of the peak frequency.
    pub band: Interval,
}

/// The sea at the vehicle.
///
/// Deep water, `k = ω²/g`, phase `θ = ω t − k ξ + φ` with `ξ` the position along the direction of travel:
///
/// ```text
/// u_h = Σ a ω e^{−kz} cos θ      w_down = Σ a ω e^{−kz} sin θ      ζ e^{−kz} = Σ a e^{−kz} cos θ
/// ```
///
/// Each component is carried as the complex number `p = e^{−kz} e^{iθ}` and turned by `e^{iω dt}` and the second-order
/// series of `e^{−k dz − i k dξ}` per sub-step; one component per tick is computed afresh, so that the series' error
/// (third order in `k` times millimetres) never adds up.
#[derive(Clone, Debug)]
pub struct Waves {
    amplitude_m: [f64; COMPONENTS],
    omega: [f64; COMPONENTS],
    wavenumber: [f64; COMPONENTS],
    phase: [f64; COMPONENTS],
    /// `e^{iω dt}` of a sub-step.
    turn_re: [f64; COMPONENTS],
    turn_im: [f64; COMPONENTS],
    /// `p` of each component.
    re: [f64; COMPONENTS],
    im: [f64; COMPONENTS],
    direction: [f64; 2],
    depth_m: f64,
    along_m: f64,
    flat: bool,
    next_exact: usize,
}

/// Water motion of the waves at a point, NED axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WaveMotion {
    /// Velocity in m/s.
    pub velocity: Vector3<f64>,
    /// Acceleration in m/s².
    pub acceleration: Vector3<f64>,
}

/// JONSWAP spectrum up to a constant factor, at `x = ω/ω_p`: `x⁻⁵ exp(−5/4 x⁻⁴) γ^b`.
///
/// Source: Hasselmann et al. 1973; form as in Fossen (2021), ch. 10.
#[must_use]
pub fn jonswap_shape(x: f64, peak_enhancement: f64) -> f64 {
    let width = if x <= 1.0 { 0.07 } else { 0.09 };
    let b = libm::exp(-0.5 * (x - 1.0) * (x - 1.0) / (width * width));
    let x2 = x * x;
    libm::exp(-1.25 / (x2 * x2)) / (x2 * x2 * x) * libm::pow(peak_enhancement, b)
}

impl Waves {
    /// Draws frequencies (one in each of the equal bins of the band) and phases from the stream `waves`.
    #[must_use]
    pub fn new(config: &WavesConfig, seed: u64, substep_s: f64) -> Self {
        let mut stream = Stream::new(seed, "waves");
        let direction = libm::sincos(config.direction_rad.sample(&mut stream));
        let omega_peak = core::f64::consts::TAU / config.peak_period_s.get();
        let (low, high) = (config.band.low(), config.band.high());
        let bin = (high - low) / COMPONENTS as f64;
        let x: [f64; COMPONENTS] = core::array::from_fn(|j| low + bin * (j as f64 + stream.uniform(0.0, 1.0)));
        let phase = core::array::from_fn(|_| stream.uniform(0.0, core::f64::consts::TAU));
        let shape = x.map(|x| jonswap_shape(x, config.peak_enhancement.get()));
        // The bins together carry the sea's energy: Σ a²/2 = Hs²/16.
        let hs = config.significant_height_m.get();
        let scale = hs * hs / (8.0 * shape.iter().sum::<f64>());
        let omega = x.map(|x| x * omega_peak);
        let turn = omega.map(|omega| libm::sincos(omega * substep_s));
        Self {
            amplitude_m: shape.map(|s| libm::sqrt(scale * s)),
            omega,
            wavenumber: omega.map(|omega| omega * omega / G),
            phase,
            turn_re: turn.map(|(_, cos)| cos),
            turn_im: turn.map(|(sin, _)| sin),
            re: [0.0; COMPONENTS],
            im: [0.0; COMPONENTS],
            direction: [direction.1, direction.0],
            depth_m: 0.0,
            along_m: 0.0,
            flat: hs <= 0.0,
            next_exact: 0,
        }
    }

    /// Computes every component afresh for a position and a time.
    pub fn start(&mut self, position_m: &Vector3<f64>, t_s: f64) {
        self.depth_m = position_m.z.max(0.0);
        self.along_m = self.direction[0] * position_m.x + self.direction[1] * position_m.y;
        for j in 0..COMPONENTS {
            self.refresh(j, t_s);
        }
    }

    fn refresh(&mut self, j: usize, t_s: f64) {
        let decay = libm::exp(-self.wavenumber[j] * self.depth_m);
        let theta = self.omega[j] * t_s - self.wavenumber[j] * self.along_m + self.phase[j];
        let (sin, cos) = libm::sincos(theta);
        (self.re[j], self.im[j]) = (decay * cos, decay * sin);
    }

    /// One sub-step later, at a position a little further on.
    pub fn advance(&mut self, position_m: &Vector3<f64>) {
        if self.flat {
            return;
        }
        let along_m = self.direction[0] * position_m.x + self.direction[1] * position_m.y;
        // Above the mean surface the water moves as it does there.
        let depth_m = position_m.z.max(0.0);
        let (dz, dxi) = (depth_m - self.depth_m, along_m - self.along_m);
        (self.depth_m, self.along_m) = (depth_m, along_m);
        for j in 0..COMPONENTS {
            // e^s ≈ 1 + s + s²/2 with s = −k (dz + i dξ).
            let (a, b) = (-self.wavenumber[j] * dz, -self.wavenumber[j] * dxi);
            let (small_re, small_im) = (1.0 + a + 0.5 * (a * a - b * b), b + a * b);
            let (turn_re, turn_im) = (self.turn_re[j], self.turn_im[j]);
            let (m_re, m_im) = (turn_re * small_re - turn_im * small_im, turn_re * small_im + turn_im * small_re);
            let (re, im) = (self.re[j], self.im[j]);
            self.re[j] = re * m_re - im * m_im;
            self.im[j] = re * m_im + im * m_re;
        }
    }

    /// Once per tick: one component afresh, in turn.
    pub fn correct(&mut self, t_s: f64) {
        if !self.flat {
            self.refresh(self.next_exact, t_s);
            self.next_exact = (self.next_exact + 1) % COMPONENTS;
        }
    }

    /// Velocity and acceleration of the water here and now.
    #[must_use]
    pub fn motion(&self) -> WaveMotion {
        if self.flat {
            return WaveMotion::default();
        }
        let (mut u, mut w, mut du, mut dw) = (0.0, 0.0, 0.0, 0.0);
        for j in 0..COMPONENTS {
            let speed = self.amplitude_m[j] * self.omega[j];
            u += speed * self.re[j];
            w += speed * self.im[j];
            du -= speed * self.omega[j] * self.im[j];
            dw += speed * self.omega[j] * self.re[j];
        }
        let [north, east] = self.direction;
        WaveMotion {
            velocity: Vector3::new(u * north, u * east, w),
            acceleration: Vector3::new(du * north, du * east, dw),
        }
    }

    /// `ζ e^{−kz}`: dynamic pressure as metres of water.
    #[must_use]
    pub fn pressure_head_m(&self) -> f64 {
        if self.flat { 0.0 } else { self.amplitude_m.iter().zip(&self.re).map(|(a, re)| a * re).sum() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(hs: f64) -> WavesConfig {
        let positive = |x| Positive::try_from(x).expect("positive");
        WavesConfig {
            significant_height_m: NonNegative::try_from(hs).expect("height"),
            peak_period_s: positive(5.0),
            peak_enhancement: positive(3.3),
            direction_rad: Draw::fixed(0.4),
            band: Interval::try_from([0.6, 2.6]).expect("in order"),
        }
    }

    #[test]
    fn the_surface_has_the_significant_height() {
        // At the surface the pressure head is the elevation: Hs = 4 std over a long record and several seeds.
        let mut variance = 0.0;
        let (seeds, n) = (20, 20_000);
        for seed in 0..seeds {
            let mut waves = Waves::new(&config(0.6), seed, 0.1);
            waves.start(&Vector3::zeros(), 0.0);
            for _ in 0..n {
                waves.advance(&Vector3::zeros());
                variance += waves.pressure_head_m() * waves.pressure_head_m() / (n * seeds) as f64;
            }
        }
        let hs = 4.0 * variance.sqrt();
        assert!((hs / 0.6 - 1.0).abs() < 0.02, "Hs {hs}");
    }

    #[test]
    fn rotating_phasors_equal_the_exact_sum_along_a_path() {
        let h = 0.01;
        let mut waves = Waves::new(&config(0.6), 3, h);
        let path = |t: f64| Vector3::new(0.3 * t, -0.2 * t, 4.0 + 0.5 * libm::sin(0.4 * t));
        waves.start(&path(0.0), 0.0);
        let mut worst: f64 = 0.0;
        for i in 1..=20_000u32 {
            let t = f64::from(i) * h;
            waves.advance(&path(t));
            if i % 2 == 0 {
                waves.correct(t);
            }
            let mut exact = waves.clone();
            exact.start(&path(t), t);
            worst = worst.max((exact.motion().velocity - waves.motion().velocity).norm());
        }
        assert!(worst < 1e-8, "worst velocity error {worst} m/s");
    }

    #[test]
    fn acceleration_is_the_derivative_of_velocity_and_pressure_follows_the_particles() {
        let mut waves = Waves::new(&config(0.6), 5, 1e-4);
        let here = Vector3::new(1.0, 2.0, 3.0);
        waves.start(&here, 0.0);
        for _ in 0..100 {
            let (before, head) = (waves.motion(), waves.pressure_head_m());
            waves.advance(&here);
            let after = waves.motion();
            let slope = (after.velocity - before.velocity) / 1e-4;
            assert!((slope - (before.acceleration + after.acceleration) / 2.0).norm() < 1e-6);
            // A particle keeps its pressure: d/dt(ζ e^{−kz}) = −w_down at a fixed point, to first order.
            let rate = (waves.pressure_head_m() - head) / 1e-4;
            assert!((rate + (before.velocity.z + after.velocity.z) / 2.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_flat_sea_is_still() {
        let mut waves = Waves::new(&config(0.0), 1, 0.01);
        waves.start(&Vector3::zeros(), 0.0);
        waves.advance(&Vector3::new(1.0, 1.0, 1.0));
        assert_eq!(waves.motion(), WaveMotion::default());
        assert_eq!(waves.pressure_head_m(), 0.0);
    }
}
