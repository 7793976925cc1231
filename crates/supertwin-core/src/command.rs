//! What a mission file gives in advance and a client asks for at run time: the same types, the same refusals.

use crate::message::{Direction, Mode, WrenchRequest};
use crate::{ParameterChange, Refusal, Tick};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize};
use std::borrow::Cow;

/// A command for one of the services, or for the wires between them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// For the plant: faults.
    Plant(PlantCommand),
    /// For the estimator.
    Estimator(EstimatorCommand),
    /// For guidance: set-points and modes.
    Guidance(GuidanceCommand),
    /// For the controller.
    Controller(ControllerCommand),
    /// For the wires, in batch only: what a cut tether does to them.
    Link(LinkCommand),
}

/// Faults of the plant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlantCommand {
    /// The DVL delivers nothing for this many seconds.
    DvlSilentForS(f64),
    /// A thruster gives this share of the force it is asked for.
    #[serde(rename = "thruster_gain")]
    ThrusterGain {
        /// Number of the thruster, from 1.
        thruster: usize,
        /// Share, 1 when healthy.
        gain: f64,
    },
}

/// What can be asked of the estimator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EstimatorCommand {
    /// Forget everything and start from the next measurements.
    Restart,
    /// Change one parameter.
    Parameter(ParameterChange),
}

/// Set-points and modes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GuidanceCommand {
    /// What to do.
    Mode(Mode),
    /// Depth below the surface.
    DepthM(Setpoint),
    /// Heading in `depth_heading_hold`.
    HeadingRad(Setpoint),
    /// Distance to the net in `follow_net`.
    NetDistanceM(Setpoint),
    /// Speed along the net in `follow_net`, zero or positive.
    SpeedMPerS(Setpoint),
    /// Which way along the net.
    Direction(Direction),
    /// Change one parameter.
    Parameter(ParameterChange),
}

/// What can be asked of the controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ControllerCommand {
    /// Hand over to another of the configured laws, by name and without a jump in the wrench.
    Law(String),
    /// Emergency neutral: no force while true, whatever guidance wants.
    Neutral(bool),
    /// Change one parameter, of the law in command or of the fallback; without a jump in the wrench.
    Parameter(ParameterChange),
}

/// What happens on the wires.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LinkCommand {
    /// A wire carries nothing for this many seconds: its receiver keeps the last value, which grows old.
    Withhold {
        /// Which wire.
        wire: Wire,
        /// For how long.
        for_s: f64,
    },
    /// Nobody is in command for this many seconds.
    OperatorLostForS(f64),
    /// An external controller asks for a wrench, at every tick of this many seconds.
    WrenchRequest {
        /// What it asks for.
        request: WrenchRequest,
        /// For how long.
        for_s: f64,
    },
}

impl LinkCommand {
    /// The first tick that it no longer concerns, when it applies at `tick`.
    ///
    /// # Errors
    /// When its duration or its forces are no numbers.
    pub fn until(&self, tick: Tick) -> Result<u64, Refusal> {
        let for_s = match self {
            Self::OperatorLostForS(for_s) | Self::Withhold { for_s, .. } => *for_s,
            Self::WrenchRequest { request, for_s } => {
                if !request.to_array().iter().flatten().all(|force| force.is_finite()) {
                    return Err(Refusal("wrench_request: every force must be finite".to_owned()));
                }
                *for_s
            }
        };
        if for_s >= 0.0 && for_s.is_finite() {
            Ok(tick.k + Tick::at_or_after(for_s, tick.dt_s))
        } else {
            Err(Refusal(format!("for_s = {for_s}: must be zero or positive, and finite")))
        }
    }
}

/// The wires of the ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Wire {
    /// Plant to estimator.
    Measurements,
    /// Estimator to guidance and controller.
    Nav,
    /// Guidance to controller.
    Reference,
    /// Controller to plant and estimator.
    Thrust,
}

/// Shortest duration of a ramp and shortest period of a sine.
const SHORTEST_S: f64 = 1e-3;

/// A set-point that may vary in time. Written as a number or as a table with one of the profiles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Setpoint {
    /// The same value from now on.
    Constant(f64),
    /// From the present set-point to `to` at a constant rate, in `over_s` seconds.
    Ramp {
        /// Final value.
        to: f64,
        /// Duration in seconds.
        over_s: f64,
    },
    /// `mean + amplitude sin(2π t/period_s)`, t from the command.
    Sine {
        /// Mean value.
        mean: f64,
        /// Amplitude, in the unit of the set-point.
        amplitude: f64,
        /// Period in seconds.
        period_s: f64,
    },
}

/// A set-point as a table.
#[derive(Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", remote = "Setpoint")]
enum Profile {
    /// The same value from now on.
    Constant(f64),
    /// From the present set-point to `to` at a constant rate, in `over_s` seconds.
    Ramp { to: f64, over_s: f64 },
    /// `mean + amplitude sin(2π t/period_s)`, t from the command.
    Sine { mean: f64, amplitude: f64, period_s: f64 },
}

