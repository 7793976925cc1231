//! The ring in lock step, in one process.

use crate::config::ConfigError;
use crate::ring::{Blocks, RingBlock, RingVisitor, around};
use crate::trial_config::ResolvedTrial;
use crate::wires::RingWires;
use arrayvec::ArrayVec;
use supertwin_core::command::Command;
use supertwin_core::digest::{DigestProbe, RunDigest, block_digest};
use supertwin_core::message::{Measurements, Nav, Reference, Thrust, Truth};
use supertwin_core::observe::Snapshot;
use supertwin_core::{Block, Event, Observe, Probe, Refusal, Tick, Watch, signal};
use supertwin_plant::Drive;

/// Events that one tick can have; more are counted.
const MAX_EVENTS: usize = 16;

/// A quantity that is no number: the run stops here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("tick {k}: {path} is NaN or infinite")]
pub struct NonFinite {
    /// Tick at which it was found.
    pub k: u64,
    /// Path of the signal that holds NaN or an infinity.
    pub path: &'static str,
}

/// The blocks of the ring and their wires.
#[derive(Clone, Debug)]
pub struct Twin {
    pub(crate) blocks: Blocks,
    wires: RingWires,
    /// Hashes of plant, estimator, guidance and controller at the last tick.
    pub digests: [u64; 4],
    /// Hash of the run so far.
    pub run_digest: RunDigest,
    /// What happened at the last tick.
    pub events: ArrayVec<Event, MAX_EVENTS>,
    /// Events that did not fit; always zero unless something is very wrong.
    pub events_dropped: u64,
    /// What each block last gave notice of.
    watches: [Watch; 4],
}

/// The four messages of one tick.
#[derive(Clone, Copy, Debug)]
pub struct Outputs<'a> {
    /// Plant to estimator.
    pub measurements: &'a Measurements,
    /// Estimator to guidance and controller.
    pub nav: &'a Nav,
    /// Guidance to controller.
    pub reference: &'a Reference,
    /// Controller to plant and estimator.
    pub thrust: &'a Thrust,
}

impl Twin {
    /// Builds the blocks of a trial for one seed and wires them.
    ///
    /// # Errors
    /// When pieces that are legal alone do not fit together.
    pub fn new(trial: &ResolvedTrial, seed: u64) -> Result<Self, ConfigError> {
        Ok(Self::of(Blocks::new(trial, seed)?))
    }

    /// Connects the outputs of the blocks with the inputs of the next in the ring.
    #[must_use]
    pub fn of(blocks: Blocks) -> Self {
        let watches = [
            Watch::new(&blocks.plant),
            Watch::new(&blocks.estimator),
            Watch::new(&blocks.guidance),
            Watch::new(&blocks.controller),
        ];
        Self {
            blocks,
            wires: RingWires::default(),
            digests: [0; 4],
            run_digest: RunDigest::default(),
            events: ArrayVec::new(),
            events_dropped: 0,
            watches,
        }
    }

    /// From the next step on the plant is driven by this disturbance in the place of its environment.
    pub fn drive(&mut self, drive: Drive) {
        self.blocks.plant.drive(drive);
    }

    /// A command, from now on.
    ///
    /// # Errors
    /// When the block refuses it.
    pub fn command(&mut self, tick: Tick, command: &Command) -> Result<(), Refusal> {
        match command {
            Command::Plant(command) => self.blocks.plant.command(tick, command),
            Command::Estimator(command) => self.blocks.estimator.command(tick, command),
            Command::Guidance(command) => self.blocks.guidance.command(tick, command),
            Command::Controller(command) => self.blocks.controller.command(tick, command),
            Command::Link(command) => self.wires.command(tick, command),
        }
    }

    /// Steps every block once, in the order of the ring.
    pub fn step(&mut self, tick: Tick) {
        self.events.clear();
        self.wires.begin(tick);
        around(&mut Lap { twin: self, tick });
    }

    /// Hashes this tick's states and outputs; returns the tick's own hash.
    ///
    /// # Errors
    /// When a quantity is no number.
    pub fn digest(&mut self, tick: Tick, probe: &mut DigestProbe) -> Result<u64, NonFinite> {
        around(&mut Hash { twin: self, probe });
        if probe.finish_tick() {
            return Ok(self.run_digest.fold(tick, self.digests));
        }
        match Snapshot::of(self).first_non_finite() {
            Some(culprit) => Err(NonFinite { k: tick.k, path: culprit.path }),
            // Only their sum was none.
            None => Ok(self.run_digest.fold(tick, self.digests)),
        }
    }

    /// True state of the vehicle after the last step.
    #[must_use]
    pub fn truth(&self) -> &Truth {
        &self.blocks.plant.truth
    }

    /// Everything that the blocks put out at the last tick, whether or not it got through; `None` before the first.
    #[must_use]
    pub fn outputs(&self) -> Option<Outputs<'_>> {
        Some(Outputs {
            measurements: self.wires.at_source()?,
            nav: self.wires.at_source()?,
            reference: self.wires.at_source()?,
            thrust: self.wires.at_source()?,
        })
    }
}

/// A step of every block.
struct Lap<'a> {
    twin: &'a mut Twin,
    tick: Tick,
}

impl RingVisitor for Lap<'_> {
    fn block<B: RingBlock>(&mut self) {
        let (tick, twin) = (self.tick, &mut *self.twin);
        let block = B::of_mut(&mut twin.blocks);
        let out = block.step(tick, twin.wires.input::<B>(tick));
        let (events, dropped) = (&mut twin.events, &mut twin.events_dropped);
        twin.watches[B::PLACE].after(tick, block, &out, |event| *dropped += u64::from(events.try_push(event).is_err()));
        twin.wires.send(tick.k, out);
    }
}

/// The hash of every block.
struct Hash<'a> {
    twin: &'a mut Twin,
    probe: &'a mut DigestProbe,
}

impl RingVisitor for Hash<'_> {
    fn block<B: RingBlock>(&mut self) {
        if let Some(out) = self.twin.wires.at_source::<B::Out>() {
            self.twin.digests[B::PLACE] = block_digest(self.probe, B::of(&self.twin.blocks), out);
        }
    }
}

/// Everything that every block shows.
struct Show<'a, P> {
    twin: &'a Twin,
    probe: &'a mut P,
}

impl<P: Probe> RingVisitor for Show<'_, P> {
    fn block<B: RingBlock>(&mut self) {
        if let Some(out) = self.twin.wires.at_source::<B::Out>() {
            B::of(&self.twin.blocks).observe(self.probe);
            out.observe(self.probe);
        }
    }
}

impl Observe for Twin {
    /// Everything that the blocks and the wires show, in the order of the ring.
    fn observe<P: Probe>(&self, probe: &mut P) {
        if self.outputs().is_some() {
            around(&mut Show { twin: self, probe });
            probe.vector(&signal::link::WITHHELD, &self.wires.withheld().map(|count| count as f64));
        }
    }
}
