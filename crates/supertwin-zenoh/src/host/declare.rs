//! What a host declares on its session: the wires it listens to, the questions it answers, the wire it writes.

use super::{HostOptions, Pace, WireKind};
use crate::mailbox::Mailbox;
use crate::outbox::{Outbox, Outgoing};
use crate::session::LinkError;
use crate::transport::publisher;
use std::sync::Arc;
use supertwin_core::{Ports, Wired};
use supertwin_protocol::keys;
use supertwin_protocol::payload::STREAMS;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::Priority;
use zenoh::query::{Query, Queryable};
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

/// The wires that a host listens to, by their number in the mailbox; the block's own come first.
pub(super) fn wire_kinds<B: Wired>(ports: &Ports<B>, options: &HostOptions<B::Command>) -> Vec<(String, WireKind)> {
    let mut kinds: Vec<_> = ports.states().map(|port| (port.key.to_owned(), WireKind::Port)).collect();
    if options.takes_setpoints {
        kinds.extend(STREAMS.iter().enumerate().map(|(i, name)| (keys::setpoint(name), WireKind::Setpoint(i))));
    }
    if !options.keeps_authority {
        kinds.push((keys::LEASE_STATE.to_owned(), WireKind::Lease));
    }
    if options.pace == Pace::LockStep {
        kinds.push((keys::stop("*"), WireKind::Stop));
        if !options.witnesses.is_empty() {
            kinds.push((keys::witness("*"), WireKind::Witness));
        }
    }
    if options.keeps_authority {
        kinds.push((keys::operator("*"), WireKind::Operator));
    }
    kinds
}

/// Puts what arrives on the wires into the mailbox, for host number `index`. Of an operator only its end is told, by name.
pub(super) fn subscribe(
    session: &Session,
    kinds: &[(String, WireKind)],
    mailbox: &Arc<Mailbox>,
    index: usize,
) -> Result<Vec<Subscriber<()>>, LinkError> {
    let declare = |(number, (key, kind)): (usize, &(String, WireKind))| {
        let mailbox = Arc::clone(mailbox);
        if *kind == WireKind::Operator {
            let subscriber = session.liveliness().declare_subscriber(key.clone()).callback(move |sample| {
                if sample.kind() == SampleKind::Delete {
                    let client = sample.key_expr().as_str().rsplit('/').next().unwrap_or("").to_owned();
                    mailbox.wire(index, number, ZBytes::from(client));
                }
            });
            return subscriber.wait().map_err(LinkError::session("liveliness of operators"));
        }
        let subscriber = session.declare_subscriber(key.clone()).callback(move |sample| {
            if sample.kind() == SampleKind::Put {
                mailbox.wire(index, number, sample.payload().clone());
            }
        });
        subscriber.wait().map_err(LinkError::session(format!("subscriber {key}")))
    };
    kinds.iter().enumerate().map(declare).collect()
}

/// Answers requests, questions for states and, where authority is kept, for the lease.
pub(super) fn queryables<B: Wired>(
    session: &Session,
    keeps_authority: bool,
    mailbox: &Arc<Mailbox>,
    index: usize,
    outbox: &Outbox,
) -> Result<Vec<Queryable<()>>, LinkError> {
    let mut served = vec![
        keys::command(B::NAME, "*"),
        format!("{}/**", keys::param(B::NAME, "")),
        keys::held(B::NAME, "**"),
        keys::state(B::NAME, "now"),
    ];
    let mut states = vec![keys::state(B::NAME, "*")];
    if keeps_authority {
        served.extend([keys::LEASE.to_owned(), keys::PING.to_owned()]);
        states.push(keys::LEASE_STATE.to_owned());
    }
    let failed = |key: &str| LinkError::session(format!("queryable {key}"));
    let serve = |key: String| {
        let mailbox = Arc::clone(mailbox);
        let answered = move |query: Query| {
            let urgent = query.key_expr().as_str().ends_with("/neutral");
            mailbox.request(index, query, urgent);
        };
        session.declare_queryable(&key).complete(true).callback(answered).wait().map_err(failed(&key))
    };
    let tell = |key: String| {
        let outbox = Arc::clone(&outbox.shared);
        let answered = move |query| outbox.send(Outgoing::StateQuery(query));
        session.declare_queryable(&key).callback(answered).wait().map_err(failed(&key))
    };
    served.into_iter().map(serve).chain(states.into_iter().map(tell)).collect()
}

pub(super) fn wire_publisher(session: &Session, key: &str) -> Result<Publisher<'static>, LinkError> {
    publisher(session, key.to_owned(), Priority::InteractiveHigh)
        .express(true)
        .wait()
        .map_err(LinkError::session(format!("publisher {key}")))
}
