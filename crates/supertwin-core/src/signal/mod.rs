//! Every signal by its handle: path, components, units and meaning stand here or beside the message, and nowhere else.
//!
//! Whoever shows, reads, scores or draws a signal names its handle, so that a renamed signal is followed by all of
//! them, and one that is gone is an error of the compiler. Signals of messages stand with the message, since they are
//! also how a message is found again in a recording ([`crate::message::FromSignals`]); those of states stand below, one
//! file per service. A control law keeps signals that nobody else asks for in its own file.

pub mod controller;
pub mod estimator;
pub mod guidance;
pub mod link;
pub mod plant;
pub mod shadow;
pub mod tracking;

pub use crate::message::{measurements, nav, reference, thrust, truth, wrench_request};

/// A named quantity. Its path is at once telemetry path, recording entity and dashboard content.
///
/// Declare signals as `static` (by [`signals!`](crate::signals)): listeners may tell them apart by address.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct Signal {
    /// `service/quantity`, without a leading slash.
    pub path: &'static str,
    /// Names of the components; empty for a scalar.
    pub components: &'static [&'static str],
    /// Unit of every component, or one unit for all of them; empty for a label.
    pub units: &'static [&'static str],
    /// What it is, in one line.
    pub about: &'static str,
}

impl Signal {
    /// How many numbers it has at a tick.
    #[must_use]
    pub const fn width(&self) -> usize {
        if self.components.is_empty() { 1 } else { self.components.len() }
    }

    /// A state with a name instead of numbers.
    #[must_use]
    pub const fn is_label(&self) -> bool {
        self.units.is_empty()
    }

    /// Unit of component `i`.
    #[must_use]
    pub fn unit(&self, i: usize) -> &'static str {
        self.units.get(i).or(self.units.last()).copied().unwrap_or("")
    }

    /// The last part of its path.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.path.rsplit('/').next().unwrap_or(self.path)
    }

    /// The first part of its path.
    #[must_use]
    pub fn service(&self) -> &'static str {
        self.path.split('/').next().unwrap_or(self.path)
    }

    /// Which component is called `name`.
    #[must_use]
    pub const fn component(&self, name: &str) -> Option<usize> {
        position(self.components, name)
    }

    /// The component called `name`.
    ///
    /// # Panics
    /// When there is none: in a `const`, the program does not compile.
    #[must_use]
    pub const fn at(&'static self, name: &str) -> Component {
        match self.component(name) {
            Some(index) => Component { signal: self, index },
            None => panic!("no component of this name"),
        }
    }
}

/// Where `name` stands among `names`; `==` can't be asked in a `const`.
const fn position(names: &[&str], name: &str) -> Option<usize> {
    let mut at = 0;
    while at < names.len() {
        let (a, b) = (names[at].as_bytes(), name.as_bytes());
        let mut i = 0;
        while i < a.len() && i < b.len() && a[i] == b[i] {
            i += 1;
        }
        if i == a.len() && i == b.len() {
            return Some(at);
        }
        at += 1;
    }
    None
}

/// One component of a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Component {
    /// Of this signal.
    pub signal: &'static Signal,
    /// Its place among the numbers of a tick.
    pub index: usize,
}

impl Component {
    /// Its unit.
    #[must_use]
    pub fn unit(self) -> &'static str {
        self.signal.unit(self.index)
    }

    /// Its number among those of a tick; `None` when they are too few.
    #[must_use]
    pub fn of(self, values: &[f64]) -> Option<f64> {
        values.get(self.index).copied()
    }
}

/// Declares signals below a path, each with a handle, and `SIGNALS`, the list of them.
///
/// ```
/// supertwin_core::signals! { pub below "controller/":
///     INTEGRAL "integral" &["surge", "sway"], &["m"], "integral of the tracking error";
///     LAW "law" &[], &[], "law in command";
/// }
/// assert_eq!((INTEGRAL.width(), INTEGRAL.unit(1), SIGNALS.len()), (2, "m", 2));
/// ```
#[macro_export]
macro_rules! signals {
    ($visibility:vis below $below:literal:
     $($name:ident $path:literal $components:expr, $units:expr, $about:literal;)*) => {
        $(
            #[doc = concat!("Signal: ", $about, ".")]
            $visibility static $name: $crate::Signal = $crate::Signal {
                path: concat!($below, $crate::renamed!(), $path),
                components: $components,
                units: $units,
                about: $about,
            };
        )*
        /// All signals that are declared here.
        $visibility static SIGNALS: &[&$crate::Signal] = &[$(&$name),*];
    };
}

/// With the feature `renamed-signals` every signal has another path: whoever retypes a path finds nothing under it.
#[cfg(not(feature = "renamed-signals"))]
#[doc(hidden)]
#[macro_export]
macro_rules! renamed {
    () => {
        ""
    };
}
#[cfg(feature = "renamed-signals")]
#[doc(hidden)]
#[macro_export]
macro_rules! renamed {
    () => {
        "renamed_"
    };
}

/// Every signal that has a handle in this crate, service by service.
pub fn all() -> impl Iterator<Item = &'static Signal> {
    let of = [
        plant::SIGNALS,
        truth::SIGNALS,
        estimator::SIGNALS,
        nav::SIGNALS,
        guidance::SIGNALS,
        reference::SIGNALS,
        controller::SIGNALS,
        thrust::SIGNALS,
        wrench_request::SIGNALS,
        tracking::SIGNALS,
        link::SIGNALS,
        shadow::SIGNALS,
    ];
    of.into_iter().chain(measurements::SIGNALS.iter().copied()).flatten().copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_signal_has_a_path_of_its_own_a_meaning_and_a_unit_for_each_number() {
        let mut paths = BTreeSet::new();
        for signal in all() {
            assert!(paths.insert(signal.path), "{} twice", signal.path);
            assert!(!signal.about.is_empty() && signal.path.contains('/'), "{signal:?}");
            let names: BTreeSet<_> = signal.components.iter().collect();
            assert_eq!(names.len(), signal.components.len(), "{signal:?}");
            let units = signal.units.len();
            assert!(signal.is_label() || units == 1 || units == signal.width(), "{signal:?}");
            assert!(signal.units.iter().all(|unit| !unit.is_empty()), "{signal:?}");
        }
        assert!(paths.len() > 60, "{}", paths.len());
    }

    #[test]
    fn components_are_found_by_name() {
        const DEPTH: Component = truth::POSE.at("depth");
        assert_eq!((DEPTH.index, DEPTH.unit(), DEPTH.of(&[1.0, 2.0, 3.0])), (2, "m", Some(3.0)));
        assert_eq!((truth::POSE.component("dept"), DEPTH.of(&[1.0])), (None, None));
    }
}
