//! Numbers that carry their rule: a value of these types is legal, and illegal input names the rule it breaks.
//!
//! Deserialising refuses the value at its place, so that a configuration error points at line and column.
//! In JSON Schemas the rule is the keyword `rule`, which is ours.

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

macro_rules! checked {
    ($(#[$doc:meta])* $name:ident, $rule:literal, |$x:ident| $legal:expr) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
        #[serde(try_from = "f64", into = "f64")]
        pub struct $name(f64);

        impl $name {
            /// The number, which has passed the check.
            #[must_use]
            pub fn get(self) -> f64 { self.0 }
        }

        impl TryFrom<f64> for $name {
            /// The offending number and the rule.
            type Error = String;
            fn try_from($x: f64) -> Result<Self, String> {
                // Written as a positive containment check, so that NaN fails it.
                if $legal { Ok(Self($x)) } else { Err(format!(concat!("{}: must be ", $rule), $x)) }
            }
        }

        impl From<$name> for f64 {
            fn from(x: $name) -> f64 { x.0 }
        }

        impl JsonSchema for $name {
            fn inline_schema() -> bool { true }
            fn schema_name() -> Cow<'static, str> { stringify!($name).into() }
            fn json_schema(_: &mut SchemaGenerator) -> Schema { json_schema!({ "type": "number", "rule": $rule }) }
        }
    };
}

checked! {
    /// Any finite number.
    Finite, "finite", |x| x.is_finite()
}
checked! {
    /// A finite number above zero.
    Positive, "positive and finite", |x| x > 0.0 && x.is_finite()
}
checked! {
    /// A finite number, zero or above.
    NonNegative, "zero or positive, and finite", |x| x >= 0.0 && x.is_finite()
}
checked! {
    /// A share between 0 and 1, both included.
    Fraction, "between 0 and 1", |x| (0.0..=1.0).contains(&x)
}

checked! {
    /// An angle between 0 and a right angle, neither included.
    AcuteAngle, "between 0 and π/2 (exclusive)", |x| x > 0.0 && x < core::f64::consts::FRAC_PI_2
}

/// Two numbers in order, `low < high`. Written as `[low, high]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "[f64; 2]", into = "[f64; 2]")]
pub struct Interval {
    low: f64,
    high: f64,
}

impl Interval {
    /// Lower end, which belongs to the interval.
    #[must_use]
    pub fn low(self) -> f64 {
        self.low
    }

    /// Upper end, which belongs to the interval.
    #[must_use]
    pub fn high(self) -> f64 {
        self.high
    }

    /// Whether `x` lies inside, ends included.
    #[must_use]
    pub fn contains(self, x: f64) -> bool {
        (self.low..=self.high).contains(&x)
    }
}

impl TryFrom<[f64; 2]> for Interval {
    type Error = String;
    fn try_from([low, high]: [f64; 2]) -> Result<Self, String> {
        if low < high && low.is_finite() && high.is_finite() {
            return Ok(Self { low, high });
        }
        Err(format!("[{low}, {high}]: must be finite, and the first less than the second"))
    }
}

impl JsonSchema for Interval {
    fn inline_schema() -> bool {
        true
    }
    fn schema_name() -> Cow<'static, str> {
        "Interval".into()
    }
    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "array", "rule": "[low, high], finite and in order" })
    }
}

impl From<Interval> for [f64; 2] {
    fn from(interval: Interval) -> Self {
        [interval.low, interval.high]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_and_infinity_pass_nowhere() {
        for x in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(Finite::try_from(x).is_err());
            assert!(Positive::try_from(x).is_err());
            assert!(NonNegative::try_from(x).is_err());
            assert!(Fraction::try_from(x).is_err());
        }
    }

    #[test]
    fn an_interval_is_in_order() {
        assert!(Interval::try_from([1.0, 2.0]).is_ok_and(|interval| interval.contains(2.0) && !interval.contains(2.1)));
        for ends in [[2.0, 1.0], [1.0, 1.0], [f64::NAN, 1.0], [0.0, f64::INFINITY]] {
            let error = Interval::try_from(ends).expect_err("not in order");
            assert!(error.contains("the first less than the second"), "{error}");
        }
    }

    #[test]
    fn the_error_names_value_and_rule() {
        let broken = Positive::try_from(-5.0).expect_err("negative");
        assert_eq!(broken, "-5: must be positive and finite");
        assert!(NonNegative::try_from(0.0).is_ok() && Positive::try_from(0.0).is_err());
        assert!(Fraction::try_from(1.0).is_ok() && Fraction::try_from(1.01).is_err());
    }
}
