//! One block, fed again with what it had: the messages, commands and restarts of every instance of it.

use super::plan::{BlockHistory, Instance, Step};
use super::track::Track;
use super::{BlockVerdict, Inexact, Messages};
use crate::ring::RingBlock;
use std::collections::BTreeSet;
use supertwin_core::command::Command;
use supertwin_core::digest::{DigestProbe, block_digest};
use supertwin_core::event::EventCommand;
use supertwin_core::port::PortVisitor;
use supertwin_core::{Event, EventKind, Message, OperatorLink, Port, Ports, Severity, Tick, Watch};

/// Steps that are made up for where the recording has none; more of them lead nowhere.
const MOST_UNTOLD: u64 = 5000;

/// What became of one block.
#[derive(Clone, Debug, Default)]
pub(crate) struct Played {
    pub(crate) track: Track,
    /// Steps that were replayed.
    pub(crate) steps: u64,
    pub(crate) instances: u64,
    /// Ticks of steps that must be equal in every bit.
    pub(crate) compared: BTreeSet<u64>,
    pub(crate) inexact: Vec<Inexact>,
    /// The hash of this tick is another one than the recorded one, and nothing explains that.
    pub(crate) digest_differs: Option<u64>,
    /// Hashes of the steps.
    pub(crate) digests: Vec<(u64, u64)>,
    /// Commands that applied in the run and are refused now.
    pub(crate) refused: Vec<Event>,
}

/// How a block is replayed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct How {
    pub(crate) tick_s: f64,
    /// Its outputs take the place of those that were recorded.
    pub(crate) anew: bool,
}

/// Which messages steps used that nothing was told of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Untold {
    /// Each what was the newest at its tick.
    Newest,
    /// All what the next one used: they were done one after the other, and nothing arrived in between.
    AsNext,
}

/// A block with its wires, on its way.
#[derive(Clone)]
struct State<B: RingBlock> {
    block: B,
    ports: Ports<B>,
    watch: Watch,
    /// Who wrote last on each port.
    writers: Vec<String>,
    /// The next command.
    command: usize,
}

/// Puts the messages that a step used into the ports.
struct Feed<'a> {
    messages: &'a Messages,
    /// Ticks by key; without it, what was the newest at this tick.
    used: Option<&'a [(String, Vec<u64>)]>,
    k: u64,
    writers: &'a mut Vec<String>,
    missing: Option<(&'static str, u64)>,
}

impl PortVisitor for Feed<'_> {
    fn port<M: Message>(&mut self, at: usize, port: &mut Port<M>) {
        if self.writers.len() <= at {
            self.writers.push(String::new());
        }
        let ticks = match self.used {
            Some(used) => {
                used.iter().find(|(key, _)| key == M::KEY).map(|(_, ticks)| ticks.clone()).unwrap_or_default()
            }
            None => {
                let Some(until) = port.state.expected(self.k) else { return };
                let mut ticks = self.messages.ticks::<M>(port.state.made_at(), until);
                ticks.drain(..ticks.len().saturating_sub(port.state.rule.keep));
                ticks
            }
        };
        for tick in ticks {
            // What is held was offered before.
            if port.state.made_at() == Some(tick) {
                continue;
            }
            let message = self.messages.at::<M>(tick, &self.writers[at]);
            match message {
                Some((source, message)) if port.state.made_at().is_none_or(|made_at| tick > made_at) => {
                    self.writers[at].clone_from(source);
                    port.offer(tick, message.clone());
                }
                _ => self.missing = self.missing.or(Some((M::KEY, tick))),
            }
        }
    }
}

/// Why the steps of an instance can't be held to the recording any more.
enum Doubt {
    /// Something that it used is not in the recording.
    Lacks(String),
    /// It differs since this tick.
    Differs(u64),
}

/// What one step came to.
struct Done<O> {
    out: O,
    events: Vec<Event>,
    missing: Option<(&'static str, u64)>,
}

/// One way to come to a step that was told.
struct Attempt<B: RingBlock> {
    state: State<B>,
    done: Done<B::Out>,
    digest: u64,
    /// Outputs of the steps before it that were not told.
    filled: Vec<(u64, B::Out)>,
}

impl<B: RingBlock> State<B> {
    fn new(block: B) -> Self {
        Self { watch: Watch::new(&block), ports: Ports::default(), block, writers: Vec::new(), command: 0 }
    }

