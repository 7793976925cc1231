//! The plant beside a real vehicle: it takes the thrust that the vehicle takes, and says what it would have measured.
//!
//! The vehicle's driver owns the time and writes `plant/measurements`; whatever the shadow says is on keys of its own.
//! Nothing pulls it back to the vehicle: the difference of the two is what the model does not know.

use crate::plant::Plant;
use core::f64::consts::TAU;
use serde::{Deserialize, Serialize};
use std::sync::OnceLock;
use supertwin_core::command::PlantCommand;
use supertwin_core::message::{Measurements, Message, Thrust, Truth};
use supertwin_core::port::MessageVisitor;
use supertwin_core::{
    Block, Input, Notice, Notices, Observe, OperatorLink, PortRule, Prev, Probe, Refusal, Signal, Tick, Wired, Wires,
    signal,
};

/// Ticks without a word of the driver that are made up for; after more, the shadow goes on from where it was.
const CATCH_UP: u64 = 500;

/// What the shadow's sensors deliver.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ShadowMeasurements(pub Measurements);

/// Where the shadow is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ShadowTruth(pub Truth);

impl Observe for ShadowMeasurements {
    fn observe<P: Probe>(&self, probe: &mut P) {
        self.0.observe(&mut Renamed(probe));
    }
}
impl Message for ShadowMeasurements {
    const KEY: &'static str = "shadow/plant/measurements";
}
impl Observe for ShadowTruth {
    fn observe<P: Probe>(&self, probe: &mut P) {
        self.0.observe(&mut Renamed(probe));
    }
}
impl Message for ShadowTruth {
    const KEY: &'static str = "shadow/plant/truth";
}

/// The vehicle's last readings less the shadow's truth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Residual {
    depth_m: f64,
    heading_rad: f64,
    yaw_rate_rad_per_s: f64,
    velocity_m_per_s: [f64; 3],
}

/// A plant in the shadow of a vehicle.
#[derive(Clone, Debug)]
pub struct Shadow {
    plant: Plant,
    truth: ShadowTruth,
    residual: Residual,
    next: Option<u64>,
    left_out: u64,
}

impl Shadow {
    /// Of this plant.
    #[must_use]
    pub fn new(plant: Plant) -> Self {
        Self { truth: ShadowTruth(plant.truth.clone()), plant, residual: Residual::default(), next: None, left_out: 0 }
    }

    fn compare(&mut self, measured: &Measurements) {
        let (truth, residual) = (&self.truth.0, &mut self.residual);
        if let Some(sample) = &measured.depth {
            residual.depth_m = sample.depth_m - truth.depth_m;
        }
        if let Some(sample) = &measured.compass {
            let turn = (sample.heading_rad - truth.heading_rad) / TAU;
            residual.heading_rad = TAU * (turn - libm::rint(turn));
        }
        if let Some(sample) = &measured.gyro {
            residual.yaw_rate_rad_per_s = sample.yaw_rate_rad_per_s - truth.velocity.yaw_rad_per_s;
        }
        if let Some(velocity) = measured.dvl.as_ref().and_then(|ping| ping.velocity_m_per_s) {
            let [surge, sway, heave, _] = truth.velocity.to_array();
            residual.velocity_m_per_s = [velocity[0] - surge, velocity[1] - sway, velocity[2] - heave];
        }
    }
}

/// What the shadow consumes: the vehicle's measurements of the tick, and the thrust of the tick before.
#[derive(Clone, Copy, Debug)]
pub struct ShadowInput<'a> {
    /// Of the vehicle: they tell the time, and what the shadow is compared with.
    pub measurements: Input<&'a Measurements>,
    /// What the vehicle was given.
    pub thrust: Prev<Input<&'a Thrust>>,
}

impl Block for Shadow {
    const NAME: &'static str = "shadow";
    type In<'a> = ShadowInput<'a>;
    type Out = ShadowMeasurements;
    type Command = PlantCommand;

    /// Goes on to the driver's tick, also over ticks of which nothing was heard.
    fn step(&mut self, tick: Tick, input: ShadowInput<'_>) -> ShadowMeasurements {
        let first = self.next.unwrap_or(tick.k).min(tick.k);
        let from = first.max(tick.k.saturating_sub(CATCH_UP));
        self.left_out += from - first;
        let mut out = Measurements::default();
        for k in from..=tick.k {
            out = self.plant.step(Tick { k, ..tick }, input.thrust);
        }
        self.next = Some(tick.k + 1);
        self.truth.0.clone_from(&self.plant.truth);
        if let Input::Fresh(measured) = input.measurements {
            self.compare(measured);
        }
        ShadowMeasurements(out)
    }

