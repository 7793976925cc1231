//! Everything a block shows at a tick, as one message; and what of its inputs it had.

use crate::envelope::{Envelope, Rejected, decode};
use schemars::JsonSchema;
use serde::ser::{Error as _, SerializeMap};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;
use std::borrow::Cow;
use std::collections::BTreeMap;
use supertwin_core::{Block, Observe, Probe, Signal};

/// Telemetry as a service writes it.
#[derive(Debug, Serialize)]
pub struct Shown<'a, B: Block> {
    /// What of its inputs the step used.
    #[serde(serialize_with = "map")]
    pub used: Used,
    /// Steps that the block has done in this run, this one included, and those that nothing was sent of.
    pub steps: u64,
    /// The operator was lost.
    #[serde(skip_serializing_if = "core::ops::Not::not")]
    pub operator_lost: bool,
    /// Commands that applied at this tick.
    #[serde(skip_serializing_if = "<[Value]>::is_empty")]
    pub commands: &'a [Value],
    /// Commands that applied at ticks before, of which no telemetry was sent.
    #[serde(skip_serializing_if = "<[AppliedBefore]>::is_empty")]
    pub earlier: &'a [AppliedBefore],
    /// Every signal by its path.
    #[serde(serialize_with = "signals")]
    pub signals: (&'a B, &'a B::Out),
}

/// Ticks of the messages that a step used, by key and in the order of the wires.
pub type Used = Vec<(&'static str, Vec<u64>)>;

fn map<S: Serializer>(used: &Used, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(used.iter().map(|(key, ticks)| (key, ticks)))
}

/// The signals that a block has shown so far: what a recorder needs to know of them beside their numbers.
#[derive(Debug, Default)]
pub struct SignalList {
    /// In the order in which they are shown.
    pub known: Vec<&'static Signal>,
    cursor: usize,
    grown: bool,
}

impl SignalList {
    /// Looks at what a block shows; true when something is there for the first time.
    pub fn update<B: Block>(&mut self, block: &B, out: &B::Out) -> bool {
        (self.cursor, self.grown) = (0, false);
        block.observe(self);
        out.observe(self);
        self.grown
    }

    fn add(&mut self, signal: &'static Signal) {
        // Signals are shown in the same order at every tick: mostly the next one is it.
        let (before, after) = self.known.split_at(self.cursor.min(self.known.len()));
        let is_it = |known: &&'static Signal| std::ptr::eq(*known, signal);
        if let Some(ahead) = after.iter().position(is_it) {
            self.cursor += ahead + 1;
        } else if let Some(at) = before.iter().position(is_it) {
            self.cursor = at + 1;
        } else {
            self.known.insert(self.cursor, signal);
            self.cursor += 1;
            self.grown = true;
        }
    }
}

impl Probe for SignalList {
    fn vector(&mut self, signal: &'static Signal, _: &[f64]) {
        self.add(signal);
    }
    fn label(&mut self, signal: &'static Signal, _: &'static str) {
        self.add(signal);
    }
}

/// A [`Signal`] as `state/<service>/signals` lists it, without its numbers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Description<'a> {
    /// `service/quantity`.
    #[serde(borrow)]
    pub path: Cow<'a, str>,
    /// Names of the components; empty for a scalar.
    pub components: Vec<Cow<'a, str>>,
    /// Unit of every component, or one unit for all of them.
    pub units: Vec<Cow<'a, str>>,
    /// What the signal means.
    pub about: Cow<'a, str>,
}

fn signals<B: Block, S: Serializer>(shown: &(&B, &B::Out), serializer: S) -> Result<S::Ok, S::Error> {
    let mut probe = SignalMapWriter { map: serializer.serialize_map(None)?, failed: None };
    shown.0.observe(&mut probe);
    shown.1.observe(&mut probe);
    match probe.failed {
        Some(error) => Err(error),
        None => probe.map.end(),
    }
}

struct SignalMapWriter<M: SerializeMap> {
    map: M,
    failed: Option<M::Error>,
}

impl<M: SerializeMap> SignalMapWriter<M> {
    fn entry(&mut self, path: &'static str, value: &(impl Serialize + ?Sized)) {
        if self.failed.is_none() {
            self.failed = self.map.serialize_entry(path, value).err();
        }
    }
}

impl<M: SerializeMap> Probe for SignalMapWriter<M> {
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

/// A command with the tick at which it applied.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AppliedBefore {
    /// The tick at which it applied.
    pub tick: u64,
    /// The command, as the block took it.
    pub command: Value,
}

/// Telemetry as a listener reads it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Telemetry {
    /// Ticks of the messages that the step used, by key: all that were new where every one counts, else the newest.
    pub used: BTreeMap<String, Vec<u64>>,
    /// Steps that the block has done in this run, this one included, and those that nothing was sent of. 0: not told.
    #[serde(default)]
    pub steps: u64,
    /// The operator was lost.
    #[serde(default)]
    pub operator_lost: bool,
    /// Commands that applied at this tick.
    #[serde(default)]
    pub commands: Vec<Value>,
    /// Commands that applied at ticks before, of which no telemetry was sent.
    #[serde(default)]
    pub earlier: Vec<AppliedBefore>,
    /// Every signal by its path.
    pub signals: BTreeMap<String, Shape>,
}

/// Reads telemetry.
///
/// # Errors
/// As [`decode`].
pub fn read(payload: &[u8]) -> Result<Envelope<'_, Telemetry>, Rejected> {
    decode(payload)
}

/// A signal's value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Shape {
    /// Numbers, one per component.
    Numbers(Vec<f64>),
    /// A state with a name.
    Label(String),
}
