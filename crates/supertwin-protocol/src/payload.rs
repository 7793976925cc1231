//! Payloads of the keys that are no message of a block.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// What ends a lock-step run for everybody.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stop {
    /// Identifier of the run that is over.
    pub run: String,
    /// Service and instance that ends it.
    pub source: String,
    /// The tick at which it ends.
    pub tick: u64,
    /// All ticks were done.
    pub complete: bool,
    /// Why it ends, for people.
    pub reason: String,
}

/// A witness has seen a tick.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Seen {
    /// Identifier of the run.
    pub run: String,
    /// Name and instance of the witness.
    pub source: String,
    /// The newest tick of which it has everything.
    pub tick: u64,
    /// Sent again because nothing was heard.
    #[serde(default)]
    pub repeat: bool,
}

/// A streaming set-point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StreamedSetpoint {
    /// Name of the client, the same as in its lease.
    pub client: String,
    /// Proof of authority, from the lease.
    pub token: String,
    /// Counts the client's samples on this key.
    pub seq: u64,
    /// The value; absent when the stream ends and the last value stays.
    #[serde(default)]
    pub value: Option<f64>,
}

/// The last accepted command of a name, at `state/<service>/<name>`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Applied {
    /// The value that was set.
    pub value: Value,
    /// The tick at which it applied.
    pub applied_tick: u64,
    /// Who asked for it: `client seq 7`; null for the mission.
    pub by: Option<String>,
}

/// The answer of `clock/ping`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Pong {
    /// The service's clock when it was asked, nanoseconds since 1970.
    pub received_ns: u64,
}

/// Which run and tick it is, for a service that starts anew.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Now {
    /// Identifier of the run.
    pub run: String,
    /// Service and instance that answers.
    pub source: String,
    /// The next tick that will be stepped.
    pub next: u64,
}

/// Names of the set-points that may be streamed.
pub const STREAMS: [&str; 4] = ["depth_m", "heading_rad", "net_distance_m", "speed_m_per_s"];