    /// Makes ready for the first step. Says what that leaves in doubt.
    fn begin(
        &mut self,
        first: &Step,
        instance: &Instance,
        commands: &[(u64, Command)],
        messages: &Messages,
        how: How,
    ) -> Option<String> {
        // What applied before it began was for a predecessor.
        self.command = commands.partition_point(|(at, _)| *at < first.tick);
        if let Some((_, out)) = messages.at::<B::Out>(first.tick, &instance.source) {
            self.block.take_over(Tick { k: first.tick, dt_s: how.tick_s }, out);
        }
        let known = first.steps.unwrap_or(first.seq);
        (known > 1).then(|| format!("its first {} steps are not in the recording", known - 1))
    }

    fn step(
        &mut self,
        tick: Tick,
        used: Option<&[(String, Vec<u64>)]>,
        operator: OperatorLink,
        messages: &Messages,
        commands: &[(u64, Command)],
    ) -> Done<B::Out> {
        let mut events = Vec::new();
        while let Some((_, command)) = commands.get(self.command).filter(|(at, _)| *at <= tick.k) {
            self.command += 1;
            let Some(command) = B::own(command) else { continue };
            if let Err(refusal) = self.block.command(tick, command) {
                let command = serde_json::to_value(command).unwrap_or_default();
                let what = EventKind::CommandRefused {
                    command: EventCommand::new(B::NAME, command, None),
                    session: None,
                    reason: refusal.to_string(),
                    so_far: None,
                };
                events.push(Event::new(tick.k, B::NAME, Severity::Error, what));
            }
        }
        let mut feed = Feed { messages, used, k: tick.k, writers: &mut self.writers, missing: None };
        self.ports.visit(&mut feed);
        let missing = feed.missing;
        let out = self.block.step(tick, self.ports.input(tick, operator));
        self.ports.stepped();
        self.watch.after(tick, &self.block, &out, |event| events.push(event));
        Done { out, events, missing }
    }
}

/// Replays all instances of a block. `build` gives the block of one of them.
pub(crate) fn play<B: RingBlock, E>(
    part: &BlockHistory,
    messages: &mut Messages,
    how: How,
    mut build: impl FnMut(&Instance) -> Result<B, E>,
) -> Result<Played, E> {
    let mut played = Played { track: Track::new(B::NAME, how.tick_s), ..Played::default() };
    for instance in &part.instances {
        let block = build(instance)?;
        play_instance(block, instance, &part.commands, messages, how, &mut played);
        played.instances += 1;
    }
    Ok(played)
}

fn play_instance<B: RingBlock>(
    block: B,
    instance: &Instance,
    commands: &[(u64, Command)],
    messages: &mut Messages,
    how: How,
    played: &mut Played,
) {
    let mut state = State::new(block);
    let mut probe = DigestProbe::default();
    let mut doubt: Option<Doubt> = None;
    let mut before: Option<&Step> = None;
    for step in &instance.steps {
        played.steps += 1;
        let untold = match before {
            None => {
                doubt = state.begin(step, instance, commands, messages, how).map(Doubt::Lacks);
                None
            }
            Some(before) => untold(before, step, B::OWNS_TIME),
        };
        let told = Told { step, untold: untold.as_ref(), messages, commands, how };
        let attempt = told.best(state, &mut probe);
        let equal = step.digest.map(|recorded| recorded == attempt.digest);
        if let Some((key, at)) = attempt.done.missing {
            doubt.get_or_insert_with(|| {
                Doubt::Lacks(format!("the message of {key} at tick {at} is not in the recording"))
            });
        }
        if let Some(untold) = untold.filter(|_| equal != Some(true)) {
            doubt.get_or_insert(Doubt::Lacks(untold.why));
        }
        played.judge(step, before, equal, how.anew, &mut doubt);
        played.take(step, &attempt);
        if how.anew {
            for (k, out) in attempt.filled {
                // Telemetry may be thinned out where the wire is not.
                if messages.at::<B::Out>(k, "").is_some() {
                    messages.put(k, out);
                }
            }
            messages.put(step.tick, attempt.done.out);
        }
        before = Some(step);
        state = attempt.state;
    }
}

/// What is known of a step and of those before it that were not told.
struct Told<'a> {
    step: &'a Step,
    untold: Option<&'a Between>,
    messages: &'a Messages,
    commands: &'a [(u64, Command)],
    how: How,
}

