//! What signals are called and how they are measured, as their services say.
//!
//! Listeners of signals expect them to live for ever, as those of blocks do: each is kept once, and there is a limit.

use std::collections::{BTreeMap, BTreeSet};
use supertwin_core::Signal;
use supertwin_protocol::Description;

/// Signals and values of labels that are kept; whoever makes up more of them is not believed.
const ROOM: usize = 4096;

/// Signals and labels by name.
#[derive(Debug, Default)]
pub(crate) struct SignalRegistry {
    signals: BTreeMap<&'static str, &'static Signal>,
    labels: BTreeSet<&'static str>,
}

impl SignalRegistry {
    /// Learns what a service says about its signals.
    pub(crate) fn learn(&mut self, descriptions: &[Description<'_>]) {
        for description in descriptions {
            let components: Vec<&str> = description.components.iter().map(|word| &**word).collect();
            let units: Vec<&str> = description.units.iter().map(|word| &**word).collect();
            self.register(&description.path, &components, &units, &description.about);
        }
    }

    /// The signal at `path`, if somebody has described it.
    pub(crate) fn get(&self, path: &str) -> Option<&'static Signal> {
        self.signals.get(path).copied()
    }

    /// The signal at `path`; described like this, when nobody has described it before. `None` when there are too many.
    pub(crate) fn register(
        &mut self,
        path: &str,
        components: &[&str],
        units: &[&str],
        about: &str,
    ) -> Option<&'static Signal> {
        if let Some(known) = self.get(path) {
            return Some(known);
        }
        if self.signals.len() >= ROOM {
            return None;
        }
        let all = |words: &[&str]| -> &'static [&'static str] {
            let words: Vec<&'static str> = words.iter().map(|word| forever(word)).collect();
            Vec::leak(words)
        };
        let (path, about) = (forever(path), forever(about));
        let signal: &'static Signal =
            Box::leak(Box::new(Signal { path, components: all(components), units: all(units), about }));
        self.signals.insert(path, signal);
        Some(signal)
    }

    /// A label's value; `None` when there are too many.
    pub(crate) fn label(&mut self, value: &str) -> Option<&'static str> {
        if let Some(known) = self.labels.get(value) {
            return Some(known);
        }
        if self.labels.len() >= ROOM {
            return None;
        }
        let value = forever(value);
        self.labels.insert(value);
        Some(value)
    }
}

fn forever(text: &str) -> &'static str {
    String::leak(text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signal_is_kept_once_and_as_first_described() {
        let mut registry = SignalRegistry::default();
        let first = registry.register("a/b", &["x"], &["m"], "first").unwrap();
        let again = registry.register("a/b", &[], &[], "second").unwrap();
        assert!(std::ptr::eq(first, again) && first.components == ["x"] && first.unit(0) == "m");
        assert!(std::ptr::eq(registry.label("on").unwrap(), registry.label("on").unwrap()));
    }

    #[test]
    fn whoever_makes_names_up_fills_no_memory() {
        let mut registry = SignalRegistry::default();
        for i in 0..ROOM {
            assert!(registry.register(&i.to_string(), &[], &[], "").is_some());
        }
        assert!(registry.register("one more", &[], &[], "").is_none());
        assert!(registry.register("0", &[], &[], "").is_some(), "what is known stays known");
    }
}
