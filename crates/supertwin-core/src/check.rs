//! Numbers that carry their rule: a value of these types is legal, and illegal input names the rule it breaks.
//!
//! Deserialising refuses the value at its place, so that a configuration error points at line and column.

use serde::{Deserialize, Serialize};

/// A number that breaks the rule of its type.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{value}: must be {rule}")]
pub struct RuleBroken {
    /// The offending number.
    pub value: f64,
    /// The rule in words.
    pub rule: &'static str,
}

macro_rules! checked {
    ($(#[$doc:meta])* $name:ident, $rule:literal, |$x:ident| $legal:expr) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
        #[serde(try_from = "f64", into = "f64")]
        pub struct $name(f64);

        impl $name {
            /// The number.
            #[must_use]
            pub fn get(self) -> f64 { self.0 }
        }

        impl TryFrom<f64> for $name {
            type Error = RuleBroken;
            fn try_from($x: f64) -> Result<Self, RuleBroken> {
                // Written as a positive containment check, so that NaN fails it.
                if $legal { Ok(Self($x)) } else { Err(RuleBroken { value: $x, rule: $rule }) }
            }
        }

        impl From<$name> for f64 {
            fn from(x: $name) -> f64 { x.0 }
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
    fn the_error_names_value_and_rule() {
        let broken = Positive::try_from(-5.0).expect_err("negative");
        assert_eq!(broken.to_string(), "-5: must be positive and finite");
        assert!(NonNegative::try_from(0.0).is_ok() && Positive::try_from(0.0).is_err());
        assert!(Fraction::try_from(1.0).is_ok() && Fraction::try_from(1.01).is_err());
    }
}
