//! Fixed-step integration of ordinary differential equations.

use nalgebra::SVector;

/// One step of the classical fourth-order Runge-Kutta method for `x' = f(t, x)`; `t` counts from the step's start.
///
/// Local error O(h⁵), global error O(h⁴); the order is a test.
pub fn rk4<const N: usize>(
    x: &SVector<f64, N>,
    h_s: f64,
    mut f: impl FnMut(f64, &SVector<f64, N>) -> SVector<f64, N>,
) -> SVector<f64, N> {
    let half = 0.5 * h_s;
    let k1 = f(0.0, x);
    let k2 = f(half, &(x + k1 * half));
    let k3 = f(half, &(x + k2 * half));
    let k4 = f(h_s, &(x + k3 * h_s));
    x + (k1 + (k2 + k3) * 2.0 + k4) * (h_s / 6.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    fn error_at_one(steps: u32) -> f64 {
        // Harmonic oscillator from (1, 0): x(t) = (cos t, -sin t).
        let h = 1.0 / f64::from(steps);
        let mut x = Vector2::new(1.0, 0.0);
        for _ in 0..steps {
            x = rk4(&x, h, |_, x| Vector2::new(x.y, -x.x));
        }
        (x - Vector2::new(libm::cos(1.0), -libm::sin(1.0))).norm()
    }

    #[test]
    fn the_global_error_is_of_fourth_order() {
        let order = libm::log2(error_at_one(20) / error_at_one(40));
        assert!((order - 4.0).abs() < 0.1, "order {order}");
    }

    #[test]
    fn time_reaches_the_stages() {
        // x' = 4 t³ is integrated exactly by a fourth-order rule.
        let x = rk4(&nalgebra::Vector1::new(0.0), 2.0, |t, _| nalgebra::Vector1::new(4.0 * t * t * t));
        assert!((x.x - 16.0).abs() < 1e-12);
    }
}
