//! The Doppler velocity log.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One ping of the forward-looking DVL.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DvlPing {
    /// When the sound was sent, in seconds of the run.
    pub taken_at_s: f64,
    /// Surge, sway, heave of the vehicle relative to the net, in m/s; absent when fewer than three beams came back.
    pub velocity_m_per_s: Option<[f64; 3]>,
    /// Range along each of the four beams in metres; absent where nothing came back.
    pub beam_range_m: [Option<f64>; 4],
}

/// Names of the four beams.
pub const BEAM_NAMES: &[&str] = &["beam1", "beam2", "beam3", "beam4"];

shown! { ping: DvlPing, "plant/measurements/":
    TAKEN_AT "dvl_taken_at" &[], &["s"], "when the ping was sent" => { ping.taken_at_s };
    RANGE "dvl_range" BEAM_NAMES, &["m"], "DVL beam ranges; 0 where nothing came back" => { ping.beam_range_m };
    VELOCITY "dvl_velocity" &["surge", "sway", "heave"], &["m/s"], "DVL velocity relative to the net"
        => { ping.velocity_m_per_s };
}
