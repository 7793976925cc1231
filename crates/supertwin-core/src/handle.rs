//! The handle of a signal: a named quantity with its components, units and meaning.

/// A named quantity. Its path is at once telemetry path, recording entity and dashboard content.
///
/// Declare signals as `static` (by [`signals!`](crate::signals)): listeners may tell them apart by address.
#[derive(Debug, PartialEq, Eq, Hash, serde::Serialize)]
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
pub(crate) const fn position(names: &[&str], name: &str) -> Option<usize> {
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
    /// The signal whose component it is.
    pub signal: &'static Signal,
    /// Its place among the numbers of a tick.
    pub index: usize,
}

impl Component {
    /// Unit of its number, as the signal declares it.
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
        #[allow(dead_code, reason = "a law that has signals for itself alone lists them nowhere")]
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

#[cfg(test)]
mod tests {
    // Without a visibility, as in the file of a control law.
    crate::signals! { below "controller/":
        OWN "own" &["surge", "sway"], &["N"], "signal that one law shows";
    }

    #[test]
    fn a_signal_may_be_private_to_its_file() {
        assert_eq!((OWN.service(), OWN.width(), OWN.unit(1)), ("controller", 2, "N"));
    }
}