/// As [`Setpoint::deserialize`] reads it.
impl JsonSchema for Setpoint {
    fn schema_name() -> Cow<'static, str> {
        "Setpoint".into()
    }
    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "A set-point that may vary in time: a number, or a table with one of the profiles.",
            "anyOf": [{ "type": "number" }, generator.subschema_for::<Profile>()],
        })
    }
}

impl<'de> Deserialize<'de> for Setpoint {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NumberOrProfile;
        impl<'de> serde::de::Visitor<'de> for NumberOrProfile {
            type Value = Setpoint;
            fn expecting(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str("a number, or a table with one of constant, ramp, sine")
            }
            fn visit_f64<E>(self, value: f64) -> Result<Setpoint, E> {
                Ok(Setpoint::Constant(value))
            }
            fn visit_i64<E>(self, value: i64) -> Result<Setpoint, E> {
                Ok(Setpoint::Constant(value as f64))
            }
            fn visit_u64<E>(self, value: u64) -> Result<Setpoint, E> {
                Ok(Setpoint::Constant(value as f64))
            }
            fn visit_map<A: serde::de::MapAccess<'de>>(self, map: A) -> Result<Setpoint, A::Error> {
                Profile::deserialize(serde::de::value::MapAccessDeserializer::new(map))
            }
        }
        deserializer.deserialize_any(NumberOrProfile)
    }
}

impl Setpoint {
    /// The smallest and the largest value that it asks for. A ramp asks for its end: where it begins is where the
    /// set-point is, and a vehicle outside the limits may always be called back.
    #[must_use]
    pub fn bounds(self) -> (f64, f64) {
        match self {
            Self::Constant(value) | Self::Ramp { to: value, .. } => (value, value),
            Self::Sine { mean, amplitude, .. } => (mean - amplitude.abs(), mean + amplitude.abs()),
        }
    }

    /// Refuses numbers that are not finite, times that are not positive, and values outside `low..=high`.
    ///
    /// # Errors
    /// Names `what`, the value and the rule.
    pub fn check(self, what: &str, low: f64, high: f64) -> Result<(), Refusal> {
        let time_s = match self {
            Self::Constant(_) => 1.0,
            Self::Ramp { over_s, .. } => over_s,
            Self::Sine { period_s, .. } => period_s,
        };
        // In a shorter time the phase of a sine would overflow, and the set-point be no number.
        if !(time_s >= SHORTEST_S && time_s.is_finite()) {
            return Err(Refusal(format!("{what}: the time {time_s} s must be at least {SHORTEST_S} s and finite")));
        }
        let (least, most) = self.bounds();
        if (low..=high).contains(&least) && (low..=high).contains(&most) {
            Ok(())
        } else {
            let worst = if (low..=high).contains(&least) { most } else { least };
            Err(Refusal(format!("{what} = {worst}: must lie between {low} and {high}")))
        }
    }
}

/// A set-point in flight: what [`Setpoint`] means from the tick on at which it applied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trajectory {
    setpoint: Setpoint,
    since_s: f64,
    from: f64,
}

impl Trajectory {
    /// Stays at `value`.
    #[must_use]
    pub fn constant(value: f64) -> Self {
        Self { setpoint: Setpoint::Constant(value), since_s: 0.0, from: value }
    }

    /// Follows `setpoint` from now on.
    pub fn follow(&mut self, setpoint: Setpoint, now: Tick) {
        *self = Self { setpoint, since_s: now.t_s(), from: self.at(now) };
    }

    /// The value at `now`.
    #[must_use]
    pub fn at(&self, now: Tick) -> f64 {
        let elapsed_s = now.t_s() - self.since_s;
        match self.setpoint {
            Setpoint::Constant(value) => value,
            Setpoint::Ramp { to, over_s } => self.from + (to - self.from) * (elapsed_s / over_s).clamp(0.0, 1.0),
            Setpoint::Sine { mean, amplitude, period_s } => {
                mean + amplitude * libm::sin(core::f64::consts::TAU * elapsed_s / period_s)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_follow_their_formulas() {
        let tick = |t_s: f64| Tick { k: (t_s / 0.02).round() as u64, dt_s: 0.02 };
        let mut depth = Trajectory::constant(2.0);
        depth.follow(Setpoint::Ramp { to: 5.0, over_s: 10.0 }, tick(4.0));
        assert_eq!(depth.at(tick(4.0)), 2.0);
        assert!((depth.at(tick(9.0)) - 3.5).abs() < 1e-12);
        assert_eq!(depth.at(tick(60.0)), 5.0);
        depth.follow(Setpoint::Sine { mean: 5.0, amplitude: 0.5, period_s: 8.0 }, tick(60.0));
        assert!((depth.at(tick(62.0)) - 5.5).abs() < 1e-9);
    }

    #[test]
    fn a_setpoint_that_would_become_no_number_is_refused() {
        let hasty = Setpoint::Sine { mean: 1.0, amplitude: 0.5, period_s: 1e-310 };
        let mut trajectory = Trajectory::constant(1.0);
        trajectory.follow(hasty, Tick { k: 0, dt_s: 0.02 });
        assert!(trajectory.at(Tick { k: 7, dt_s: 0.02 }).is_nan(), "which is why it is refused:");
        assert!(hasty.check("d", 0.0, 5.0).is_err());
    }
}
