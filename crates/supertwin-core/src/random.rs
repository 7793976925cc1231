//! Named random streams: one per consumer, so that adding a sensor does not shift another one's noise.

use nalgebra::SVector;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Exp1, StandardNormal};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize};
use std::borrow::Cow;

/// A random stream that belongs to one named consumer of one seeded run.
#[derive(Clone, Debug)]
pub struct Stream(ChaCha8Rng);

impl Stream {
    /// The stream of `consumer` in the run with `seed`. ChaCha's stream number is the hash of the name:
    /// streams of one seed never overlap.
    #[must_use]
    pub fn new(seed: u64, consumer: &str) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(xxhash_rust::xxh3::xxh3_64(consumer.as_bytes()));
        Self(rng)
    }

    /// A deviate of the standard normal distribution.
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// A vector of independent standard normal deviates.
    pub fn normals<const N: usize>(&mut self) -> SVector<f64, N> {
        SVector::from_fn(|_, _| self.normal())
    }

    /// An exponential deviate with the given mean.
    pub fn exponential(&mut self, mean: f64) -> f64 {
        let unit: f64 = Exp1.sample(&mut self.0);
        mean * unit
    }

    /// A uniform deviate in [low, high).
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// A whole number in 0..n, uniform but for one part in 2³²/n.
    pub fn below(&mut self, n: u32) -> u32 {
        ((u64::from(self.0.random::<u32>()) * u64::from(n)) >> 32) as u32
    }

    /// True with probability `p`.
    pub fn chance(&mut self, p: f64) -> bool {
        self.0.random::<f64>() < p
    }
}

/// A value, or a range that a value is drawn from once per run. Written as a number or as `[low, high]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(into = "[f64; 2]")]
pub struct Draw {
    low: f64,
    high: f64,
}

impl Draw {
    /// Always the same value.
    #[must_use]
    pub fn fixed(value: f64) -> Self {
        Self { low: value, high: value }
    }

    /// The ends of the range.
    #[must_use]
    pub fn range(self) -> (f64, f64) {
        (self.low, self.high)
    }

    /// Draws a value from the range, uniformly.
    pub fn sample(self, stream: &mut Stream) -> f64 {
        stream.uniform(self.low, self.high)
    }
}

impl From<Draw> for [f64; 2] {
    fn from(draw: Draw) -> Self {
        [draw.low, draw.high]
    }
}

impl JsonSchema for Draw {
    fn inline_schema() -> bool {
        true
    }
    fn schema_name() -> Cow<'static, str> {
        "Draw".into()
    }
    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "number", "rule": "finite; or a range [low, high] that each seed draws from" })
    }
}

impl<'de> Deserialize<'de> for Draw {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ValueOrRange;
        impl<'de> serde::de::Visitor<'de> for ValueOrRange {
            type Value = Draw;
            fn expecting(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str("a finite number, or a range [low, high] of finite numbers")
            }
            fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<Draw, E> {
                if value.is_finite() {
                    Ok(Draw::fixed(value))
                } else {
                    Err(E::custom(format!("{value}: must be finite")))
                }
            }
            fn visit_i64<E>(self, value: i64) -> Result<Draw, E> {
                Ok(Draw::fixed(value as f64))
            }
            fn visit_u64<E>(self, value: u64) -> Result<Draw, E> {
                Ok(Draw::fixed(value as f64))
            }
            fn visit_seq<A: serde::de::SeqAccess<'de>>(self, seq: A) -> Result<Draw, A::Error> {
                let [low, high] = <[f64; 2]>::deserialize(serde::de::value::SeqAccessDeserializer::new(seq))?;
                if low <= high && low.is_finite() && high.is_finite() {
                    Ok(Draw { low, high })
                } else {
                    Err(serde::de::Error::custom(format!("[{low}, {high}]: must be finite and low ≤ high")))
                }
            }
        }
        deserializer.deserialize_any(ValueOrRange)
    }
}

