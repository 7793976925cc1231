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

pub use crate::handle::{Component, Signal};
pub use crate::message::{measurements, nav, reference, thrust, truth, wrench_request};

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
            assert!(signal.units.is_empty() || units == 1 || units == signal.width(), "{signal:?}");
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
