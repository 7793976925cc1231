//! Starting anew while the others run: which run and tick it is, who has the lease, what was in force.

use super::Host;
use super::ports::{Deliver, Delivered};
use crate::session::LinkError;
use crate::transport::question;
use std::time::Duration;
use supertwin_core::{EventKind, Severity, Wired};
use supertwin_protocol::keys;
use supertwin_protocol::ledger::Ledger;
use supertwin_protocol::payload::Now;
use zenoh::bytes::ZBytes;
use zenoh::sample::Locality;
use zenoh::{Session, Wait};

/// Longest wait for those who are up, when a service starts.
const REJOIN: Duration = Duration::from_secs(1);

impl<B: Wired + 'static> Host<B> {
    /// Real time: learns from those who are up which run and tick it is, who has the lease, and what the last
    /// messages were.
    pub(super) fn rejoin(&mut self, session: &Session) -> Result<(), LinkError> {
        let ask = |key: String| {
            // Not our own: nobody answers for us yet.
            let question = question(session, &key, REJOIN).allowed_destination(Locality::Remote);
            question.wait().map_err(LinkError::session(&*key))
        };
        // All questions at once: whoever is up answers within a tick, and the wait is one time-out at worst.
        let (nows, lease) = (ask(keys::state("*", "now"))?, ask(keys::LEASE_STATE.to_owned())?);
        let kept = self.ports.states().map(|port| ask(keys::held("*", port.key))).collect::<Result<Vec<_>, _>>()?;
        let payloads = |replies: zenoh::handlers::FifoChannelHandler<zenoh::query::Reply>| -> Vec<ZBytes> {
            let samples = replies.into_iter().filter_map(|reply| reply.into_result().ok());
            samples.map(|sample| sample.payload().clone()).collect()
        };
        let mut newest: Option<Now> = None;
        for payload in payloads(nows) {
            let Ok(now) = serde_json::from_slice::<Now>(&payload.to_bytes()) else { continue };
            let others = now.source != self.source && !now.run.is_empty() && now.next > 0;
            if others && newest.as_ref().is_none_or(|best| now.next > best.next) {
                newest = Some(now);
            }
        }
        let Some(newest) = newest else { return Ok(()) };
        if B::OWNS_TIME {
            self.run.clone_from(&newest.run);
            self.next = newest.next + 1;
            // Its mission up to here is history.
            self.commands.due(self.next.saturating_sub(1));
            self.note(Severity::Info, EventKind::RunRejoined { run: self.run.clone(), at_tick: self.next });
        }
        for (i, replies) in kept.into_iter().enumerate() {
            payloads(replies).iter().for_each(|payload| self.offer_held(i, payload, &newest.run));
        }
        let lease = payloads(lease);
        // The answers took their time.
        self.now = self.clock.now();
        for payload in lease {
            self.lease_state(&payload.to_bytes());
        }
        Ok(())
    }

    /// A message that somebody kept: known, but nothing new, and no sign that its writer is alive.
    pub(super) fn offer_held(&mut self, i: usize, payload: &ZBytes, run: &str) {
        let mut scratch = Ledger::new(Duration::ZERO);
        let mut its_run = run.to_owned();
        let mut deliver = Deliver {
            wanted: i,
            payload: &payload.to_bytes(),
            ledger: &mut scratch,
            run: &mut its_run,
            lock_step: false,
            now: self.now,
            newest_allowed: u64::MAX - 1,
            outcome: Delivered::Nothing,
        };
        self.ports.visit(&mut deliver);
        if let Delivered::Taken { .. } = deliver.outcome {
            self.wires[i].held = Some(payload.clone());
        }
    }
}