    fn notices(&self, out: Option<&ShadowMeasurements>) -> Notices {
        let mut notices = self.plant.notices(out.map(|out| &out.0));
        // Room for eight, and the plant has one.
        let shadow = Notice::either(self.left_out > 0, "shadow", "out of step", "in step");
        let _ = notices.try_push(shadow.with_consequence("the driver was silent for too long"));
        notices
    }

    fn command(&mut self, tick: Tick, command: &PlantCommand) -> Result<(), Refusal> {
        self.plant.command(tick, command)
    }
}

impl Wired for Shadow {
    fn input<'a>(wires: &mut impl Wires<'a>, _: OperatorLink) -> ShadowInput<'a> {
        ShadowInput { measurements: wires.newest(PortRule::TRIGGER), thrust: Prev(wires.newest(PortRule::BEFORE)) }
    }

    fn asides<V: MessageVisitor>(&self, visitor: &mut V) {
        visitor.message(&self.truth);
    }
}

impl Observe for Shadow {
    fn observe<P: Probe>(&self, probe: &mut P) {
        self.plant.observe(&mut Renamed(probe));
        let r = &self.residual;
        let [surge, sway, heave] = r.velocity_m_per_s;
        probe.vector(&signal::shadow::RESIDUAL, &[r.depth_m, r.heading_rad, r.yaw_rate_rad_per_s, surge, sway, heave]);
        probe.scalar(&signal::shadow::LEFT_OUT, self.left_out as f64);
    }
}

/// Hands signals on under names of the shadow.
struct Renamed<'a, P>(&'a mut P);

impl<P: Probe> Probe for Renamed<'_, P> {
    fn vector(&mut self, signal: &'static Signal, values: &[f64]) {
        self.0.vector(shadowed(signal), values);
    }
    fn label(&mut self, signal: &'static Signal, value: &'static str) {
        self.0.label(shadowed(signal), value);
    }
}

/// The signal `shadow/…` beside one of the plant's.
fn shadowed(signal: &'static Signal) -> &'static Signal {
    static KNOWN: OnceLock<Vec<(&'static Signal, Signal)>> = OnceLock::new();
    let known =
        KNOWN.get_or_init(|| signal::all().filter(|signal| signal.service() == Plant::NAME).map(renamed).collect());
    known.iter().find(|(theirs, _)| core::ptr::eq(*theirs, signal)).map_or(signal, |(_, ours)| ours)
}

/// Once for the whole program.
fn renamed(signal: &'static Signal) -> (&'static Signal, Signal) {
    let Signal { components, units, about, .. } = *signal;
    (signal, Signal { path: String::leak(format!("shadow/{}", signal.path)), components, units, about })
}

#[cfg(test)]
mod tests {
    use super::*;
    use supertwin_core::message::DepthSample;
    use supertwin_core::observe::Snapshot;

    #[test]
    fn every_signal_of_the_plant_has_another_name_in_the_shadow() {
        let theirs: Vec<_> = signal::all().filter(|signal| signal.service() == "plant").collect();
        assert!(theirs.contains(&&signal::plant::HEALTH) && theirs.contains(&&signal::measurements::gyro::YAW_RATE));
        for signal in theirs {
            assert_eq!(shadowed(signal).path, format!("shadow/{}", signal.path));
            assert_eq!(shadowed(signal).units, signal.units);
        }
        let shown = Snapshot::of(&ShadowTruth::default());
        assert!(shown.vectors.iter().all(|(signal, _)| signal.path.starts_with("shadow/plant/")), "{shown:?}");
    }

    #[test]
    fn its_messages_are_those_of_the_plant_on_other_keys() {
        let measured =
            Measurements { depth: Some(DepthSample { taken_at_s: 1.0, depth_m: 2.0 }), ..Default::default() };
        let plain = serde_json::to_string(&measured).expect("JSON");
        assert_eq!(serde_json::to_string(&ShadowMeasurements(measured)).expect("JSON"), plain);
        assert_eq!(ShadowMeasurements::KEY, format!("shadow/{}", Measurements::KEY));
        assert_eq!(ShadowTruth::KEY, format!("shadow/{}", Truth::KEY));
    }
}
