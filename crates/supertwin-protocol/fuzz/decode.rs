//! Whatever bytes arrive on a wire: either no message, or one that comes back bit for bit when it is written again.

use crate::envelope::{Envelope, MAX_PAYLOAD, decode, encode};
use supertwin_core::Event;
use supertwin_core::message::{Measurements, Message, Nav, Reference, Thrust, Truth, WrenchRequest};

/// What was read can be written, and reads the same again; every number is finite.
fn same<M: serde::Serialize + serde::de::DeserializeOwned>(payload: &[u8]) -> Option<M> {
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
    if let Some(data) = same::<M>(payload) {
        assert!(data.is_finite(), "a number that is none came through");
    }
}

/// One payload.
pub(crate) fn check(payload: &[u8]) {
    message::<Measurements>(payload);
    message::<Truth>(payload);
    message::<Nav>(payload);
    message::<Reference>(payload);
    message::<Thrust>(payload);
    message::<WrenchRequest>(payload);
    same::<Event>(payload);
}
