//! What travels on a wire: a message with its run, source, tick and sequence number, as JSON with exact floats.

use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::time::Duration;
use supertwin_core::Tick;

/// Largest payload that is looked at, in bytes.
pub const MAX_PAYLOAD: usize = 64 * 1024;

/// A message on its way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Envelope<'a, T> {
    /// Which run it belongs to; a client that is no service may leave it empty.
    #[serde(borrow, default)]
    pub run: Cow<'a, str>,
    /// Which instance of which service sent it.
    #[serde(borrow)]
    pub source: Cow<'a, str>,
    /// The tick it was made at.
    pub tick: u64,
    /// Counts the source's messages on this key, from 1.
    pub seq: u64,
    /// Simulation time of the tick.
    #[serde(default)]
    pub sim_time_s: f64,
    /// The sender's clock, nanoseconds since 1970.
    #[serde(default)]
    pub clock_ns: u64,
    /// Hash of the sending block's state and output at this tick, 16 hexadecimal digits.
    #[serde(borrow, default, skip_serializing_if = "Option::is_none")]
    pub digest: Option<Cow<'a, str>>,
    /// Sent again because nothing was heard.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub repeat: bool,
    /// The message.
    pub data: T,
}

impl<'a> Envelope<'a, ()> {
    /// Of a message of `source` that is made at a tick, without digest and for the first time.
    #[must_use]
    pub fn new(run: &'a str, source: &'a str, tick: Tick, seq: u64, clock_ns: u64) -> Self {
        let (run, source, sim_time_s) = (run.into(), source.into(), tick.t_s());
        Self { run, source, tick: tick.k, seq, sim_time_s, clock_ns, digest: None, repeat: false, data: () }
    }

    /// The same around a message.
    pub fn with<T>(self, data: T) -> Envelope<'a, T> {
        let Self { run, source, tick, seq, sim_time_s, clock_ns, digest, repeat, .. } = self;
        Envelope { run, source, tick, seq, sim_time_s, clock_ns, digest, repeat, data }
    }
}

/// A sample that was heard.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Received {
    /// Its full key.
    pub key: String,
    /// Its bytes.
    pub payload: Vec<u8>,
    /// The key was deleted, or whoever showed to be alive no longer does.
    pub gone: bool,
    /// The listener's clock at its arrival.
    pub at: Duration,
}

/// Why a payload is no message: too long, and therefore not parsed, no JSON, or not of this message's schema.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Rejected(pub String);

/// Appends the JSON of `envelope` to `out`.
///
/// # Errors
/// When the value can't be written as JSON.
pub fn encode<T: Serialize>(envelope: &Envelope<'_, T>, out: &mut Vec<u8>) -> Result<(), Rejected> {
    serde_json::to_writer(out, envelope).map_err(|error| Rejected(error.to_string()))
}

/// Reads a message. JSON has no NaN and no infinity, and a number too large for a double is refused: what comes
/// back is finite.
///
/// # Errors
/// Says what is wrong, and where.
pub fn decode<T: DeserializeOwned>(payload: &[u8]) -> Result<Envelope<'_, T>, Rejected> {
    if payload.len() > MAX_PAYLOAD {
        return Err(Rejected(format!("{} bytes: must be at most {MAX_PAYLOAD}", payload.len())));
    }
    serde_json::from_slice(payload).map_err(|error| Rejected(error.to_string()))
}

/// Reads who sent a message, when, and with which number; what it says is not looked at.
///
/// # Errors
/// As [`decode`].
pub fn head(payload: &[u8]) -> Result<Envelope<'_, serde::de::IgnoredAny>, Rejected> {
    decode(payload)
}

#[cfg(test)]
mod tests {
    use super::*;
    use supertwin_core::message::{Measurements, Nav};

    fn envelope<T>(data: T) -> Envelope<'static, T> {
        let mut envelope = Envelope::new("r1", "estimator-1", Tick { k: 7, dt_s: 0.02 }, 8, 1).with(data);
        envelope.digest = Some("00000000000000ff".into());
        envelope
    }

    #[test]
    fn a_message_comes_back_bit_for_bit() {
        let nav = Nav { depth_m: 0.1 + 0.2, heading_rad: -1.0e-310, ..Nav::default() };
        let mut bytes = Vec::new();
        encode(&envelope(nav.clone()), &mut bytes).expect("encodes");
        let back: Envelope<'_, Nav> = decode(&bytes).expect("decodes");
        assert_eq!(back.data.depth_m.to_bits(), nav.depth_m.to_bits());
        assert_eq!(back.data.heading_rad.to_bits(), nav.heading_rad.to_bits());
        assert_eq!(back, envelope(nav));
    }

    #[test]
    fn what_is_no_message_is_refused() {
        let mut good = Vec::new();
        encode(&envelope(Measurements::default()), &mut good).expect("encodes");
        let good = String::from_utf8(good).expect("is text");
        for bad in [
            String::new(),
            "\u{0}\u{1}garbage".to_owned(),
            good.replace("\"tick\":7", "\"tick\":-7"),
            good.replace("\"tick\":7", "\"tick\":7,\"extra\":1"),
            good.replace("\"depth\":null", "\"depth\":{\"taken_at_s\":0.0,\"depth_m\":NaN}"),
            good.replace("\"depth\":null", "\"depth\":{\"taken_at_s\":0.0,\"depth_m\":1e999}"),
            good.replace("\"depth\":null", "\"depth\":{\"taken_at_s\":0.0,\"depth_m\":null}"),
            good[..good.len() - 2].to_owned(),
        ] {
            assert!(decode::<Measurements>(bad.as_bytes()).is_err(), "{bad}");
        }
        assert!(decode::<Measurements>(good.as_bytes()).is_ok());
        let padded = format!("{good}{}", " ".repeat(MAX_PAYLOAD));
        let rejected = decode::<Measurements>(padded.as_bytes()).expect_err("too long");
        assert!(rejected.0.contains("bytes: must be at most 65536"), "{rejected}");
    }
}
