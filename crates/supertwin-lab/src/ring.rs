//! The ring: which blocks it has, in which order, and how a trial builds them.
#![allow(non_snake_case, reason = "matrices are capitals, as in the book")]

use crate::config::ConfigError;
use crate::trial_config::ResolvedTrial;
use nalgebra::Vector4;
use std::path::Path;
use supertwin_core::command::{Command, ControllerCommand};
use supertwin_core::message::Thrust;
use supertwin_core::random::Stream;
use supertwin_core::{Block, Tick, Wired};
use supertwin_gnc::control::ControllerSetup;
use supertwin_gnc::{Allocation, Controller, Estimator, Guidance};
use supertwin_model::{Hydrodynamics, Thrusters};
use supertwin_plant::{Plant, PlantConfig, Shadow};

/// The services in the order of the ring.
pub const RING: [&str; 4] = [Plant::NAME, Estimator::NAME, Guidance::NAME, Controller::NAME];

/// A block with its place in the ring.
pub(crate) trait RingBlock: Wired<Out: Default> {
    /// Its index in [`RING`].
    const PLACE: usize;
    /// The one among `blocks`.
    fn of(blocks: &Blocks) -> &Self;
    /// The one among `blocks`.
    fn of_mut(blocks: &mut Blocks) -> &mut Self;
    /// The command, if it is one of its own.
    fn own(command: &Command) -> Option<&Self::Command>;
    /// Takes over what a predecessor in another run left it, which its first output shows.
    fn take_over(&mut self, tick: Tick, first: &Self::Out) {
        let _ = (tick, first);
    }
}

macro_rules! ring_block {
    ($place:literal, $block:ident, $field:ident $(, $take_over:item)?) => {
        impl RingBlock for $block {
            const PLACE: usize = $place;
            fn of(blocks: &Blocks) -> &Self {
                &blocks.$field
            }
            fn of_mut(blocks: &mut Blocks) -> &mut Self {
                &mut blocks.$field
            }
            fn own(command: &Command) -> Option<&Self::Command> {
                if let Command::$block(command) = command { Some(command) } else { None }
            }
            $($take_over)?
        }
    };
}
ring_block!(0, Plant, plant);
ring_block!(1, Estimator, estimator);
ring_block!(2, Guidance, guidance);
ring_block!(
    3,
    Controller,
    controller,
    /// An emergency in force outlives a run. Whether it came from there, from the thrust that was found or from a
    /// command of the first tick: demanded before the first step, it is in force in it in each of these cases.
    fn take_over(&mut self, tick: Tick, first: &Thrust) {
        if first.emergency_neutral {
            // Is never refused.
            let _ = self.command(tick, &ControllerCommand::Neutral(true));
        }
    }
);

/// Goes round the ring.
pub(crate) trait RingVisitor {
    /// The next block.
    fn block<B: RingBlock>(&mut self);
}

/// Once round the ring: the order in which the blocks step within a tick. Which message each of them takes, and of which
/// tick, is its own [`Wired::input`].
///
/// ```text
///   ┌──────────────────────────── Prev<Thrust> (z⁻¹) ───────────────┬──────────────────────┐
///   ▼                                                               ▼                      │
/// plant ──Measurements──▶ estimator ──Nav──▶ guidance ──Reference──▶ controller ──Thrust──▶┘
///                            ▲   └───────────────Nav────────────────▲
///                            └── Prev<Thrust>
/// ```
pub(crate) fn around(visitor: &mut impl RingVisitor) {
    visitor.block::<Plant>();
    visitor.block::<Estimator>();
    visitor.block::<Guidance>();
    visitor.block::<Controller>();
}

/// The four blocks of a trial, not yet wired.
#[derive(Clone, Debug)]
pub struct Blocks {
    /// Vehicle, sea and sensors: thrust into measurements, and the true state.
    pub plant: Plant,
    /// Measurements into navigation.
    pub estimator: Estimator,
    /// Set-points into references.
    pub guidance: Guidance,
    /// References into thrust.
    pub controller: Controller,
}

impl Blocks {
    /// Builds the blocks of a trial for one seed. The nominal model is drawn from the stream `nominal`.
    ///
    /// # Errors
    /// When pieces that are legal alone do not fit together.
    pub fn new(trial: &ResolvedTrial, seed: u64) -> Result<Self, ConfigError> {
        Self::build(trial, seed, false)
    }

    /// The same with a plant that moves as the brain's nominal model says: for one that is driven by the disturbance that
    /// an estimator with this model has found.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn nominal(trial: &ResolvedTrial, seed: u64) -> Result<Self, ConfigError> {
        Self::build(trial, seed, true)
    }

    fn build(trial: &ResolvedTrial, seed: u64, as_nominal: bool) -> Result<Self, ConfigError> {
        let wrong = |place: &Path| {
            let path = place.display().to_string();
            move |message: String| ConfigError::Combination { path: path.clone(), message }
        };
        let config = &trial.trial;
        let vehicle = &trial.vehicle;
        let dt_s = config.tick_s.get();
        let thrusters =
            Thrusters::new(&vehicle.thruster).map_err(|error| wrong(&trial.places.vehicle)(error.to_string()))?;
        let nominal = nominal_model(&Hydrodynamics::from(&vehicle.nominal), config.nominal_spread.get(), seed);
        let plant = Plant::new(
            &PlantConfig {
                dynamics: if as_nominal { nominal } else { Hydrodynamics::from(&vehicle.truth) },
                mass_kg: vehicle.truth.rigid_body.mass_kg.get(),
                height_m: vehicle.size_m[2].get(),
                thrusters,
                propulsion: &vehicle.propulsion,
                unmodelled: &vehicle.unmodelled,
                environment: &trial.environment,
                sensors: &trial.sensors,
                start: &config.start,
                dt_s,
                substeps: config.substeps,
                thrust_stale_after_ticks: Tick::at_or_after(trial.safety.plant.thrust_s.get(), dt_s),
            },
            seed,
        )
        .map_err(wrong(&trial.places.vehicle))?;
        let estimator = Estimator::new(
            &trial.estimator,
            nominal,
            trial.sensors.dvl.beam_angle_rad.get(),
            &trial.safety.estimator,
            dt_s,
        );
        let guidance = Guidance::new(&trial.guidance, trial.safety.guidance.nav_s.get(), dt_s);
        let laws = std::iter::once((trial.controller_name.clone(), &trial.controller.law))
            .chain(trial.standby.iter().map(|(name, config)| (name.clone(), &config.law)))
            .collect();
        let controller = Controller::new(&ControllerSetup {
            laws,
            model: nominal,
            allocation: Allocation::new(thrusters, vehicle.propulsion.dead_band_n.get(), &vehicle.allocation),
            limits: &trial.safety.controller,
            fallback: &trial.safety.fallback,
            dt_s,
        })
        .map_err(wrong(&trial.places.controller))?;
        Ok(Self { plant, estimator, guidance, controller })
    }

    /// The plant of these blocks beside a real vehicle.
    #[must_use]
    pub fn shadow(self) -> Shadow {
        Shadow::new(self.plant)
    }
}

/// The brain's model: every inertia and damping wrong by a factor drawn from `1 ± spread`.
fn nominal_model(model: &Hydrodynamics, spread: f64, seed: u64) -> Hydrodynamics {
    let mut stream = Stream::new(seed, "nominal");
    let mut factors = || Vector4::from_fn(|_, _| stream.uniform(1.0 - spread, 1.0 + spread));
    let (M, D_l, D_q) = (factors(), factors(), factors());
    model.perturbed(&M, &D_l, &D_q)
}
