//! Signals about the wires: messages withheld in one process, and over a network the accounts of services and recorder.

use crate::services::SERVICES;

/// Of times in an account.
const QUANTILES: &[&str] = &["median", "p99", "max"];

crate::signals! { pub below "link/":
    WITHHELD "withheld" &["measurements", "nav", "reference", "thrust"], &["count"], "messages lost on cut wires";
    GAPS "recorder/gaps" &SERVICES, &["count"], "messages that are not in this recording";
    LAG "recorder/lag" &[], &["ms"], "from the plant's clock to the recorder's";
}

/// A signal that each service has, at `link/<service>/<name>`.
#[derive(Clone, Copy, Debug)]
pub struct Account {
    /// Last part of its path.
    pub name: &'static str,
    /// Names of the components; empty for a scalar, and where there is one per wire.
    pub components: &'static [&'static str],
    /// Unit of all of them.
    pub unit: &'static str,
    /// What it is, in one line.
    pub about: &'static str,
}

impl Account {
    /// The path of this account of `service`.
    #[must_use]
    pub fn path(&self, service: &str) -> String {
        format!("link/{service}/{}", self.name)
    }

    /// Which of its numbers is called `name`.
    ///
    /// # Panics
    /// When there is none: in a `const`, the program does not compile.
    #[must_use]
    pub const fn at(&self, name: &str) -> usize {
        crate::handle::position(self.components, name).expect("no component of this name")
    }
}

macro_rules! accounts {
    ($($name:ident $path:literal $components:expr, $unit:literal, $about:literal;)*) => {
        $(
            #[doc = concat!("Account: ", $about, ".")]
            pub static $name: Account =
                Account { name: $path, components: $components, unit: $unit, about: $about };
        )*
    };
}

accounts! {
    STEP_TIME "step_time" QUANTILES, "µs", "time of a step with all that belongs to it";
    LOOP_TIME "loop_time" QUANTILES, "µs", "from measurements to the thrust they led to";
    RATE "rate" &[], "Hz", "steps per second";
    DEADLINE "deadline" &["misses", "skipped", "by_timer", "late_triggers"], "count",
        "ticks that did not come as planned";
    REFUSED "refused" &["refused", "overflow", "telemetry_dropped", "letters_dropped", "not_finite"], "count",
        "what was refused or did not fit";
    AGE "age" &[], "ticks", "greatest age of an input at a step";
    TRANSPORT "transport" &[], "ms", "longest way of an input, if the clocks agree";
    MISSING "missing" &[], "count", "messages of an input that never came";
}

/// The recorder's account of the wire `key`: messages that are not in the recording.
#[must_use]
pub fn wire_gaps(key: &str) -> String {
    format!("link/recorder/wire_gaps/{key}")
}