impl Told<'_> {
    /// Of several ways to fill what was not told the one is taken that leads to the recorded hash.
    fn best<B: RingBlock>(&self, state: State<B>, probe: &mut DigestProbe) -> Attempt<B> {
        if self.untold.is_none() {
            return self.attempt(state, Untold::Newest, probe);
        }
        let [first, second] =
            if B::OWNS_TIME { [Untold::AsNext, Untold::Newest] } else { [Untold::Newest, Untold::AsNext] };
        let attempt = self.attempt(state.clone(), first, probe);
        if self.how.anew || self.step.digest == Some(attempt.digest) {
            return attempt;
        }
        let other = self.attempt(state, second, probe);
        if self.step.digest == Some(other.digest) { other } else { attempt }
    }

    fn attempt<B: RingBlock>(&self, mut state: State<B>, way: Untold, probe: &mut DigestProbe) -> Attempt<B> {
        let Self { step, messages, commands, .. } = *self;
        let tick = |k: u64| Tick { k, dt_s: self.how.tick_s };
        let mut filled = Vec::new();
        let mut lacking = None;
        let mut events = Vec::new();
        for k in self.untold.iter().flat_map(|untold| untold.ticks.clone()) {
            let used = (way == Untold::AsNext).then_some(step.used.as_slice());
            let done = state.step(tick(k), used, step.operator, messages, commands);
            lacking = lacking.or(done.missing);
            events.extend(done.events);
            filled.push((k, done.out));
        }
        let mut done = state.step(tick(step.tick), Some(&step.used), step.operator, messages, commands);
        done.missing = lacking.or(done.missing);
        events.append(&mut done.events);
        done.events = events;
        let digest = block_digest(probe, &state.block, &done.out);
        probe.finish_tick();
        Attempt { state, done, digest, filled }
    }
}

impl Played {
    /// Steps and gaps; whether they are as recorded is left open.
    pub(crate) fn without_comparison(&self) -> BlockVerdict {
        BlockVerdict {
            service: self.track.service,
            instances: self.instances,
            steps: self.steps,
            compared: 0,
            inexact: self.inexact.clone(),
            difference: None,
        }
    }

    /// Enters whether a step is as recorded, where that can be said. What makes a step doubtful makes all after it so.
    fn judge(
        &mut self,
        step: &Step,
        before: Option<&Step>,
        equal: Option<bool>,
        anew: bool,
        doubt: &mut Option<Doubt>,
    ) {
        if equal == Some(true) || (equal.is_none() && doubt.is_none()) {
            self.compared.insert(step.tick);
            return;
        }
        let why = match doubt {
            None => {
                // It must be equal, and is not.
                self.compared.insert(step.tick);
                self.digest_differs = Some(self.digest_differs.map_or(step.tick, |tick| tick.min(step.tick)));
                *doubt = Some(Doubt::Differs(step.tick));
                return;
            }
            // What is new differs for a reason: only what the recording lacks is worth telling.
            Some(Doubt::Differs(_)) if anew => return,
            Some(Doubt::Differs(tick)) => format!("it differs from the recording at tick {tick} already"),
            Some(Doubt::Lacks(why)) => why.clone(),
        };
        match self.inexact.last_mut() {
            Some(last) if last.why == why && before.is_some_and(|before| before.tick == last.to_tick) => {
                last.to_tick = step.tick;
            }
            _ => self.inexact.push(Inexact { from_tick: step.tick, to_tick: step.tick, why }),
        }
    }

    /// Enters what a step came to.
    fn take<B: RingBlock>(&mut self, step: &Step, attempt: &Attempt<B>) {
        self.track.show(step.tick, &attempt.state.block, &attempt.done.out);
        self.digests.push((step.tick, attempt.digest));
        for event in &attempt.done.events {
            if matches!(event.what, EventKind::CommandRefused { .. }) {
                self.refused.push(event.clone());
            }
            self.track.events.push(event.clone());
        }
    }
}

/// Steps between two that were told.
struct Between {
    ticks: core::ops::Range<u64>,
    why: String,
}

fn untold(before: &Step, step: &Step, owns_time: bool) -> Option<Between> {
    let lost = step.seq.saturating_sub(before.seq + 1);
    let steps = match (before.steps, step.steps) {
        (Some(before), Some(now)) => now.saturating_sub(before + 1),
        _ => lost,
    };
    if steps == 0 {
        return None;
    }
    let why = if lost > 0 {
        format!("{lost} messages of telemetry before tick {} are not in the recording", step.tick)
    } else if owns_time {
        format!("{steps} steps before tick {} were late, and nothing was sent of them", step.tick)
    } else {
        format!("{steps} steps before tick {} were not told by telemetry", step.tick)
    };
    let from = (before.tick + 1).max(step.tick.saturating_sub(steps.min(MOST_UNTOLD)));
    Some(Between { ticks: from..step.tick, why })
}
