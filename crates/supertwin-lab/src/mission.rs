//! Missions: timed commands of the same type that network clients send.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::Tick;
use supertwin_core::check::NonNegative;
use supertwin_core::command::{Command, ControllerCommand, EstimatorCommand, GuidanceCommand, PlantCommand};

/// A command and its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MissionStep {
    /// Seconds from the start of the run.
    pub at_s: NonNegative,
    /// Command that applies at that time.
    pub command: Command,
}

/// Commands in the order of their ticks; of equal ticks, in the order of the file.
#[derive(Clone, Debug, Default)]
pub struct Mission {
    /// All commands with their ticks.
    pub steps: Vec<(u64, Command)>,
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
}

/// A mission taken apart: each service plays its own part, at the same ticks.
#[derive(Clone, Debug, Default)]
pub struct Parts {
    /// Faults for the plant, by tick.
    pub plant: Vec<(u64, PlantCommand)>,
    /// For the estimator.
    pub estimator: Vec<(u64, EstimatorCommand)>,
    /// Set-points and modes.
    pub guidance: Vec<(u64, GuidanceCommand)>,
    /// Laws, gains, neutral.
    pub controller: Vec<(u64, ControllerCommand)>,
}

impl Parts {
    /// # Errors
    /// When the mission disturbs the wires, which only a batch run can do: over a network they are real.
    pub fn of(mission: &Mission) -> Result<Self, String> {
        let mut parts = Self::default();
        for (tick, command) in &mission.steps {
            match command.clone() {
                Command::Plant(command) => parts.plant.push((*tick, command)),
                Command::Estimator(command) => parts.estimator.push((*tick, command)),
                Command::Guidance(command) => parts.guidance.push((*tick, command)),
                Command::Controller(command) => parts.controller.push((*tick, command)),
                Command::Link(_) => {
                    return Err(
                        "the mission has command.link, which disturbs wires in batch only; over a network cut \
                                the real link"
                            .to_owned(),
                    );
                }
            }
        }
        Ok(parts)
    }
}
