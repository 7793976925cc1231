//! Whatever bytes arrive on a wire: either no message, or one that comes back bit for bit when it is written again.
//!
//! ```text
//! rustup toolchain install nightly; cargo install cargo-fuzz
//! cd crates/supertwin-zenoh && cargo +nightly fuzz run decode -- -max_total_time=300
//! ```
#![no_main]
#![allow(dead_code, reason = "the modules under test have more than is tested here")]

#[path = "../../src/envelope.rs"]
mod envelope;

use envelope::{Envelope, MAX_PAYLOAD, decode, encode};
use libfuzzer_sys::fuzz_target;
use supertwin_core::Event;
use supertwin_core::message::{Measurements, Message, Nav, Reference, Thrust, Truth, WrenchRequest};

/// What was read can be written, and reads the same again; every number is finite.
fn check<M: serde::Serialize + serde::de::DeserializeOwned>(payload: &[u8]) -> Option<M> {
    let envelope: Envelope<'_, M> = decode(payload).ok()?;
    let mut once = Vec::new();
    encode(&envelope, &mut once).expect("what was read can be written");
    if once.len() <= MAX_PAYLOAD {
        // Numbers are written with all their digits: equal text is equal bits.
        let again: Envelope<'_, M> = decode(&once).expect("what was written can be read");
        assert_eq!((&again.run, &again.source), (&envelope.run, &envelope.source));
        assert_eq!((again.tick, again.seq, again.repeat), (envelope.tick, envelope.seq, envelope.repeat));
        assert_eq!((again.clock_ns, &again.digest), (envelope.clock_ns, &envelope.digest));
        assert_eq!(again.sim_time_s.to_bits(), envelope.sim_time_s.to_bits());
        let mut twice = Vec::new();
        encode(&again, &mut twice).expect("and written again");
        assert_eq!(once, twice);
    }
    Some(envelope.data)
}

fn message<M: Message>(payload: &[u8]) {
    if let Some(data) = check::<M>(payload) {
        assert!(data.is_finite(), "a number that is none came through");
    }
}

fuzz_target!(|payload: &[u8]| {
    message::<Measurements>(payload);
    message::<Truth>(payload);
    message::<Nav>(payload);
    message::<Reference>(payload);
    message::<Thrust>(payload);
    message::<WrenchRequest>(payload);
    check::<Event>(payload);
});
