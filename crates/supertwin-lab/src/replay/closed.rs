//! The whole ring again, with a plant that is driven by the disturbance which the estimator found in a recording.
//!
//! The estimator explains the measured motion by `M ν̇ + C(ν) ν + D(ν) ν + g = τ + b` with its own nominal model. A plant
//! that obeys this equation and is driven by the recorded `b` moves as the recorded vehicle did, as far as the filter could
//! follow, when it gets the recorded thrust; with other thrust it moves as that vehicle would have if `b` had been the
//! same. That is an approximation, good near the recorded motion:
//!
//! * `b` is what a filter makes of it: what is faster than the filter (a wave, a thruster's lag) is damped and late.
//! * `b` is taken as fixed in space and time. A vehicle at another place, depth or speed would have met another drag.
//! * Nothing but the net, the sensors and the thrusters is left of the trial's plant: no current, no waves, no tether.

use super::change::Changed;
use super::{Replay, ReplayError};
use crate::ring::Blocks;
use crate::run::{self, RunOutcome, play};
use crate::twin::Twin;
use supertwin_core::command::{Command, LinkCommand};
use supertwin_core::message::WrenchRequest;
use supertwin_core::run::Properties;
use supertwin_core::signal::{self, Component};
use supertwin_core::source::Columns;
use supertwin_core::{Event, EventKind, OperatorLink, RunHeader, RunSink, Severity, Signal, Tick, Wrench};
use supertwin_plant::Drive;

/// The heading at which the disturbance was found.
const HEADING: Component = signal::nav::POSE.at("heading");

/// What became of a run in a closed loop.
#[derive(Clone, Debug)]
pub struct Closed {
    /// Scores and hash.
    pub outcome: RunOutcome,
    /// Ticks at which no disturbance was recorded, or none that is a number: the last one went on.
    pub held: u64,
}

/// The recorded disturbance tick by tick.
struct Recorded<'a> {
    disturbance: &'a Columns,
    pose: &'a Columns,
    last: Drive,
    held: u64,
}

impl Recorded<'_> {
    fn at(&mut self, tick: u64) -> Drive {
        let row = |columns: &Columns| columns.at(tick.cast_signed()).map(<[f64]>::to_vec);
        let found = row(self.disturbance).zip(row(self.pose)).and_then(|(b, pose)| {
            let b: [f64; 4] = b.try_into().ok()?;
            let heading_rad = HEADING.of(&pose)?;
            let usable = b.iter().chain([&heading_rad]).all(|x| x.is_finite());
            usable.then(|| Drive::from_body(&Wrench::from(b), heading_rad))
        });
        match found {
            Some(drive) => self.last = drive,
            None => self.held += 1,
        }
        self.last
    }
}

impl Replay<'_> {
    /// Ticks of a run in a closed loop.
    #[must_use]
    pub fn closed_ticks(&self) -> u64 {
        self.plan.last() + 1
    }

    /// The ring in a closed loop, from the start of the recorded trial on, under the commands that applied in the run;
    /// `go_on` as in [`crate::run()`].
    ///
    /// # Errors
    /// When a change breaks a rule, no disturbance was recorded, or the sink can't keep the run.
    pub fn closed_loop<S: RunSink>(
        &self,
        changed: &Changed,
        provenance: &Properties,
        sink: &mut S,
        go_on: impl FnMut(u64) -> bool,
    ) -> Result<Closed, ReplayError> {
        let columns = |signal: &Signal| {
            let columns = self.source.signal(signal).filter(|columns| columns.width == signal.width());
            columns.ok_or_else(|| {
                let (run, path) = (&self.source.name, signal.path);
                ReplayError::Change(format!("{run}: {path} was not recorded: a closed loop needs it"))
            })
        };
        let mut drives = Recorded {
            disturbance: columns(&signal::nav::DISTURBANCE)?,
            pose: columns(HEADING.signal)?,
            last: Drive::default(),
            held: 0,
        };
        let mut trial = changed.apply(&self.trial)?;
        let properties = self.about(&trial, changed, "closed loop", provenance)?;
        trial = super::what_if::with_commands(&trial, &self.plan)?;
        if !self.plan.batch {
            self.links(&mut trial);
        }
        let seed = self.seed();
        let header = RunHeader {
            name: format!("{}-closed-loop", self.source.name),
            properties,
            scene: run::scene(&trial, seed)?,
        };
        let twin = Twin::of(Blocks::nominal(&trial, seed)?);
        let ticks = self.closed_ticks();
        let (recording, changed) = (self.source.name.clone(), changed.words.clone());
        let what = EventKind::ReplayedClosedLoop { recording, changed };
        let announced = Event::new(0, "replay", Severity::Info, what);
        let before = |twin: &mut Twin, tick: Tick, sink: &mut S| {
            twin.drive(drives.at(tick.k));
            if tick.k == 0 { sink.event(&announced) } else { Ok(()) }
        };
        let outcome = play(&trial, twin, ticks, Some(&header), sink, before, go_on)?;
        Ok(Closed { outcome, held: drives.held })
    }

    /// What came over the network beside commands: an operator who was lost, an external controller.
    fn links(&self, trial: &mut crate::ResolvedTrial) {
        let dt_s = self.plan.tick_s;
        let mut add = |tick: u64, command: LinkCommand| {
            if let Ok(at_s) = (tick as f64 * dt_s).try_into() {
                trial.trial.mission.push(crate::mission::MissionStep { at_s, command: Command::Link(command) });
            }
        };
        let guidance = &self.plan.parts[2];
        for step in guidance.instances.iter().flat_map(|instance| &instance.steps) {
            if step.operator == OperatorLink::Lost {
                add(step.tick, LinkCommand::OperatorLostForS(dt_s));
            }
        }
        for tick in self.messages.ticks::<WrenchRequest>(None, self.plan.last()) {
            if let Some((_, request)) = self.messages.at::<WrenchRequest>(tick, "") {
                add(tick, LinkCommand::WrenchRequest { request: request.clone(), for_s: dt_s });
            }
        }
    }
}
