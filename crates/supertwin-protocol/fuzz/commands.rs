//! Whatever requests arrive, in whatever order: without authority nothing is scheduled, a number is obeyed once, memory
//! is bounded, and a lease is never held by two.
//!
//! A payload is a sequence of lines `NAME BODY`: a command of that name, or a request for the lease when it is `lease`;
//! a line `tick` lets time pass. The token in bodies is `t`, the holder `anna`.

use crate::command_queue::{Answer, CommandQueue, Request, RequestTime};
use crate::lease::{Authority, LeaseAction, LeaseRequest, LeaseState, LeaseView};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::time::Duration;
use supertwin_core::command::{ControllerCommand, EstimatorCommand, GuidanceCommand, PlantCommand, Setpoint};
use supertwin_core::{Refusal, Tick};

/// One queue with its model: the last number that was scheduled for each client, and under which lease.
struct Bench<C> {
    queue: CommandQueue<C>,
    scheduled: BTreeMap<String, (String, u64)>,
    waiting_before: usize,
}

impl<C: Serialize + DeserializeOwned + Clone> Bench<C> {
    fn new() -> Self {
        Self { queue: CommandQueue::new(&[]), scheduled: BTreeMap::new(), waiting_before: 0 }
    }

    fn submit(&mut self, name: &str, body: &[u8], lease: &LeaseView, moment: RequestTime, refuse: bool) {
        let before = self.queue.counts;
        let attempt = |_: &C| if refuse { Err(Refusal("no".to_owned())) } else { Ok(()) };
        let answer = self.queue.submit(name, body, lease, moment, attempt);
        let counts = self.queue.counts;
        let rise = |after: u64, before: u64| usize::try_from(after - before).expect("small");
        let one = rise(counts.scheduled, before.scheduled)
            + rise(counts.refused, before.refused)
            + rise(counts.repeated, before.repeated);
        assert_eq!(one, 1, "every request is accounted for once");
        let grown = self.queue.waiting() - self.waiting_before;
        assert_eq!(grown, rise(counts.scheduled, before.scheduled), "what is refused or repeated leaves nothing");
        self.waiting_before = self.queue.waiting();
        let text = serde_json::to_vec(&answer).expect("an answer can be written");
        assert_eq!(serde_json::from_slice::<Answer>(&text).expect("and read"), answer);
        if counts.scheduled > before.scheduled {
            let request: Request = serde_json::from_slice(body).expect("only a request is scheduled");
            let Answer::Scheduled { seq, apply_tick, .. } = answer else { panic!("scheduled and refused") };
            assert_eq!(seq, request.seq);
            assert!(apply_tick >= moment.next && crate::keys::is_name(&request.client));
            let emergency = name == "neutral" && request.value == true;
            assert!(emergency || lease.allows(&request.client, &request.token, moment.now).is_ok());
            // A cry for help has no memory. Another lease counts from the start again, as does a client that was
            // forgotten among many.
            if !emergency && self.scheduled.len() < 60 {
                let last = self.scheduled.insert(request.client, (request.token.clone(), seq));
                assert!(last.is_none_or(|(token, last)| token != request.token || seq > last), "numbers only rise");
            }
        }
    }

    fn due(&mut self, k: u64) {
        for waiting in self.queue.due(k) {
            serde_json::to_value(&waiting.command).expect("a command can be written");
            assert!(waiting.by.is_some() && !waiting.name.is_empty());
        }
        self.waiting_before = self.queue.waiting();
    }
}

/// One payload.
pub(crate) fn check(payload: &[u8]) {
    let mut authority = Authority::default();
    let mut view = LeaseView::default();
    let mut now = Duration::from_secs(1);
    let mut next = 0;
    let (mut plant, mut estimator) = (Bench::<PlantCommand>::new(), Bench::<EstimatorCommand>::new());
    let (mut guidance, mut controller) = (Bench::<GuidanceCommand>::new(), Bench::<ControllerCommand>::new());
    for line in payload.split(|byte| *byte == b'\n').take(200) {
        let (name, body) = line.iter().position(|byte| *byte == b' ').map_or((line, &[][..]), |at| {
            let (name, rest) = line.split_at(at);
            (name, &rest[1..])
        });
        let Ok(name) = core::str::from_utf8(name) else { continue };
        match name {
            "tick" => {
                next += 1;
                now += Duration::from_millis(20 * u64::from(body.first().copied().unwrap_or(1)));
                plant.due(next);
                estimator.due(next);
                guidance.due(next);
                controller.due(next);
            }
            "state" => {
                // What another one says about the lease, true or not, is never believed for longer than a lease lasts.
                if let Ok(state) = serde_json::from_slice::<LeaseState>(body) {
                    let mut other = LeaseView::default();
                    other.update(state, now);
                    assert!(other.holder(now + Duration::from_secs(61)).is_none());
                }
            }
            "lease" => {
                let Ok(request) = serde_json::from_slice::<LeaseRequest>(body) else { continue };
                let held = authority.view.holder(now).map(str::to_owned);
                let mine = authority.view.allows(&request.client, &request.token, now).is_ok();
                let (reply, _) = authority.answer(&request, "t", now);
                if let Some(held) = held {
                    let stays = authority.view.holder(now) == Some(held.as_str());
                    assert!(stays || (mine && request.action == LeaseAction::Release), "a lease was taken away");
                    assert!(reply.token.is_none(), "the token is told once");
                }
                assert!((0.0..=60.0).contains(&reply.expires_in_s));
                view.update(authority.state("fuzz", now), now);
            }
            _ => {
                let refuse = body.len() % 7 == 3;
                let moment = RequestTime { now, next, tick_s: 0.02, lead: 3 };
                plant.submit(name, body, &view, moment, refuse);
                estimator.submit(name, body, &view, moment, refuse);
                guidance.submit(name, body, &view, moment, refuse);
                controller.submit(name, body, &view, moment, refuse);
                // A set-point of any shape can be followed.
                if let Ok(setpoint) = serde_json::from_slice::<Setpoint>(body)
                    && setpoint.check(name, -1e6, 1e6).is_ok()
                {
                    let mut trajectory = supertwin_core::command::Trajectory::constant(1.0);
                    trajectory.follow(setpoint, Tick { k: next, dt_s: 0.02 });
                    assert!(trajectory.at(Tick { k: next + 7, dt_s: 0.02 }).is_finite());
                }
            }
        }
    }
}
