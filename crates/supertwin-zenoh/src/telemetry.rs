//! Everything a block shows at a tick, as one message; and what of its inputs it had.

use serde::ser::{Error as _, SerializeMap};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;
use std::collections::BTreeMap;
use supertwin_core::{Block, Observe, Probe, Signal};

/// Telemetry as a service writes it.
#[derive(Debug, Serialize)]
pub(crate) struct Shown<'a, B: Block> {
    /// The tick of each input that the step used, by key.
    #[serde(serialize_with = "map")]
    pub(crate) used: &'a [(&'static str, u64)],
    /// Commands that applied at this tick.
    #[serde(skip_serializing_if = "<[Value]>::is_empty")]
    pub(crate) commands: &'a [Value],
    /// Every signal by its path.
    #[serde(serialize_with = "signals")]
    pub(crate) signals: (&'a B, &'a B::Out),
}

fn map<S: Serializer>(pairs: &[(&'static str, u64)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(pairs.iter().copied())
}

fn signals<B: Block, S: Serializer>(shown: &(&B, &B::Out), serializer: S) -> Result<S::Ok, S::Error> {
    let mut probe = MapProbe { map: serializer.serialize_map(None)?, failed: None };
    shown.0.observe(&mut probe);
    shown.1.observe(&mut probe);
    match probe.failed {
        Some(error) => Err(error),
        None => probe.map.end(),
    }
}

struct MapProbe<M: SerializeMap> {
    map: M,
    failed: Option<M::Error>,
}

impl<M: SerializeMap> MapProbe<M> {
    fn entry(&mut self, path: &'static str, value: &(impl Serialize + ?Sized)) {
        if self.failed.is_none() {
            self.failed = self.map.serialize_entry(path, value).err();
        }
    }
}

impl<M: SerializeMap> Probe for MapProbe<M> {
    fn vector(&mut self, signal: &'static Signal, values: &[f64]) {
        if values.iter().all(|x| x.is_finite()) {
            self.entry(signal.path, values);
        } else if self.failed.is_none() {
            self.failed = Some(M::Error::custom(format!("{} is NaN or infinite", signal.path)));
        }
    }
    fn label(&mut self, signal: &'static Signal, value: &'static str) {
        self.entry(signal.path, value);
    }
}

/// Telemetry as a listener reads it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Telemetry {
    /// The tick of each input that the step used, by key.
    pub used: BTreeMap<String, u64>,
    /// Commands that applied at this tick.
    #[serde(default)]
    pub commands: Vec<Value>,
    /// Every signal by its path.
    pub signals: BTreeMap<String, Shape>,
}

/// A signal's value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Shape {
    /// Numbers, one per component.
    Numbers(Vec<f64>),
    /// A state with a name.
    Label(String),
}