/// Ornstein-Uhlenbeck process in N dimensions: `dx = −x/T dt + std sqrt(2/T) dW`, discretised exactly.
///
/// Stationary standard deviation `std`, autocorrelation `exp(−lag/T)`. It starts in its stationary distribution.
#[derive(Clone, Debug)]
pub struct OrnsteinUhlenbeck<const N: usize> {
    value: SVector<f64, N>,
    decay: f64,
    kick: SVector<f64, N>,
    stream: Stream,
}

impl<const N: usize> OrnsteinUhlenbeck<N> {
    /// `std` per component, correlation time in seconds (positive), step in seconds.
    #[must_use]
    pub fn new(std: SVector<f64, N>, correlation_time_s: f64, dt_s: f64, mut stream: Stream) -> Self {
        let decay = libm::exp(-dt_s / correlation_time_s);
        let value = std.component_mul(&stream.normals());
        Self { value, decay, kick: std * libm::sqrt(1.0 - decay * decay), stream }
    }

    /// One step; returns the new value.
    pub fn step(&mut self) -> SVector<f64, N> {
        self.value = self.value * self.decay + self.kick.component_mul(&self.stream.normals());
        self.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn streams_differ_by_name_and_repeat_by_seed() {
        let draw = |seed, name| {
            let mut s = Stream::new(seed, name);
            [s.normal(), s.uniform(0.0, 1.0), s.exponential(1.0)]
        };
        assert_eq!(draw(1, "gyro"), draw(1, "gyro"));
        assert_ne!(draw(1, "gyro"), draw(1, "compass"));
        assert_ne!(draw(1, "gyro"), draw(2, "gyro"));
    }

    #[test]
    fn ornstein_uhlenbeck_has_its_stationary_statistics() {
        // 200,000 s of a process with T = 5 s: about 40,000 independent samples, so 2 % is four sigma.
        let (std, correlation_time_s, dt_s) = (Vector2::new(2.0, 0.5), 5.0, 0.5);
        let mut process = OrnsteinUhlenbeck::new(std, correlation_time_s, dt_s, Stream::new(7, "test"));
        let n = 400_000;
        let lag = 10; // one correlation time
        let samples: Vec<Vector2<f64>> = (0..n).map(|_| process.step()).collect();
        for axis in 0..2 {
            let mean = samples.iter().map(|x| x[axis]).sum::<f64>() / f64::from(n);
            let variance = samples.iter().map(|x| x[axis] * x[axis]).sum::<f64>() / f64::from(n);
            let lagged = samples.windows(lag + 1).map(|w| w[0][axis] * w[lag][axis]).sum::<f64>() / f64::from(n);
            assert!(mean.abs() < 0.03 * std[axis], "mean {mean}");
            assert!((variance / (std[axis] * std[axis]) - 1.0).abs() < 0.03, "variance {variance}");
            assert!((lagged / variance - (-1.0f64).exp()).abs() < 0.02, "autocorrelation {}", lagged / variance);
        }
    }

    #[test]
    fn the_deviates_have_their_moments() {
        let mut s = Stream::new(3, "moments");
        let n = 200_000;
        let (mut normal2, mut exponential, mut hits) = (0.0, 0.0, 0);
        for _ in 0..n {
            let x = s.normal();
            normal2 += x * x;
            exponential += s.exponential(0.05);
            hits += i32::from(s.chance(0.3));
        }
        let n = f64::from(n);
        assert!((normal2 / n - 1.0).abs() < 0.015);
        assert!((exponential / n - 0.05).abs() < 0.0006);
        assert!((f64::from(hits) / n - 0.3).abs() < 0.005);
        let mut faces = [0u32; 6];
        (0..60_000).for_each(|_| faces[s.below(6) as usize] += 1);
        assert!(faces.iter().all(|face| face.abs_diff(10_000) < 400), "{faces:?}");
    }
}
