//! How the fields of a message become numbers of signals, and back.

use super::{Mode, PerThruster};
use crate::{Axes, BodyAcceleration, BodyVelocity, Probe, Signal, Wrench};

/// What signals are at one tick.
pub trait SignalValues {
    /// The numbers of `signal`.
    fn numbers(&self, signal: &'static Signal) -> Option<&[f64]>;
    /// The label that `signal` has.
    fn label(&self, signal: &'static Signal) -> Option<&str>;
}

/// A message, or a part of one, that is found again in the signals it has shown.
pub trait FromSignals: Sized {
    /// `None` when a signal is missing, or has another number of components.
    ///
    /// Numbers have all their bits. Only where zero is shown for what is not there can zero not be told from it.
    fn from_signals(values: &impl SignalValues) -> Option<Self>;
}

/// Declares the signals of a message: handle, path, components, units, meaning, and the fields whose numbers it shows.
/// They are shown in this order.
macro_rules! shown {
    // One field of any form.
    (@show $probe:ident $signal:ident $field:expr) => {
        $crate::message::shown::Field::show(&$field, &$signal, $probe)
    };
    (@find $values:ident $signal:ident $field:expr) => {
        $field = $crate::message::shown::Field::find(&$signal, $values)?
    };
    // A number from each of several fields.
    (@show $probe:ident $signal:ident $($field:expr),+) => {
        $probe.vector(&$signal, &[$($crate::message::shown::Number::number(&$field)),+])
    };
    (@find $values:ident $signal:ident $($field:expr),+) => {
        let mut numbers = $values.numbers(&$signal)?.iter().copied();
        if numbers.len() != $signal.width() {
            return None;
        }
        $($field = $crate::message::shown::Number::from_number(numbers.next()?);)+
    };
    ($this:ident: $type:ident, $below:literal:
     $($name:ident $path:literal $components:expr, $units:expr, $about:literal => { $($field:expr),+ };)*) => {
        $crate::signals! { pub below $below: $($name $path $components, $units, $about;)* }

        impl $crate::Observe for $type {
            fn observe<P: $crate::Probe>(&self, probe: &mut P) {
                let $this = self;
                $(shown!(@show probe $name $($field),+);)*
            }
        }

        impl $crate::message::FromSignals for $type {
            fn from_signals(values: &impl $crate::message::SignalValues) -> Option<Self> {
                let mut $this = Self::default();
                $(shown!(@find values $name $($field),+);)*
                Some($this)
            }
        }
    };
}

/// A field that is one number.
pub(super) trait Number: Copy {
    fn number(&self) -> f64;
    fn from_number(number: f64) -> Self;
}

impl Number for f64 {
    #[inline]
    fn number(&self) -> f64 {
        *self
    }
    fn from_number(number: f64) -> Self {
        number
    }
}

impl Number for bool {
    #[inline]
    fn number(&self) -> f64 {
        if *self { 1.0 } else { 0.0 }
    }
    fn from_number(number: f64) -> Self {
        number != 0.0
    }
}

/// Zero where there is none.
impl Number for Option<f64> {
    #[inline]
    fn number(&self) -> f64 {
        self.unwrap_or(0.0)
    }
    fn from_number(number: f64) -> Self {
        (number != 0.0).then_some(number)
    }
}

/// A field that is a whole signal.
pub(super) trait Field: Sized {
    fn show<P: Probe>(&self, signal: &'static Signal, probe: &mut P);
    fn find(signal: &'static Signal, values: &impl SignalValues) -> Option<Self>;
}

impl<T: Number> Field for T {
    #[inline]
    fn show<P: Probe>(&self, signal: &'static Signal, probe: &mut P) {
        probe.scalar(signal, self.number());
    }
    fn find(signal: &'static Signal, values: &impl SignalValues) -> Option<Self> {
        <[T; 1]>::find(signal, values).map(|[number]| number)
    }
}

impl<T: Number, const N: usize> Field for [T; N] {
    #[inline]
    fn show<P: Probe>(&self, signal: &'static Signal, probe: &mut P) {
        probe.vector(signal, &self.map(|number| number.number()));
    }
    fn find(signal: &'static Signal, values: &impl SignalValues) -> Option<Self> {
        let numbers: [f64; N] = values.numbers(signal)?.try_into().ok()?;
        Some(numbers.map(T::from_number))
    }
}

/// Shown only when it is there.
impl Field for Option<[f64; 3]> {
    #[inline]
    fn show<P: Probe>(&self, signal: &'static Signal, probe: &mut P) {
        if let Some(numbers) = self {
            numbers.show(signal, probe);
        }
    }
    fn find(signal: &'static Signal, values: &impl SignalValues) -> Option<Self> {
        Some(<[f64; 3]>::find(signal, values))
    }
}

/// A vehicle without thrusters has no such signal.
impl Field for PerThruster {
    #[inline]
    fn show<P: Probe>(&self, signal: &'static Signal, probe: &mut P) {
        probe.vector(signal, self);
    }
    fn find(signal: &'static Signal, values: &impl SignalValues) -> Option<Self> {
        Self::try_from(values.numbers(signal).unwrap_or_default()).ok()
    }
}

impl Field for Mode {
    #[inline]
    fn show<P: Probe>(&self, signal: &'static Signal, probe: &mut P) {
        probe.label(signal, self.name());
    }
    fn find(signal: &'static Signal, values: &impl SignalValues) -> Option<Self> {
        values.label(signal)?.parse().ok()
    }
}

macro_rules! four_axes {
    ($($type:ty),*) => {
        $(impl Field for $type {
            #[inline]
            fn show<P: Probe>(&self, signal: &'static Signal, probe: &mut P) {
                self.to_array().show(signal, probe);
            }
            fn find(signal: &'static Signal, values: &impl SignalValues) -> Option<Self> {
                <[_; 4]>::find(signal, values).map(Self::from)
            }
        })*
    };
}
four_axes!(BodyVelocity, BodyAcceleration, Wrench, Axes<bool>);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{
        DepthSample, DvlPing, HeadingSample, Measurements, Nav, Reference, Thrust, Truth, YawRateSample,
    };
    use crate::observe::Snapshot;
    use crate::{Observe, signal};
    use core::fmt::Debug;

    impl SignalValues for Snapshot {
        fn numbers(&self, signal: &'static Signal) -> Option<&[f64]> {
            self.get(signal)
        }
        fn label(&self, signal: &'static Signal) -> Option<&str> {
            self.labels.iter().find(|(other, _)| *other == signal).map(|(_, label)| *label)
        }
    }

    fn assert_found_again<M: Observe + FromSignals + PartialEq + Debug>(message: &M) {
        let shown = Snapshot::of(message);
        assert_eq!(M::from_signals(&shown).as_ref(), Some(message));
        let known: Vec<_> = signal::all().collect();
        for (signal, values) in &shown.vectors {
            assert!(known.contains(signal) && values.len() <= signal.width(), "{signal:?}");
            let is_each = signal.components == super::super::THRUSTER_NAMES;
            assert!(is_each || values.len() == signal.width(), "{signal:?}");
        }
    }

    /// Numbers that are all different, flags that are not all alike.
    fn filled<M: serde::Serialize + serde::de::DeserializeOwned>(empty: &M) -> M {
        fn fill(value: &mut serde_json::Value, count: &mut f64) {
            *count += 1.0;
            match value {
                serde_json::Value::Number(_) => *value = (*count / 7.0).into(),
                serde_json::Value::Bool(flag) => *flag = *count % 3.0 < 1.5,
                serde_json::Value::Array(items) => items.iter_mut().for_each(|item| fill(item, count)),
                serde_json::Value::Object(items) => items.values_mut().for_each(|item| fill(item, count)),
                _ => {}
            }
        }
        let mut value = serde_json::to_value(empty).unwrap();
        fill(&mut value, &mut 0.0);
        serde_json::from_value(value).unwrap()
    }

    #[test]
    fn a_message_assert_found_again_in_what_it_showed() {
        let force_n = [1.0; 3].into_iter().collect();
        assert_found_again(&filled(&Truth { thruster_force_n: force_n, ..Truth::default() }));
        assert_found_again(&filled(&Nav::default()));
        assert_found_again(&filled(&Reference { mode: Mode::FollowNet, ..Reference::default() }));
        assert_found_again(&filled(&Thrust { force_n: [1.0; 6].into_iter().collect(), ..Thrust::default() }));
        assert_found_again(&Thrust::default());
        let ping = DvlPing { velocity_m_per_s: Some([1.0; 3]), beam_range_m: [Some(1.0); 4], taken_at_s: 1.0 };
        let all = Measurements {
            dvl: Some(ping),
            depth: Some(DepthSample::default()),
            compass: Some(HeadingSample::default()),
            gyro: Some(YawRateSample::default()),
        };
        assert_found_again(&filled(&all));
        let blind =
            DvlPing { velocity_m_per_s: None, beam_range_m: [Some(2.0), None, None, Some(3.0)], taken_at_s: 1.0 };
        assert_found_again(&Measurements { dvl: Some(blind), compass: None, ..filled(&all) });
        assert_found_again(&Measurements::default());
    }

    #[test]
    fn a_message_of_which_a_signal_is_missing_is_not_made_up() {
        let mut shown = Snapshot::of(&Nav::default());
        shown.vectors.retain(|(signal, _)| *signal != &signal::nav::HEALTH);
        assert_eq!(Nav::from_signals(&shown), None);
        shown.vectors.push((&signal::nav::HEALTH, vec![0.0; 5]));
        assert_eq!(Nav::from_signals(&shown), None);
    }
}
