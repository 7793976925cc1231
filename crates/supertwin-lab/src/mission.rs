//! Missions: timed commands of the same type that network clients send.

use serde::{Deserialize, Serialize};
use supertwin_core::Tick;
use supertwin_core::check::NonNegative;
use supertwin_core::command::Command;

/// A command and its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MissionStep {
    /// Seconds from the start of the run.
    pub at_s: NonNegative,
    /// What then.
    pub command: Command,
}

/// Commands in the order of their ticks; of equal ticks, in the order of the file.
#[derive(Clone, Debug, Default)]
pub struct Mission {
    steps: Vec<(u64, Command)>,
    next: usize,
}

impl Mission {
    /// From a trial's steps.
    #[must_use]
    pub fn new(steps: &[MissionStep], dt_s: f64) -> Self {
        let mut steps: Vec<(u64, Command)> =
            steps.iter().map(|step| (Tick::at_or_after(step.at_s.get(), dt_s), step.command.clone())).collect();
        steps.sort_by_key(|(tick, _)| *tick);
        Self { steps, next: 0 }
    }

    /// The next command that applies at `tick`, if there is one left.
    pub fn due(&mut self, tick: Tick) -> Option<&Command> {
        let (at, command) = self.steps.get(self.next)?;
        (*at <= tick.k).then(|| {
            self.next += 1;
            command
        })
    }

    /// Commands that have not been due yet.
    #[must_use]
    pub fn rest(&self) -> &[(u64, Command)] {
        &self.steps[self.next..]
    }

    /// All commands with their ticks.
    #[must_use]
    pub fn steps(&self) -> &[(u64, Command)] {
        &self.steps
    }
}
