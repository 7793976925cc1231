//! Where a run is written to: the trait between whoever produces a run and whoever keeps it.

use crate::{Event, Probe, Signal, Tick};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One property of a run, such as its seed or a score.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Property {
    /// A count, a seed.
    Integer(u64),
    /// A measure.
    Number(f64),
    /// A name, a hash, a whole configuration.
    Text(String),
}

impl From<&str> for Property {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}
impl From<String> for Property {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}
impl From<f64> for Property {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}
impl From<u64> for Property {
    fn from(number: u64) -> Self {
        Self::Integer(number)
    }
}

/// Version of what recordings contain, and how: the property `format` of a run, 1 where it is missing.
pub const FORMAT: u64 = 1;

/// Properties by name, in alphabetical order.
pub type Properties = BTreeMap<String, Property>;

/// What is known when a run begins.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunHeader {
    /// Unique name of the run, safe as a file name.
    pub name: String,
    /// Everything that is needed to repeat the run.
    pub properties: Properties,
    /// What can be drawn.
    pub scene: Scene,
}

/// What the eye needs beside the signals: geometry in metres, NED, and limits that are configured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// Polylines of the net at rest.
    pub net_lines_m: Vec<Vec<[f64; 3]>>,
    /// Half of length, breadth and height of the vehicle.
    pub body_half_size_m: [f64; 3],
    /// Unit vectors of the DVL beams, body axes.
    pub beams: [[f64; 3]; 4],
    /// The thrusters, in the order of their signals.
    pub thrusters: Vec<ThrusterPlace>,
    /// Lines beside curves.
    pub limits: Limits,
}

/// Where a thruster sits, body axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ThrusterPlace {
    /// Position in metres.
    pub position_m: [f64; 3],
    /// Direction of a positive force, a unit vector.
    pub direction: [f64; 3],
    /// Largest force either way.
    pub max_n: f64,
}

/// Limits as configured when the run began; commands that change them later do not change the lines.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Limits {
    /// Inside this band of the sliding variable an adaptive law lets its gains fall.
    pub alpha_tol: Option<[f64; 4]>,
    /// Gates on the normalised innovation squared by the signal of the innovation; a sensor without one takes everything.
    pub nis_gates: Vec<(&'static Signal, f64)>,
}

impl Limits {
    /// Gate of the sensor that has this innovation.
    #[must_use]
    pub fn nis_gate(&self, innovation: &Signal) -> Option<f64> {
        self.nis_gates.iter().find(|(of, _)| of.path == innovation.path).map(|(_, gate)| *gate)
    }
}

/// A run could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{what}: {cause}")]
pub struct SinkError {
    /// The file or stream.
    pub what: String,
    /// What the system or the library reported.
    pub cause: String,
}

/// Keeps a run: a listener that also hears where ticks begin and what happened.
///
/// Order of calls: `begin`, then per tick `tick`, the quantities and events of that tick, and at the end `finish`.
/// Dropping a sink without `finish` must leave what was heard so far readable.
pub trait RunSink: Probe {
    /// The run begins.
    ///
    /// # Errors
    /// When the run can't be written.
    fn begin(&mut self, header: &RunHeader) -> Result<(), SinkError>;
    /// What is shown from here on belongs to `tick`.
    ///
    /// # Errors
    /// When something shown earlier could not be written.
    fn tick(&mut self, tick: Tick) -> Result<(), SinkError>;
    /// Something happened.
    ///
    /// # Errors
    /// When it can't be written.
    fn event(&mut self, event: &Event) -> Result<(), SinkError>;
    /// The run is over; `results` are its scores and its hash.
    ///
    /// # Errors
    /// When something can't be written or closed.
    fn finish(&mut self, results: &Properties) -> Result<(), SinkError>;
}

/// Two who keep the same run; both hear everything, also when one fails.
impl<A: RunSink, B: RunSink> RunSink for crate::observe::Both<'_, A, B> {
    fn begin(&mut self, header: &RunHeader) -> Result<(), SinkError> {
        let first = self.0.begin(header);
        self.1.begin(header).and(first)
    }
    fn tick(&mut self, tick: Tick) -> Result<(), SinkError> {
        let first = self.0.tick(tick);
        self.1.tick(tick).and(first)
    }
    fn event(&mut self, event: &Event) -> Result<(), SinkError> {
        let first = self.0.event(event);
        self.1.event(event).and(first)
    }
    fn finish(&mut self, results: &Properties) -> Result<(), SinkError> {
        let first = self.0.finish(results);
        self.1.finish(results).and(first)
    }
}

/// A run that nobody keeps.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoSink;

impl Probe for NoSink {
    fn vector(&mut self, _: &'static Signal, _: &[f64]) {}
    fn label(&mut self, _: &'static Signal, _: &'static str) {}
}
impl RunSink for NoSink {
    fn begin(&mut self, _: &RunHeader) -> Result<(), SinkError> {
        Ok(())
    }
    fn tick(&mut self, _: Tick) -> Result<(), SinkError> {
        Ok(())
    }
    fn event(&mut self, _: &Event) -> Result<(), SinkError> {
        Ok(())
    }
    fn finish(&mut self, _: &Properties) -> Result<(), SinkError> {
        Ok(())
    }
}
